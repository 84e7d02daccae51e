"""One move of an axis, as its device plays it: accelerations held over ticks, from rest to rest.

Every move of this room is such a row of numbers, whatever made it. What rounding to ticks does to a shaper is
therefore in the command itself, and every prediction counts it exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.excitation.moves import PointToPoint
from beam_ident.excitation.sampled import AxisLimits, Quantity


@dataclass(frozen=True, eq=False)
class Move:
    """A move from rest to rest.

    Parameters
    ----------
    name : str -- what made it
    period_s : float -- tick of the device [s]
    accelerations : ndarray, shape (n_ticks,) -- held from tick k to k + 1 [m/s^2]
    quantity : {"acceleration", "velocity", "position"}
        What the device is commanded in. Accelerations are held between ticks, velocities too, and positions are
        joined by straight lines; all three are computed from the same accelerations.
    """

    name: str
    period_s: float
    accelerations: FloatArray
    quantity: Quantity = "acceleration"

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.accelerations) * self.period_s

    @property
    def velocities(self) -> FloatArray:
        """Velocity at the ticks [m/s], shape (n_ticks + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.accelerations) * self.period_s])

    @property
    def positions(self) -> FloatArray:
        """Way from the start at the ticks [m], shape (n_ticks + 1,)."""
        v = self.velocities
        return np.concatenate([[0.0], np.cumsum(0.5 * (v[:-1] + v[1:])) * self.period_s])

    @property
    def distance(self) -> float:
        """How far it goes, with its sign [m]."""
        return float(self.positions[-1])

    def end_phasors(self, poles: ComplexArray) -> ComplexArray:
        """Return what the move leaves in oscillators with these poles, in the poles' shape [m/s].

        Parameters
        ----------
        poles : ndarray of complex -- upper poles [rad/s]

        Notes
        -----
        For ``q'' + 2 zeta omega q' + omega^2 q = -a(t)``, the motion after the end of the move is
        ``q(t_end + tau) = -Im(E exp(p tau)) / Im(p)`` with ``E = int a(t) exp(p (t_end - t)) dt``, so that a move
        leaves the amplitude ``|E| / Im(p)``. Over ticks the integral is a polynomial in ``exp(p T)``: exact.
        """
        step = np.exp(poles * self.period_s)
        total = np.zeros_like(step)
        for acceleration in self.accelerations.tolist():
            total = (total + acceleration) * step
        return np.asarray(total / step * hold_factor(poles, self.period_s, self.quantity))

    def scaled_to(self, distance: float) -> Move:
        """Return the same shape over another distance [m]."""
        return replace(self, accelerations=self.accelerations * (distance / self.distance))


def hold_factor(poles: ComplexArray, period_s: float, quantity: Quantity) -> ComplexArray:
    """Return ``int h(t) exp(p (T - t)) dt`` of what one tick's unit acceleration becomes on the device.

    Notes
    -----
    A held acceleration gives ``(exp(p T) - 1) / p``. A held velocity takes the tick's change at its end (an impulse
    T there), and positions on straight lines take half of it at either end.
    """
    step = np.exp(poles * period_s)
    if quantity == "acceleration":
        return np.asarray((step - 1.0) / poles)
    if quantity == "velocity":
        return np.asarray(period_s * np.ones_like(step))
    return np.asarray(0.5 * period_s * (1.0 + step))


def s_curve(
    distance: float,
    limits: AxisLimits,
    period_s: float,
    *,
    quantity: Quantity = "acceleration",
    duration_s: float = 0.0,
    name: str = "S-curve",
) -> Move:
    """Return the double-S move over a distance: as quick as the limits allow, or slower.

    Parameters
    ----------
    distance : float -- either sign, not 0 [m]
    limits : AxisLimits -- finite speed, acceleration and jerk
    period_s : float -- [s]
    duration_s : float -- take at least so long [s]: speed, acceleration and jerk are lowered together
    """
    if not (math.isfinite(distance) and distance != 0.0):
        raise ExcitationError(
            f"a move over {distance!r} m; expected a finite distance other than 0: give an end that is not the start"
        )
    v, a, j = limits.speed, limits.acceleration, limits.jerk
    quickest = _double_s(abs(distance), v, a, j).move_times_s[0]
    slower = max(1.0, duration_s / quickest)
    recipe = _double_s(abs(distance), v / slower, a / slower**2, j / slower**3)
    n = max(2, math.ceil(recipe.move_times_s[0] / period_s - 1e-9)) + 1
    # Half a tick late, as every recipe: the first difference is still at rest.
    ticks = np.arange(-1, n + 1) * period_s
    way = np.where(ticks <= 0.0, 0.0, recipe.displacement(np.minimum(ticks, recipe.move_times_s[0])))
    accelerations = math.copysign(1.0, distance) * np.diff(way, 2) / period_s**2
    return exactly(Move(name, period_s, accelerations, quantity), distance)


def _double_s(distance: float, speed: float, acceleration: float, jerk: float) -> PointToPoint:
    return PointToPoint(
        waypoints=(distance, 0.0), speed=speed, acceleration=acceleration, jerk=jerk, dwell=1.0, still=0.0
    )


def convolved(move: Move, times_s: FloatArray, amplitudes: FloatArray, name: str) -> Move:
    """Return a move behind an input shaper: the sum of delayed, scaled copies of it.

    Parameters
    ----------
    move : Move
    times_s, amplitudes : ndarray, shape (n_impulses,)
        Of the shaper; the amplitudes add up to 1. An impulse between two ticks is shared between them, so that its
        mean delay is kept.
    name : str
    """
    places = np.asarray(times_s) / move.period_s
    first = np.floor(places + 1e-9).astype(int)
    share = np.clip(places - first, 0.0, 1.0)
    taps = np.zeros(int(first[-1]) + 2)
    np.add.at(taps, first, amplitudes * (1.0 - share))
    np.add.at(taps, first + 1, amplitudes * share)
    taps = np.trim_zeros(taps, "b")
    whole = replace(move, name=name, accelerations=np.convolve(move.accelerations, taps))
    return exactly(whole, move.distance)


def exactly(move: Move, distance: float) -> Move:
    """Return a move without the rounding of sums in its end velocity and distance."""
    n, period = len(move.accelerations), move.period_s
    lever = (n - 0.5 - np.arange(n)) * period**2
    rows = np.stack([np.full(n, period), lever])
    lack = np.array([0.0, distance]) - rows @ move.accelerations
    correction = rows.T @ np.linalg.solve(rows @ rows.T, lack)
    return replace(move, accelerations=move.accelerations + correction)
