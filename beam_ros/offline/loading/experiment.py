"""A recorded bag as one experiment: what ``beam identify``, ``beam check`` and the identifier node begin with.

Only header stamps carry time. The hub's samples are counted in device ticks and put on the host's clock by one
straight line through the whole recording's clock comparisons; how well that line is known enters the fit as
prior knowledge of the clock rate, and so the stated standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import InputSignal, Prior, TimeRecord
from beam_ros.bags.apparatus import MEASURED, Apparatus, apparatus_of
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.errors import UsageError
from beam_ros.files.formats import is_column_file
from beam_ros.offline.loading.described_rig import described_rig
from beam_ros.offline.loading.hub_drive import RecordedDrive, hub_drive
from beam_ros.offline.loading.markers import marker_outputs
from beam_ros.offline.loading.options import FitOptions
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.film_points import rig_with_points
from beam_ros.rig.rig import Rig
from beam_ros.signals.camera_lateness import CameraLateness, camera_lateness, on_time
from beam_ros.signals.descriptions import Signals, SignalSource
from beam_ros.signals.fields import FieldSamples, read_field
from beam_ros.signals.file_columns import read_file_signals
from beam_ros.signals.records import SensorOutput, input_signal, output_signal, records_of_one_model
from beam_ros.signals.stray_stamps import well_placed

IMAGES = "camera/image_raw"
VIDEO_TOPIC = "tracker/video"
"""String topic on which ``beam track`` says how a video's frames came into the bag: JSON."""
_LEAD_S = 0.3
_GUARD_S = 0.02
_MIN_SEEN = 50
_UNUSED = 0.1  # of an output's samples: more of them without input are named
_CLOCK_TOLERANCE = 50e-6


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
    apparatus : Apparatus -- whether a beam was measured or simulated, and whether its date is one
    n_images : int -- frames in the bag
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
    apparatus: Apparatus = MEASURED
    n_images: int = 0

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
    """Read a bag, or a file of columns, as one experiment.

    Parameters
    ----------
    path : Path or RemotePath -- the bag, or a file in a format of ``beam_ros.files``
    rig : Rig, optional -- None: the rig that the bag itself describes, if it does
    structure : str -- base_motion, acceleration, velocity or force; "auto": by the hub's command mode
    options : FitOptions, optional -- signals, segments and hold are taken from it
    start_s, end_s : float, optional -- only what lies between these times after the first message, or row [s]

    Returns
    -------
    Experiment

    Raises
    ------
    BagError
        The bag is missing, damaged, or lacks a topic that identification needs.
    UsageError
        A signal names no field, or its samples do not go together with the others.
    ColumnFileError
        A file of columns cannot be read, lacks a column or a unit, or has times that cannot be right.
    """
    options = options or FitOptions()
    if is_column_file(path):
        return _columns_experiment(Path(str(path)), rig, structure, options, start_s, end_s)
    with Bag(path, start_s=start_s, end_s=end_s) as bag:
        return experiment_of(bag, rig, structure, options)


def experiment_of(
    bag: Bag, rig: Rig | None = None, structure: str = "auto", options: FitOptions | None = None
) -> Experiment:
    """Read an open bag, or what was heard so far, as one experiment: as ``load_experiment`` does."""
    options = options or FitOptions()
    path, signals = bag.path, options.signals
    signals.require_topics()
    notes: list[str] = []
    if not signals.outputs:
        bag.require("beam/displacement")
    bag.read("excitation/info", "hub/sequence_state", VIDEO_TOPIC, "/diagnostics")
    info = bag.excitation_info() or {}
    apparatus = apparatus_of(bag, info)
    rig = rig or _rig_of(path, info, signals, notes)
    videos = bag.texts(VIDEO_TOPIC)
    if rig is not None and videos and "points" in videos[-1]:
        rig = rig_with_points(rig, videos[-1]["points"])
    if signals.drive is None:
        drive = hub_drive(bag, rig, structure, info, notes)
    else:
        drive = _signal_drive(read_field(bag, signals.drive.topic, signals.drive.field), signals.drive, notes)
    outputs, late = _outputs(bag, signals, drive, rig, bool(videos), notes)
    shares_clock = {own.topic for own in signals.outputs} == {signals.drive.topic if signals.drive else ""}
    chosen, records = _records(path.name, structure, options, drive, outputs, notes, info)
    return Experiment(
        path,
        records[0],
        rig,
        chosen,
        Prior(drive.clock_rate.mean, math.hypot(drive.clock_rate.sd, _rate_tolerance(rig, videos, late))),
        tuple(notes),
        info,
        further=records[1:],
        latency=None if drive.is_hub or shares_clock else Prior(0.0, math.inf),
        late_s=late.late_s if late else 0.0,
        apparatus=apparatus,
        n_images=bag.count(IMAGES),
    )


def _outputs(
    bag: Bag, signals: Signals, drive: RecordedDrive, rig: Rig | None, is_video: bool, notes: list[str]
) -> tuple[list[SensorOutput], CameraLateness | None]:
    """Return the outputs that are named, else the markers, and by how much the camera was late with these."""
    if signals.outputs:
        fields = [(read_field(bag, own.topic, own.field), own) for own in signals.outputs]
        return [_signal_output(samples, own, drive.origin_ns, notes) for samples, own in fields], None
    displacements = well_placed(bag, bag.displacements(), drive.origin_ns, notes)
    markers = marker_outputs(displacements, drive.origin_ns, rig, notes)
    late = camera_lateness(bag, markers, drive.origin_ns) if drive.is_hub and not is_video else None
    if late is not None:
        markers = on_time(markers, late)
        notes.append(late.sentence)
    return [SensorOutput(marker) for marker in markers], late


def _rate_tolerance(rig: Rig | None, videos: Sequence[Any], late: CameraLateness | None) -> float:
    """Return how well the rate of the outputs' clock is known before anything is fitted."""
    tolerance = rig.camera.clock_tolerance if rig else _CLOCK_TOLERANCE
    if videos:
        # The frames run on the camera's own clock, which is known as well as the low marker tells.
        tolerance = float(videos[-1].get("synchronisation", {}).get("drift_sd", 0.0))
    return tolerance if late is None else late.rate_tolerance(tolerance)


def _columns_experiment(
    path: Path,
    rig: Rig | None,
    structure: str,
    options: FitOptions,
    start_s: float | None,
    end_s: float | None,
) -> Experiment:
    """Read a file of columns, which share one clock."""
    notes: list[str] = []
    (source, samples), *others = read_file_signals(
        path, options.signals, options.time, notes, start_s=start_s, end_s=end_s
    )
    drive = _signal_drive(samples, source, notes)
    outputs = [_signal_output(own, told, drive.origin_ns, notes) for told, own in others]
    chosen, records = _records(path.name, structure, options, drive, outputs, notes, {})
    return Experiment(path, records[0], rig, chosen, drive.clock_rate, tuple(notes), {}, further=records[1:])


def _records(
    name: str,
    structure: str,
    options: FitOptions,
    drive: RecordedDrive,
    outputs: Sequence[SensorOutput],
    notes: list[str],
    info: Mapping[str, Any],
) -> tuple[str, tuple[TimeRecord, ...]]:
    """Return the structure, and the records of every stretch of the input and every kind of sensor."""
    chosen, records = "", tuple[TimeRecord, ...]()
    for signal, beside in _stretches(drive, outputs, notes):
        signal = signal if options.hold is None else replace(signal, hold=options.hold)
        chosen, own = records_of_one_model(
            signal, drive.kind, beside, drive.origin_ns, name, has_rigid_body=drive.is_hub
        )
        records += own
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
    return chosen, records


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


def _signal_drive(samples: FieldSamples, source: SignalSource, notes: list[str]) -> RecordedDrive:
    """Return the input that a field or a column tells of."""
    origin_ns = int(samples.stamps_ns[0])
    notes += samples.notes(origin_ns)
    notes.append(f"input {source.title} is a {source.input_kind}, {source.held} between samples")
    signal = input_signal(source, samples, origin_ns)
    return RecordedDrive((signal,), source.input_kind, origin_ns, Prior(0.0, 0.0), is_hub=False)


def _signal_output(
    samples: FieldSamples, source: SignalSource, origin_ns: int, notes: list[str]
) -> SensorOutput:
    """Return the output that a field or a column tells of."""
    notes += samples.notes(origin_ns)
    notes.append(f"output {source.title} is taken for {source.output_kind}, in {source.output_unit}")
    return output_signal(source, samples, origin_ns)


def _stretches(
    drive: RecordedDrive, outputs: Sequence[SensorOutput], notes: list[str]
) -> list[tuple[InputSignal, Sequence[SensorOutput]]]:
    """Return every stretch of the input with what was seen meanwhile; the first one whatever it has."""
    times = outputs[0].signal.times_s
    is_used = np.zeros(len(times), dtype=bool)
    for first, last in (own.span_s for own in drive.signals):
        is_used |= (times >= first) & (times <= last)
    if np.mean(is_used) < 1.0 - _UNUSED:
        notes.append(
            f"{np.count_nonzero(~is_used)} of {len(times)} samples of {outputs[0].signal.name} were taken while "
            f"nothing is known of the input {drive.signals[0].name}, and are not used"
        )
    found = [(drive.signals[0], outputs)]
    for signal in drive.signals[1:]:
        first, last = signal.span_s
        seen = [
            int(np.count_nonzero((own.signal.times_s > first) & (own.signal.times_s < last)))
            for own in outputs
        ]
        if min(seen) >= _MIN_SEEN:
            found.append((signal, outputs))
        else:
            notes.append(
                f"a stretch of {last - first:.3g} s from {first:.3f} s on is left out, for {min(seen)} samples of an "
                f"output were taken meanwhile; {_MIN_SEEN} are the least"
            )
    return found


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


def _trimmed(record: TimeRecord, info: Mapping[str, Any]) -> TimeRecord:
    """Leave out what happened long before the excitation began."""
    drive = record.inputs[0]
    first, last = drive.span_s
    if "start_ns" in info and drive.name == "hub":
        begun = (int(info["start_ns"]) - record.start_ns) * 1e-9 - _LEAD_S
        first = max(first, begun) if begun < last else first
    if last - first <= 2.0 * _GUARD_S:
        raise BagError(
            f"{record.name}: the input {drive.name} is known for {max(last - first, 0.0):.3g} s only; expected more "
            f"than {2.0 * _GUARD_S:g} s. Record input and outputs together, and longer"
        )
    outputs = tuple(output.between(first + _GUARD_S, last - _GUARD_S) for output in record.outputs)
    return TimeRecord((drive.between(first, last),), outputs, record.start_ns, record.name)
