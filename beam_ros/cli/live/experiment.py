"""Run an experiment from its plan: recordings, estimations and validations, into one folder with one report.

With --until in place of a PLAN it goes on, segment by segment, each designed from those before, until the modes are
known as well as that asks or the time is up: beam experiment --until "f1:0.01%, zeta1:2%".

PLAN is a YAML file, or the name of a packaged plan (listed below). Everything is checked before anything moves. What
is done is kept after every step: --resume goes on after Ctrl-C or a crash, and the outcome is the same.
"""

from __future__ import annotations

import argparse
import sys
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ros.cli.options import read_rig, run_folder
from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import RigKind
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import end_with, signals_taken
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

if TYPE_CHECKING:
    from beam_ros.excitation.shaping import MoveOrder
    from beam_ros.experiments.plan import Plan
    from beam_ros.experiments.steps import Means, Record, Report
    from beam_ros.offline.identification import Looked
    from beam_ros.offline.identification_summary import IdentificationOutcome
    from beam_ros.offline.loading.options import FitOptions
    from beam_ros.process.remote_paths import AnyPath
    from beam_ros.rig.rig import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "plan", type=Path, nargs="?", metavar="PLAN", help="the plan's file, or the name of a packaged one"
    )
    parser.add_argument(
        "--until",
        metavar="AIMS",
        help="relative standard deviations that are asked: f1:0.01%%, zeta1:2%% (quantity and number of a mode)",
    )
    parser.add_argument(
        "--time", type=float, default=120.0, metavar="SECONDS", help="with --until at most so much motion"
    )
    parser.add_argument(
        "--segment", type=float, default=8.0, metavar="SECONDS", help="with --until the length of a segment"
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

    if (arguments.plan is None) == (arguments.until is None):
        raise UsageError("expected either a PLAN or --until: what is to be done, or what is to be known")
    if arguments.until is not None:
        return _run_until(arguments)
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


def _run_until(arguments: argparse.Namespace) -> int:
    """Run segments until the aims are met; the exit status is 1 where they are not."""
    from beam_ident import aims_of
    from beam_ident.report.page import write_whole
    from beam_ros.experiments.until_known import KnownSegment, experiment_until
    from beam_ros.offline.loading.experiment import Experiment, load_experiment
    from beam_ros.process.folders import make_folder

    aims = aims_of(arguments.until)
    rig, kind = read_rig(arguments), RigKind(arguments.rig or RigKind.SIMULATED)
    folder = run_folder(arguments.out, "until")
    make_folder(folder)
    record = _record_on(kind, kind is not RigKind.SIMULATED or bool(arguments.over_ros), folder)
    seed = rig.simulation.seed if arguments.seed is None else arguments.seed

    def record_segment(here: Rig, number: int) -> Experiment:
        bag = folder / f"segment-{number}"
        with Progress(f"segment {number}", 1.0) as stage:
            record(
                here.with_values({"simulation.seed": seed + number}),
                bag,
                with_frames=False,
                report=lambda share, phrase: stage.update(share),
            )
            stage.finish(f"{here.excitation.kind}, {here.excitation.duration + here.excitation.still:g} s")
        return load_experiment(bag, rig)

    def told(segment: KnownSegment) -> None:
        print(f"  {segment.excitation}: {segment.n_modes} modes; {segment.known}", file=sys.stderr)

    outcome = experiment_until(rig, aims, record_segment, arguments.time, arguments.segment, told=told)
    write_whole(folder / "until.json", strict_json(outcome.to_dict(), indent=1))
    if arguments.json:
        print(strict_json(outcome.to_dict(), indent=2))
    else:
        print(f"{outcome.sentence}\nbags and model  {folder}")
    return 0 if outcome.is_known else 1


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


def _check(bag: AnyPath, options: FitOptions) -> Looked:
    from beam_ros.checks.bag_check import check_bag

    return check_bag(bag, None, options).looked


def _means(plan: Plan, folder: Path) -> Means:
    from beam_ros.experiments.steps import Means

    return Means(_record_on(plan.kind, plan.is_live, folder), _calibrate, _check, _report, _shape)


def _record_on(kind: RigKind, is_live: bool, folder: Path) -> Record:
    """Return how a rig records: as nodes, or by the simulator's core."""
    from beam_ros.experiments.steps import record_by_core

    if not is_live:
        return record_by_core
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.recording import record_live

    return partial(_record_live, record_live, kind, folder / "logs")


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
