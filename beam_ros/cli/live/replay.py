"""Play a bag back onto its topics, header stamps untouched; the same as the node `bag_player`.

What moves an axis is left out, and nothing is played while a live hub is on the graph.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.process.executables import run_executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag")
    parser.add_argument("--rate", type=float, default=1.0, help="speed of the replay (default: 1)")
    parser.add_argument(
        "--start",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="begin so long after the bag's first message",
    )
    parser.add_argument("--loop", action="store_true", help="begin anew at the end, until Ctrl-C")
    parser.add_argument(
        "--paused", action="store_true", help="stand still at first: `beam call player/step`, `player/pause`"
    )
    parser.add_argument(
        "--clock", action="store_true", help="publish the bag's time on /clock, for use_sim_time"
    )
    parser.add_argument(
        "--remap", action="append", default=[], metavar="TOPIC:=NAME", help="play a topic under another name"
    )
    parser.add_argument("--namespace", default="", help="ROS namespace to play the rig's topics in")
    parser.add_argument("--commands", action="store_true", help="also replay what moves an axis")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    words = [
        "--ros-args",
        *("-p", f"player.bag:={arguments.bag.resolve()}"),
        *("-p", f"player.rate:={arguments.rate}"),
        *("-p", f"player.start:={arguments.start}"),
    ]
    for name in ("commands", "loop", "paused", "clock"):
        words += ["-p", f"player.{name}:={str(getattr(arguments, name)).lower()}"]
    for pair in arguments.remap:
        topic, _, name = pair.partition(":=")
        if not topic or not name:
            raise UsageError(f"--remap {pair}: expected TOPIC:=NAME, such as hub/measured:=old/measured")
        words += ["-r", pair]
    if arguments.namespace:
        words += ["-r", f"__ns:=/{arguments.namespace.strip('/')}"]
    return run_executable("bag_player", words)
