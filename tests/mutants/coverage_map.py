"""A pytest plug-in: notes which test runs which line, and how long each test takes.

The lines that a fixture of several tests runs are noted for the whole file, since each of its tests may be
the one that sees a mutation there. Processes that a test starts read their context from the environment
(see ``coverage.ini``).
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import coverage
import pytest

_durations_s: dict[str, float] = defaultdict(float)


def _switch(context: str) -> None:
    measuring = coverage.Coverage.current()
    if measuring is not None:
        measuring.switch_context(context)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Note what the test itself runs."""
    _switch(item.nodeid)
    try:
        return (yield)
    finally:
        _switch("")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: Any) -> Generator[None, Any, Any]:
    """Note what a fixture of several tests runs for all of their file."""
    if fixturedef.scope == "function":
        return (yield)
    _switch(request.node.nodeid)
    try:
        return (yield)
    finally:
        _switch(request._pyfuncitem.nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up a test's set-up, call and teardown."""
    if not report.failed and not report.skipped:
        _durations_s[report.nodeid] += report.duration
    else:
        _durations_s.pop(report.nodeid, None)


def pytest_sessionfinish() -> None:
    """Write the durations of the tests that passed."""
    path = Path(os.environ["MUTANTS_CACHE"]) / "durations.json"
    path.write_text(json.dumps(_durations_s, indent=0))
