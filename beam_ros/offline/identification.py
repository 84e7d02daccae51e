"""From a recorded bag to an identified model: what the identifier node and ``beam identify`` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from beam_ident import (
    AxisResult,
    BestLinearApproximation,
    EstimationError,
    IdentificationError,
    IdentificationResult,
    Result,
    TimeRecord,
    ValidationResult,
    find_estimator,
    models_of,
    run_estimator,
    validate,
)
from beam_ident.amplitude.curves import AmplitudeCurves, amplitude_curves, driven_amplitude_curves
from beam_ident.amplitude.free_stretches import free_decay_of
from beam_ident.amplitude.linearity import Linearity, linearity
from beam_ident.report.evidence import (
    Agreement,
    ErrorSources,
    ModeRow,
    Theory,
    Unseen,
    beside_theory,
    mode_rows,
)
from beam_ident.report.gates import Gate
from beam_ident.report.page import write_whole
from beam_ident.report.verdict import judge
from beam_ros.bags.apparatus import simulated_line
from beam_ros.errors import UsageError
from beam_ros.offline.axis_bag import identify_axis_of, refuse_files, rig_values
from beam_ros.offline.best_linear import best_linear_of
from beam_ros.offline.identification_summary import SCHEMA, describe, validation_scores
from beam_ros.offline.loading.experiment import Experiment, load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.loading.seen_data import refuse_shared
from beam_ros.offline.theory import error_sources, theory_of_rig
from beam_ros.process.folders import new_folder
from beam_ros.process.remote_paths import AnyPath
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

Progress = Callable[[str, float], None]
Looked = tuple[Sequence[Gate], Experiment | None]
"""What was looked at in a bag, and what was read of it, None where nothing was."""
Checked = Callable[[AnyPath, FitOptions], Looked]


def nothing_checked(bag: AnyPath, options: FitOptions) -> Looked:
    """Return no gates, where nobody looks at a bag before it is fitted."""
    return (), None


@dataclass(frozen=True, eq=False)
class IdentificationOutcome:
    """What came of bags: data, models, checks, validations and the verdict on them, for every page that shows it.

    Attributes
    ----------
    experiments : tuple of Experiment -- what was identified
    options : FitOptions -- how
    result : Result
    unseen : tuple of (Experiment, tuple of ValidationResult)
        What the models were scored on, and how each of them did there.
    modes : tuple of ModeRow -- every mode with all that is not known of it
    theory : Theory or None -- of the rig, where the bag describes it
    agreement : Agreement or None -- of the modes with theory
    sources : ErrorSources -- what the scatter of the samples cannot show
    gates : tuple of Gate -- what was looked at in the data before the fit
    content : mapping -- the same in plain numbers: what ``identification/result`` carries and ``--json`` prints
    curves : AmplitudeCurves or None -- of frequency and damping over amplitude, where they were asked for
    best_linear : BestLinearApproximation or None -- noise and distortion by line, where they were asked for
    linearity : Linearity or None -- whether one pole describes each mode; None where the estimator has no modes
    axis : AxisResult or None -- mass and friction of the hub's axis, where they were asked for
    """

    experiments: tuple[Experiment, ...]
    options: FitOptions
    result: Result
    unseen: tuple[tuple[Experiment, tuple[ValidationResult, ...]], ...]
    modes: tuple[ModeRow, ...]
    theory: Theory | None
    agreement: Agreement | None
    sources: ErrorSources
    gates: tuple[Gate, ...]
    content: Mapping[str, Any]
    curves: AmplitudeCurves | None = None
    best_linear: BestLinearApproximation | None = None
    linearity: Linearity | None = None
    axis: AxisResult | None = None

    @property
    def experiment(self) -> Experiment:
        """The first experiment, whose rig and structure hold for all."""
        return self.experiments[0]

    @property
    def simulated(self) -> str:
        """What a page must say under its title where no beam was measured; empty where all data are measured."""
        return simulated_line(
            one.apparatus for one in (*self.experiments, *(other for other, _ in self.unseen))
        )


def identify_bag(
    path: AnyPath | Sequence[AnyPath], *, folder: Path | None = None, overwrite: bool = False, **more: Any
) -> dict[str, Any]:
    """Identify a model from a bag, or several; write ``model.json`` where a folder is given.

    Parameters
    ----------
    path : Path or sequence of Path -- the bag, or bags of one system that are one fit
    folder : Path, optional -- for the model
    overwrite : bool -- write where there is something already
    more
        As ``identification_of_bags`` takes them.

    Returns
    -------
    dict -- what ``identification/result`` carries and ``--json`` prints

    Raises
    ------
    BagError, UsageError, IdentificationError
    """
    if folder is not None:
        new_folder(folder, overwrite)
    found = identification_of_bags(path, **more)
    content = dict(found.content)
    if folder is not None:
        content["model"] = str(write_models(found, folder / "model.json"))
    return content


def identification_of_bags(
    path: AnyPath | Sequence[AnyPath],
    *,
    estimator: str | None = None,
    rig: Rig | None = None,
    structure: str | None = None,
    n_modes: int | None = None,
    options: FitOptions | None = None,
    validation: AnyPath | Sequence[AnyPath] | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    checked: Checked = nothing_checked,
    temperature_k: float | None = None,
    progress: Progress = lambda phrase, share: None,
) -> IdentificationOutcome:
    """Identify a model from a bag, or several, and keep everything for a report.

    Parameters
    ----------
    path : Path or sequence of Path -- the bag, or bags of one system that are one fit
    rig : Rig, optional -- None: as the bag says
    options : FitOptions, optional
    estimator, structure, n_modes : optional -- these options instead of those in ``options``
    validation : Path or sequence of Path, optional -- other bags, on which the model is scored
    start_s, end_s : float, optional -- only what lies between these times after the first message of each bag [s]
    checked : callable
        Called with every bag before anything is fitted; returns what was looked at in it, and the experiment that
        it read with the same rig, options and times, which is not read again.
    temperature_k : float, optional -- standard uncertainty of the beam's temperature [K]
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    BagError, UsageError, IdentificationError
    """
    options = options or FitOptions()
    options = replace(
        options,
        estimator=estimator or options.estimator,
        structure=structure or options.structure,
        n_modes=n_modes or options.n_modes,
    )
    find_estimator(options.estimator)
    given = _several(path)
    beside_axis = _beside_axis(given, options) if options.axis else options
    looked = [checked(one, options) for one in given]
    gates = [gate for own, _ in looked for gate in own]
    experiments = [
        read
        if read is not None and beside_axis == options
        else load_experiment(one, rig, beside_axis.structure, beside_axis, start_s=start_s, end_s=end_s)
        for one, (_, read) in zip(given, looked, strict=True)
    ]
    options = beside_axis
    whole = replace(options, segments=())
    unseen = [load_experiment(one, rig, options.structure, whole) for one in _several(validation)]
    _refuse_mixed(experiments, unseen)
    # Before the fit: bags that are no realisations are refused at once.
    best_linear = best_linear_of(experiments) if options.best_linear else None
    result = _fitted(experiments, options, progress)
    experiment, models = experiments[0], models_of(result)
    is_simulated = all(one.apparatus.is_simulated for one in experiments)
    sources = error_sources(experiment.structure, models, temperature_k, is_simulated)
    modes = tuple(mode_rows(models, sources))
    theory = agreement = None
    if experiment.rig is not None and modes:
        theory = theory_of_rig(experiment.rig, experiment.structure, is_simulated, temperature_k)
        agreement = beside_theory(modes, theory)
    seen = tuple((one, _validated(one, result)) for one in unseen)
    outcome = IdentificationOutcome(
        experiments=tuple(experiments),
        options=options,
        result=result,
        unseen=seen,
        modes=modes,
        theory=theory,
        agreement=agreement,
        sources=sources,
        gates=tuple(gates),
        content=_content(experiments, options, result, modes, agreement, seen, gates),
        best_linear=best_linear,
    )
    return _with_further_looks(outcome, progress)


def _refuse_mixed(experiments: Sequence[Experiment], unseen: Sequence[Experiment]) -> None:
    """Refuse bags of several kinds of drive, and data that are both fitted and unseen."""
    experiment = experiments[0]
    for other in (*experiments[1:], *unseen):
        if other.structure != experiment.structure:
            raise UsageError(
                f"{experiment.path} shows {experiment.structure} and {other.path} {other.structure}; expected bags "
                "of one kind of drive, or a structure that fits all with --structure"
            )
    refuse_shared([(one.path, one.record) for one in experiments], [(one.path, one.record) for one in unseen])


def _fitted(experiments: Sequence[Experiment], options: FitOptions, progress: Progress) -> Result:
    """Return what the estimator finds; where it finds nothing, the error says what was noted of the bags."""
    experiment = experiments[0]
    settings = options.settings(experiment.structure, experiment.clock_rate, experiment.latency)
    records = [record for one in experiments for record in one.records]
    try:
        return run_estimator(options.estimator, records, replace(settings, progress=progress))
    except IdentificationError as err:
        notes = [note for one in experiments for note in one.notes]
        if not notes:
            raise
        raise type(err)(f"{err}. Of the bag: {'; '.join(notes)}") from err


def _content(
    experiments: Sequence[Experiment],
    options: FitOptions,
    result: Result,
    modes: Sequence[ModeRow],
    agreement: Agreement | None,
    seen: Sequence[tuple[Experiment, tuple[ValidationResult, ...]]],
    gates: Sequence[Gate],
) -> dict[str, Any]:
    """Return an identification in plain numbers, with its validation and the verdict on it."""
    content = describe(experiments, options.estimator, result, modes, agreement)
    if seen:
        content["validation"] = [
            {"bag": str(one.path), "scores": validation_scores(results)} for one, results in seen
        ]
    verdict = judge(result, gates, [Unseen(one.path.name, results) for one, results in seen], agreement)
    content["verdict"] = {"tone": verdict.tone, "text": verdict.text, "reasons": list(verdict.reasons)}
    return content


def _with_further_looks(found: IdentificationOutcome, progress: Progress) -> IdentificationOutcome:
    """Return an identification with what else was asked of its records, in numbers too."""
    options, result, content = found.options, found.result, dict(found.content)
    records = [record for one in found.experiments for record in one.records]
    found_linear = curves = axis = None
    if isinstance(result, IdentificationResult) and result.model.n_modes:
        found_linear = linearity(records, result.model)
        content["linearity"] = found_linear.to_dict()
    if options.amplitude:
        progress("curves over amplitude", 0.0)
        curves = _over_amplitude(records, result, found_linear)
        content["amplitude"] = curves.to_dict()
    if found.best_linear is not None:
        content["best_linear"] = found.best_linear.to_dict()
    if options.axis:
        progress("the axis", 0.0)
        axis = _axis_of(found.experiments, options, content)
    return replace(found, content=content, curves=curves, linearity=found_linear, axis=axis)


def _beside_axis(paths: Sequence[AnyPath], options: FitOptions) -> FitOptions:
    """Return the options by which a beam is identified whose axis is identified, too."""
    refuse_files(paths)
    if options.structure == "auto" and options.signals.drive is None:
        # From force to motion leads the axis with its friction; the beam answers to the motion, which is measured.
        return replace(options, structure="base_motion")
    return options


def _axis_of(experiments: Sequence[Experiment], options: FitOptions, content: dict[str, Any]) -> AxisResult:
    """Return the axis that bags show, and put it into what is stored."""
    rig, paths = experiments[0].rig, [one.path for one in experiments]
    axis = identify_axis_of(
        paths, rig, content["notes"], encoder=options.encoder, drive_mass=options.drive_mass
    )
    content["axis"] = axis.to_dict()
    if rig is not None:
        content["rig_values"] = rig_values(axis, rig)
    return axis


def _over_amplitude(
    records: Sequence[TimeRecord], result: Result, found: Linearity | None
) -> AmplitudeCurves:
    """Return the curves of the decays; of records that do not end at rest, of the mode that swings most in them."""
    try:
        decays = [free_decay_of(record) for record in records]
    except EstimationError:
        if found is None or not isinstance(result, IdentificationResult):
            raise
        largest = max(found.modes, key=lambda mode: mode.largest)
        return driven_amplitude_curves(records, result.model, mode=largest.number - 1)
    return amplitude_curves(decays)


def _several(given: AnyPath | Sequence[AnyPath] | None) -> list[AnyPath]:
    if given is None:
        return []
    return list(given) if isinstance(given, Sequence) else [given]


def _validated(unseen: Experiment, result: Result) -> tuple[ValidationResult, ...]:
    """Score the model, or the model of every output, on data that it was not fitted to."""
    for model in models_of(result):
        if not hasattr(model, "simulate"):
            raise UsageError(
                f"--validate needs a model that predicts, and this estimator gives a {type(model).__name__}; leave "
                "--validate out, or take the estimator modal"
            )
    return tuple(validate(model, list(unseen.records)) for model in models_of(result))


def write_models(found: IdentificationOutcome, path: Path) -> Path:
    """Write the models of an identification with its summary as JSON; the file appears whole or not at all."""
    stored = [model.to_dict() for model in models_of(found.result)]
    models = {"model": stored[0]} if len(stored) == 1 else {"models": stored}
    document = {"schema": SCHEMA, **models, "summary": found.content}
    write_whole(path, strict_json(document, indent=1))
    return path
