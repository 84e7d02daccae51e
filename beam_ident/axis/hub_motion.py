"""A mass on a guide under a force: its motion from reversal to reversal, without an error of integration.

    m x'' = f(t - delay) - c x' - R(x'),    R = F_c + F_0 forward, -(F_c - F_0) backward

Between two reversals the equation is linear, so that it is propagated exactly over every step of a regular grid, on
which the force keeps its mean and its first moment. Where the velocity passes zero the instant is found within the
step: the mass turns back, goes on, or is held until the force leaves the band from -(F_c - F_0) to F_c + F_0.

Dry friction that differs between the directions, F_c+ and F_c-, and a constant force F_0 are two sums: forward acts
F_c+ + F_0, backward F_c- - F_0, moving and at rest. No record of force and position tells the three apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.numerics.piecewise import PiecewisePolynomial
from beam_ident.numerics.recursions import one_pole

_FIRST_CHUNK, _LONGEST_CHUNK = 128, 8192  # steps that are looked at together for the next reversal
_MOST_EVENTS = 4  # within one step: a mass that rattles on rests
_SERIES = 1e-3  # of a step over the time constant of friction: below, exponentials are taken as their series


@dataclass(frozen=True)
class Guide:
    """Mass and friction.

    Attributes
    ----------
    mass : float -- [kg]
    viscous_forward, viscous_backward : float -- [N s/m]
    forward, backward : float -- constant resistance to motion along +x, and against it [N]
    """

    mass: float
    viscous_forward: float
    viscous_backward: float
    forward: float
    backward: float

    def viscous(self, direction: int) -> float:
        """Return the viscous friction of a direction, +1 or -1 [N s/m]."""
        return self.viscous_forward if direction > 0 else self.viscous_backward

    def resistance(self, direction: int) -> float:
        """Return the constant part of what opposes the force in a direction, signed along +x [N]."""
        return self.forward if direction > 0 else -self.backward

    def pushed(self, force: float, last: int) -> int:
        """Return where a force sends a mass at rest: +1, -1, or 0 where friction holds it.

        ``last`` is the direction of the motion that has ended. It matters where friction is negative, as it may be
        for an iteration's step: then the mass can go both ways, and turns.
        """
        goes = [d for d in (-last, last) if d * (force - self.resistance(d)) > 0.0]
        return goes[0] if goes else 0


@dataclass(frozen=True, eq=False)
class GridForce:
    """A force on a regular grid: a straight line over every step, with the mean and first moment of the real one.

    Attributes
    ----------
    start_s, period_s : float -- first knot and step [s]
    at_start, slope : ndarray, shape (n_steps,) -- of the line [N], [N/s]
    """

    start_s: float
    period_s: float
    at_start: FloatArray
    slope: FloatArray

    @staticmethod
    def of(
        force: PiecewisePolynomial,
        integrals: tuple[PiecewisePolynomial, PiecewisePolynomial],
        start_s: float,
        period_s: float,
        n_steps: int,
        delay_s: float,
    ) -> GridForce:
        """Put a force, whose single and double integral are known, on a grid, acting ``delay_s`` later."""
        t = start_s + period_s * np.arange(n_steps + 1) - delay_s
        area = np.clip(t, force.knots[0], force.knots[-1])
        first, second = integrals[0](area), integrals[1](area)
        h = np.diff(t)
        held = np.diff(area) > 0.5 * h
        mean = np.where(held, np.diff(first) / h, np.where(t[:-1] < force.knots[0], force(area)[:-1], 0.0))
        moment = np.diff(second) - np.diff(area) * first[:-1]
        # f_0 + f_1 s over the step: f_1 = 12 (mean h^2/2 - int (h - s) f ds) / h^3.
        slope = np.where(held, 12.0 * (0.5 * mean * h**2 - moment) / h**3, 0.0)
        return GridForce(start_s, period_s, mean - 0.5 * slope * h, slope)

    def plus(self, knots: FloatArray) -> GridForce:
        """Return this force and another one that is known at the knots, shape (n_steps + 1,), and linear between."""
        slope = np.diff(knots) / self.period_s
        return replace(self, at_start=self.at_start + knots[:-1], slope=self.slope + slope)

    def at(self, step: int, tau: float) -> float:
        """Return the force ``tau`` seconds into a step [N]."""
        return float(self.at_start[step] + self.slope[step] * tau)


class _Flow:
    """What one step of linear motion does: m v' = f - c v over a force ``f_0 + f_1 s``."""

    def __init__(self, mass: float, viscous: float) -> None:
        self._mass, self._rate = mass, viscous / mass

    def gains(self, tau: float) -> tuple[float, float, float, float, float, float]:
        """Return decay of v, v for f_0 and f_1, and x for v, f_0 and f_1, after ``tau`` seconds."""
        m, z = self._mass, self._rate * tau
        # phi_k(z) = int_0^1 e^(-z(1-s)) s^(k-1)/(k-1)! ds; x is the integral of v.
        phi_1, phi_2, phi_3 = _phi(z)
        return (
            math.exp(-z),
            tau * phi_1 / m,
            tau**2 * phi_2 / m,
            tau * phi_1,
            tau**2 * phi_2 / m,
            tau**3 * phi_3 / m,
        )

    def after(self, tau: float, x: float, v: float, f_0: float, f_1: float) -> tuple[float, float]:
        """Return position and velocity after ``tau`` seconds."""
        decay, v_0, v_1, x_v, x_0, x_1 = self.gains(tau)
        return x + x_v * v + x_0 * f_0 + x_1 * f_1, decay * v + v_0 * f_0 + v_1 * f_1

    def turning(self, longest: float, v: float, f_0: float, f_1: float) -> float:
        """Return the instant within ``longest`` seconds at which the velocity, of one sign before, is zero."""
        low, high = 0.0, longest
        side = math.copysign(1.0, v) if v != 0.0 else math.copysign(1.0, f_0)
        tau = 0.5 * longest
        for _ in range(60):
            decay, v_0, v_1, *_ = self.gains(tau)
            left = decay * v + v_0 * f_0 + v_1 * f_1
            low, high = (tau, high) if side * left > 0.0 else (low, tau)
            slope = (f_0 + f_1 * tau) / self._mass - self._rate * left
            step = tau - left / slope if slope != 0.0 else -1.0
            following = step if low < step < high else 0.5 * (low + high)
            if abs(following - tau) <= 1e-14 * longest:
                break
            tau = following
        return tau


def _phi(z: float) -> tuple[float, float, float]:
    """Return phi_1, phi_2, phi_3 of exponential integrators at -z."""
    if abs(z) < _SERIES:
        return (
            1.0 - z / 2.0 + z**2 / 6.0 - z**3 / 24.0,
            1.0 / 2.0 - z / 6.0 + z**2 / 24.0 - z**3 / 120.0,
            1.0 / 6.0 - z / 24.0 + z**2 / 120.0 - z**3 / 720.0,
        )
    phi_1 = -math.expm1(-z) / z
    phi_2 = (1.0 - phi_1) / z
    return phi_1, phi_2, (0.5 - phi_2) / z


def simulate_guide(
    guide: Guide, force: GridForce, first: int, last: int, position: float, velocity: float
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity at the knots ``first`` to ``last`` of a force's grid.

    Parameters
    ----------
    guide : Guide
    force : GridForce
    first, last : int -- knots; steps ``first`` to ``last - 1`` are made
    position, velocity : float -- at the first knot [m], [m/s]

    Returns
    -------
    x, v : ndarray, shape (last - first + 1,)
    """
    x, v = np.empty(last - first + 1), np.empty(last - first + 1)
    x[0], v[0] = position, velocity
    flows = {d: _Flow(guide.mass, guide.viscous(d)) for d in (1, -1)}
    k, direction, chunk = first, int(np.sign(velocity)), _FIRST_CHUNK
    last_direction = direction or 1
    while k < last:
        here = k - first
        if direction == 0:
            direction = guide.pushed(force.at(k, 0.0), last_direction)
            if direction == 0:
                held = _steps_held(guide, force, k, last)
                x[here + 1 : here + held + 1], v[here + 1 : here + held + 1] = x[here], 0.0
                k += held
                if k < last:
                    x[k - first + 1], v[k - first + 1], direction = _eventful_step(
                        guide, flows, force, k, float(x[k - first]), 0.0, 0, last_direction
                    )
                    last_direction = direction or last_direction
                    k += 1
                continue
            last_direction = direction
        n = min(chunk, last - k)
        own_x, own_v = _smooth_steps(
            flows[direction], guide.resistance(direction), force, k, n, float(x[here]), float(v[here])
        )
        against = np.flatnonzero(direction * own_v < 0.0)
        good = int(against[0]) if len(against) else n
        x[here + 1 : here + good + 1], v[here + 1 : here + good + 1] = own_x[:good], own_v[:good]
        k += good
        chunk = min(2 * chunk, _LONGEST_CHUNK)
        if good < n:
            chunk = _FIRST_CHUNK
            here = k - first
            x[here + 1], v[here + 1], direction = _eventful_step(
                guide, flows, force, k, float(x[here]), float(v[here]), direction, direction
            )
            last_direction = direction or last_direction
            k += 1
    return x, v


def _smooth_steps(
    flow: _Flow, resistance: float, force: GridForce, k: int, n: int, x: float, v: float
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity after each of ``n`` steps in one direction."""
    decay, v_0, v_1, x_v, x_0, x_1 = flow.gains(force.period_s)
    f_0, f_1 = force.at_start[k : k + n] - resistance, force.slope[k : k + n]
    after = one_pole(decay, v_0 * f_0 + v_1 * f_1, v)
    before = np.concatenate([[v], after[:-1]])
    return x + np.cumsum(x_v * before + x_0 * f_0 + x_1 * f_1), after


def _steps_held(guide: Guide, force: GridForce, k: int, last: int) -> int:
    """Return over how many whole steps friction holds the mass."""
    begin = force.at_start[k:last]
    end = begin + force.slope[k:last] * force.period_s
    leaves = (np.maximum(begin, end) > guide.forward) | (np.minimum(begin, end) < -guide.backward)
    found = np.flatnonzero(leaves)
    return int(found[0]) if len(found) else last - k


def _eventful_step(
    guide: Guide,
    flows: dict[int, _Flow],
    force: GridForce,
    k: int,
    x: float,
    v: float,
    direction: int,
    last: int,
) -> tuple[float, float, int]:
    """Return position, velocity and direction after one step in which the mass turns, rests or breaks loose."""
    h, tau = force.period_s, 0.0
    f_1 = float(force.slope[k])
    for _ in range(_MOST_EVENTS):
        if direction == 0:
            direction = guide.pushed(force.at(k, tau), last)
            if direction == 0:
                wait = _until_loose(guide, force.at(k, tau), f_1)
                if tau + wait >= h:
                    return x, 0.0, 0
                tau += wait
                direction = 1 if f_1 > 0.0 else -1
        f_0 = force.at(k, tau) - guide.resistance(direction)
        end_x, end_v = flows[direction].after(h - tau, x, v, f_0, f_1)
        if direction * end_v >= 0.0:
            return end_x, end_v, direction
        if v == 0.0 and direction * f_0 <= 0.0:
            return x, 0.0, 0
        spent = flows[direction].turning(h - tau, v, f_0, f_1)
        x, _ = flows[direction].after(spent, x, v, f_0, f_1)
        v, tau, last = 0.0, tau + spent, direction
        direction = guide.pushed(force.at(k, min(tau, h)), last)
    return x, 0.0, 0


def _until_loose(guide: Guide, force: float, slope: float) -> float:
    """Return how long a force that changes at a constant rate stays within what friction holds [s]."""
    if slope > 0.0:
        return max(guide.forward - force, 0.0) / slope
    if slope < 0.0:
        return max(force + guide.backward, 0.0) / -slope
    return math.inf


def at_stamps(
    x: FloatArray, v: FloatArray, start_s: float, period_s: float, times_s: FloatArray
) -> FloatArray:
    """Return positions between knots by the cubic of both ends' positions and velocities.

    Parameters
    ----------
    x, v : ndarray, shape (n_knots,) or (n_knots, n_columns)
    start_s, period_s : float -- of the knots [s]
    times_s : ndarray, shape (n,) -- within them [s]
    """
    place = (times_s - start_s) / period_s
    k = np.clip(np.floor(place + 1e-9).astype(np.intp), 0, len(x) - 2)
    s = place - k
    s = np.where(np.abs(s) < 1e-9, 0.0, s)
    s2, s3 = s * s, s * s * s
    return np.asarray(
        (1.0 - 3.0 * s2 + 2.0 * s3) * x[k]
        + (s - 2.0 * s2 + s3) * period_s * v[k]
        + (3.0 * s2 - 2.0 * s3) * x[k + 1]
        + (s3 - s2) * period_s * v[k + 1]
    )
