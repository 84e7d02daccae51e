"""Find the shortest move that leaves less swing than an aim, with its predicted swing and interval, before it is
made.

MODEL is the model.json that `beam identify` wrote; without one, the rig's theory is taken. The folder of results
holds the rig with this move as its excitation (move.yaml: a PLAN.yaml for `beam simulate`, or a --rig-file), a page
with pictures, and the numbers. Nothing moves.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ident.shaping.known_beam import PoleDrift
from beam_ros.cli.options import add_rig_file, read_rig, run_folder
from beam_ros.errors import UsageError
from beam_ros.excitation.optimal import THEORY_SD
from beam_ros.excitation.shaping import MOVED_SD, MoveOrder, shape_for_rig
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "model", nargs="?", type=Path, metavar="MODEL", help="model.json of `beam identify`, or its folder"
    )
    parser.add_argument("--from", dest="start", type=float, default=0.0, metavar="METRES", help="0: home")
    parser.add_argument("--to", dest="end", type=float, required=True, metavar="METRES")
    parser.add_argument(
        "--aim", type=float, required=True, metavar="METRES", help="largest swing after the move, as 20e-6"
    )
    parser.add_argument(
        "--jerk",
        type=float,
        metavar="M/S^3",
        help="largest; by default excitation.max_jerk, or the largest acceleration in a period of the highest mode",
    )
    for name, what, number in (("frequency", "natural frequencies", 0), ("damping", "damping ratios", 1)):
        parser.add_argument(
            f"--{name}-sd",
            type=float,
            metavar="SHARE",
            help=f"how far the {what} may have moved since, relative, beside the model's covariance; by default "
            f"{MOVED_SD[number]:g}, or {THEORY_SD[number]:g} of a theory",
        )
    parser.add_argument(
        "--rehearsal",
        type=Path,
        metavar="BAG",
        help="quick moves with rests: how the hub follows its commands, and what air and large swings do",
    )
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="by default runs/<date>-shape")
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.reporting.shaping import RIG_FILE, describe_move, format_move, known_model, write_move

    rig = read_rig(arguments)
    folder = run_folder(arguments.out, "shape")
    if arguments.rehearsal is not None and arguments.model is None:
        raise UsageError("--rehearsal goes with a MODEL that was identified; give one, or leave it out")
    known = None if arguments.model is None else known_model(arguments.model, arguments.rehearsal)
    sds = list(THEORY_SD if known is None else MOVED_SD)
    for number, value in enumerate((arguments.frequency_sd, arguments.damping_sd)):
        if value is not None:
            if not 0.0 <= value < 1.0:
                name = ("--frequency-sd", "--damping-sd")[number]
                raise UsageError(f"{name} is {value}: expected a share from 0 to 1, as 0.001 for 0.1 %")
            sds[number] = value
    order = MoveOrder(arguments.start, arguments.end, arguments.aim, arguments.jerk, PoleDrift(*sds))
    with Progress("shape", 100.0, "%") as stage:
        found = shape_for_rig(
            rig,
            order,
            known.model if known else None,
            curves=known.curves if known else None,
            axis=known.axis if known else None,
            progress=lambda phrase, share: stage.update(100.0 * share, phrase),
        )
        stage.finish(f"{found.choice.chosen.move.name}, {found.choice.chosen.move.duration_s:.3f} s")
    write_move(found, folder)
    content = describe_move(found)
    if arguments.json:
        print(strict_json({**content, "folder": str(folder)}, indent=2))
    else:
        print(f"{format_move(content)}\n\nplay it with `beam simulate {folder / RIG_FILE} --bag OUT`")
        print(folder)
    return 0
