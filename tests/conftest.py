"""What all tests share: a private ROS domain, and real processes that never outlive their test."""

from __future__ import annotations

import importlib.util
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from beam_ros.launching.processes import PrivateDomain, stay_on_this_machine
from tests.real_processes import Executables


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer `--verify`."""
    parser.addoption(
        "--verify", action="store_true", help="run the tests marked `verify`, and only those, at full length"
    )


IN_REAL_TIME = (
    *(f"tests/beam_ros/{room}/" for room in ("bags", "hub", "launching", "nodes", "shell")),
    "tests/beam_ros/experiments/test_conduct.py",
    "tests/firmware/test_host_build.py",
    "tests/packaging/test_colcon.py",
    "tests/packaging/test_environment.py",
    "tests/packaging/test_plug_in.py",
    "tests/test_full_demo.py",
)

IN_VIRTUAL_TIME = ("tests/beam_ros/hub/conformance/",)


_BACKGROUND = 10
"""Niceness of a worker once it runs what has no clock."""


def is_in_real_time(file: str) -> bool:
    """Tell whether a file's tests wait for a clock."""
    return file.startswith(IN_REAL_TIME) and not file.startswith(IN_VIRTUAL_TIME)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With several workers let one take all that runs in real time, and keep every other file in one.

    Two rigs at once would compete for a processor, and a file's fixtures are made once.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "in real time" if is_in_real_time(file) else file

    return ByFile(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Beside a worker that runs in real time, let what has no clock wait for the processor."""
    is_beside = "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "nice")
    if is_beside and not is_in_real_time(item.nodeid) and os.nice(0) < _BACKGROUND:
        os.nice(_BACKGROUND)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep `verify` tests to `--verify`, and skip `ros` tests where ROS 2 is truly absent."""
    is_verifying = config.getoption("--verify")
    left_out = [item for item in items if (item.get_closest_marker("verify") is not None) != is_verifying]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
    if importlib.util.find_spec("rclpy") is None:
        for item in items:
            if item.get_closest_marker("ros") is not None:
                item.add_marker(pytest.mark.skip(reason="no rclpy in this Python; `make test` brings it"))


@pytest.fixture(scope="session", autouse=True)
def _private_ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Nothing of a test session leaves the machine or meets another session's nodes."""
    # What a shell starts in the background ignores Ctrl-C, and so would all processes of the tests.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    domain = PrivateDomain()
    before = dict(os.environ)
    stay_on_this_machine(os.environ, domain.number, tmp_path_factory.mktemp("ros_log"))
    yield
    os.environ.clear()
    os.environ.update(before)
    domain.release()


@pytest.fixture
def executables(tmp_path: Path) -> Iterator[Executables]:
    """Start executables: `executables.start("simulator", ...)`, `executables.run("beam", ...)`."""
    started = Executables(tmp_path)
    yield started
    started.close()
