"""Turn a bag's signals into CSV files, or into a flat bag with one sample a message for plotting tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.bags.reading import Bag
from beam_ros.cli.options import add_bag, read_span
from beam_ros.offline.export import export_csv, export_flat_bag
from beam_ros.process.progress import Progress
from beam_ros.process.remote_paths import any_path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_bag(parser)
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--csv", type=Path, metavar="DIR", help="new folder for one CSV file a signal")
    target.add_argument("--flat-bag", type=Path, metavar="BAG", help="new bag with one sample a message")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
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
