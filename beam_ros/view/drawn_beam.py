"""The beam as the page draws it: measured by the markers, predicted from the hub, and both over the last seconds.

The measured shape is the fit of the model's modes to the markers (``beam_ros.rig.beam_line``); the predicted one
follows the hub's samples alone. Both are drawn at the same instant, that of the newest frame.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import SampleBatch
from beam_ros.messages import SECOND_NS, Displacement
from beam_ros.rig.beam_line import marker_shape_fitter
from beam_ros.rig.rig import Rig
from beam_ros.view.predicted_motion import PredictedMotion
from beam_ros.view.traces import Trace


def _millimetres(values: FloatArray) -> list[float | None]:
    """Write lengths as a browser draws them: in millimetres, to a tenth of a micrometre; null where not known."""
    return [round(value, 4) if math.isfinite(value) else None for value in (1e3 * values).tolist()]


class DrawnBeam:
    """Follows hub and markers of one rig.

    Parameters
    ----------
    rig : Rig
    seconds : float -- how long the traces of hub and tip are [s]
    points : int -- of the drawn line
    marker_sd_m : float -- of the markers' displacements, beside what the model allows the tip [m]
    first_epoch : int -- of the traces

    Attributes
    ----------
    hub : Trace -- rows of time [s], hub position [mm], predicted tip deflection [mm]
    tip : Trace -- rows of time [s], measured tip deflection [mm]
    speed : float -- the hub's [m/s]; NaN while it was not heard
    stepped_back_s : float -- by how much the stamps jumped back when the traces began anew; 0 while they have not [s]
    """

    def __init__(
        self,
        rig: Rig,
        *,
        seconds: float = 10.0,
        points: int = 41,
        marker_sd_m: float = 1e-5,
        first_epoch: int = 0,
    ) -> None:
        model = rig.beam_model()
        self._heights = np.linspace(0.0, rig.beam.length, points)
        self._shapes = model.shape(self._heights)
        self._frequencies_hz = model.natural_frequencies / (2.0 * math.pi)
        self._names = rig.markers.names
        self._marker_sd_m = marker_sd_m
        self._fitter = marker_shape_fitter(rig, rig.markers.heights)
        self._line = lru_cache(maxsize=16)(self._line_of)
        self._prediction = PredictedMotion(model)
        self.hub, self.tip = Trace(seconds, first_epoch), Trace(seconds, first_epoch)
        # What the hub did while a frame was on its way: alpha and q by their stamps.
        self._recent: deque[tuple[int, float, FloatArray]] = deque(maxlen=1000)
        self._markers: FloatArray = np.full(len(self._names), np.nan)
        self._markers_ns = 0
        self._tip: float | None = None
        self._origin_ns: int | None = None
        self.speed = math.nan
        self.stepped_back_s = 0.0

    def theory(self) -> dict[str, Any]:
        """Return the modes that the rig file lets expect: frequencies [Hz], heights [mm], shapes up to 1."""
        shapes = self._shapes / np.abs(self._shapes).max(axis=0)
        return {
            "frequency_hz": [round(own, 4) for own in self._frequencies_hz.tolist()],
            "heights": _millimetres(self._heights),
            "shapes": np.round(shapes.T, 4).tolist(),
        }

    @property
    def length_m(self) -> float:
        """Height of the tip [m]."""
        return float(self._heights[-1])

    def _seconds(self, stamp_ns: int) -> float:
        if self._origin_ns is None:
            self._origin_ns = stamp_ns
        return round((stamp_ns - self._origin_ns) / SECOND_NS, 6)

    def begin_anew(self) -> None:
        """Forget what was seen."""
        self._recent.clear()
        self._markers = np.full(len(self._names), np.nan)
        self._markers_ns, self._tip, self.speed = 0, None, math.nan
        self.hub.clear()
        self.tip.clear()

    def add_hub(self, batch: SampleBatch) -> None:
        """Take what the device measured of the hub."""
        if batch.positions is None:
            return
        if self._recent and batch.stamp_ns < self._recent[-1][0]:
            self.stepped_back_s = (self._recent[-1][0] - batch.stamp_ns) / SECOND_NS
            self.begin_anew()
        stamps = [batch.stamp_ns + k * batch.period_ns for k in range(len(batch))]
        coordinates = self._prediction.add(stamps, batch.positions)
        tip = coordinates @ self._shapes[-1]
        self._recent.extend(zip(stamps, batch.positions.tolist(), coordinates, strict=True))
        for row in zip(stamps, _millimetres(batch.positions), _millimetres(tip), strict=True):
            self.hub.add(self._seconds(row[0]), *row[1:])
        self.speed = self._speed(batch)

    def _speed(self, batch: SampleBatch) -> float:
        """Return the newest speed as the device measured it, or else over what is remembered of the last 50 ms."""
        if batch.velocities is not None:
            return float(batch.velocities[-1])
        last_ns, last, _ = self._recent[-1]
        first_ns, first, _ = next(row for row in self._recent if row[0] >= last_ns - SECOND_NS // 20)
        return (last - first) / ((last_ns - first_ns) / SECOND_NS) if last_ns > first_ns else math.nan

    def add_markers(self, displacement: Displacement) -> None:
        """Take where the markers were seen."""
        found = dict(zip(displacement.names, displacement.positions, strict=True))
        markers = np.array([found.get(name, math.nan) for name in self._names], dtype=np.float64)
        if displacement.stamp_ns == self._markers_ns:
            # With a rolling shutter, or a message for each marker, one frame comes in pieces.
            markers = np.where(np.isfinite(markers), markers, self._markers)
        self._markers, self._markers_ns = markers, displacement.stamp_ns
        is_seen = np.isfinite(markers)
        line = self._line(tuple(is_seen)) @ markers[is_seen]
        self._tip = _millimetres(line[-1:] - line[:1])[0] if is_seen.any() else None
        self.tip.add(self._seconds(displacement.stamp_ns), self._tip)

    def _line_of(self, is_seen: tuple[bool, ...]) -> FloatArray:
        """Return the matrix from the markers that were seen to the drawn line, shape (n_points, n_seen).

        The fit is linear in the markers while the same of them are seen.
        """
        sd = np.where(is_seen, self._marker_sd_m, np.nan)
        lines = [
            self._fitter.fit(np.where(is_seen, unit, np.nan), sd).displacement(self._shapes)[0]
            for unit in np.eye(len(is_seen))[list(is_seen)]
        ]
        return np.asarray(np.reshape(lines, (-1, len(self._heights))).T)

    def shape(self) -> dict[str, Any]:
        """Return the newest instant: heights, measured and predicted line, markers, all in millimetres.

        Returns
        -------
        dict -- ``at``: time on the traces [s]; ``hub``; ``tip``: how far it is bent, as measured; ``heights``;
            ``measured``, ``predicted``: null where not known; ``markers``: null where one was not seen
        """
        at_ns = self._markers_ns or (self._recent[-1][0] if self._recent else 0)
        hub, predicted = self._predicted_at(at_ns)
        is_seen = np.isfinite(self._markers)
        measured = self._line(tuple(is_seen)) @ self._markers[is_seen] if is_seen.any() else None
        return {
            "at": self._seconds(at_ns) if at_ns else None,
            "hub": _millimetres(np.array([hub]))[0],
            "tip": self._tip,
            "heights": _millimetres(self._heights),
            "measured": None if measured is None else _millimetres(measured),
            "predicted": None if predicted is None else _millimetres(predicted),
            "markers": _millimetres(self._markers),
        }

    def _predicted_at(self, at_ns: int) -> tuple[float, FloatArray | None]:
        """Return hub and predicted line [m] at a time, or at the nearest that is remembered."""
        if not self._recent:
            return math.nan, None
        later = earlier = self._recent[-1]
        for earlier in reversed(self._recent):
            if earlier[0] <= at_ns:
                break
            later = earlier
        span_ns = later[0] - earlier[0]
        share = min(1.0, max(0.0, (at_ns - earlier[0]) / span_ns)) if span_ns else 0.0
        hub = earlier[1] + share * (later[1] - earlier[1])
        q = earlier[2] + share * (later[2] - earlier[2])
        return hub, hub + self._shapes @ q
