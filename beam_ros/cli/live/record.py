"""Record every topic of a running rig into a bag until Ctrl-C; the same as the node `bag_recorder`."""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.process.executables import run_executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "bag", nargs="?", type=Path, metavar="BAG", help="folder of the new bag (default: runs/<date>)"
    )
    parser.add_argument("--images", action="store_true", help="record camera frames too")
    parser.add_argument(
        "--max-size",
        type=int,
        metavar="MB",
        help="begin another file of the bag after so much (default: never)",
    )
    parser.add_argument(
        "--max-duration",
        type=float,
        metavar="SECONDS",
        help="begin another file after so long (default: never)",
    )
    parser.add_argument("--operator", metavar="NAME", help="who runs the experiment (default: the user)")
    parser.add_argument(
        "--rig-file", type=Path, metavar="FILE", help="the rig's parameter file, which the bag then carries"
    )
    parser.add_argument("--namespace", default="", help="ROS namespace of the rig")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    words = ["--ros-args", "-p", f"recorder.images:={str(arguments.images).lower()}"]
    if arguments.bag is not None:
        if arguments.bag.exists():
            raise UsageError(f"{arguments.bag}: exists already; give a folder that does not")
        words += ["-p", f"recorder.path:={arguments.bag.resolve()}"]
    if arguments.rig_file is not None:
        words += ["--params-file", str(arguments.rig_file)]
    if arguments.max_size is not None:
        words += ["-p", f"recorder.max_size:={arguments.max_size}"]
    if arguments.max_duration is not None:
        words += ["-p", f"recorder.max_duration:={arguments.max_duration}"]
    if arguments.operator is not None:
        quoted = arguments.operator.replace("'", "''")
        words += ["-p", f"recorder.operator:='{quoted}'"]
    if arguments.namespace:
        words += ["-r", f"__ns:=/{arguments.namespace.strip('/')}"]
    return run_executable("bag_recorder", words)
