"""A drive and a hub with a spring between them: the motion of both under the drive's force and the hub's friction.

    m_d x_d'' = f - T,    m_h x_h'' = T + g - c x_h' - R(x_h'),    T = k s + d s',    s = x_d - x_h

The force f acts on the drive (a rotor, a pulley, the nut of a screw), friction and what swings on the hub (g) act on
the hub, as a guide makes them. Between two reversals of the hub the equations are linear in x_h, x_h', s and s'. Over
whole steps they are propagated by the exponential of their matrix, in its Schur form, which stays exact where poles
coincide; within the step of a reversal by the Taylor series of the same exponential.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.linalg import expm, schur

from beam_ident.arrays import FloatArray
from beam_ident.axis.hub_motion import GridForce, Guide
from beam_ident.numerics.recursions import one_pole

_FIRST_CHUNK, _LONGEST_CHUNK = 2048, 8192  # steps that are looked at together for the next reversal
_MOST_EVENTS = 8  # within one step: a hub that rattles on rests
_DEGREE, _REACH = 20, 2.0  # of the Taylor series, and the norm up to which its rest is below 1e-12
_LOOKS = np.arange(1, 9) / 8.0  # shares of a piece of a step at which a sign is looked for


@dataclass(frozen=True)
class DriveSpring:
    """What lies between the force and the hub.

    Attributes
    ----------
    mass : float -- of the drive, ahead of the spring [kg]
    stiffness : float -- [N/m]
    damping : float -- [N s/m]
    """

    mass: float
    stiffness: float
    damping: float


@dataclass(frozen=True, eq=False)
class TwoMotions:
    """Positions [m] and velocities [m/s] of hub and drive at the knots of a force's grid, each (n_knots,)."""

    hub: FloatArray
    hub_velocity: FloatArray
    drive: FloatArray
    drive_velocity: FloatArray


class _Flow:
    """The linear motion in one direction of the hub, or with the hub held (0)."""

    def __init__(self, guide: Guide, spring: DriveSpring, period_s: float, direction: int) -> None:
        self.resistance = guide.resistance(direction) if direction else 0.0
        k, d = spring.stiffness, spring.damping
        A, B = np.zeros((4, 4)), np.zeros((4, 2))
        A[0, 1] = A[2, 3] = 1.0
        if direction:
            A[1, 1:] = np.array([-guide.viscous(direction), k, d]) / guide.mass
            B[1, 1] = 1.0 / guide.mass
        A[3, 2:] = -k / spring.mass, -d / spring.mass
        B[3, 0] = 1.0 / spring.mass
        A[3], B[3] = A[3] - A[1], B[3] - B[1]
        # Rates in units of the resonance: all four states are lengths.
        rate = math.sqrt(k * (1.0 / spring.mass + 1.0 / guide.mass))
        self.scale = np.array([1.0, rate, 1.0, rate])
        self._A = A * period_s * self.scale / self.scale[:, None]
        self._B = B * period_s / self.scale[:, None]
        self.n_pieces = max(math.ceil(float(np.linalg.norm(self._A, 2)) / _REACH), 1)
        # One step: exp of the states with the force's value and slope (over a step) as further ones.
        whole = np.zeros((8, 8))
        whole[:4, :4], whole[:4, 4:6], whole[4:6, 6:] = self._A, self._B, np.eye(2)
        exact = expm(whole)
        self._T, self._U = schur(exact[:4, :4], output="complex")
        self._gains = self._U.conj().T @ exact[:4, 4:]

    def steps(self, state: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the states after each step, (n, 4), under forces and their changes over a step (4, n)."""
        pushes = self._gains @ inputs
        y = self._U.conj().T @ state
        found = np.empty((4, inputs.shape[1]), dtype=np.complex128)
        for i in range(3, -1, -1):
            push = pushes[i]
            for j in range(i + 1, 4):
                push = push + self._T[i, j] * np.concatenate([y[j : j + 1], found[j, :-1]])
            own = self._T[i, i]
            found[i] = one_pole(own, push, y[i])
        return np.asarray((self._U @ found).real.T)

    def series(self, state: FloatArray, push: FloatArray, slope: FloatArray, span: float) -> FloatArray:
        """Return the states over ``span`` steps as polynomials of the share of it, (degree + 1, 4)."""
        found = np.zeros((_DEGREE + 1, 4))
        found[0] = state
        A, B = self._A * span, self._B * span
        for j in range(_DEGREE):
            following = A @ found[j]
            if j == 0:
                following = following + B @ push
            elif j == 1:
                following = following + B @ (slope * span)
            found[j + 1] = following / (j + 1)
        return found


def simulate_compliant(
    guide: Guide,
    spring: DriveSpring,
    force: GridForce,
    load: FloatArray | None,
    steps: tuple[int, int],
    start: tuple[float, float, float],
) -> TwoMotions:
    """Return the motion of hub and drive at the knots ``steps[0]`` to ``steps[1]`` of a force's grid.

    Parameters
    ----------
    guide : Guide -- mass and friction of the hub
    spring : DriveSpring
    force : GridForce -- on the drive
    load : ndarray, shape (n_steps + 1,), optional -- a further force on the hub at the knots [N]
    steps : (first, last) -- knots
    start : (velocity, deflection, rate)
        Of the hub, which begins at 0 m [m/s]; of the spring, drive less hub [m], [m/s].
    """
    first, last = steps
    here = slice(first, last)
    h = force.period_s
    held_load = np.zeros(last - first + 1) if load is None else load[first : last + 1]
    inputs = np.array(
        [force.at_start[here], held_load[:-1], force.slope[here] * h, np.diff(held_load)], dtype=np.float64
    )
    return _Run(guide, spring, h, inputs).made(start)


@lru_cache(maxsize=4)
def _flows(guide: Guide, spring: DriveSpring, period_s: float) -> dict[int, _Flow]:
    """Return the linear motions by the hub's direction; the pieces of a record share them."""
    return {direction: _Flow(guide, spring, period_s, direction) for direction in (1, -1, 0)}


class _Run:
    """One simulation: flows, forces and the states found so far."""

    def __init__(self, guide: Guide, spring: DriveSpring, period_s: float, inputs: FloatArray) -> None:
        self._guide, self._inputs = guide, inputs
        self._flows = _flows(guide, spring, period_s)
        self._scale = self._flows[0].scale
        rate = self._scale[3]
        # T = k s + d s' of the scaled state.
        self._tension = np.array([0.0, 0.0, spring.stiffness, spring.damping * rate])

    def made(self, start: tuple[float, float, float]) -> TwoMotions:
        n_steps = self._inputs.shape[1]
        velocity, deflection, rate = start
        states = np.empty((n_steps + 1, 4))
        states[0] = np.array([0.0, velocity, deflection, rate]) / self._scale
        k, chunk = 0, _FIRST_CHUNK
        direction = int(np.sign(velocity)) or self._sent(states[0], 0, 0.0)
        while k < n_steps:
            n = min(chunk, n_steps - k)
            found, good = self._whole_steps(states[k], k, n, direction)
            states[k + 1 : k + good + 1] = found[:good]
            k += good
            chunk = min(2 * chunk, _LONGEST_CHUNK)
            if good < n:
                states[k + 1], direction = self._eventful_step(states[k], k, direction)
                k, chunk = k + 1, _FIRST_CHUNK
        x, v, s, r = (states * self._scale).T
        return TwoMotions(x, v, x + s, v + r)

    def _whole_steps(self, state: FloatArray, k: int, n: int, direction: int) -> tuple[FloatArray, int]:
        """Return the states after ``n`` steps without an event, and how many of them are true."""
        flow, inputs = self._flows[direction], self._inputs[:, k : k + n]
        if direction:
            found = flow.steps(state, inputs - np.array([[0.0], [flow.resistance], [0.0], [0.0]]))
            wrong = direction * found[:, 1] < 0.0
        else:
            found = flow.steps(state, inputs)
            pull = found @ self._tension + inputs[1] + inputs[3]
            wrong = (pull > self._guide.forward) | (pull < -self._guide.backward)
        places = np.flatnonzero(wrong)
        return found, int(places[0]) if len(places) else n

    def _eventful_step(self, state: FloatArray, k: int, direction: int) -> tuple[FloatArray, int]:
        """Return state and direction after a step in which the hub turns, rests or breaks loose."""
        state = state.copy()
        f, g, f_slope, g_slope = self._inputs[:, k]
        n_pieces = max(flow.n_pieces for flow in self._flows.values())
        edges = np.linspace(0.0, 1.0, n_pieces + 1)
        for begin, end in pairwise(edges):
            at = float(begin)
            for turn in range(_MOST_EVENTS + 1):
                if turn == _MOST_EVENTS:
                    direction = 0
                    state[1] = 0.0
                span = float(end) - at
                flow = self._flows[direction]
                push = np.array([f + f_slope * at, g + g_slope * at - flow.resistance])
                slope = np.array([f_slope, g_slope])
                series = flow.series(state, push, slope, span)
                instant = 1.0 if turn == _MOST_EVENTS else self._event(series, push, slope * span, direction)
                state = _at(series, instant)
                at += instant * span
                if instant >= 1.0:
                    break
                if direction:
                    state[1] = 0.0
                    direction = self._sent(state, k, at)
                else:
                    direction = 1 if state @ self._tension + g + g_slope * at > 0.0 else -1
        return state, direction

    def _event(self, series: FloatArray, push: FloatArray, slope: FloatArray, direction: int) -> float:
        """Return the share of a piece after which the direction of the hub changes, 1 where it does not."""
        if direction:
            return _first_below(direction * series[:, 1])
        pull = series @ self._tension
        pull[0] += push[1]
        pull[1] += slope[1]
        up, down = -pull, pull.copy()
        up[0] += self._guide.forward
        down[0] += self._guide.backward
        return min(_first_below(up), _first_below(down))

    def _sent(self, state: FloatArray, k: int, share: float) -> int:
        """Return where spring and load send a hub at rest: +1, -1, or 0 where friction holds it."""
        pull = float(state @ self._tension) + self._inputs[1, k] + share * self._inputs[3, k]
        if pull > self._guide.forward:
            return 1
        return -1 if pull < -self._guide.backward else 0


def _at(series: FloatArray, share: float) -> FloatArray:
    """Return polynomials' values (Horner)."""
    value = series[-1]
    for row in series[-2::-1]:
        value = value * share + row
    return np.array(value)


def _first_below(series: FloatArray) -> float:
    """Return the share at which a polynomial falls below 0, 1 where it does not; a zero at 0 is none."""
    coefficients = series.tolist()
    low = 0.0
    for look in _LOOKS.tolist():
        if _value(coefficients, look) < 0.0:
            break
        low = look
    else:
        return 1.0
    high = look
    for _ in range(60):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if _value(coefficients, middle) < 0.0:
            high = middle
        else:
            low = middle
    return float(high)


def _value(coefficients: list[float], share: float) -> float:
    value = 0.0
    for one in reversed(coefficients):
        value = value * share + one
    return value
