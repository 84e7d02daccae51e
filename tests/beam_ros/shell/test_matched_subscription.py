"""All that waits is handed over at once, in its order: one round of the executor for a burst of frames."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
import rclpy

from beam_ros import messages
from beam_ros.interfaces.graph import TOPICS
from beam_ros.shell.matched_subscription import MatchedSubscription
from beam_ros.shell.node import qos_profile
from beam_ros.vision.camera.image_messages import read_image

pytestmark = pytest.mark.ros
DEPTH = 8


def subscribed(graph, callback, **options) -> MatchedSubscription:
    def listen(name, callback, qos, **given):
        kind = graph.types.message_class(TOPICS[name].type_name)
        return graph.node.create_subscription(kind, name, callback, qos_profile(qos), **given)

    node = SimpleNamespace(
        listen=listen,
        resolve_topic_name=graph.node.resolve_topic_name,
        get_publishers_info_by_topic=graph.node.get_publishers_info_by_topic,
    )
    return MatchedSubscription(node, TOPICS["camera/image_raw"], callback, depth=DEPTH, raw=True, **options)


def publish_burst(graph, frames: MatchedSubscription, count: int) -> None:
    camera = graph.publisher("camera/image_raw")
    graph.wait(lambda: frames.follow() or camera.get_subscription_count() > 0, "a match")
    image = messages.image(graph.types, 0, np.zeros((4, 4), dtype=np.uint8))
    for k in range(count):
        image.header.stamp.sec = k
        camera.publish(image)
    time.sleep(0.5)  # until all of them wait


@pytest.mark.parametrize("takes_all", [True, False])
def test_a_burst_is_taken_in_one_round(graph, takes_all: bool) -> None:
    taken: list[int] = []
    frames = subscribed(
        graph, lambda message: taken.append(read_image(message).stamp_ns), takes_all=takes_all
    )
    publish_burst(graph, frames, 5)
    while not taken:
        rclpy.spin_once(graph.node, timeout_sec=5.0)
    assert taken == [k * 1_000_000_000 for k in range(5 if takes_all else 1)]


def test_what_wakes_nobody_waits_until_it_is_taken(graph) -> None:
    taken: list[tuple[int, int | None]] = []

    def take(message: bytes, info: dict[str, int | None]) -> None:
        taken.append((read_image(message).stamp_ns, info["received_timestamp"]))

    frames, begun_ns = subscribed(graph, take, wakes=False), time.time_ns()
    publish_burst(graph, frames, 5)
    rclpy.spin_once(graph.node, timeout_sec=0.2)
    assert not taken
    frames.take()
    assert [stamp_ns for stamp_ns, _ in taken] == [k * 1_000_000_000 for k in range(5)]
    assert all(begun_ns < received_ns < time.time_ns() for _, received_ns in taken)
    frames.take()
    assert len(taken) == 5
