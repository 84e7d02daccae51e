"""Run an experiment from its plan: recordings, estimations and validations, into one folder with one report.

PLAN is a YAML file, or the name of a packaged plan (listed below). Everything is checked before anything moves. What
is done is kept after every step: --resume goes on after Ctrl-C or a crash, and the outcome is the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ros.cli.options import run_folder
from beam_ros.interfaces.graph import RigKind
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import end_with, signals_taken
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

if TYPE_CHECKING:
    from beam_ident.report.gates import Gate
    from beam_ros.excitation.shaping import MoveOrder
    from beam_ros.experiments.plan import Plan
    from beam_ros.experiments.steps import Means, Report
    from beam_ros.offline.identification import IdentificationOutcome
    from beam_ros.offline.loading.options import FitOptions
    from beam_ros.process.remote_paths import AnyPath
    from beam_ros.rig.rig import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "plan", type=Path, metavar="PLAN", help="the plan's file, or the name of a packaged one"
    )
    add_rig(parser)
    add_folder(parser, "runs/<time>-<plan>")
    parser.add_argument(
        "--check",
        action="store_true",
        help="check the plan and list its steps; nothing moves, nothing is written",
    )


def add_rig(parser: argparse.ArgumentParser) -> None:
    """Add what a plan says of the rig, and may be said anew."""
    kinds = [kind.value for kind in RigKind]
    parser.add_argument("--rig", choices=kinds, help="what to run it on, in place of what the plan says")
    parser.add_argument(
        "--over-ros",
        action="store_true",
        default=None,
        help="a simulated rig as nodes in real time, not its core",
    )
    parser.add_argument("--rig-file", type=Path, metavar="FILE", help="ROS parameter file of the rig")
    parser.add_argument(
        "-p", dest="parameters", metavar="NAME:=VALUE", action="append", default=[], help="one parameter"
    )
    parser.add_argument("--seed", type=int, help="seed of all simulated noise")


def add_folder(parser: argparse.ArgumentParser, default: str) -> None:
    """Add where the outcome goes."""
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"folder for all that comes of it (default: {default})"
    )
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--resume", action="store_true", help="go on with what is done in --out")
    mode.add_argument(
        "--overwrite", action="store_true", help="begin anew in --out: its earlier results are lost"
    )
    parser.add_argument("--json", action="store_true", help="print the outcome as JSON")


def epilog() -> str:
    """Return the list of packaged plans."""
    from beam_ros.experiments.plan import packaged_plans
    from beam_ros.interfaces.parameter_files import read_yaml

    titles = {name: read_yaml(path)["title"] for name, path in packaged_plans().items()}
    width = max(map(len, titles))
    return "\n".join(("packaged plans:", *(f"  {name:<{width}}  {title}" for name, title in titles.items())))


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.experiments.conduct import describe_plan

    plan = read_given_plan(arguments, arguments.plan)
    if arguments.check:
        print("\n".join(describe_plan(plan)))
        return 0
    folder, outcome = conduct_given_plan(arguments, plan)
    if arguments.json:
        print(strict_json(outcome, indent=2))
        return 0
    print(f"report   {folder / 'report.html'}\noutcome  {folder / 'outcome.json'}")
    return 0


def read_given_plan(arguments: argparse.Namespace, path: Path) -> Plan:
    """Read a plan with what the command line says of its rig."""
    from beam_ros.experiments.plan import read_plan

    return read_plan(
        path,
        kind=RigKind(arguments.rig) if arguments.rig else None,
        over_ros=arguments.over_ros,
        rig_file=arguments.rig_file,
        parameters=arguments.parameters,
        seed=arguments.seed,
    )


def conduct_given_plan(arguments: argparse.Namespace, plan: Plan) -> tuple[Path, dict[str, Any]]:
    """Conduct a plan in the folder of the command line, with its state on the screen."""
    from beam_ros.experiments.conduct import begin, conduct

    going_on = arguments.out is not None and (arguments.resume or arguments.overwrite)
    folder = (
        arguments.out if going_on or _holds_state(arguments.out) else run_folder(arguments.out, plan.name)
    )
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    begun = begin(plan, folder, resume=arguments.resume, overwrite=arguments.overwrite, now=now)
    with Screen() as screen:
        return folder, conduct(plan, begun, _means(plan, folder), screen)


def _holds_state(folder: Path | None) -> bool:
    from beam_ros.experiments.progress_file import STATE_FILE

    return folder is not None and (folder / STATE_FILE).exists()


def _report(found: IdentificationOutcome, folder: Path, *, made: str) -> None:
    from beam_ros.reporting.identification import report_identification

    report_identification(found, folder, made=made)


def _check(bag: AnyPath, options: FitOptions) -> Sequence[Gate]:
    from beam_ros.checks.bag_check import gates_of_bag

    return gates_of_bag(bag, None, options)


def _means(plan: Plan, folder: Path) -> Means:
    from beam_ros.experiments.steps import Means, record_by_core

    if not plan.is_live:
        return Means(record_by_core, _calibrate, _check, _report, _shape)
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.recording import record_live

    record = partial(_record_live, record_live, plan.kind, folder / "logs")
    return Means(record, _calibrate, _check, _report, _shape)


def _record_live(
    record: Any, kind: RigKind, logs: Path, rig: Rig, bag: Path, *, with_frames: bool, report: Report
) -> None:
    record(rig, kind, bag, logs / bag.name)


def _calibrate(bag: Path, rig: Rig, file: Path) -> int:
    from beam_ros.calibration.from_bag import calibrate_from_bags
    from beam_ros.vision.calibration.storage import save_calibration

    fit, _ = calibrate_from_bags([bag], rig=rig)
    save_calibration(fit.calibration, file)
    return int(fit.calibration.provenance["n_points"])


def _shape(
    rig: Rig, order: MoveOrder, model: Path, rehearsal: Path | None, folder: Path, report: Report
) -> str:
    from beam_ros.excitation.shaping import shape_for_rig
    from beam_ros.reporting.shaping import known_model, write_move

    known = known_model(model, rehearsal)
    found = shape_for_rig(
        rig,
        order,
        known.model,
        curves=known.curves,
        axis=known.axis,
        progress=lambda phrase, share: report(share, phrase),
    )
    write_move(found, folder)
    chosen = found.choice.chosen
    return f"{chosen.move.name} in {chosen.move.duration_s:.3f} s, aim exceeded with {100 * chosen.probability:.1f} %"


class Screen:
    """The state of an experiment on the terminal: a bar for the step that runs, a line for each that has ended."""

    def __init__(self) -> None:
        self._stage: Progress | None = None

    def step(self, number: int, count: int, name: str) -> Report:
        """Begin to show a step."""
        stage = self._stage = Progress(f"[{number}/{count}] {name}", 1.0)
        return stage.update

    def done(self, number: int, count: int, name: str, said: str, *, was_done: bool) -> None:
        """Show that a step has ended."""
        stage = self._stage or Progress(f"[{number}/{count}] {name}", 1.0)
        stage.finish(f"{said} (done before)" if was_done else said)
        self._stage = None

    def __enter__(self) -> Screen:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._stage is not None:
            self._stage.__exit__(*raised)
