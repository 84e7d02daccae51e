"""What a motion of the hub would do to the beam: tip deflection, root strain and hub force, before it is run.

``LoadTrace`` follows a record, in as many pieces as one likes. ``HeldLoads`` answers what a drive does that is
held for a while, from any state: it needs two products of matrices, so that it serves every set-point of a stream.
Both are linear theory, read at the ticks. The hub is led (its acceleration is the drive) or free (a force is).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import FloatArray
from beam_model.errors import BeamParameterError
from beam_model.galerkin.model import BeamModel
from beam_model.parameters import check_number

# Instants at which ``HeldLoads`` reads its peaks: some 30 in a period of the second mode, 10 in one of the third.
_MAX_ROWS = 192
# Longest hold in ticks, as a power of two: hours at 1 kHz, after which a beam has come to rest.
_MAX_HOLD = 24


@dataclass(frozen=True)
class PredictedLoads:
    """The largest loads that a hub motion would bring, by linear theory.

    Attributes
    ----------
    tip_deflection : float
        Largest |w(L)| [m].
    modal_tip_deflections : ndarray, shape (n_modes,)
        Largest share of each mode in it [m].
    root_strain : float
        Largest bending strain at the strip's surface at the clamp.
    hub_force : float
        Largest force that moves the hub, with the beam's reaction [N].
    """

    tip_deflection: float
    modal_tip_deflections: FloatArray
    root_strain: float
    hub_force: float


class _Loads:
    """Tip deflection, root strain and hub force as linear functions of [q, q'] and the hub's acceleration.

    Notes
    -----
    Strain is thickness/2 times the curvature at the clamp; the force is J alpha'' + sum E_i q_i'', with the
    left-out modes' mass carried along rigidly.
    """

    def __init__(self, model: BeamModel, thickness: float) -> None:
        half = 0.5 * check_number("thickness", thickness, "m", above=0.0)
        n, tip = model.n_modes, model.parameters.length
        basis, damping = model.basis, model.matrices.C[1:, 1:] / model.basis.modal_mass
        self.tip_shape = model.shape([tip])[0]
        still = np.zeros(n)
        self.of_state = np.stack(
            [
                np.concatenate([self.tip_shape, still]),
                np.concatenate([half * model.shape([0.0], 2)[0], still]),
                -np.concatenate(
                    [basis.natural_frequencies**2 * basis.participation, damping.T @ basis.participation]
                ),
            ]
        )
        rigid = model.parameters.total_mass - float(model.participation_factors @ basis.participation)
        self.of_acceleration = np.array(
            [
                -float(model.residual_terms([tip])[0]),
                -half * float(model.residual_terms([0.0], 2)[0]),
                rigid,
            ]
        )


def _free_hub(model: BeamModel) -> tuple[FloatArray, float, FloatArray]:
    """Return the free hub's acceleration per state and per force, and which of its states are [q, q']."""
    A, B = model.matrices.state_space()
    n = model.n_modes
    elastic = np.concatenate([np.arange(1, n + 1), np.arange(n + 2, 2 * n + 2)])
    return A[n + 1], float(B[n + 1]), elastic


class LoadTrace:
    """The loads along a record that comes in pieces.

    Parameters
    ----------
    model : BeamModel
    period : float
        From tick to tick [s].
    thickness : float
        Of the strip in the direction of motion [m].
    is_free : bool, optional
        The drive is a force on the free hub [N], not the hub's acceleration [m/s^2].
    state : ndarray, shape (2 n_modes,), optional
        q and q' at the beginning; by default a straight beam at rest.
    position : float, optional
        Where a free hub rests at the beginning [m].

    Attributes
    ----------
    position, velocity : float
        Of a free hub: largest |alpha| [m] and |alpha'| [m/s].
    """

    def __init__(
        self,
        model: BeamModel,
        period: float,
        thickness: float,
        *,
        is_free: bool = False,
        state: FloatArray | None = None,
        position: float = 0.0,
    ) -> None:
        self._loads = _Loads(model, thickness)
        self._n_modes = n = model.n_modes
        self._is_free = is_free
        self._stepper = model.force_stepper(period) if is_free else model.motion_stepper(period)
        self._hub_of_state, self._hub_of_force, self._elastic = _free_hub(model)
        if state is not None:
            self._stepper.state[self._elastic if is_free else slice(None)] = state
        if is_free:
            self._stepper.state[0] = position
        self._peaks = np.zeros(3)
        self._modal = np.zeros(n)
        self.position, self.velocity = abs(position), 0.0

    def add(self, drive: ArrayLike) -> None:
        """Go on with the next samples of the drive, shape (n_samples,), each held for a tick."""
        u = np.asarray(drive, dtype=np.float64).ravel()
        if u.size == 0 or not np.all(np.isfinite(u)):
            raise BeamParameterError("accelerations", u.size, "", "at least one finite value")
        states, acceleration = self._stepper.run(u)[:-1], u
        if self._is_free:
            acceleration = states @ self._hub_of_state + self._hub_of_force * u
            self.position = max(self.position, float(np.abs(states[:, 0]).max()))
            self.velocity = max(self.velocity, float(np.abs(states[:, self._n_modes + 1]).max()))
            states = states[:, self._elastic]
        loads = states @ self._loads.of_state.T + np.multiply.outer(acceleration, self._loads.of_acceleration)
        if self._is_free:
            loads[:, 2] = u
        modal = states[:, : self._n_modes] * self._loads.tip_shape
        np.maximum(self._peaks, np.abs(loads).max(axis=0), out=self._peaks)
        np.maximum(self._modal, np.abs(modal).max(axis=0), out=self._modal)

    @property
    def loads(self) -> PredictedLoads:
        """The largest loads so far."""
        tip, strain, force = self._peaks.tolist()
        return PredictedLoads(tip, self._modal.copy(), strain, force)


def predict_loads(
    model: BeamModel, period: float, accelerations: ArrayLike, thickness: float
) -> PredictedLoads:
    """Return what a record of hub accelerations, held over each tick, would do to beam and hub.

    Parameters
    ----------
    model : BeamModel
    period : float
        From tick to tick [s].
    accelerations : array_like, shape (n_samples,)
        Of the hub, from rest [m/s^2].
    thickness : float
        Of the strip in the direction of motion [m].
    """
    trace = LoadTrace(model, period, thickness)
    trace.add(accelerations)
    return trace.loads


class HeldLoads:
    """The loads under a drive that is held, from any state of the beam.

    Parameters
    ----------
    model : BeamModel
    period : float
        From tick to tick [s].
    thickness : float
        Of the strip in the direction of motion [m].
    is_free : bool, optional
        The drive is a force on the free hub [N], not the hub's acceleration [m/s^2].

    Attributes
    ----------
    n_states : int
        Length of a state: for a led hub [q, q'] and what the damping adds (``MotionStepper``); for a free one
        [alpha, q, alpha', q'] (``ForceStepper``).
    elastic : ndarray of int, shape (2 n_modes,)
        Which of the states are q and q'.

    Notes
    -----
    With Z = [X, u] a tick is Z+ = P Z, and P^(2^k) for all k takes it over any number of ticks. The loads at
    tick k are C P^k Z: one table for up to 192 instants within a period of the slowest mode. Under a held drive
    the transient only decays, so that what comes later is not larger.
    """

    def __init__(self, model: BeamModel, period: float, thickness: float, *, is_free: bool = False) -> None:
        stepper = model.force_stepper(period) if is_free else model.motion_stepper(period)
        transition, held = stepper.tick_matrices
        self.n_states = size = held.size
        n = model.n_modes
        hub_of_state, hub_of_force, free_elastic = _free_hub(model)
        self.elastic = free_elastic if is_free else np.arange(2 * n)
        step = np.eye(size + 1)
        step[:size, :size], step[:size, size] = transition, held
        self._powers = [step]
        for _ in range(_MAX_HOLD):
            self._powers.append(self._powers[-1] @ self._powers[-1])
        loads = _Loads(model, thickness)
        outputs = np.zeros((3, size + 1))
        outputs[:, self.elastic] = loads.of_state
        if is_free:
            outputs[:, :size] += np.outer(loads.of_acceleration, hub_of_state)
            outputs[:, size] = loads.of_acceleration * hub_of_force
            outputs[2] = np.append(np.zeros(size), 1.0)
        else:
            outputs[:, size] = loads.of_acceleration
        slowest = 2.0 * math.pi / float(model.natural_frequencies[0])
        n_ticks = max(1, math.ceil(slowest / period))
        self._stride = -(-n_ticks // _MAX_ROWS)
        rows = [outputs]
        for _ in range(n_ticks // self._stride):
            rows.append(self._transfer(rows[-1], self._stride))
        self._table = np.concatenate(rows)
        self._drives = np.zeros(size + 1)

    def _transfer(self, rows: FloatArray, n_ticks: int) -> FloatArray:
        for power in self._powers:
            if n_ticks & 1:
                rows = rows @ power
            n_ticks >>= 1
        return rows

    def after(self, state: FloatArray, drive: float, n_ticks: int) -> FloatArray:
        """Return the state after some ticks under a held drive, shape (n_states,)."""
        z = np.append(state, drive)
        n_ticks = min(n_ticks, 2**_MAX_HOLD)
        power = 0
        while n_ticks:
            if n_ticks & 1:
                z = self._powers[power].dot(z)
            n_ticks >>= 1
            power += 1
        return z[:-1]

    def peaks(self, state: FloatArray, drive: float, n_ticks: int) -> FloatArray:
        """Return the largest tip deflection [m], root strain and hub force [N] of these ticks, shape (3,)."""
        z = self._drives
        z[:-1], z[-1] = state, drive
        n_rows = min((n_ticks - 1) // self._stride + 1, len(self._table) // 3)
        loads = self._table[: 3 * max(1, n_rows)].dot(z)
        np.abs(loads, out=loads)
        return np.asarray(loads.reshape(-1, 3).max(axis=0))
