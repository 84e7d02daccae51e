"""Turn a bag's signals into CSV files, or into a flat bag with one sample a message for plotting tools.

With --viewers, no bag is needed: layouts of PlotJuggler, Foxglove and Lichtblick, a configuration of RViz, and the
qualities of service for `ros2 bag`, for the markers of the rig file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.bags.reading import Bag
from beam_ros.cli.options import add_bag, add_rig_file, read_rig, read_span
from beam_ros.errors import UsageError
from beam_ros.offline.export import export_csv, export_flat_bag
from beam_ros.process.progress import Progress
from beam_ros.process.remote_paths import any_path
from beam_ros.viewers.layouts import write_layouts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_bag(parser, nargs="?")
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--csv", type=Path, metavar="DIR", help="new folder for one CSV file a signal")
    target.add_argument("--flat-bag", type=Path, metavar="BAG", help="new bag with one sample a message")
    target.add_argument("--viewers", type=Path, metavar="DIR", help="new folder for the layouts of viewers")
    parser.add_argument("--namespace", default="", metavar="NAME", help="of the rig, for --viewers")
    add_rig_file(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if (arguments.bag is None) != (arguments.viewers is not None):
        raise UsageError("--viewers takes no bag, --csv and --flat-bag take one; give one or the other")
    if arguments.viewers is not None:
        names = read_rig(arguments).markers.names
        print("\n".join(map(str, write_layouts(arguments.viewers, names, arguments.namespace))))
        return 0
    start_s, end_s = read_span(arguments)
    with Bag(any_path(arguments.bag), start_s=start_s, end_s=end_s) as bag, Progress("export", 1.0) as stage:
        if arguments.csv is not None:
            files = export_csv(bag, arguments.csv, stage.update)
            stage.finish(f"{len(files)} files in {arguments.csv}")
            print("\n".join(str(path) for path in files))
        else:
            count = export_flat_bag(bag, arguments.flat_bag, stage.update)
            stage.finish(f"{count} messages in {arguments.flat_bag}")
            print(arguments.flat_bag)
    return 0
