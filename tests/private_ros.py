"""Fixtures of tests that start nodes: a private ROS domain, real processes that never outlive their test, a node."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from beam_ros.launching.processes import PrivateDomain, stay_on_this_machine
from tests.real_processes import Executables


@pytest.fixture(scope="session", autouse=True)
def private_ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
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


@pytest.fixture
def graph() -> Iterator[object]:
    """A node of the test's own on the graph."""
    pytest.importorskip("rclpy")
    from tests.graph import Graph

    with Graph() as graph:
        yield graph
