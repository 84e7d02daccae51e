"""A pytest plug-in: which worker runs what (pytest-xdist).

A file stays in one worker, where its fixtures are made once. All that starts rigs goes to one worker and begins
first, since two rigs at a time would compete for a processor; beside it all else lets the rigs go first.
"""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

import pytest

LIVE = (
    *(f"tests/beam_ros/{room}/" for room in ("launching", "nodes", "shell")),
    "tests/beam_ros/bags/test_bag_",
    "tests/firmware/test_host_build.py",
    "tests/packaging/test_plug_in.py",
)
"""Rooms and files with tests that start rigs of several nodes."""

_BACKGROUND = 10
"""Niceness of a worker once it runs what has no clock."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One worker for each processor, and one for what mostly waits: for a clock, a port, a process."""
    return len(os.sched_getaffinity(0)) + 1 if config.getoption("--all") else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep every file in one worker, and with slow tests all that is live."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "live" if config.getoption("--all") and file.startswith(LIVE) else file

    config.option.loadscopereorder = False
    return ByFile(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the rigs, and go on with the files of many tests, so that the last ones are short."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    sizes = Counter(_file(item) for item in items)
    items.sort(key=lambda item: (not _is_live(config, item), -sizes[_file(item)]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let what has no clock wait for the processor."""
    is_beside = "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "nice") and item.config.getoption("--all")
    if is_beside and not _is_live(item.config, item) and os.nice(0) < _BACKGROUND:
        os.nice(_BACKGROUND)


def _is_live(config: pytest.Config, item: pytest.Item) -> bool:
    return bool(config.getoption("--all")) and item.nodeid.startswith(LIVE)


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
