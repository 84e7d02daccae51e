"""A trajectory of one's own: rows of time and position, velocity or acceleration, as another program leaves them.

Between the rows a position is a cubic spline that begins and ends at rest, a velocity is straight, and an
acceleration is held, so that a velocity is straight, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.sampled import UNITS

_REST = 1e-4
"""Of the largest speed: what rounding to five digits leaves of a velocity that should be zero."""


@dataclass(frozen=True)
class Trajectory(Recipe):
    """Rows of a motion, played from where the hub is.

    Parameters
    ----------
    quantity : {"position", "velocity", "acceleration"}
    times : tuple of float -- of the rows, increasing [s]; the first is the beginning
    values : tuple of float
        Of the rows [m], [m/s] or [m/s^2]; positions count from the first one.  It begins and ends at rest.
    source : str -- where it comes from, as a file's name and checksum
    still : float -- rest afterwards [s]

    Notes
    -----
    Velocities at the ticks are exact where velocities or accelerations are given, and so are accelerations whose
    rows lie on ticks.  Positions are met within ``T^2 / 4`` of the acceleration, 2.5 um at 10 m/s^2 and 1 kHz; the
    last one exactly.
    """

    kind: ClassVar[str] = "file"

    quantity: str = "position"
    times: tuple[float, ...] = (0.0, 0.5, 1.0)
    values: tuple[float, ...] = (0.0, 0.001, 0.0)
    source: str = ""
    still: float = 10.0

    def _check(self) -> None:
        self._one_of("quantity", tuple(UNITS))
        self._not_negative("still")
        n = len(self.values)
        self._require(
            n >= 2 and n == len(self.times),
            "values",
            f"{n} of them",
            f"one for each of {len(self.times)} times, at least two",
        )
        steps = np.diff(self.times)
        if not np.all(steps > 0.0):
            late = self.times[int(np.argmin(steps > 0.0)) + 1]
            self._require(False, "times", f"{late:g} s after a later one", "times that increase")
        if self.quantity != "position":
            velocities = np.asarray(self._knots[1])
            largest = float(np.max(np.abs(velocities)))
            self._require(largest > 0.0, "values", "zero throughout", "a motion")
            for what, at, value in (("begins", 0, velocities[0]), ("ends", -1, velocities[-1])):
                is_at_rest = abs(float(value)) <= _REST * largest
                self._require(
                    is_at_rest,
                    "values",
                    f"{value:.4g} m/s where it {what}, at {self._knots[0][at]:g} s",
                    "to begin and end at rest",
                )
        else:
            self._require(np.ptp(self.values) > 0.0, "values", "all the same", "a motion")

    @cached_property
    def _knots(self) -> tuple[FloatArray, FloatArray]:
        """Times since the beginning [s] and velocities [m/s] between which the velocity is straight."""
        times = np.asarray(self.times) - self.times[0]
        values = np.asarray(self.values)
        if self.quantity == "velocity":
            return times, values
        # The last acceleration is held as long as the one before it.
        times = np.append(times, 2.0 * times[-1] - times[-2])
        return times, np.concatenate([[0.0], np.cumsum(values * np.diff(times))])

    @cached_property
    def _spline(self) -> Any:
        """Displacement between the first and the last row [m]."""
        from scipy.interpolate import CubicSpline, PPoly

        if self.quantity == "position":
            values = np.asarray(self.values)
            return CubicSpline(np.asarray(self.times) - self.times[0], values - values[0], bc_type="clamped")
        times, velocities = self._knots
        return PPoly(
            np.stack([np.diff(velocities) / np.diff(times), velocities[:-1]]), times
        ).antiderivative()

    @property
    def _length_s(self) -> float:
        return float(self._spline.x[-1])

    @property
    def total_s(self) -> float:
        """Length [s], the rest included."""
        return self._length_s + self.still

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]; what it ends at stays."""
        return np.asarray(self._spline(np.clip(times_s, 0.0, self._length_s)))

    def _accelerations(self, period_s: float) -> FloatArray:
        ticks = self._ticks(period_s)[1:]
        if self.quantity != "position":
            times, velocities = self._knots
            return np.asarray(np.diff(np.interp(ticks, times, velocities, left=0.0, right=0.0)) / period_s)
        is_moving = (ticks > 0.0) & (ticks < self._length_s)
        velocities = np.where(is_moving, self._spline(np.where(is_moving, ticks, 0.0), 1), 0.0)
        # The device goes in trapezoids: what they miss of the way, far below a micrometre, is spread over all of it.
        missed = self.displacement(ticks[-1:])[0] - np.sum(velocities) * period_s
        share = np.where(is_moving, np.sin(np.pi * ticks / self._length_s) ** 2, 0.0)
        velocities += missed / (np.sum(share) * period_s) * share
        return np.asarray(np.diff(velocities) / period_s)
