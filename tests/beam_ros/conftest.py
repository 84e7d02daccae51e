"""A node of the test's own on the graph."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture
def graph() -> Iterator[object]:
    pytest.importorskip("rclpy")
    from tests.graph import Graph

    with Graph() as graph:
        yield graph
