"""Moves from point to point: the step out and back, and way-points with bounded speed and jerk.

The free decay after a move shows frequencies and damping without any input, and moves are
what a positioning axis does in earnest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import smooth_rise

PROFILES = ("bounded_jerk", "quintic", "cycloidal")

_PEAKS = {"quintic": (1.875, 10.0 / math.sqrt(3.0), 60.0), "cycloidal": (2.0, 2 * math.pi, 4 * math.pi**2)}
"""Peak speed, acceleration and jerk of a move of length 1 in time 1."""


@dataclass(frozen=True)
class Step(Recipe):
    """Smooth move to a distance, a rest there, and the same way back.

    Parameters
    ----------
    step_size : float -- how far [m], either sign
    rise_time : float -- length of the move [s]
    duration : float -- both moves and the rest at the far end [s]
    still : float -- rest at home afterwards [s]
    """

    kind: ClassVar[str] = "step"

    step_size: float = 0.005
    rise_time: float = 0.2
    duration: float = 10.4
    still: float = 10.0

    def _check(self) -> None:
        self._not_zero("step_size")
        self._positive("rise_time")
        self._not_negative("still")
        self._require(
            self.duration >= 2.0 * self.rise_time, "duration", self.duration, "at least two rise times"
        )

    @property
    def total_s(self) -> float:
        """Length [s], both rests included."""
        return self.duration + self.still

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        out = smooth_rise(np.asarray(times_s) / self.rise_time)
        back = smooth_rise((np.asarray(times_s) - self.duration) / self.rise_time + 1.0)
        return np.asarray(self.step_size * (out - back))


@dataclass(frozen=True)
class PointToPoint(Recipe):
    """Moves along way-points, each as quick as speed, acceleration and jerk allow.

    Parameters
    ----------
    waypoints : tuple of float -- displacements to visit, from 0; the last is 0 again [m]
    profile : {"bounded_jerk", "quintic", "cycloidal"}
    speed, acceleration, jerk : float -- largest of each [m/s], [m/s^2], [m/s^3]
    dwell : float -- rest at every way-point [s]
    still : float -- rest at home afterwards [s]

    Notes
    -----
    ``bounded_jerk`` is the double-S profile of up to seven pieces of constant jerk (Biagiotti and
    Melchiorri, *Trajectory Planning*, 2008, section 3.4), the quickest; a long way with a speed that it
    reaches is a ramp.  ``quintic`` and ``cycloidal`` are scaled in time to the first limit that they meet; their
    acceleration is zero at both ends.
    """

    kind: ClassVar[str] = "moves"

    waypoints: tuple[float, ...] = (0.002, -0.002, 0.0)
    profile: str = "bounded_jerk"
    speed: float = 0.05
    acceleration: float = 0.5
    jerk: float = 20.0
    dwell: float = 2.0
    still: float = 10.0

    def _check(self) -> None:
        points = self.waypoints
        self._require(len(points) >= 2, "waypoints", points, "at least two displacements, the last one 0")
        self._require(points[-1] == 0.0, "waypoints", points, "the last one to be 0: the axis ends at home")
        moves = np.diff((0.0, *points))
        self._require(bool(np.all(moves != 0.0)), "waypoints", points, "each different from the one before")
        self._one_of("profile", PROFILES)
        self._positive("speed", "acceleration", "jerk")
        self._not_negative("dwell", "still")

    @property
    def move_times_s(self) -> tuple[float, ...]:
        """Length of every move [s]."""
        return tuple(self._move_time(abs(move)) for move in np.diff((0.0, *self.waypoints)).tolist())

    @property
    def total_s(self) -> float:
        """Length [s], all rests included."""
        return sum(self.move_times_s) + (len(self.waypoints) - 1) * self.dwell + self.still

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        total = np.zeros(np.shape(times_s))
        start = 0.0
        for move, length in zip(np.diff((0.0, *self.waypoints)).tolist(), self.move_times_s, strict=True):
            total += math.copysign(1.0, move) * self._travelled(abs(move), length, times_s - start)
            start += length + self.dwell
        # The way-points' differences need not add up to zero exactly; the end is exact by definition.
        return np.asarray(np.where(times_s >= start - self.dwell, 0.0, total))

    def _move_time(self, distance: float) -> float:
        if self.profile == "bounded_jerk":
            _, rise_s, cruise_s = self._double_s(distance)
            return 2.0 * rise_s + cruise_s
        speed, acceleration, jerk = _PEAKS[self.profile]
        return max(
            speed * distance / self.speed,
            math.sqrt(acceleration * distance / self.acceleration),
            float((jerk * distance / self.jerk) ** (1.0 / 3.0)),
        )

    def _travelled(self, distance: float, length: float, times: FloatArray) -> FloatArray:
        s = np.clip(times / length, 0.0, 1.0)
        if self.profile == "quintic":
            return np.asarray(distance * s**3 * (10.0 - s * (15.0 - 6.0 * s)))
        if self.profile == "cycloidal":
            return np.asarray(distance * (s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)))
        jerk_s, rise_s, _ = self._double_s(distance)
        # The second half mirrors the first, which is a way to accelerate and half of the cruise.
        clipped = np.clip(times, 0.0, length)
        first = clipped <= 0.5 * length
        half = self._accelerated(jerk_s, rise_s, np.where(first, clipped, length - clipped))
        return np.asarray(np.where(first, half, distance - half))

    def _accelerated(self, jerk_s: float, rise_s: float, t: FloatArray) -> FloatArray:
        """Return the way while accelerating over ``rise_s`` and then cruising [m]."""
        flat_s = rise_s - 2.0 * jerk_s
        total = np.zeros(np.shape(t))
        # The jerk is +, 0, -, 0: four corners, each of which bends the third derivative.
        for corner, sign in ((0.0, 1.0), (jerk_s, -1.0), (jerk_s + flat_s, -1.0), (rise_s, 1.0)):
            total += sign * self.jerk / 6.0 * np.maximum(t - corner, 0.0) ** 3
        return total

    def _double_s(self, distance: float) -> tuple[float, float, float]:
        """Return the lengths of one piece of jerk, of the whole acceleration, and of the cruise [s]."""
        v, a, j = self.speed, self.acceleration, self.jerk
        jerk_s = min(math.sqrt(v / j), a / j)
        rise_s = jerk_s + v / (j * jerk_s)
        if distance >= v * rise_s:
            return jerk_s, rise_s, distance / v - rise_s
        jerk_s = min((distance / (2.0 * j)) ** (1.0 / 3.0), a / j)
        rise_s = 0.5 * jerk_s + math.sqrt(0.25 * jerk_s**2 + distance / (j * jerk_s))
        return jerk_s, rise_s, 0.0
