"""Is another hub on this graph? Two would both act on every command."""

from __future__ import annotations

import os
import time

from rclpy.node import Node

from beam_ros.errors import RigUnavailableError

_LOOK_S = 0.5
"""Processes on a graph at rest find each other within 0.25 s; who is found later is reported, not refused."""
_STEP_S = 0.05


def reach() -> str:
    """Say in which domain and how far this process looks for nodes."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return f"ROS_DOMAIN_ID={domain}, range {os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')}"


def count_hubs(node: Node) -> int:
    """Return how many hubs are in a node's namespace, itself included where it is one."""
    found: int = node.get_node_names_and_namespaces().count(("hub", node.get_namespace()))
    return found


def two_hubs() -> str:
    """Say what is wrong with a second hub, and what to do about it."""
    return (
        f"another hub is on this graph ({reach()}): two would act on every command; end one of them, or give this "
        "one another namespace or ROS_DOMAIN_ID"
    )


def refuse_second_hub(hub: Node) -> None:
    """Look round for a moment and raise where another hub is there.

    Parameters
    ----------
    hub : Node -- the hub that starts, and has not touched its axis yet

    Raises
    ------
    RigUnavailableError
    """
    end = time.monotonic() + _LOOK_S
    while hub.context.ok() and time.monotonic() < end:
        if count_hubs(hub) > 1:
            raise RigUnavailableError(two_hubs())
        time.sleep(_STEP_S)
