"""Play a bag back onto its topics, header stamps untouched; the same as the node `bag_player`.

What moves an axis is left out, and nothing is played while a live hub is on the graph.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.process.executables import run_executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag")
    parser.add_argument("--rate", type=float, default=1.0, help="speed of the replay (default: 1)")
    parser.add_argument("--commands", action="store_true", help="also replay what moves an axis")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    words = [
        "--ros-args",
        *("-p", f"player.bag:={arguments.bag.resolve()}"),
        *("-p", f"player.rate:={arguments.rate}"),
        *("-p", f"player.commands:={str(arguments.commands).lower()}"),
    ]
    return run_executable("bag_player", words)
