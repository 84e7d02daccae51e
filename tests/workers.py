"""A pytest plug-in: which worker runs what (pytest-xdist).

A file stays in one worker, where its fixtures are made once. Everything that waits for a clock goes to one worker,
since two rigs at a time would compete for a processor; beside it what has no clock lets the rigs go first.
"""

from __future__ import annotations

import os
from typing import Any

import pytest

LIVE = (
    *(f"tests/beam_ros/{room}/" for room in ("bags", "hub", "launching", "nodes", "shell")),
    "tests/beam_ros/experiments/test_conduct.py",
    "tests/firmware/test_host_build.py",
    "tests/packaging/",
)
"""Rooms and files with tests that start nodes, ports or processes."""

_BACKGROUND = 10
"""Niceness of a worker once it runs what has no clock."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep every file in one worker, and with slow tests all that is live."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "live" if config.getoption("--all") and file.startswith(LIVE) else file

    return ByFile(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let what has no clock wait for the processor."""
    is_beside = "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "nice") and item.config.getoption("--all")
    if is_beside and not item.nodeid.startswith(LIVE) and os.nice(0) < _BACKGROUND:
        os.nice(_BACKGROUND)
