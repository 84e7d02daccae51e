"""The steps of a plan, in their order: each makes its outputs in one place, from what earlier steps have made."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from beam_ident import restore
from beam_ros.excitation.shaping import MoveOrder
from beam_ros.experiments.plan import Estimation, Fit, Plan, PlannedRecording
from beam_ros.experiments.progress_file import ProgressFile
from beam_ros.experiments.quiet_moves import PLAYED, PlannedMove, rig_that_plays, verdict_on, write_verdict
from beam_ros.offline.identification import Checked, identification_of_bags
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

CALIBRATION_FILE = "calibration.yaml"

Report = Callable[[float, str], None]
"""Called with the share done and a few words."""


class Record(Protocol):
    """Records the excitation of a rig into a bag."""

    def __call__(self, rig: Rig, bag: Path, *, with_frames: bool, report: Report) -> None:
        """Record; the bag does not exist yet, and is whole on return."""


Calibrate = Callable[[Path, Rig, Path], int]
"""Called with a bag of moves, its rig, and the calibration file to write; returns the positions."""


class WriteReport(Protocol):
    """Writes the report of an identification into a new folder."""

    def __call__(self, found: IdentificationOutcome, folder: Path, *, made: str) -> object:
        """Write it, with the date given."""


class Shape(Protocol):
    """Shapes a move and writes it into a new folder."""

    def __call__(
        self, rig: Rig, order: MoveOrder, model: Path, rehearsal: Path | None, folder: Path, report: Report
    ) -> str:
        """Shape from the folder of a model, and from a bag of moves; return the result in a phrase."""


@dataclass(frozen=True)
class Means:
    """What an experiment is carried out with.

    Attributes
    ----------
    record : callable -- how this rig records
    calibrate : callable -- how pixels become metres
    check : callable -- what is looked at in a bag before it is identified
    write_report : callable -- how a model is reported
    shape : callable -- how a move is shaped
    """

    record: Record
    calibrate: Calibrate
    check: Checked
    write_report: WriteReport
    shape: Shape


@dataclass(frozen=True)
class PlanStep:
    """One step of an experiment.

    Attributes
    ----------
    name : str
    outputs : tuple of str -- files or folders that it makes, in the experiment's folder
    run : callable
        Called with the folder of what is done, the folder to make the outputs in, and what to report to; returns
        the result in a phrase.
    keeps_pieces : bool -- what an interruption leaves of it is kept: a real axis has moved for it
    """

    name: str
    outputs: tuple[str, ...]
    run: Callable[[Path, Path, Report], str]
    keeps_pieces: bool = False


def bag_of(name: str) -> str:
    """Return where a recording's bag lies in the experiment's folder."""
    return f"bags/{name}"


def estimate_of(estimation: str, fit: str) -> str:
    """Return where a model of an estimation lies, with its report."""
    return f"estimates/{estimation}/{fit}"


def steps_of(plan: Plan, means: Means) -> list[PlanStep]:
    """Return the steps of a plan but for its report.

    Parameters
    ----------
    plan : Plan
    means : Means
    """
    steps = []
    if plan.calibration is not None and plan.calibration.recording is not None:
        steps.append(_recording(plan, plan.calibration.recording, means.record))
        steps.append(
            PlanStep("calibrate", (CALIBRATION_FILE,), _calibrate(plan.calibration.recording, means))
        )
    steps += [_recording(plan, own, means.record) for own in plan.recordings]
    for estimation in plan.estimations:
        for fit in estimation.fits:
            output = estimate_of(estimation.name, fit.name)
            steps.append(
                PlanStep(
                    f"estimate {estimation.name} from {fit.name}",
                    (output,),
                    _estimate(estimation, fit, plan.unseen_by(estimation), means),
                )
            )
    for move in plan.moves:
        steps += _of_move(plan, move, means)
    return steps


def _of_move(plan: Plan, move: PlannedMove, means: Means) -> list[PlanStep]:
    """Return the steps of a move: shaped, played unshaped and shaped, and judged."""

    def shape(done: Path, place: Path, report: Report) -> str:
        rehearsal = None if move.rehearsal is None else done / bag_of(move.rehearsal)
        order = MoveOrder(move.start, move.end, move.aim)
        model = done / estimate_of(move.estimation, move.fit)
        return means.shape(move.rig, order, model, rehearsal, place / move.folder, report)

    def play(which: str) -> PlanStep:
        def run(done: Path, place: Path, report: Report) -> str:
            own = PlannedRecording(
                move.bag(which), move.name, 1.0, 1, move.with_frames, rig_that_plays(move, done, which)
            )
            return _recording(plan, own, means.record).run(done, place, report)

        return PlanStep(f"play {move.bag(which)}", (bag_of(move.bag(which)),), run, keeps_pieces=plan.is_live)

    def judge(done: Path, place: Path, report: Report) -> str:
        bags = {which: done / bag_of(move.bag(which)) for which in PLAYED}
        return write_verdict(verdict_on(move, done, bags), place / move.verdict)

    return [
        PlanStep(f"shape {move.name}", (move.folder,), shape),
        *(play(which) for which in PLAYED),
        PlanStep(f"judge {move.name}", (move.verdict,), judge),
    ]


def record_by_core(rig: Rig, bag: Path, *, with_frames: bool, report: Report) -> None:
    """Record by the simulator's core, without ROS, as fast as the computer can."""
    simulate(
        rig,
        bag,
        with_camera=with_frames,
        on_progress=lambda done_s, total_s: report(done_s / total_s, f"{done_s:.0f} s"),
    )


def _recording(plan: Plan, recording: PlannedRecording, record: Record) -> PlanStep:
    def run(done: Path, place: Path, report: Report) -> str:
        rig = recording.rig
        if plan.calibration and plan.calibration.recording and (done / CALIBRATION_FILE).is_file():
            rig = rig.with_values({"tracker.calibration": str((done / CALIBRATION_FILE).resolve())})
        bag = place / bag_of(recording.name)
        bag.parent.mkdir(parents=True, exist_ok=True)
        record(rig, bag, with_frames=recording.with_frames, report=report)
        return f"{recording.duration_s:.0f} s of {rig.excitation.kind}"

    return PlanStep(f"record {recording.name}", (bag_of(recording.name),), run, keeps_pieces=plan.is_live)


def _calibrate(recording: PlannedRecording, means: Means) -> Callable[[Path, Path, Report], str]:
    def run(done: Path, place: Path, report: Report) -> str:
        n_points = means.calibrate(done / bag_of(recording.name), recording.rig, place / CALIBRATION_FILE)
        return f"{n_points} positions"

    return run


def _estimate(
    estimation: Estimation, fit: Fit, unseen: Sequence[str], means: Means
) -> Callable[[Path, Path, Report], str]:
    """Return what identifies, validates and reports: a page that was written before all is judged would mislead."""
    options = FitOptions(estimation.estimator, estimation.structure, estimation.modes)

    def run(done: Path, place: Path, report: Report) -> str:
        found = identification_of_bags(
            [done / bag_of(bag) for bag in fit.bags],
            validation=[done / bag_of(bag) for bag in unseen],
            checked=means.check,
            progress=lambda phrase, share: report(share, phrase),
            options=options,
        )
        state = ProgressFile.read(done)
        # The date is the experiment's, so that an interrupted one comes to the same report.
        means.write_report(
            found,
            place / estimate_of(estimation.name, fit.name),
            made=state.begun if state is not None else "",
        )
        return "; ".join(
            [
                ", ".join(f"{mode['frequency_hz']:.4f} Hz" for mode in found.content["modes"]) or "no modes",
                *(
                    f"on {name}: "
                    + ", ".join(f"{output} FIT {own['fit_percent']:.2f} %" for output, own in scores.items())
                    for name, scores in scores_of(found.content).items()
                ),
            ]
        )

    return run


def scores_of(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the scores of a result on the bags that it has not seen, by the bag's name and the output."""
    return {Path(own["bag"]).name: own["scores"] for own in summary.get("validation", ())}


def stored_models(folder: Path) -> list[Any]:
    """Return the models that a report has in its folder."""
    document: Mapping[str, Any] = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    stored = document.get("models") or [document["model"]]
    return [restore(content) for content in stored]


def summary_of(folder: Path) -> dict[str, Any]:
    """Return what was said of the result that a report has in its folder."""
    document: dict[str, Any] = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    return dict(document["summary"])
