"""The node ``hub`` with hardware: the motion controller behind a serial port."""

from __future__ import annotations

import time
from pathlib import Path

import rclpy

from beam_ros.excitation.plan import tip_guard
from beam_ros.hub.contract import Hub
from beam_ros.hub.line.driver import DriverHub
from beam_ros.rig.rig import Rig
from beam_ros.shell.hub_topics import HubNode
from beam_ros.shell.node import run_node

_LOOK_AGAIN_S = 0.05


class HubDriver(HubNode):
    """The real rig's hub."""

    def __init__(self) -> None:
        super().__init__("hub_driver", _connect)


def _connect(rig: Rig) -> Hub:
    port = Path(rig.serial.port)
    end = time.monotonic() + rig.serial.patience
    while not port.exists() and time.monotonic() < end and rclpy.ok():
        time.sleep(_LOOK_AGAIN_S)
    return DriverHub(rig.axis_parameters(), rig.link_parameters(), guard=tip_guard(rig))


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(HubDriver, argv)
