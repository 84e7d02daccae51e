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


@pytest.mark.parametrize("takes_all", [True, False])
def test_a_burst_is_taken_in_one_round(graph, takes_all: bool) -> None:
    taken: list[int] = []

    def listen(name, callback, qos, *, raw):
        kind = graph.types.message_class(TOPICS[name].type_name)
        return graph.node.create_subscription(kind, name, callback, qos_profile(qos), raw=raw)

    node = SimpleNamespace(
        listen=listen,
        resolve_topic_name=graph.node.resolve_topic_name,
        get_publishers_info_by_topic=graph.node.get_publishers_info_by_topic,
    )
    frames = MatchedSubscription(
        node,
        TOPICS["camera/image_raw"],
        lambda message: taken.append(read_image(message).stamp_ns),
        depth=DEPTH,
        raw=True,
        takes_all=takes_all,
    )
    camera = graph.publisher("camera/image_raw")
    graph.wait(lambda: frames.follow() or camera.get_subscription_count() > 0, "a match")
    image = messages.image(graph.types, 0, np.zeros((4, 4), dtype=np.uint8))
    for k in range(5):
        image.header.stamp.sec = k
        camera.publish(image)
    time.sleep(0.5)  # until all of them wait
    while not taken:
        rclpy.spin_once(graph.node, timeout_sec=5.0)
    assert taken == [k * 1_000_000_000 for k in range(5 if takes_all else 1)]
