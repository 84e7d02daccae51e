"""A camera as foreign drivers are: best effort and latched. Run as a process, until it is ended."""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node

from beam_ros import messages
from beam_ros.interfaces import graph
from beam_ros.rig.rig import Rig
from beam_ros.shell.node import qos_profile
from beam_ros.vision.rendering.frames import SceneRenderer


def main(topic: str) -> None:
    """Publish frames with all markers at 1 mm, 50 a second."""
    rig = Rig.from_file()
    pixels = SceneRenderer(rig.camera_parameters(), rig.markers.heights).render(
        np.full(3, 1e-3), np.random.default_rng(0)
    )
    rclpy.init(args=[])
    node = Node("foreign_camera")
    types = messages.RosTypes()
    qos = graph.QualityOfService(5, is_reliable=False, is_latched=True)
    publisher = node.create_publisher(types.message_class("sensor_msgs/msg/Image"), topic, qos_profile(qos))
    while True:
        publisher.publish(messages.image(types, time.time_ns(), pixels))
        time.sleep(0.02)


if __name__ == "__main__":
    main(sys.argv[1])
