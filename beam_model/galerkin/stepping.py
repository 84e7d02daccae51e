"""Exact stepping of the beam in time, for the simulator (one tick at a time) and for whole records.

The model is linear and its input is held between ticks, so that the step from one tick to the next is a
matrix computed once, X_{k+1} = e^{AT} X_k + int_0^T e^{As} ds B u_k: no step size, no drift, and the state
between two ticks is as exact as at them.

Equation numbers are those of docs/beam-equations.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.sparse.csgraph import connected_components

from beam_model.arrays import FloatArray, IndexArray
from beam_model.errors import BeamParameterError
from beam_model.galerkin.compiled import compiled_pairs
from beam_model.parameters import check_number

# Terms of the exponential's series and the largest |A| tau for it: 3^28/28! is below rounding.
_SERIES_TERMS = 28
_SERIES_REACH = 3.0
_SERIES_POWERS = np.arange(_SERIES_TERMS)
_BLOCK = 16  # ticks
_GROUP, _FEW_STATES = 64, 4  # blocks in a group, where no more states than this depend on each other
_COMPILED_FROM = 20_000  # ticks: fewer are done before a compiled loop is loaded


def discretise(
    A: FloatArray, B: FloatArray, period: float, scale: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return e^{AT} and the effects of an input that is held and of one that rises by 1 over the period.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n,)
    period : float
        T [s].
    scale : ndarray, shape (n,), optional
        Magnitudes of the states against each other; the exponential is taken of the scaled system, which
        keeps small entries accurate.

    Returns
    -------
    transition : ndarray, shape (n, n)
    held, ramp : ndarray, shape (n,)
        Zero-order hold: X+ = transition X + held u. First-order hold: + ramp (u+ - u) more.
    """
    size = A.shape[0]
    weight = np.append(np.ones(size) if scale is None else scale, [1.0, 1.0])
    # (B.1): the last two states are the input and its rise over the period. Rows and columns are scaled by
    # the states' magnitudes before the exponential, and back after it.
    augmented = np.zeros((size + 2, size + 2))
    augmented[:size, :size] = A * period
    augmented[:size, size] = B * period
    augmented[size, size + 1] = 1.0
    result = expm(augmented * weight[:, None] / weight[None, :]) * weight[None, :] / weight[:, None]
    held, ramp = result[:size, size], result[:size, size + 1]
    return np.ascontiguousarray(result[:size, :size]), np.ascontiguousarray(held), np.ascontiguousarray(ramp)


def _powers(matrix: FloatArray, highest: int) -> FloatArray:
    """Return powers 0 to a highest one of a matrix, shape (highest + 1, n, n)."""
    result = np.empty((highest + 1, *matrix.shape))
    result[0], result[1] = np.eye(len(matrix)), matrix
    known = 1
    while known < highest:
        # Those known so far, times the highest of them: a handful of products instead of one for each.
        more = min(known, highest - known)
        np.matmul(result[known], result[1 : 1 + more], out=result[known + 1 : known + 1 + more])
        known += more
    return result


def _pairs(transition: FloatArray) -> FloatArray | None:
    """Return the transition of every mode, shape (4, n_modes), or None where a mode depends on another one."""
    n_modes = len(transition) // 2
    blocks = [
        np.diag(transition[i : i + n_modes, j : j + n_modes]) for i in (0, n_modes) for j in (0, n_modes)
    ]
    is_alone = len(transition) == 2 * n_modes and np.count_nonzero(transition) == np.count_nonzero(blocks)
    return np.stack(blocks) if is_alone else None


def _independent(transition: FloatArray) -> list[IndexArray]:
    """Return the sets of states that do not depend on each other."""
    if _pairs(transition) is not None:
        n_modes = len(transition) // 2
        return list(np.arange(2 * n_modes).reshape(2, n_modes).T)
    n_sets, which = connected_components(transition != 0.0, directed=False)
    return [np.flatnonzero(which == own) for own in range(n_sets)]


def _series_of_tick(A: FloatArray, B: FloatArray, period: float) -> FloatArray:
    """Return the terms of exp(A T) and of the held input's effect, shape (terms, n^2 + n)."""
    n = B.size
    terms = np.zeros((_SERIES_TERMS, n * n + n))
    power = np.eye(n)
    terms[0, : n * n] = power.ravel()
    for k in range(1, _SERIES_TERMS):
        terms[k, n * n :] = power @ B * (period / k)
        power = power @ A * (period / k)
        terms[k, : n * n] = power.ravel()
    return terms


class LinearStepper:
    """A linear system under a held input, stepped exactly.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n,)
    period : float
        From tick to tick [s].
    scale : ndarray, shape (n,)
        See ``discretise``.
    """

    def __init__(self, A: FloatArray, B: FloatArray, period: float, scale: FloatArray) -> None:
        self.period = check_number("period", period, "s", above=0.0)
        self._A, self._B = A, B
        self._transition, self._held, self._ramp = discretise(A, B, self.period, scale)
        self._full_state = np.zeros(B.size)
        self._scratch = np.zeros(B.size)
        scaled = A * scale[:, None] / scale[None, :]
        self._rate = float(np.linalg.norm(scaled, 2))
        self._of_tick: FloatArray | None = None

    @property
    def tick_matrices(self) -> tuple[FloatArray, FloatArray]:
        """Transition, shape (n, n), and effect of a held input, shape (n,): X+ = transition X + held u."""
        return self._transition, self._held

    def _advance(self, value: float) -> None:
        np.dot(self._transition, self._full_state, out=self._scratch)
        np.multiply(self._held, value, out=self._full_state)
        np.add(self._full_state, self._scratch, out=self._full_state)

    def _advance_linear(self, start: float, end: float) -> None:
        self._advance(start)
        self._full_state += self._ramp * (end - start)

    def _state_after(self, tau: float | FloatArray, value: float) -> FloatArray:
        """Return the whole state ``tau`` seconds into the tick, shape (n,) or (n_tau, n)."""
        taus = np.asarray(tau, dtype=np.float64)
        if taus.ndim == 0:
            return self._state_at(float(taus), value)
        result: FloatArray
        horizon = float(np.max(np.abs(taus), initial=0.0))
        if self._rate * horizon > _SERIES_REACH:
            result = np.stack([self._state_at(float(t), value) for t in taus])
            return result
        terms = np.empty((_SERIES_TERMS, self._full_state.size))
        terms[0] = self._full_state
        # (B.3) for the longest tau; for the others the k-th term is (tau/longest)^k of it.
        terms[1] = horizon * (self._A @ terms[0] + self._B * value)
        for k in range(2, _SERIES_TERMS):
            terms[k] = self._A @ terms[k - 1] * (horizon / k)
        ratios = taus / horizon if horizon > 0.0 else taus
        powers = ratios[:, None] ** np.arange(_SERIES_TERMS)[None, :]
        result = powers @ terms
        return result

    def _state_at(self, tau: float, value: float, slope: float = 0.0) -> FloatArray:
        return self.propagate(self._full_state, tau, value, slope)

    def _propagate_inside_tick(self, start: FloatArray, tau: float, value: float) -> FloatArray:
        """Sum the series of ``propagate`` at once: its matrices are known for a whole tick."""
        if self._of_tick is None:
            self._of_tick = _series_of_tick(self._A, self._B, self.period)
        ratios = (tau / self.period) ** _SERIES_POWERS
        # The k-th row is (A T)^k / k!, flat, and (A T)^(k-1) T B / k!, for the tick T.
        of_both = ratios @ self._of_tick
        n = start.size
        return np.asarray(of_both[: n * n].reshape(n, n) @ start + of_both[n * n :] * value)

    def propagate(self, start: FloatArray, tau: float, value: float, slope: float = 0.0) -> FloatArray:
        """Return where a state stands after ``tau`` under the input value + slope t, shape (n,).

        Parameters
        ----------
        start : ndarray, shape (n,)
            Not the stepper's own state, which stays as it is.
        tau : float
            [s], as long as wanted; a whole period under a held input takes the precomputed step.
        value, slope : float
            Of the input and of its change per second.
        """
        if tau == self.period and slope == 0.0:
            return np.asarray(self._transition @ start + self._held * value)
        if slope == 0.0 and abs(tau) <= self.period and self._rate * self.period <= _SERIES_REACH:
            return self._propagate_inside_tick(start, tau, value)
        # A long way is cut so that the series' terms do not grow before they fall.
        n_pieces = max(1, int(np.ceil(self._rate * abs(tau) / _SERIES_REACH)))
        h = tau / n_pieces
        state = start.copy()
        for piece in range(n_pieces):
            term = h * (self._A @ state + self._B * (value + slope * h * piece))
            state += term
            # The slope of the input enters with the second derivative, and from there on through A alone.
            term = 0.5 * h * (self._A @ term + self._B * (slope * h))
            state += term
            for k in range(3, _SERIES_TERMS):
                term = self._A @ term * (h / k)
                state += term
        return np.asarray(state)

    def _run(self, values: FloatArray, hold: str) -> FloatArray:
        """Return the state at every tick and leave the stepper at the last one.

        A first-order hold is a zero-order hold of the state less ramp u: one path serves both.
        """
        values = np.asarray(values, dtype=np.float64).ravel()
        if hold == "zoh":
            return self._run_held(values, self._held)
        if hold != "foh":
            raise BeamParameterError("hold", hold, "", '"zoh" or "foh"')
        if values.size == 0:
            raise BeamParameterError(
                "values", (), "", "at least the value at the present tick for a first-order hold"
            )
        # (B.2): step Z = X - G_1 u under a held input, then add G_1 u again.
        self._full_state -= self._ramp * values[0]
        shifted = self._run_held(values[:-1], self._held - self._ramp + self._transition @ self._ramp)
        result = shifted + values[:, None] * self._ramp
        self._full_state[:] = result[-1]
        return result

    def _run_held(self, values: FloatArray, effect: FloatArray) -> FloatArray:
        result = np.empty((values.size + 1, self._full_state.size))
        result[0] = self._full_state
        pairs = _pairs(self._transition) if values.size >= _COMPILED_FROM else None
        compiled = None if pairs is None else compiled_pairs()
        if pairs is None or compiled is None:
            self._run_in_blocks(values, effect, result)
        else:
            compiled(pairs, effect.reshape(2, -1).copy(), np.ascontiguousarray(values), result)
        self._full_state[:] = result[-1]
        return result

    def _run_in_blocks(self, values: FloatArray, effect: FloatArray, result: FloatArray) -> None:
        """Fill in the states after the first: of many short blocks at once, from the states at their beginnings."""
        size, n_samples = self._full_state.size, values.size
        sets = _independent(self._transition)
        # Blocks come in groups: few where the states of all are turned together.
        n_blocks = _GROUP if max(map(len, sets)) <= _FEW_STATES else _BLOCK
        n_groups = -(-n_samples // (n_blocks * _BLOCK))
        whole, rest = divmod(n_samples, _BLOCK)
        # Of every block its inputs and the state at its beginning, side by side.
        given = np.empty((n_groups * n_blocks, _BLOCK + size))
        inputs, starts = given[:, :_BLOCK], given[:, _BLOCK:].reshape(n_groups, n_blocks, size)
        inputs[:whole] = values[: whole * _BLOCK].reshape(whole, _BLOCK)
        inputs[whole:] = 0.0
        inputs[whole : whole + 1, :rest] = values[whole * _BLOCK :]
        powers = _powers(self._transition, _BLOCK)
        # impulse[k]: what an input does to the state k + 1 ticks after it begins.
        impulse = powers[:_BLOCK] @ effect
        # From block to block, X_0 <- F^n X_0 + (what the block's inputs add): the same recursion with a longer step,
        # for groups of blocks at once and for every set of states that do not know of the others.
        ends = (inputs @ impulse[::-1].copy()).reshape(n_groups, n_blocks, size)
        for own in sets:
            longer = _powers(powers[_BLOCK][np.ix_(own, own)], n_blocks)
            width = len(own)
            # What a block adds is there at the beginning of every following one: (from, state, to, state).
            lags = np.arange(n_blocks)[None, :] - np.arange(n_blocks)[:, None] - 1
            reaching = np.concatenate([longer[:n_blocks], np.zeros((1, width, width))])
            later = reaching[np.where(lags < 0, n_blocks, lags)].transpose(0, 3, 1, 2)
            added = ends[:, :, own]
            found = added.reshape(n_groups, -1) @ later.reshape(n_blocks * width, -1)
            state = self._full_state[own]
            firsts = np.empty((n_groups, width))
            gained = found.reshape(n_groups, n_blocks, width)[:, -1] @ longer[1].T + added[:, -1]
            for group in range(n_groups):
                firsts[group] = state
                state = longer[n_blocks] @ state + gained[group]
            found += firsts @ longer[:n_blocks].transpose(2, 0, 1).reshape(width, -1)
            starts[:, :, own] = found.reshape(n_groups, n_blocks, width)
        # X_(k+1) = F^(k+1) X_0 + sum_j F^(k-j) G_0 u_j, for all k of all blocks in one product.
        reached = np.zeros((_BLOCK + size, _BLOCK, size))
        for k in range(_BLOCK):
            reached[: k + 1, k] = impulse[k::-1]
        reached[_BLOCK:] = powers[1:].transpose(2, 0, 1)
        effects = reached.reshape(_BLOCK + size, -1)
        np.matmul(given[:whole], effects, out=result[1 : 1 + whole * _BLOCK].reshape(whole, _BLOCK * size))
        if rest:
            result[-rest:] = (given[whole] @ effects).reshape(_BLOCK, size)[:rest]

    def _run_at(self, times: FloatArray, values: FloatArray, hold: str) -> FloatArray:
        """Return the state at every one of increasing times, the stepper standing at the first of them."""
        times, values = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
        if hold not in ("zoh", "foh"):
            raise BeamParameterError("hold", hold, "", '"zoh" or "foh"')
        if times.shape != values.shape or times.ndim != 1:
            raise BeamParameterError(
                "times", times.shape, "", f"one time for each of the values {values.shape}"
            )
        steps = np.diff(times)
        if not np.all(steps > 0.0):
            raise BeamParameterError("times", float(steps.min()), "s", "strictly increasing")
        result = np.empty((times.size, self._full_state.size))
        for index, step in enumerate(np.append(steps, 0.0)):
            result[index] = self._full_state
            if step > 0.0:
                slope = (values[index + 1] - values[index]) / step if hold == "foh" else 0.0
                self._full_state[:] = self._state_at(float(step), float(values[index]), float(slope))
        return result


class MotionStepper(LinearStepper):
    """The beam under a prescribed hub acceleration, held over each tick.

    Deflections are w(z, t) = shape(z) @ q(t) - R(z) a_R(t) with ``BeamModel.shape``, ``BeamModel.residual_terms``
    and the acceleration a_R that the left-out modes follow, ``residual_acceleration``: the hub's own, unless
    there is internal damping.

    Parameters
    ----------
    A, B, period, scale
        See ``LinearStepper``; states are q, q', and, where the damping asks for them, the hub's velocity (air)
        and a_R (internal damping).
    n_modes : int
        n.
    gain : ndarray, shape (n,)
        Gamma_i = E_i / m_b: q_i'' + ... = -Gamma_i alpha''.
    has_velocity, has_lag : bool
        Whether the hub's velocity and a_R are states.
    """

    def __init__(
        self,
        A: FloatArray,
        B: FloatArray,
        period: float,
        scale: FloatArray,
        *,
        n_modes: int,
        gain: FloatArray,
        has_velocity: bool,
        has_lag: bool,
    ) -> None:
        super().__init__(A, B, period, scale)
        self._n = n_modes
        self._gain = gain
        self._has_velocity, self._has_lag = has_velocity, has_lag

    @property
    def state(self) -> FloatArray:
        """Coordinates q and rates q', shape (2 n,); a view, so that it can be written to."""
        return self._full_state[: 2 * self._n]

    @state.setter
    def state(self, value: FloatArray) -> None:
        self._full_state[: 2 * self._n] = value

    def reset(self) -> None:
        """Put the beam at rest, straight, on a still hub."""
        self._full_state[:] = 0.0

    def step(self, acceleration: float) -> None:
        """Advance one tick under a hub acceleration held over it [m/s^2]."""
        self._advance(acceleration)

    def coordinates(self, tau: float | FloatArray, acceleration: float) -> FloatArray:
        """Return q at ``tau`` seconds into the current tick, exact, without a change of state.

        Parameters
        ----------
        tau : float or ndarray, shape (n_tau,)
            Between 0 and the period.
        acceleration : float
            Of the hub, held since the tick [m/s^2].

        Returns
        -------
        ndarray, shape (n,) or (n_tau, n)
        """
        return self._state_after(tau, acceleration)[..., : self._n]

    def residual_acceleration(self, tau: float | FloatArray, acceleration: float) -> FloatArray:
        """Return a_R [m/s^2] at ``tau``: what the left-out modes follow, shape () or (n_tau,)."""
        if self._has_lag:
            return np.asarray(self._state_after(tau, acceleration)[..., -1])
        return np.full(np.shape(tau), acceleration, dtype=np.float64)

    def kick(self, delta_velocity: float) -> None:
        """Change the hub's velocity at once [m/s], as a piecewise-constant velocity command does at a tick.

        The left-out modes, which have no inertia of their own, do not show the blow.
        """
        # q' jumps by -Gamma times the jump of alpha', the integral of q'' = -Gamma alpha'' + .. over the
        # blow.
        self._full_state[self._n : 2 * self._n] -= self._gain * delta_velocity
        if self._has_velocity:
            self._full_state[2 * self._n] += delta_velocity

    def step_linear(self, start: float, end: float) -> None:
        """Advance one tick under a hub acceleration that runs straight from ``start`` to ``end`` [m/s^2]."""
        self._advance_linear(start, end)

    def run(self, accelerations: FloatArray, hold: str = "zoh") -> FloatArray:
        """Return q and q' at every tick of a record, shape (n_ticks, 2 n), the present state first.

        Parameters
        ----------
        accelerations : ndarray
            Of the hub [m/s^2]: for "zoh" (n_ticks - 1,), held from tick to tick; for "foh" (n_ticks,), joined by
            straight lines.
        hold : {"zoh", "foh"}
            How the input runs between ticks. The stepper is left at the end of the record.
        """
        return self._run(accelerations, hold)[:, : 2 * self._n]

    def run_at(self, times: FloatArray, accelerations: FloatArray, hold: str = "zoh") -> FloatArray:
        """Return q and q' at irregular times, shape (n_times, 2 n), the present state at the first of them.

        Parameters
        ----------
        times : ndarray, shape (n_times,)
            Strictly increasing [s].
        accelerations : ndarray, shape (n_times,)
            Of the hub at those times [m/s^2], held ("zoh": the last one is not used) or joined ("foh").
        hold : {"zoh", "foh"}
        """
        return self._run_at(times, accelerations, hold)[:, : 2 * self._n]


@dataclass(frozen=True)
class HubAndBeam:
    """Where hub and beam are at one instant, or at several.

    Attributes
    ----------
    position, velocity, acceleration : ndarray, shape () or (n_tau,)
        Of the hub [m], [m/s], [m/s^2].
    coordinates : ndarray, shape (n,) or (n_tau, n)
        q.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    coordinates: FloatArray


class ForceStepper(LinearStepper):
    """The beam on a free hub under a force, held over each tick.

    Displacements are u(z, t) = alpha + shape(z) @ q - R(z) alpha''. (The lag that internal damping gives to the
    last term, eta omega of a part in a thousand, is left out here.)

    Parameters
    ----------
    A, B, period, scale
        See ``LinearStepper``; states are [alpha, q, alpha', q'].
    """

    def __init__(self, A: FloatArray, B: FloatArray, period: float, scale: FloatArray) -> None:
        super().__init__(A, B, period, scale)
        self._n = B.size // 2

    @property
    def state(self) -> FloatArray:
        """Hub and beam, [alpha, q, alpha', q'], shape (2 + 2 n,); a view, so that it can be written to."""
        return self._full_state

    @state.setter
    def state(self, value: FloatArray) -> None:
        self._full_state[:] = value

    def reset(self) -> None:
        """Put the hub at rest at home with a straight, still beam."""
        self._full_state[:] = 0.0

    def step(self, force: float) -> None:
        """Advance one tick under a force on the hub held over it [N]."""
        self._advance(force)

    def coordinates(self, tau: float | FloatArray, force: float) -> tuple[FloatArray, FloatArray]:
        """Return alpha, shape () or (n_tau,), and q, shape (n,) or (n_tau, n), ``tau`` into the tick."""
        state = self._state_after(tau, force)
        return state[..., 0], state[..., 1 : self._n]

    def motion(self, tau: float | FloatArray, force: float) -> HubAndBeam:
        """Return position, velocity and acceleration of the hub and q, at ``tau`` into the current tick."""
        state = self._state_after(tau, force)
        # The hub's row of X' = A X + B f.
        acceleration = state @ self._A[self._n] + self._B[self._n] * force
        return HubAndBeam(state[..., 0], state[..., self._n], acceleration, state[..., 1 : self._n])

    def step_linear(self, start: float, end: float) -> None:
        """Advance one tick under a force that runs straight from ``start`` to ``end`` [N]."""
        self._advance_linear(start, end)

    def run(self, forces: FloatArray, hold: str = "zoh") -> FloatArray:
        """Return [alpha, q, alpha', q'] at every tick, shape (n_ticks, 2 + 2 n); see ``MotionStepper.run``."""
        return self._run(forces, hold)

    def run_at(self, times: FloatArray, forces: FloatArray, hold: str = "zoh") -> FloatArray:
        """Return [alpha, q, alpha', q'] at irregular times; see ``MotionStepper.run_at``."""
        return self._run_at(times, forces, hold)
