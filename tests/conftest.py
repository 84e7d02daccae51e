"""Which tests run: the quick ones, all, or the figures of the documentation.

``make test`` takes the tests that need neither a real clock nor a process, and at most two seconds of processor time
each. ``make test-all`` adds those marked ``slow``, all that start the suite's processes, and of those marked
``first_case`` the other cases.
"""

from __future__ import annotations

import importlib.util

import pytest

pytest_plugins = ["tests.costs", "tests.workers"]

LIVE_FIXTURES = {"executables", "graph"}
"""A test that asks for one of these starts processes or nodes, and waits for a real clock."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer `--all` and `--verify`."""
    parser.addoption("--all", action="store_true", help="run the slow tests as well (`make test-all`)")
    parser.addoption("--slow", action="store_true", help="with --all: without the quick ones")
    parser.addoption(
        "--verify", action="store_true", help="run the tests marked `verify`, and only those, at full length"
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Select by mark, and skip `ros` tests where ROS 2 is truly absent; what a person names by its id runs always."""
    has_ros = importlib.util.find_spec("rclpy") is not None
    is_named = any("::" in name for name in config.args)
    seen: set[str] = set()
    left_out = set()
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        if "ros" in marks or LIVE_FIXTURES & set(getattr(item, "fixturenames", ())):
            marks.add("slow")
        if not has_ros and "ros" in marks:
            item.add_marker(pytest.mark.skip(reason="no rclpy in this Python; `make test` brings it"))
        function = item.nodeid.partition("[")[0]
        is_quick = "slow" not in marks and not ("first_case" in marks and function in seen)
        seen.add(function)
        if config.getoption("--verify"):
            is_wanted = "verify" in marks
        else:
            is_run = not config.getoption("--slow") if is_quick else config.getoption("--all")
            is_wanted = "verify" not in marks and is_run
        if not is_wanted and not is_named:
            left_out.add(item)
    if left_out:
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]
