"""A pytest plug-in: which worker runs what (pytest-xdist).

A file stays in one worker, where its fixtures are made once. All that starts rigs goes to one worker and begins
first, since two rigs at a time would compete for a processor; all that serves a port or waits for a clock goes to
another. Beside these all else lets them go first.
"""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

import pytest

LIVE = {
    "rigs": (
        *(f"tests/beam_ros/{room}/" for room in ("launching", "nodes", "shell")),
        "tests/beam_ros/bags/test_bag_",
        "tests/firmware/test_host_build.py",
        "tests/packaging/test_plug_in.py",
        "tests/docs/test_tutorials.py",
    ),
    "ports": (
        "tests/beam_ros/hub/emulated/",
        *(f"tests/beam_ros/hub/line/test_{name}.py" for name in ("connection", "driver", "transport")),
        *(f"tests/beam_ros/hub/links/test_{name}.py" for name in ("csv_board", "host_paced_hub", "probe")),
        "tests/beam_ros/bags/live/",
        "tests/beam_ros/view/test_server.py",
        "tests/beam_ros/experiments/test_conduct.py",
    ),
}
"""Rooms and files with tests that start rigs of several nodes, and with tests of one part against a clock."""

_BACKGROUND = 10
"""Niceness of a worker once it runs what has no clock."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One worker for each processor, and one for what mostly waits: for a clock, a port, a process."""
    return len(os.sched_getaffinity(0)) + 1 if config.getoption("--all") else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep every file in one worker, and with slow tests all of one live kind."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _live(config, nodeid) or nodeid.partition("::")[0]

    config.option.loadscopereorder = False
    return ByFile(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the rigs, and go on with the files of many tests, so that the last ones are short."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    sizes = Counter(_file(item) for item in items)
    places = {kind: place for place, kind in enumerate((*LIVE, ""))}
    items.sort(key=lambda item: (places[_live(config, item.nodeid)], -sizes[_file(item)]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let what has no clock wait for the processor."""
    is_beside = "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "nice") and item.config.getoption("--all")
    if is_beside and not _live(item.config, item.nodeid) and os.nice(0) < _BACKGROUND:
        os.nice(_BACKGROUND)


def _live(config: pytest.Config, test: str) -> str:
    """Return the kind of a test that is live, and nothing of any other."""
    kinds = (kind for kind, places in LIVE.items() if test.startswith(places))
    return next(kinds, "") if config.getoption("--all") else ""


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
