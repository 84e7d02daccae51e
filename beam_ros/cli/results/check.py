"""Check a recorded bag before anything is fitted to it: can it be identified, and if not why.

Prints the answer in one line, and below it a table of what was looked at: clocks, stamps, gaps and where they are,
samples and markers that are lost, saturation, noise, limits, the excited band, and what the record tells of the rig's
modes at best. Status 0: it can be identified; 1: it cannot; 2: a fault of the user's.
"""

from __future__ import annotations

import argparse

from beam_ros.cli.options import add_rig_file, add_span, read_span
from beam_ros.cli.results.identify import add_options, bags_of, read_settings
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

_PARAMETERS = ("structure", "hold", "segments", "input", "outputs", "time", "signals")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "bag",
        nargs="+",
        metavar="BAG",
        help="folder of the bag, or a single .mcap or .db3 file, here or by its URL, or a file of columns",
    )
    add_span(parser)
    add_options(parser, _PARAMETERS)
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.checks.bag_check import check_bag, format_check
    from beam_ros.offline.loading.options import FitOptions, paths

    settings, rig = read_settings(arguments)
    options = FitOptions.of(settings)
    start_s, end_s = read_span(arguments)
    checks = []
    with Progress("check", float(len(arguments.bag))) as stage:
        for number, path in enumerate(paths(bags_of(arguments))):
            stage.update(float(number), str(path))
            checks.append(check_bag(path, rig, options, start_s=start_s, end_s=end_s))
        stage.finish(f"{len(checks)} bags")
    if arguments.json:
        found = [check.to_dict() for check in checks]
        print(strict_json(found[0] if len(found) == 1 else found, indent=2))
    else:
        print("\n\n".join(f"{check.path}\n{format_check(check)}" for check in checks))
    return 0 if all(check.can_be_identified for check in checks) else 1
