"""A pytest plug-in: what tests cost by room (`--costs`), and which quick tests are none."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Generator
from typing import Any

import pytest

QUICK_S = 2.0
"""Processor time of a quick test [s], with its share of what the tests of its file set up together."""

_PHASES = ("setup", "call", "teardown")
_costs: dict[str, dict[str, tuple[float, float]]] = {}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer `--costs`."""
    parser.addoption("--costs", action="store_true", help="end with a table of seconds and tests by room")


def _clocks() -> tuple[float, float]:
    used = os.times()
    return time.monotonic(), used.user + used.system + used.children_user + used.children_system


def _timed(item: pytest.Item, phase: str) -> Generator[None, Any, Any]:
    begun = _clocks()
    try:
        return (yield)
    finally:
        item.user_properties.append((phase, tuple(b - a for a, b in zip(begun, _clocks(), strict=True))))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, Any, Any]:
    """Note what the fixtures cost."""
    return (yield from _timed(item, "setup"))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Note what the test itself costs, with the processes that it waited for."""
    return (yield from _timed(item, "call"))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, Any, Any]:
    """Note what the end of the fixtures costs."""
    return (yield from _timed(item, "teardown"))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect the costs where the results come together."""
    if report.when == "teardown":
        _costs[report.nodeid] = {name: value for name, value in report.user_properties if name in _PHASES}


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print the table, and name the quick tests that are none."""
    rooms: dict[str, list[float]] = defaultdict(lambda: [0.0] * 5)
    for test, costs in _costs.items():
        room = rooms[os.path.dirname(test.partition("::")[0])]
        room[0] += 1
        for k, phase in enumerate(_PHASES):
            wall_s, processor_s = costs.get(phase, (0.0, 0.0))
            room[k + 1] += wall_s
            room[4] += processor_s
    if config.getoption("--costs"):
        terminalreporter.write_line(f"{'tests':>6}{'set-up':>9}{'call':>9}{'end':>9}{'processor':>11}  [s]")
        total = [sum(column) for column in zip(*rooms.values(), strict=True)]
        for name, row in [*sorted(rooms.items(), key=lambda pair: -pair[1][4]), ("in all", total)]:
            numbers = "".join(f"{value:9.1f}" for value in row[1:4])
            terminalreporter.write_line(f"{row[0]:6.0f}{numbers}{row[4]:11.1f}  {name}")
    if not (config.getoption("--all") or config.getoption("--verify")):
        for test, taken_s in _shares().items():
            if taken_s > QUICK_S:
                terminalreporter.write_line(
                    f"{test} took {taken_s:.1f} s of processor time; expected at most {QUICK_S:g} s: "
                    "make it quicker, or mark it slow"
                )


def _shares() -> dict[str, float]:
    """Return the processor time of each test's own part and its share of its file's fixtures [s]."""
    files = defaultdict(list)
    for test in _costs:
        files[test.partition("::")[0]].append(test)
    shared_s = {
        file: sum(_processor_s(test, "setup") + _processor_s(test, "teardown") for test in tests) / len(tests)
        for file, tests in files.items()
    }
    return {test: _processor_s(test, "call") + shared_s[test.partition("::")[0]] for test in _costs}


def _processor_s(test: str, phase: str) -> float:
    return _costs[test].get(phase, (0.0, 0.0))[1]
