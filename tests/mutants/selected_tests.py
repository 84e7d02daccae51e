"""A pytest plug-in: runs the tests of a list in its order, each with a time limit of its own.

Tests that the list does not know yet run first: somebody has just written them.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

_chosen: dict[str, float] = {}
_known: set[str] = set()


def pytest_configure() -> None:
    """Read the list."""
    given = json.loads(Path(os.environ["MUTANTS_SELECTED"]).read_text())
    _chosen.update(given["chosen"])
    _known.update(given["known"])


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the chosen tests and the new ones."""
    rank = {name: k for k, name in enumerate(_chosen)}
    kept = [item for item in items if item.nodeid in _chosen or item.nodeid not in _known]
    items[:] = sorted(kept, key=lambda item: rank.get(item.nodeid, -1))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Fail a test that takes far longer than it did."""
    signal.signal(signal.SIGALRM, _end)
    signal.alarm(int(30 + 10 * _chosen.get(item.nodeid, 3.0)))
    try:
        return (yield)
    finally:
        signal.alarm(0)


def _end(*_: object) -> None:
    pytest.fail("the time limit of this test has passed", pytrace=False)
