"""An experiment from its plan to its folder: step after step, from where it was interrupted, and nothing twice."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from beam_ros.errors import RigError, UsageError, faults_of_the_user
from beam_ros.excitation.plan import plan_excitation
from beam_ros.experiments.outcome import OUTCOME_FILE, REPORT_FILE, read_outcome, write_outcome
from beam_ros.experiments.plan import Plan
from beam_ros.experiments.progress_file import STATE_FILE, ProgressFile
from beam_ros.experiments.steps import Means, PlanStep, Report, steps_of
from beam_ros.offline.identification import nothing_checked
from beam_ros.process.folder_lock import LOCK_NAME, FolderLock
from beam_ros.process.folders import make_folder
from beam_ros.process.interruption import whole_or_interrupted

PLAN_FILE = "plan.yaml"

_UNFINISHED = ".unfinished"
_INTERRUPTED = "interrupted"
_NO_RESULTS = (_INTERRUPTED, LOCK_NAME, f".{STATE_FILE}.partial")
_OWN = (
    STATE_FILE,
    PLAN_FILE,
    _UNFINISHED,
    OUTCOME_FILE,
    REPORT_FILE,
    "bags",
    "estimates",
    "moves",
    "verdicts",
    "calibration.yaml",
    "figures",
    "tables",
    "logs",
    "thesis.html",
    "model.json",
)


class StepFailedError(RigError):
    """A step of an experiment failed; what was done before is kept."""


class Watcher(Protocol):
    """Shows how an experiment goes."""

    def step(self, number: int, count: int, name: str) -> Report:
        """Begin to show a step; returns what it reports its share to."""

    def done(self, number: int, count: int, name: str, said: str, *, was_done: bool) -> None:
        """Show that a step has ended, now or before an interruption."""


@dataclass(frozen=True)
class Begun:
    """A folder with its state, ready to work in, and this process's alone until ``conduct`` has ended."""

    folder: Path
    state: ProgressFile
    lock: FolderLock


def begin(plan: Plan, folder: Path, *, resume: bool, overwrite: bool, now: str) -> Begun:
    """Prepare the folder of an experiment, or go back to it.

    Parameters
    ----------
    plan : Plan
    folder : Path
    resume : bool -- go on with what is there
    overwrite : bool -- take away what an earlier experiment left there
    now : str -- ISO 8601, for the state of a new experiment

    Returns
    -------
    Begun

    Raises
    ------
    UsageError
        The folder holds something else, another plan, or results that are not to be overwritten; another process
        works in it; a finished step's output is gone or has changed; the disk is too small.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: is there already and is no folder; give another --out")
    if ProgressFile.read(folder) is None:
        if folder.exists() and any(own.name not in _NO_RESULTS for own in folder.iterdir()):
            raise UsageError(
                f"{folder} exists, is not empty and holds no experiment of this suite: expected a new folder; give "
                "another --out"
            )
        if resume:
            raise UsageError(f"{folder}: holds no experiment to go on with; leave --resume out to begin one")
        _require_space(plan, folder)
        make_folder(folder)
    lock = FolderLock(folder)
    try:
        state = _gone_back_to(plan, folder, resume=resume, overwrite=overwrite)
        if state is None:
            state = ProgressFile(folder, plan.name, plan.digest(), now)
            state.write()
            (folder / PLAN_FILE).write_text(plan.text, encoding="utf-8")
    except BaseException:
        lock.release()
        raise
    return Begun(folder, state, lock)


def _gone_back_to(plan: Plan, folder: Path, *, resume: bool, overwrite: bool) -> ProgressFile | None:
    """Return the state with which an experiment goes on; None where it begins, in an empty folder."""
    state = ProgressFile.read(folder)
    if state is None:
        return None
    if overwrite:
        foreign = sorted(own.name for own in folder.iterdir() if own.name not in (*_OWN, *_NO_RESULTS))
        if foreign:
            raise UsageError(
                f"{folder}: --overwrite would leave results beside {', '.join(foreign)}, which no experiment made; "
                "move that away, or give another --out"
            )
        _clear(folder)
        _require_space(plan, folder)
        return None
    if state.digest != plan.digest():
        raise UsageError(
            f"{folder} holds an experiment of the plan {state.plan!r}, which is not this one (or the plan, its "
            "rig or its seed have changed since); give another --out, or begin anew with --overwrite"
        )
    if not resume:
        raise UsageError(
            f"{folder} holds this experiment with {len(state.steps)} finished steps; go on with --resume, or "
            "begin anew with --overwrite"
        )
    state.verify()
    return state


def conduct(plan: Plan, begun: Begun, means: Means, watcher: Watcher) -> dict[str, Any]:
    """Do every step that is not done yet, and return the outcome.

    Parameters
    ----------
    plan : Plan
    begun : Begun -- of ``begin``
    means : Means
    watcher : Watcher

    Returns
    -------
    dict -- the content of ``outcome.json``

    Raises
    ------
    StepFailedError
        A step failed, on the rig, on its data or on the disk; finished steps stay, and ``resume`` goes on.
    """
    folder, state = begun.folder, begun.state
    outcome: dict[str, Any] = {}

    def report(done: Path, place: Path, _report: Report) -> str:
        outcome.update(write_outcome(plan, done, place, state.begun))
        return REPORT_FILE

    steps = [*steps_of(plan, means), PlanStep("report", (REPORT_FILE, OUTCOME_FILE), report)]
    with begun.lock:
        for number, step in enumerate(steps, start=1):
            if step.name in state.steps:
                watcher.done(number, len(steps), step.name, state.steps[step.name].said, was_done=True)
                continue
            shown = watcher.step(number, len(steps), step.name)
            said = _do(step, folder, state, shown)
            watcher.done(number, len(steps), step.name, said, was_done=False)
    return outcome or read_outcome(folder)


def _do(step: PlanStep, folder: Path, state: ProgressFile, report: Report) -> str:
    """Do one step: its outputs appear under their names only when they are whole."""
    place, faults = folder / _UNFINISHED, faults_of_the_user()
    for leftover in (place, *(folder / output for output in step.outputs)):
        _put_away(leftover, folder, step)
    try:
        place.mkdir()
        with whole_or_interrupted():
            said = step.run(folder, place, report)
        for output in step.outputs:
            (folder / output).parent.mkdir(parents=True, exist_ok=True)
            (place / output).rename(folder / output)
        shutil.rmtree(place)
        state.finish(step.name, step.outputs, said)
    except Exception as err:
        if not isinstance(err, faults) and not isinstance(err, OSError):
            raise
        said_by = str(err) if isinstance(err, faults) else f"{folder}: {err}"
        raise StepFailedError(
            f"step {step.name!r} failed: {said_by}; {len(state.steps)} finished steps are kept: mend that, and go on "
            "with --resume"
        ) from err
    return said


def _put_away(leftover: Path, folder: Path, step: PlanStep) -> None:
    """Clear the place of a step that was interrupted; what a real axis has moved for is kept."""
    if not leftover.exists():
        return
    if step.keeps_pieces:
        kept = folder / _INTERRUPTED
        kept.mkdir(exist_ok=True)
        number = 1 + sum(1 for _ in kept.iterdir())
        leftover.rename(kept / f"{step.name.replace(' ', '-')}-{number}")
    elif leftover.is_dir():
        shutil.rmtree(leftover)
    else:
        leftover.unlink()


def _clear(folder: Path) -> None:
    """Take away what an experiment made in its folder, and nothing else."""
    for name in _OWN:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _require_space(plan: Plan, folder: Path) -> None:
    there = next(own for own in (folder.absolute(), *folder.absolute().parents) if own.exists())
    free = shutil.disk_usage(there).free
    if free < plan.bytes_needed:
        raise UsageError(
            f"{folder}: the plan's bags take about {plan.bytes_needed / 1e6:.0f} MB, and {free / 1e6:.0f} MB are "
            "free there; give --out on another disk, or make room"
        )


def describe_plan(plan: Plan) -> list[str]:
    """Return the steps of a plan as lines, with what each recording is predicted to do."""
    lines = []
    for own in plan.all_recordings:
        loads = plan_excitation(own.rig).prediction
        lines.append(
            f"record {own.name}: {own.rig.excitation.kind}, {own.duration_s:.0f} s, level {own.level:g}, tip at most "
            f"{loads.tip_deflection * 1e3:.2f} mm, hub force at most {loads.hub_force:.2f} N"
        )
    lines += [
        step.name
        for step in steps_of(
            plan,
            Means(_nothing, lambda *bags: 0, nothing_checked, _nothing, lambda *shaped: ""),
        )
        if not step.name.startswith("record ")
    ]
    return [*lines, "report"]


def _nothing(*_arguments: object, **_options: object) -> None:
    return None
