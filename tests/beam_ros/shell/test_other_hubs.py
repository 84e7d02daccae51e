"""Two hubs on one graph: real processes."""

from __future__ import annotations

import signal

import pytest

from beam_ros import messages

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")

QUIET = ("--ros-args", "-p", "simulation.images:=false")


def test_the_second_hub_on_a_graph_is_refused_and_the_first_goes_on(executables, graph) -> None:
    modes = []
    graph.listen("hub/mode", modes.append)
    first = executables.start("simulator", *QUIET)
    graph.wait(lambda: bool(modes), "a hub", 20.0)
    second = executables.start("simulator", *QUIET)
    # On a busy computer the first is found after the second has started: then it is told of, and not refused.
    second.wait_for("another hub is on this graph", 60.0)
    assert "end one of them, or give this one another namespace or ROS_DOMAIN_ID" in second.output()
    if "simulator:" in second.output():
        assert second.wait(60.0) == 2
    else:
        second.send_signal(signal.SIGINT)
        second.wait(60.0)
    assert first.process.poll() is None
    # In a namespace of its own it is no rival.
    apart = executables.start("simulator", *QUIET, "-r", "__ns:=/other")
    graph.wait(lambda: ("hub", "/other") in graph.node.get_node_names_and_namespaces(), "the other rig", 20.0)
    graph.spin(1.0)
    assert apart.process.poll() is None


def test_a_hub_that_comes_unseen_is_reported_by_the_one_that_is_there(executables, graph) -> None:
    import rclpy

    health = []
    graph.listen("/diagnostics", lambda m: health.extend(messages.read_diagnostics(m)))
    hub = executables.start("simulator", *QUIET)
    graph.wait(lambda: any(h.hardware_id == "hub" and h.level == "OK" for h in health), "a healthy hub", 20.0)
    rival = rclpy.create_node("hub", context=graph.node.context)
    try:
        graph.wait(
            lambda: any(h.level == "ERROR" and "another hub is on this graph" in h.message for h in health),
            "its report",
            10.0,
        )
        hub.wait_for("another hub is on this graph")
    finally:
        rival.destroy_node()
    health.clear()
    graph.wait(lambda: any(h.hardware_id == "hub" and h.level == "OK" for h in health), "health again")
