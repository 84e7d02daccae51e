"""A camera that sends frames of 2 MB at once, best effort. Run as a process, until it is ended."""

from __future__ import annotations

import os
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node

from beam_ros import messages
from beam_ros.interfaces import graph
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import qos_profile


def main(topic: str, count: int) -> None:
    """Wait for a listener, and send so many frames without a pause."""
    widen_shared_memory(os.environ)
    rclpy.init(args=[])
    node = Node("large_frames_camera")
    types = messages.RosTypes()
    qos = graph.QualityOfService(count, is_reliable=False)
    publisher = node.create_publisher(types.message_class("sensor_msgs/msg/Image"), topic, qos_profile(qos))
    while publisher.get_subscription_count() == 0:
        time.sleep(0.02)
    # The listener's side of the match may be later than this side.
    time.sleep(0.5)
    for k in range(count):
        publisher.publish(messages.image(types, k + 1, np.full((1080, 1920), k, np.uint8)))
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
