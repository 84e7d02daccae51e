"""From a recorded bag to an identified model: what the identifier node and ``beam identify`` share.

Only header stamps carry time. The hub's samples are counted in device ticks and put on the host's clock by one
straight line through the whole recording's clock comparisons; how well that line is known enters the fit as
prior knowledge of the clock rate, and so the stated standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import (
    AxisResult,
    BestLinearApproximation,
    EstimationError,
    IdentificationError,
    IdentificationResult,
    InputSignal,
    LineResult,
    ModalModel,
    OutputSignal,
    Prior,
    Result,
    SeparateOutputsResult,
    TimeRecord,
    TimeResult,
    ValidationResult,
    find_estimator,
    models_of,
    run_estimator,
    validate,
)
from beam_ident.amplitude.curves import AmplitudeCurves, amplitude_curves, driven_amplitude_curves
from beam_ident.amplitude.free_stretches import free_decay_of
from beam_ident.amplitude.linearity import Linearity, linearity
from beam_ident.data.gaps import Bridge
from beam_ident.numerics.piecewise import Hold, PiecewisePolynomial
from beam_ident.report.page import write_whole
from beam_ident.sensing.commanded_motion import as_commanded
from beam_ident.sensing.still_noise import StillNoise
from beam_model import BeamModel
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import Displacements, HubSamples
from beam_ros.errors import ParameterFileError, UsageError
from beam_ros.interfaces.parameter_files import in_present_words
from beam_ros.offline.axis_bag import (
    device_clock,
    device_times,
    identify_axis_of,
    longest_epoch,
    on_every_tick,
    rig_values,
)
from beam_ros.offline.best_linear import best_linear_of
from beam_ros.offline.options import FitOptions
from beam_ros.offline.seen_data import refuse_shared
from beam_ros.process.folders import new_folder
from beam_ros.process.remote_paths import AnyPath
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.film_points import rig_with_points
from beam_ros.rig.rig import Rig
from beam_ros.signals.camera_lateness import CameraLateness, camera_lateness, on_time
from beam_ros.signals.descriptions import Signals, SignalSource
from beam_ros.signals.fields import read_field
from beam_ros.signals.records import SensorOutput, input_signal, output_signal, records_of_one_model
from beam_ros.signals.stray_stamps import well_placed, without_stray_batches

Progress = Callable[[str, float], None]

SCHEMA = 1
_LEAD_S = 0.3
_NAMED_GAPS = 5
_MOST_DEVIATIONS = 999
_MORE_NOISE = 1.5
_FINE_ENCODER = 2.5e-7  # m
VIDEO_TOPIC = "tracker/video"
"""String topic on which ``beam track`` says how a video's frames came into the bag: JSON."""
_STRUCTURE_OF_MODE = {
    "acceleration": "base_motion",
    "velocity": "base_motion",
    "position": "base_motion",
    "effort": "force",
}
_INPUT_OF_STRUCTURE = {
    "base_motion": ("hub/measured", "positions", "m", "position"),
    "acceleration": ("hub/applied", "accelerations", "m/s^2", "acceleration"),
    "velocity": ("hub/applied", "velocities", "m/s", "velocity"),
    "force": ("hub/applied", "efforts", "N", "force"),
}
_CLOCK_TOLERANCE = 50e-6
_SAME_SHARE, _FEW_VALUES = (
    0.5,
    20,
)  # of the samples of two bags, and moving ones among them, that make them one


@dataclass(frozen=True)
class Experiment:
    """A recorded experiment, ready for estimation.

    Attributes
    ----------
    path : Path or RemotePath -- the bag
    record : TimeRecord -- input and outputs, by default hub and markers, on the host's clock
    rig : Rig or None -- the rig it was recorded on, None where nobody says
    structure : str -- which model goes with the input
    clock_rate : Prior -- what is known of the device's clock against the host's
    notes : tuple of str -- what a reader should know: gaps, lost samples, markers not seen
    info : mapping -- what ``excitation/info`` said
    further : tuple of TimeRecord -- sensors of other kinds, and further segments
    latency : Prior or None -- what is known of the time by which outputs are late; None: what is usual
    late_s : float -- what was taken off the markers' stamps already, because they were late by more than a fit finds
    """

    path: AnyPath
    record: TimeRecord
    rig: Rig | None
    structure: str
    clock_rate: Prior
    notes: tuple[str, ...]
    info: Mapping[str, Any]
    further: tuple[TimeRecord, ...] = ()
    latency: Prior | None = None
    late_s: float = 0.0

    @property
    def records(self) -> tuple[TimeRecord, ...]:
        """All records of the bag."""
        return (self.record, *self.further)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs of all records, in order."""
        return tuple(dict.fromkeys(name for one in self.records for name in one.output_names))


def load_experiment(
    path: AnyPath,
    rig: Rig | None = None,
    structure: str = "auto",
    options: FitOptions | None = None,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Experiment:
    """Read a bag as one experiment.

    Parameters
    ----------
    path : Path or RemotePath -- the bag
    rig : Rig, optional -- None: the rig that the bag itself describes, if it does
    structure : str -- base_motion, acceleration, velocity or force; "auto": by the hub's command mode
    options : FitOptions, optional -- signals, segments and hold are taken from it
    start_s, end_s : float, optional -- only what lies between these times after the bag's first message [s]

    Returns
    -------
    Experiment

    Raises
    ------
    BagError
        The bag is missing, damaged, or lacks a topic that identification needs.
    UsageError
        A signal names no field, or its samples do not go together with the others.
    """
    options = options or FitOptions()
    signals = options.signals
    notes: list[str] = []
    late: CameraLateness | None = None
    with Bag(path, start_s=start_s, end_s=end_s) as bag:
        if not signals.outputs:
            bag.require("beam/displacement")
        bag.read("excitation/info", "hub/sequence_state", VIDEO_TOPIC)
        info = bag.excitation_info() or {}
        rig = rig or _rig_of(path, info, signals, notes)
        videos = bag.texts(VIDEO_TOPIC)
        if rig is not None and videos and "points" in videos[-1]:
            rig = rig_with_points(rig, videos[-1]["points"])
        drive = _hub_drive(bag, rig, structure, info, notes) if signals.drive is None else None
        if drive is None:
            assert signals.drive is not None
            drive = _signal_drive(bag, signals.drive, notes)
        if signals.outputs:
            outputs = [_signal_output(bag, source, drive.origin_ns, notes) for source in signals.outputs]
        else:
            displacements = well_placed(bag, bag.displacements(), drive.origin_ns, notes)
            markers = _outputs(displacements, drive.origin_ns, rig, notes)
            if drive.is_hub and not videos:
                late = camera_lateness(bag, markers, drive.origin_ns)
            if late is not None:
                markers = on_time(markers, late)
                notes.append(late.sentence)
            outputs = [SensorOutput(marker) for marker in markers]
    clock_rate, tolerance = drive.clock_rate, rig.camera.clock_tolerance if rig else _CLOCK_TOLERANCE
    if videos:
        # The frames run on the camera's own clock, which is known as well as the low marker tells.
        tolerance = float(videos[-1].get("synchronisation", {}).get("drift_sd", 0.0))
    if late is not None:
        tolerance = late.rate_tolerance(tolerance)
    clock_rate = Prior(clock_rate.mean, math.hypot(clock_rate.sd, tolerance))
    signal = drive.signal if options.hold is None else replace(drive.signal, hold=options.hold)
    chosen, records = records_of_one_model(
        signal, drive.kind, outputs, drive.origin_ns, path.name, has_rigid_body=drive.is_hub
    )
    if structure != "auto" and not drive.is_hub:
        if len(records) > 1 and structure != chosen:
            raise UsageError(
                f"structure {structure} with sensors of several kinds, which are fitted as {chosen}; leave "
                "--structure out, or give outputs of one kind"
            )
        chosen, records = structure, (replace(records[0], inputs=(signal,)), *records[1:])
    records = tuple(_trimmed(record, info) for record in records)
    if options.segments:
        records = tuple(part for record in records for part in _cut(record, options.segments))
    shares_clock = {own.topic for own in signals.outputs} == {signals.drive.topic if signals.drive else ""}
    latency = None if drive.is_hub or shares_clock else Prior(0.0, math.inf)
    return Experiment(
        path,
        records[0],
        rig,
        chosen,
        clock_rate,
        tuple(notes),
        info,
        further=records[1:],
        latency=latency,
        late_s=late.late_s if late else 0.0,
    )


@dataclass(frozen=True)
class _Drive:
    """What drives an experiment: its signal, what that is, when its time axis begins, what is known of its clock."""

    signal: InputSignal
    kind: str
    origin_ns: int
    clock_rate: Prior
    is_hub: bool


def _rig_of(path: AnyPath, info: Mapping[str, Any], signals: Signals, notes: list[str]) -> Rig | None:
    """Return the rig that a bag describes, None where it describes none or one that nobody knows any more."""
    try:
        return described_rig(path, info)
    except UsageError as err:
        if not (signals.drive and signals.outputs):
            notes.append(
                f"{err}: without it there is no theory to compare with, holds are those of the packaged rig, and "
                "exposure and encoder are taken to be ideal"
            )
        return None


def _hub_drive(
    bag: Bag, rig: Rig | None, structure: str, info: Mapping[str, Any], notes: list[str]
) -> _Drive:
    """Read what the rig's hub did."""
    path, known = bag.path, rig or Rig.from_file()
    mode = str(info.get("mode", known.hub.command_mode))
    if mode not in _STRUCTURE_OF_MODE:
        raise BagError(
            f"{path}: excitation/info names the command mode {mode!r}; expected one of "
            f"{', '.join(_STRUCTURE_OF_MODE)}: give the structure with --structure and the rig with --rig-file"
        )
    _refuse_unrun_sequence(path, info, bag.sequence_states())
    chosen = _STRUCTURE_OF_MODE[mode] if structure == "auto" else structure
    if chosen not in _INPUT_OF_STRUCTURE:
        raise UsageError(
            f"structure {chosen} has a force of its own as input, and the hub is none; name it with --input "
            "TOPIC:FIELD"
        )
    topic, quantity, unit, kind = _INPUT_OF_STRUCTURE[chosen]
    bag.require(topic)
    bag.read(topic, "beam/displacement", "hub/clock_sync")
    samples = without_stray_batches(bag, bag.hub_samples(topic), notes)
    syncs = bag.clock_syncs()
    values = getattr(samples, quantity)
    if values is None:
        raise BagError(
            f"{path}: {topic} carries no {quantity}, which structure {chosen} needs; choose the structure that "
            f"goes with command mode {mode}"
        )
    part = longest_epoch(samples, notes)
    rate, clock_rate = device_clock(samples, syncs, part)
    origin_ns = int(samples.stamps_ns[part.start])
    times, filled = on_every_tick(device_times(samples, part, rate, origin_ns), values[part], samples, rate)
    _note_gaps(samples, part, origin_ns, notes)
    hold = known.hub.measured_hold if topic == "hub/measured" else known.hub.applied_hold
    drive = InputSignal("hub", unit, times, filled, hold)
    if topic == "hub/measured":
        resolution = rig.hub.encoder_resolution if rig else 0.0
        drive = replace(drive, sigma=_encoder_noise(drive, resolution, notes))
        seen = np.isfinite(filled)
        is_coarse = drive.sigma > _FINE_ENCODER
        if (is_coarse or not np.all(seen)) and bag.count("hub/applied"):
            commanded = bag.hub_samples("hub/applied")
            reference = _commanded_position(commanded, known.hub.applied_hold, times, origin_ns, rate)
            led = as_commanded(drive, reference, seen) if is_coarse and reference is not None else None
            if led is not None:
                apart = float(np.std((drive.values - led.values)[seen]))
                notes.append(
                    f"hub/measured differs from the motion that hub/applied makes by noise of {apart * 1e6:.2g} um "
                    "alone: the hub went as it was led; its position is taken from hub/applied, without that noise"
                )
            drive = led or _filled_by_command(drive, times, filled, reference)
    return _Drive(drive, kind, origin_ns, clock_rate, is_hub=True)


def _signal_drive(bag: Bag, source: SignalSource, notes: list[str]) -> _Drive:
    """Read an input by its topic and field."""
    samples = read_field(bag, source.topic, source.field)
    origin_ns = int(samples.stamps_ns[0])
    notes += samples.notes(origin_ns)
    notes.append(f"input {source.title} is a {source.input_kind}, {source.held} between samples")
    signal = input_signal(source, samples, origin_ns)
    return _Drive(signal, source.input_kind, origin_ns, Prior(0.0, 0.0), is_hub=False)


def _signal_output(bag: Bag, source: SignalSource, origin_ns: int, notes: list[str]) -> SensorOutput:
    """Read an output by its topic and field."""
    samples = read_field(bag, source.topic, source.field)
    notes += samples.notes(origin_ns)
    notes.append(f"output {source.title} is taken for {source.output_kind}, in {source.unit}")
    return output_signal(source, samples, origin_ns)


def _cut(record: TimeRecord, segments: Sequence[tuple[float, float]]) -> list[TimeRecord]:
    """Return the segments of a record, each by itself."""
    first, last = record.inputs[0].span_s
    parts = []
    for start, end in segments:
        if start >= last or end <= first:
            raise UsageError(
                f"segment {start:g}:{end:g} lies outside of {record.name}, which spans {first:.3f} to {last:.3f} s; "
                "give one inside"
            )
        parts.append(record.between(start, min(end, last)))
    return parts


def described_rig(path: AnyPath, info: Mapping[str, Any]) -> Rig:
    """Build the rig that a bag's ``excitation/info`` describes.

    Parameters
    ----------
    path : Path -- the bag, for the message
    info : mapping -- the content of ``excitation/info``; empty where there is none

    Raises
    ------
    UsageError
        It describes none, or one that this version does not know.
    """
    if "rig" not in info:
        raise UsageError(
            f"{path}: has no excitation/info that describes its rig; give the rig file it was recorded "
            "with (--rig-file)"
        )
    try:
        return Rig.from_nested(in_present_words(info["rig"]))
    except (ParameterFileError, AttributeError) as err:
        raise UsageError(
            f"{path}: its excitation/info describes a rig that this version does not read ({err}); give the "
            "rig file it was recorded with (--rig-file)"
        ) from err


def _refuse_unrun_sequence(
    path: AnyPath, info: Mapping[str, Any], states: Sequence[Mapping[str, Any]]
) -> None:
    """Name the hub's refusal where the recorded excitation never ran."""
    for state in states:
        if state.get("id") == info.get("sequence_id") and state.get("state") == "refused":
            raise BagError(
                f"{path}: the hub refused the excitation {state['id']} ({state.get('reason')}), so that nothing "
                "moved; mend that and record again"
            )


def _note_gaps(samples: HubSamples, part: slice, origin_ns: int, notes: list[str]) -> None:
    """Name the gaps in the samples that are used."""
    first, last = int(samples.stamps_ns[part.start]), int(samples.stamps_ns[part.stop - 1])
    gaps = [gap for gap in samples.gaps if first <= gap.start_ns and gap.end_ns <= last]
    if not gaps:
        return
    named = [
        f"{(gap.start_ns - origin_ns) * 1e-9:.3f} s ({(gap.end_ns - gap.start_ns) * 1e-6:.3g} ms)"
        for gap in gaps[:_NAMED_GAPS]
    ]
    more = f" and {len(gaps) - _NAMED_GAPS} more" if len(gaps) > _NAMED_GAPS else ""
    notes.append(
        f"{samples.topic} has {_counted(len(gaps), 'gap')}, {sum(gap.missing for gap in gaps)} samples lost: at "
        f"{', '.join(named)}{more}; what is on both sides was used"
    )


def _encoder_noise(drive: InputSignal, resolution: float, notes: list[str]) -> float:
    """Return the standard deviation of a measured position [m]: of its rounding, or more where it shows more."""
    of_rounding = resolution / math.sqrt(12.0)
    shown = StillNoise.of(drive).sigma
    if shown > _MORE_NOISE * of_rounding:
        notes.append(
            f"hub/measured has noise of {shown * 1e6:.2g} um, more than the {of_rounding * 1e6:.2g} um of an encoder "
            f"of {resolution * 1e6:.2g} um"
        )
    return max(shown, of_rounding)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _commanded_position(
    commanded: HubSamples, hold: Hold, times: FloatArray, origin_ns: int, rate: float
) -> FloatArray | None:
    """Return the position that the commands make, up to a constant and a drift; NaN where they were lost.

    The device integrates what it is given itself, so that commands say what the hub did while nobody heard of it,
    but for the error of its servo.
    """
    quantities = ((commanded.positions, 0), (commanded.velocities, 1), (commanded.accelerations, 2))
    for values, n_integrals in quantities:
        if values is None or np.count_nonzero(np.isfinite(values)) < 2:
            continue
        part = slice(0, len(values))
        at, every = on_every_tick(device_times(commanded, part, rate, origin_ns), values, commanded, rate)
        lost = np.isnan(every)
        signal = PiecewisePolynomial.from_samples(at, np.where(lost, 0.0, every), hold)
        for _ in range(n_integrals):
            signal = signal.antiderivative()
        known = (times >= at[0]) & (times <= at[-1]) & (np.interp(times, at, lost.astype(np.float64)) == 0.0)
        return np.where(known, signal(np.clip(times, at[0], at[-1])), np.nan)
    return None


def _filled_by_command(
    alone: InputSignal, times: FloatArray, values: FloatArray, reference: FloatArray | None
) -> InputSignal:
    """Return the input with every gap filled from its own samples or from the commands, whichever is surer."""
    if reference is None:
        return alone
    left = values - reference
    filled, gaps = np.array(alone.values), []
    for gap in alone.gaps:
        first = int(np.searchsorted(times, gap.start_s, side="right"))
        hole = slice(first, first + gap.missing)
        if np.all(np.isfinite(left[[first - 1, first + gap.missing]])) and not np.any(
            np.isnan(reference[hole])
        ):
            led = Bridge(times, left, first, gap.missing)
            if led.gap.sigma < gap.sigma:
                filled[hole], gap = led.values + reference[hole], led.gap
        gaps.append(gap)
    return replace(alone, values=filled, gaps=tuple(gaps))


def _outputs(
    displacements: Displacements, origin_ns: int, rig: Rig | None, notes: list[str]
) -> tuple[OutputSignal, ...]:
    readout, exposure = (rig.camera.readout, rig.camera.exposure) if rig else (0.0, 0.0)
    times: FloatArray = np.asarray((displacements.stamps_ns - origin_ns) * 1e-9, dtype=np.float64)
    # With a rolling shutter every marker has stamps of its own: those of the first one count the frames.
    is_frame = np.isfinite(displacements.positions[:, 0]) if readout else np.ones(len(times), dtype=bool)
    lost, longest_s = _lost_frames(times[is_frame])
    if lost:
        notes.append(
            f"beam/displacement lacks {lost} of {lost + np.count_nonzero(is_frame)} frames, at the longest "
            f"{longest_s * 1e3:.3g} ms; all others were used at their own stamps"
        )
    outputs = []
    for k, name in enumerate(displacements.names):
        values = displacements.positions[:, k]
        seen = np.isfinite(values)
        if not np.any(seen):
            notes.append(f"{name} was never seen and is left out")
            continue
        missing = int(np.count_nonzero(~seen))
        # With a rolling shutter every marker has stamps of its own, and NaN at the others'.
        if missing and readout == 0.0:
            notes.append(f"{name} was not seen in {missing} of {len(values)} frames")
        outputs.append(OutputSignal(name, "m", times[seen], values[seen], exposure_s=exposure))
    return tuple(outputs)


def _lost_frames(times: FloatArray) -> tuple[int, float]:
    """Return how many frames are missing between the first and the last, and the longest time without one [s]."""
    steps = np.diff(times)
    if len(steps) < 2:
        return 0, 0.0
    counts = np.rint(steps / np.median(steps))
    return int(np.sum(np.maximum(counts - 1.0, 0.0))), float(np.max(steps))


def _trimmed(record: TimeRecord, info: Mapping[str, Any]) -> TimeRecord:
    """Leave out what happened long before the excitation began."""
    drive = record.inputs[0]
    first, last = drive.span_s
    if "start_ns" in info and drive.name == "hub":
        first = max(first, (int(info["start_ns"]) - record.start_ns) * 1e-9 - _LEAD_S)
    guard = 0.02
    outputs = tuple(output.between(first + guard, last - guard) for output in record.outputs)
    return TimeRecord((drive.between(first, last),), outputs, record.start_ns, record.name)


def theoretical_modes(rig: Rig, structure: str) -> tuple[FloatArray, FloatArray]:
    """Return natural frequencies [rad/s] and damping ratios of the poles that a structure identifies."""
    model: BeamModel = rig.beam_model()
    if structure == "force":
        return model.free_hub_natural_frequencies, model.free_hub_damping_ratios
    return model.natural_frequencies, model.damping_ratios


@dataclass(frozen=True, eq=False)
class Identification:
    """An identification with everything that a report says of it.

    Attributes
    ----------
    experiments : tuple of Experiment -- what was identified
    options : FitOptions -- how
    result : Result
    unseen : tuple of (Experiment, tuple of ValidationResult)
        What the models were scored on, and how each of them did there.
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
    content: Mapping[str, Any]
    curves: AmplitudeCurves | None = None
    best_linear: BestLinearApproximation | None = None
    linearity: Linearity | None = None
    axis: AxisResult | None = None

    @property
    def experiment(self) -> Experiment:
        """The first experiment, whose rig and structure hold for all."""
        return self.experiments[0]


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
    progress: Progress = lambda phrase, share: None,
) -> Identification:
    """Identify a model from a bag, or several, and keep everything for a report.

    Parameters
    ----------
    path : Path or sequence of Path -- the bag, or bags of one system that are one fit
    rig : Rig, optional -- None: as the bag says
    options : FitOptions, optional
    estimator, structure, n_modes : optional -- these options instead of those in ``options``
    validation : Path or sequence of Path, optional -- other bags, on which the model is scored
    start_s, end_s : float, optional -- only what lies between these times after the first message of each bag [s]
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
    if options.axis and options.structure == "auto" and options.signals.drive is None:
        # From force to motion leads the axis with its friction; the beam answers to the motion, which is measured.
        options = replace(options, structure="base_motion")
    experiments = [
        load_experiment(one, rig, options.structure, options, start_s=start_s, end_s=end_s)
        for one in _several(path)
    ]
    whole = replace(options, segments=())
    unseen = [load_experiment(one, rig, options.structure, whole) for one in _several(validation)]
    experiment = experiments[0]
    for other in (*experiments[1:], *unseen):
        if other.structure != experiment.structure:
            raise UsageError(
                f"{experiment.path} shows {experiment.structure} and {other.path} {other.structure}; expected bags "
                "of one kind of drive, or a structure that fits all with --structure"
            )
    refuse_shared([(one.path, one.record) for one in experiments], [(one.path, one.record) for one in unseen])
    # Before the fit: bags that are no realisations are refused at once.
    best_linear = best_linear_of(experiments) if options.best_linear else None
    settings = replace(
        options.settings(experiment.structure, experiment.clock_rate, experiment.latency), progress=progress
    )
    records = [record for one in experiments for record in one.records]
    try:
        result = run_estimator(options.estimator, records, settings)
    except IdentificationError as err:
        notes = [note for one in experiments for note in one.notes]
        if not notes:
            raise
        raise type(err)(f"{err}. Of the bag: {'; '.join(notes)}") from err
    content = describe(experiments, options.estimator, result)
    seen = tuple((one, _validated(one, result)) for one in unseen)
    if seen:
        content["validation"] = [
            {"bag": str(one.path), "scores": _validation_scores(results)} for one, results in seen
        ]
    found_linear = None
    if isinstance(result, IdentificationResult) and result.model.n_modes:
        found_linear = linearity(records, result.model)
        content["linearity"] = found_linear.to_dict()
    curves = None
    if options.amplitude:
        progress("curves over amplitude", 0.0)
        curves = _over_amplitude(records, result, found_linear)
        content["amplitude"] = curves.to_dict()
    if best_linear is not None:
        content["best_linear"] = best_linear.to_dict()
    axis = None
    if options.axis:
        progress("the axis", 0.0)
        axis = identify_axis_of([one.path for one in experiments], experiment.rig, content["notes"])
        content["axis"] = axis.to_dict()
        if experiment.rig is not None:
            content["rig_values"] = rig_values(axis, experiment.rig)
    return Identification(
        tuple(experiments), options, result, seen, content, curves, best_linear, found_linear, axis
    )


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


def describe(experiments: Sequence[Experiment], estimator: str, result: Result) -> dict[str, Any]:
    """Summarise an identification in plain numbers, beside the theory of its rig."""
    experiment = experiments[0]
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "bag": str(experiment.path),
        "bags": [str(one.path) for one in experiments],
        "estimator": estimator,
        "structure": experiment.structure,
        "outputs": list(experiment.output_names),
        "modes": _modes(experiment, result),
    }
    model = models_of(result)[0]
    if isinstance(model, ModalModel):
        content |= {
            "latency_s": model.latency + experiment.late_s,
            "latency_sd_s": model.latency_sd,
            "clock_rate": model.clock_rate,
            "clock_rate_sd": model.clock_rate_sd,
        }
    content["scores"] = _scores(experiment, result)
    if isinstance(result, LineResult):
        content["misfit"] = result.misfit.chi_squared / result.misfit.expected
    if isinstance(result, SeparateOutputsResult) and result.tables:
        content["orders"] = list(result.tables)
    notes = [
        note if len(experiments) == 1 else f"{one.path.name}: {note}"
        for one in experiments
        for note in one.notes
    ]
    return content | {"converged": result.converged, "warnings": list(result.warnings), "notes": notes}


def _modes(experiment: Experiment, result: Result) -> list[dict[str, Any]]:
    """Return every mode, beside the nearest of theory where there is one; by output where each has its own poles."""
    theory = theoretical_modes(experiment.rig, experiment.structure) if experiment.rig else None
    found: dict[tuple[float, ...], Any] = {}
    for model in models_of(result):
        modes = model.modes() if hasattr(model, "modes") else ((), (), (), ())
        found.setdefault(tuple(modes[0]), (model, modes))
    rows = []
    doubts = iter(result.doubts if isinstance(result, IdentificationResult) else ())
    hertz = 2.0 * math.pi
    for model, modes in found.values():
        for omega, zeta, omega_sd, zeta_sd in zip(*modes, strict=True):
            row: dict[str, Any] = {
                "frequency_hz": float(omega / hertz),
                "frequency_sd_hz": float(omega_sd / hertz),
                "damping_ratio": float(zeta),
                "damping_ratio_sd": float(zeta_sd),
            }
            if theory is not None:
                omegas, zetas = theory
                nearest = int(np.argmin(np.abs(np.log(omegas / omega))))
                row |= {
                    "theory_mode": nearest + 1,
                    "theory_frequency_hz": float(omegas[nearest] / hertz),
                    "theory_damping_ratio": float(zetas[nearest]),
                    "frequency_z": float((omega - omegas[nearest]) / omega_sd),
                    "damping_ratio_z": float((zeta - zetas[nearest]) / zeta_sd),
                }
            row["doubt"] = next(doubts, "")
            rows.append(row if len(found) == 1 else {"output": model.output_name, **row})
    return rows


def _scores(experiment: Experiment, result: Result) -> dict[str, dict[str, Any]]:
    """Return how well every output is reproduced, where the result is one from samples."""
    if not isinstance(result, TimeResult):
        return {}
    parts = (result.scores, result.whiteness, result.residuals)
    scores = {
        name: {
            "fit_percent": own.fit_percent,
            "r_squared": own.r_squared,
            "noise_sd_m": float(np.std(residuals)),
            "residuals_are_white": whiteness.is_white,
        }
        for name, own, whiteness, residuals in zip(
            experiment.output_names,
            *(part if isinstance(part, tuple) else (part,) for part in parts),
            strict=True,
        )
    }
    for output in result.outputs if isinstance(result, IdentificationResult) else ():
        scores[output.name] |= {
            "deflection_fit_percent": output.deflection_scores.fit_percent,
            "deflection_r_squared": output.deflection_scores.r_squared,
            "noise_sd_m": output.noise_sd,
        }
    return scores


def _validated(unseen: Experiment, result: Result) -> tuple[ValidationResult, ...]:
    """Score the model, or the model of every output, on data that it was not fitted to."""
    for model in models_of(result):
        if not hasattr(model, "simulate"):
            raise UsageError(
                f"--validate needs a model that predicts, and this estimator gives a {type(model).__name__}; leave "
                "--validate out, or take the estimator modal"
            )
    return tuple(validate(model, list(unseen.records)) for model in models_of(result))


def _validation_scores(results: Sequence[ValidationResult]) -> dict[str, dict[str, Any]]:
    return {
        output.name: {
            "fit_percent": output.scores.fit_percent,
            "r_squared": output.scores.r_squared,
            "deflection_fit_percent": output.deflection_scores.fit_percent,
            "fit_from_rest_percent": output.simulation_scores.fit_percent,
            "residual_over_noise": output.noise_ratio,
            "verdict": output.verdict,
        }
        for result in results
        for output in result.outputs
    }


def write_models(found: Identification, path: Path) -> Path:
    """Write the models of an identification with its summary as JSON; the file appears whole or not at all."""
    stored = [model.to_dict() for model in models_of(found.result)]
    models = {"model": stored[0]} if len(stored) == 1 else {"models": stored}
    document = {"schema": SCHEMA, **models, "summary": found.content}
    write_whole(path, strict_json(document, indent=1))
    return path


def format_table(content: Mapping[str, Any]) -> str:
    """Format the identified modes, beside the theoretical ones where there are some, for a terminal."""
    has_theory = any("theory_mode" in mode for mode in content["modes"])
    lines = (
        [
            "mode    identified                    theory    off       identified            theory    off",
            "        natural frequency [Hz]                 [sd]      damping ratio [%]               [sd]",
        ]
        if has_theory
        else ["mode    natural frequency [Hz]      damping ratio [%]"]
    )
    for k, mode in enumerate(content["modes"], start=1):
        if mode.get("doubt"):
            # Deviations of a mode that is not there mean nothing, however small they come out.
            lines.append(
                f"{mode.get('output', k):>4} {mode['frequency_hz']:>13.1f} not a mode: {mode['doubt']}"
            )
            continue
        f_sd, zeta_sd = mode["frequency_sd_hz"], 100 * mode["damping_ratio_sd"]
        decimals = min(max(4, 1 - math.floor(math.log10(f_sd))), 8) if 0.0 < f_sd < math.inf else 6
        frequency = (
            f"{mode.get('output', k):>4} {mode['frequency_hz']:>13.{decimals}f} +- {_or_dash(f_sd, '<8.2g')} "
        )
        damping = f"{100 * mode['damping_ratio']:>8.5f} +- {_or_dash(zeta_sd, '<8.2g')} "
        if has_theory:
            frequency += (
                f"{mode['theory_frequency_hz']:>13.{decimals}f} {_deviations(mode['frequency_z'])}      "
            )
            damping += f"{100 * mode['theory_damping_ratio']:>7.4f} {_deviations(mode['damping_ratio_z'])}"
        lines.append((frequency + damping).rstrip())
    return "\n".join(lines)


def _deviations(z: float) -> str:
    """Return a difference from theory in standard deviations; so many that only "other" is true are not counted."""
    if abs(z) > _MOST_DEVIATIONS:
        return f"{'>' if z > 0.0 else '<-'}{_MOST_DEVIATIONS}".rjust(6)
    return _or_dash(z, ">+6.1f")


def _or_dash(value: float, form: str) -> str:
    """Return a number in a format that begins with alignment and width, or a dash where it is not known."""
    return (
        format(value, form) if math.isfinite(value) else format("-", form.replace("+", "").partition(".")[0])
    )
