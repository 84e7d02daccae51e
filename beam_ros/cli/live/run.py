"""Run one node in this process, as `ros2 run beam_ros NODE` does in a ROS 2 workspace.

What follows the node's name goes to the node: `beam run simulator --ros-args -p camera.rate:=50.0`.
"""

from __future__ import annotations

import argparse

from beam_ros.cli.options import one_of
from beam_ros.interfaces.graph import NODES
from beam_ros.process.executables import run_executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    width = max(map(len, NODES))
    parser.epilog = "nodes:\n" + "\n".join(f"  {name:<{width}}  {row.meaning}" for name, row in NODES.items())
    parser.add_argument("node", metavar="NODE", type=one_of("node", NODES), help="which node (listed below)")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="for the node")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    return run_executable(arguments.node, arguments.arguments)
