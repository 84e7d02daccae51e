"""Reproduce the reference work: its tables and figures under their numbers, in one document.

The plan `thesis` is conducted first (E1, E2, V1, V2, a step and the moves of the calibration, on the simulated rig
unless said otherwise), and its bags are worked out. --bags takes recordings that exist instead: a folder with E1, E2,
V2, S, and if there are any V1 and calibration.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from beam_ros.cli.live.experiment import add_folder, add_rig, conduct_given_plan, read_given_plan
from beam_ros.cli.options import run_folder
from beam_ros.errors import UsageError
from beam_ros.process.folders import make_folder
from beam_ros.process.interruption import whole_or_interrupted
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_rig(parser)
    add_folder(parser, "runs/<time>-thesis")
    parser.add_argument(
        "--bags", type=Path, metavar="DIR", help="recordings that exist, in place of the plan's"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.thesis.data import estimate_all, load_bags
    from beam_ros.thesis.document import write_thesis

    started = time.monotonic()
    if arguments.bags is not None:
        bags, folder = load_bags(arguments.bags), _folder_for_given(arguments)
    else:
        folder, _ = conduct_given_plan(arguments, read_given_plan(arguments, Path("thesis")))
        bags = load_bags(folder)
    with Progress("estimate", 1.0) as stage:
        fit = None
        if "calibration" in bags:
            from beam_ros.calibration.from_bag import calibrate_from_bags

            fit, _ = calibrate_from_bags([bags["calibration"]])
        with whole_or_interrupted():
            data = estimate_all(bags, fit, lambda phrase, share: stage.update(share, phrase))
        stage.finish(f"models at {' and '.join(at.point.label for at in data.points)}")
    with Progress("write", 1.0) as stage:
        content = write_thesis(data, folder)
        stage.finish(
            f"{len(content['tables'])} tables, in {time.monotonic() - started:.0f} s from the beginning"
        )
    if arguments.json:
        print(strict_json(content, indent=2))
        return 0
    print(f"document {content['document']}\nmodels   {folder / 'model.json'}")
    return 0


def _folder_for_given(arguments: argparse.Namespace) -> Path:
    """Return the folder for what is made of given bags."""
    if arguments.resume:
        raise UsageError("--resume goes on with recordings, and --bags gives them; leave one of the two out")
    if arguments.overwrite and arguments.out is not None and (arguments.out / "thesis.html").is_file():
        return Path(arguments.out)
    return make_folder(run_folder(arguments.out, "thesis"))
