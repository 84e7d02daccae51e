"""Samples of fields as signals of identification, and sensors of several kinds under one model.

A response that shows acceleration is the one that shows displacement, differentiated twice; so is the response to an
input that is differentiated twice. Sensors of different kinds therefore become records of one model: in each stands
the input in the form that makes all outputs answer alike. Wherever possible the input is integrated for the lower
kinds, which is exact; a position is differentiated only where an output shows more than the input has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident import InputSignal, LowPass, OutputSignal, TimeRecord
from beam_ident.numerics.piecewise import Hold
from beam_ros.arrays import FloatArray, StampArray
from beam_ros.signals.descriptions import FORCE, POWERS, SENSORS, SignalSource
from beam_ros.signals.fields import FieldSamples

_MOTION = ("base_motion", "velocity", "acceleration")
"""Structures by how often the input is integrated to become what the outputs show of the base."""
_SMOOTHER: dict[Hold, Hold] = {"zoh": "linear", "linear": "cubic"}


@dataclass(frozen=True)
class SensorOutput:
    """An output, and how often displacement is differentiated to become it."""

    signal: OutputSignal
    power: int = 0


def input_signal(source: SignalSource, samples: FieldSamples, origin_ns: int) -> InputSignal:
    """Return a field's samples as an input, on the time axis that begins at ``origin_ns``."""
    hold: Hold = source.held  # type: ignore[assignment]
    seen = np.isfinite(samples.values)
    return InputSignal(
        source.title,
        source.input_unit,
        _times(samples.stamps_ns[seen], origin_ns, source),
        samples.values[seen] * source.factor,
        hold,
        source.sd or 0.0,
    )


def output_signal(source: SignalSource, samples: FieldSamples, origin_ns: int) -> SensorOutput:
    """Return a field's samples as an output, on the time axis that begins at ``origin_ns``."""
    seen = np.isfinite(samples.values)
    signal = OutputSignal(
        source.title,
        source.output_unit,
        _times(samples.stamps_ns[seen], origin_ns, source),
        samples.values[seen] * source.factor,
        source.exposure,
        source.sd,
        LowPass.of_order(source.order, source.low_pass) if source.low_pass else None,
    )
    return SensorOutput(signal, SENSORS[source.output_kind])


def _times(stamps_ns: StampArray, origin_ns: int, source: SignalSource) -> FloatArray:
    """Return when samples were taken [s], as far as the sensor's delay is known."""
    return np.asarray((stamps_ns - origin_ns) * 1e-9 - source.delay, dtype=np.float64)


def records_of_one_model(
    drive: InputSignal,
    drive_kind: str,
    outputs: Sequence[SensorOutput],
    origin_ns: int,
    name: str,
    has_rigid_body: bool = False,
) -> tuple[str, tuple[TimeRecord, ...]]:
    """Return the structure that all outputs share, and a record for each kind of sensor.

    Parameters
    ----------
    drive : InputSignal
    drive_kind : str -- position, velocity, acceleration or force
    outputs : sequence of SensorOutput
    origin_ns : int -- host time of the instant 0 s [ns]
    name : str -- of the records
    has_rigid_body : bool -- whether a force moves the structure as a whole, seen by sensors of displacement

    Notes
    -----
    With H the response of displacement to the base's position, an output of power d answers an input of power p with
    ``s^(d - p) H``. The structures base_motion, velocity and acceleration are ``s^0 H``, ``s^-1 H`` and
    ``s^-2 H``: with k integrations in the structure, the record of power d has the input of power ``k + d``.
    Accelerance is ``s^0 H``, too, but for the signs of its residues, and takes an input that jumps.
    """
    powers = sorted({own.power for own in outputs}, reverse=True)
    if drive_kind == FORCE:
        structure = list(SENSORS)[powers[0]]
        if structure == "receptance" and has_rigid_body:
            structure = "force"
        steps = {power: power - powers[0] for power in powers}
    else:
        own = POWERS[drive_kind]
        integrations = max(own - powers[0], 0)
        structure = _MOTION[integrations]
        if own and not integrations and drive.hold == "zoh":
            structure = "accelerance"
        steps = {power: integrations + power - own for power in powers}
    records = tuple(
        TimeRecord(
            (_differentiated(drive, steps[power]),),
            tuple(own.signal for own in outputs if own.power == power),
            origin_ns,
            name,
        )
        for power in powers
    )
    return structure, records


def _differentiated(drive: InputSignal, times: int) -> InputSignal:
    """Return an input differentiated so many times, or integrated where the number is negative.

    It keeps the unit of what was measured: records of one fit agree in it.
    """
    for _ in range(-times):
        whole = drive.signal().antiderivative()
        drive = replace(
            drive,
            values=whole(drive.times_s),
            hold=_SMOOTHER.get(drive.hold, drive.hold),
            sigma=0.0,
            gaps=(),
        )
    for _ in range(times):
        slope = drive.signal("cubic").derivative()
        # Noise of a value becomes noise of a slope: that of a central difference, to within a fifth.
        step = float(np.median(np.diff(drive.times_s)))
        drive = replace(
            drive,
            values=slope(drive.times_s),
            hold="cubic",
            sigma=drive.sigma * math.sqrt(2.0) / step,
            gaps=(),
        )
    return drive
