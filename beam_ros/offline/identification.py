"""From a recorded bag to an identified model: what the identifier node and ``beam identify`` share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from beam_ident import (
    EstimationError,
    IdentificationError,
    IdentificationResult,
    Result,
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
    mode_rows,
)
from beam_ident.report.gates import Gate
from beam_ident.report.page import write_whole
from beam_ros.errors import UsageError
from beam_ros.offline.axis_bag import identify_axis_of, refuse_files
from beam_ros.offline.best_linear import best_linear_of
from beam_ros.offline.identification_summary import SCHEMA, IdentificationOutcome
from beam_ros.offline.loading.experiment import Experiment, load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.loading.seen_data import refuse_shared
from beam_ros.offline.theory import error_sources, theory_of_rig
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


def identification_of_bags(
    path: AnyPath | Sequence[AnyPath],
    *,
    rig: Rig | None = None,
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
    find_estimator(options.estimator)
    paths = _several(path)
    fitted = _beside_axis(paths, options) if options.axis else options
    looked = [checked(one, options) for one in paths]
    gates = tuple(gate for own, _ in looked for gate in own)
    experiments = tuple(
        read
        if read is not None and fitted == options
        else load_experiment(one, rig, fitted.structure, fitted, start_s=start_s, end_s=end_s)
        for one, (_, read) in zip(paths, looked, strict=True)
    )
    whole = replace(fitted, segments=())
    others = [load_experiment(one, rig, whole.structure, whole) for one in _several(validation)]
    _refuse_mixed(experiments, others)
    # Before the fit: bags that are no realisations are refused at once.
    best_linear = best_linear_of(experiments) if options.best_linear else None
    result = fit(experiments, fitted, progress)
    structure, rig = experiments[0].structure, experiments[0].rig
    models, is_simulated = models_of(result), all(one.apparatus.is_simulated for one in experiments)
    sources = error_sources(structure, models, temperature_k, is_simulated)
    modes = tuple(mode_rows(models, sources))
    theory = None
    if rig is not None and modes:
        theory = theory_of_rig(rig, structure, is_simulated, temperature_k)
    found = IdentificationOutcome(
        experiments=experiments,
        options=fitted,
        result=result,
        unseen=tuple((one, _validated(one, result)) for one in others),
        modes=modes,
        theory=theory,
        sources=sources,
        gates=gates,
        best_linear=best_linear,
        linearity=_linearity(experiments, result),
    )
    if options.amplitude:
        progress("curves over amplitude", 0.0)
        found = replace(found, curves=_over_amplitude(found))
    if options.axis:
        progress("the axis", 0.0)
        notes: list[str] = []
        axis = identify_axis_of(paths, rig, notes, encoder=options.encoder, drive_mass=options.drive_mass)
        found = replace(found, axis=axis, axis_notes=tuple(notes))
    return found


def fit(
    experiments: Sequence[Experiment], options: FitOptions, progress: Progress = lambda phrase, share: None
) -> Result:
    """Fit one model to experiments; what their bags lack is said with what went wrong.

    Raises
    ------
    IdentificationError
        The data do not carry a model.
    """
    first = experiments[0]
    settings = options.settings(first.structure, first.clock_rate, first.latency)
    records = [record for one in experiments for record in one.records]
    try:
        return run_estimator(options.estimator, records, replace(settings, progress=progress))
    except IdentificationError as err:
        notes = [note for one in experiments for note in one.notes]
        if not notes:
            raise
        raise type(err)(f"{err}. Of the bag: {'; '.join(notes)}") from err


def _linearity(experiments: Sequence[Experiment], result: Result) -> Linearity | None:
    if not (isinstance(result, IdentificationResult) and result.model.n_modes):
        return None
    return linearity([record for one in experiments for record in one.records], result.model)


def _refuse_mixed(experiments: Sequence[Experiment], unseen: Sequence[Experiment]) -> None:
    """Refuse bags of several kinds of drive, and data that are both fitted and predicted."""
    first = experiments[0]
    for other in (*experiments[1:], *unseen):
        if other.structure != first.structure:
            raise UsageError(
                f"{first.path} shows {first.structure} and {other.path} {other.structure}; expected bags "
                "of one kind of drive, or a structure that fits all with --structure"
            )
    refuse_shared([(one.path, one.record) for one in experiments], [(one.path, one.record) for one in unseen])


def _beside_axis(paths: Sequence[AnyPath], options: FitOptions) -> FitOptions:
    """Return the options by which a beam is identified whose axis is identified, too."""
    refuse_files(paths)
    if options.structure == "auto" and options.signals.drive is None:
        # From force to motion leads the axis with its friction; the beam answers to the motion, which is measured.
        return replace(options, structure="base_motion")
    return options


def _over_amplitude(found: IdentificationOutcome) -> AmplitudeCurves:
    """Return the curves of the decays; of records that do not end at rest, of the mode that swings most in them."""
    try:
        decays = [free_decay_of(record) for record in found.records]
    except EstimationError:
        if found.linearity is None or not isinstance(found.result, IdentificationResult):
            raise
        largest = max(found.linearity.modes, key=lambda mode: mode.largest)
        return driven_amplitude_curves(found.records, found.result.model, mode=largest.number - 1)
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
