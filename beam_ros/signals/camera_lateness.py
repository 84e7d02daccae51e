"""How late a camera's stamps are at this start, from the low marker beside the hub.

Drivers that stamp frames on arrival are late by a time that differs at every start, by up to a second
(docs/cameras.md). A fit of the modes finds latencies within a fifth of a second by itself; what is beyond is found
here first, before anything is fitted, and taken off the stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident import OutputSignal
from beam_ros.arrays import FloatArray
from beam_ros.bags.reading import Bag
from beam_ros.signals.stray_stamps import without_stray_batches
from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.synchronisation import Synchronisation, synchronise

REACH_S = 0.1
"""Latencies up to this are left to the fit, which searches twice as far."""
_STRETCH_S = 60.0
"""So much of a record, where the hub moves most, tells the offset."""
_MARGIN_S = 2.0
_LOOK_S = 0.1
_CLEAR_SD = 3.0


@dataclass(frozen=True)
class CameraLateness:
    """How late the stamps of a camera are.

    Attributes
    ----------
    late_s, late_sd_s : float -- in the middle of the record [s]
    rate, rate_sd : float -- of the camera's clock against the hub's, less one
    """

    late_s: float
    late_sd_s: float
    rate: float
    rate_sd: float

    @property
    def sentence(self) -> str:
        """What a reader should know."""
        return (
            f"the camera's stamps are late by {self.late_s:.4f} +- {self.late_sd_s:.2g} s, as the low marker beside "
            "the hub tells; that was taken off, and is part of the latency that is reported"
        )

    def rate_tolerance(self, tolerance: float) -> float:
        """Return the tolerance of the clock's rate, widened where the marker clearly contradicts it."""
        is_beyond = abs(self.rate) - _CLEAR_SD * self.rate_sd > tolerance
        return abs(self.rate) if is_beyond else tolerance


def camera_lateness(bag: Bag, outputs: Sequence[OutputSignal], origin_ns: int) -> CameraLateness | None:
    """Find how late the markers' stamps are.

    Parameters
    ----------
    bag : Bag -- with ``hub/measured``
    outputs : sequence of OutputSignal -- the markers, from the lowest; times since ``origin_ns``
    origin_ns : int -- [ns, UNIX]

    Returns
    -------
    CameraLateness or None -- None where it is within the reach of a fit, or nothing tells it
    """
    if not outputs or not bag.count("hub/measured"):
        return None
    hub = without_stray_batches(bag, bag.hub_samples("hub/measured"), [])
    part = max(hub.stretches, key=lambda own: own.stop - own.start)
    if hub.positions is None or part.stop - part.start < 2:
        return None
    low, positions = outputs[0], hub.positions[part]
    hub_t: FloatArray = np.asarray((hub.stamps_ns[part] - origin_ns) * 1e-9)
    is_beside = (low.times_s >= hub_t[0] - _MARGIN_S) & (low.times_s <= hub_t[-1] + _MARGIN_S)
    low_t, low_x = low.times_s[is_beside], low.values[is_beside]
    if not len(low_t):
        return None
    first, last = _busiest(hub_t, positions)
    near = (hub_t >= first - _MARGIN_S) & (hub_t <= last + _MARGIN_S)
    own = (low_t >= first) & (low_t <= last)
    try:
        found = synchronise(
            hub_t[near],
            positions[near],
            low_t[own],
            low_x[own],
            fits_drift=True,
            expected_s=REACH_S,
        )
    except SynchronisationError:
        return None  # a marker that does not move as the hub does tells nothing
    late = _in_the_middle(found, 0.5 * float(low_t[0] + low_t[-1]))
    return late if abs(late.late_s) > REACH_S else None


def _in_the_middle(found: Synchronisation, middle: float) -> CameraLateness:
    return CameraLateness(
        middle - float(found.hub_times(middle)), found.offset_sd_s, -found.drift, found.drift_sd
    )


def on_time(outputs: Sequence[OutputSignal], late: CameraLateness) -> tuple[OutputSignal, ...]:
    """Return the markers with stamps that are late no more."""
    return tuple(replace(output, times_s=output.times_s - late.late_s) for output in outputs)


def _busiest(times: FloatArray, positions: FloatArray) -> tuple[float, float]:
    """Begin and end of the stretch in which the hub travels farthest [s]."""
    step = max(1, round(_LOOK_S / max(float(np.median(np.diff(times))), 1e-6)))
    coarse_t, coarse_x = times[::step], np.nan_to_num(positions[::step])
    if len(coarse_t) < 2 or coarse_t[-1] - coarse_t[0] <= _STRETCH_S:
        return float(times[0]), float(times[-1])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(coarse_x)))])
    ends = np.searchsorted(coarse_t, coarse_t + _STRETCH_S).clip(max=len(coarse_t) - 1)
    start = int(np.argmax(way[ends] - way))
    return float(coarse_t[start]), float(coarse_t[ends[start]])
