"""The node ``hub`` with hardware: the motion controller behind the axis link that the rig file chooses."""

from __future__ import annotations

from typing import Any

from beam_ros.shell.axis_links import open_axis
from beam_ros.shell.hub_topics import HubNode
from beam_ros.shell.node import run_node


class HubDriver(HubNode):
    """The real rig's hub."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hub_driver", lambda rig: open_axis(rig, rig.beam_guard()), **options)


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(HubDriver, argv)
