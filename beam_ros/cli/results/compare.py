"""Compare bags and identified models side by side.

Every argument is a bag, which is identified, or a model.json that `beam identify --report` wrote, or the folder that
holds one. The others are compared with the first: poles, the significance of every difference, responses over each
other. --report writes one page of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("paths", type=Path, nargs="+", metavar="BAG|MODEL", help="two or more bags or models")
    parser.add_argument(
        "--estimator", default="modal", metavar="NAME", help="how to identify bags (default: modal)"
    )
    parser.add_argument("--modes", type=int, help="number of modes of bags (default: from the data)")
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="folder for comparison.html and comparison.json"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace what is in the folder")
    parser.add_argument("--operator", default="", metavar="NAME", help="who answers for the comparison")
    parser.add_argument("--json", action="store_true", help="print the comparison as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.process.folders import new_folder
    from beam_ros.reporting.comparison import compare, write_comparison

    if arguments.report is not None:
        new_folder(arguments.report, arguments.overwrite)
    with Progress("compare", 1.0) as stage:
        found = compare(
            arguments.paths,
            estimator=arguments.estimator,
            n_modes=arguments.modes,
            progress=lambda phrase, share: stage.update(share, phrase),
        )
        stage.finish(f"{len(found.trials)} models")
    print(strict_json(found.to_dict(), indent=2) if arguments.json else found.table())
    if arguments.report is not None:
        page = write_comparison(found, arguments.report, arguments.overwrite, arguments.operator)
        if not arguments.json:
            print(f"report   {page}")
    return 0
