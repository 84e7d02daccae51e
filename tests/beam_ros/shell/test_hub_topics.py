"""What the hub's node does with messages that no hub can use, with the simulator as a real process."""

from __future__ import annotations

import time

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_chunk

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def test_a_malformed_chunk_refuses_its_sequence_at_once_and_the_next_one_is_taken(executables, graph) -> None:
    states: list[dict[str, object]] = []
    graph.listen("hub/sequence_state", lambda message: states.append(messages.read_json(message)))
    sequence = graph.publisher("hub/sequence")
    executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    graph.switch_on()
    graph.wait(lambda: sequence.get_subscription_count() > 0, "a hub that listens")

    def chunks(name: str, lead_s: float = 30.0):
        start_ns = graph.node.get_clock().now().nanoseconds + round(lead_s * 1e9)
        return messages.split_sequence(name, start_ns, 1_000_000, np.zeros(1500))

    def send(name: str, spoil, reason: str) -> None:
        good, bad, _ = chunks(name)
        sequence.publish(encode_chunk(good, "acceleration"))
        graph.wait(lambda: bool(states) and states[-1]["id"] == name, "the first chunk")
        sequence.publish(spoil(bad))
        graph.wait(lambda: states[-1]["state"] == "refused", "a refusal")
        assert states[-1]["id"] == name
        assert reason in states[-1]["reason"]

    def two_values_a_point(chunk):
        message = messages.sequence_chunk(graph.types, chunk, "acceleration")
        message.points[3].accelerations.append(1.0)
        return message

    send("uneven", two_values_a_point, "point")
    send("another-mode", lambda chunk: encode_chunk(chunk, "velocity"), "commanded in acceleration")
    for chunk in chunks("whole", 2.0):
        sequence.publish(encode_chunk(chunk, "acceleration"))
    graph.wait(lambda: states[-1]["id"] == "whole" and states[-1]["state"] == "running", "a whole one")


def test_of_a_flood_of_set_points_the_newest_of_each_spin_is_checked(executables, graph) -> None:
    health = []
    graph.listen("/diagnostics", lambda m: health.extend(messages.read_diagnostics(m)))
    publisher = graph.publisher("hub/setpoint")
    executables.start(
        "simulator", "--ros-args", "-p", "simulation.images:=false", "-p", "hub.command_mode:=velocity"
    )

    def refused() -> int:
        # A hub that is not enabled refuses each set-point that it checks.
        return int(health[-1].values["refused set-points"]) if health else 0

    graph.wait(lambda: publisher.get_subscription_count() > 0 and bool(health), "a hub that listens", 20.0)
    begin_s, n_sent = time.monotonic(), 0
    while time.monotonic() < begin_s + 2.0:
        point = messages.StampedSetpoint(time.time_ns(), "velocity", 0.01)
        publisher.publish(messages.setpoint(graph.types, point))
        n_sent += 1
    end_s = time.monotonic()
    # The counters come once a second.
    graph.spin(1.5)
    # A spin is 10 ms; what came last is checked at the end of it.
    n_spins = (end_s - begin_s) / 0.01 + 2
    assert 10 < refused() <= n_spins
    assert n_sent > 2 * refused()
    before = refused()
    publisher.publish(
        messages.setpoint(graph.types, messages.StampedSetpoint(time.time_ns(), "velocity", 0.0))
    )
    graph.wait(lambda: refused() == before + 1, "the last of all")
