"""Output error of an axis: the parameters under which the real force leads to the measured positions.

The force that acts on the axis is known, whatever made it: in closed loop the noise of the position sensor comes back
as a real force, moves the axis, and is in the simulation as well. What is left, measured less simulated position, is
the sensor's noise alone, and none of it has reached the force before it was measured. Hence no bias, in open and in
closed loop, where the noise is white; derivatives of noisy positions, which bias least squares, do not occur.

Position and velocity at the beginning of every piece are estimated beside the rest: the position by its mean, which
is projected out, the velocity as a parameter of its own. A force that nobody measured would make the simulation
wander; pieces no longer than it takes to see that keep it in bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.axis.axis_record import AxisRecord, Piece
from beam_ident.axis.hub_motion import GridForce, Guide, at_stamps, simulate_guide
from beam_ident.noise.autoregression import autoregression, score_covariance
from beam_ident.numerics.levenberg_marquardt import Minimum, minimise

_STEP = 1e-6  # of a parameter's scale, for derivatives by differences
_FIRST_ITERATIONS, _MAX_ITERATIONS = 12, 60
COLOURED = 2.0
"""By how much the residuals' colour may widen intervals while they are still taken for a sensor's noise."""
_GAUSS = 1.0 / math.sqrt(12.0)  # of an exposure: nodes of its mean by Gauss's rule


@dataclass(frozen=True)
class MassAndFriction:
    """What is estimated of an axis.

    Attributes
    ----------
    mass : float -- [kg]
    viscous : float -- mean of both directions [N s/m]
    coulomb : float -- dry friction, mean of both directions [N]
    offset : float
        Half the difference of what acts against forward and backward motion: a constant force that pulls backward,
        and half the difference of the dry friction [N].
    delay : float -- by how much the force acts later than its stamps say [s]
    viscous_difference : float -- forward less backward [N s/m]
    modal_masses : tuple of float -- of what swings on the axis, one for every known mode [kg]
    """

    mass: float
    viscous: float
    coulomb: float
    offset: float
    delay: float = 0.0
    viscous_difference: float = 0.0
    modal_masses: tuple[float, ...] = ()

    def value(self, name: str) -> float:
        """Return a parameter by its name, a mass of a mode as ``modal_mass_1``."""
        if name.startswith(MODAL_MASS):
            place = int(name.removeprefix(MODAL_MASS)) - 1
            return self.modal_masses[place] if place < len(self.modal_masses) else 0.0
        return float(getattr(self, name))

    def changed(self, values: Mapping[str, float]) -> MassAndFriction:
        """Return these parameters with some other values."""
        plain = {name: float(value) for name, value in values.items() if not name.startswith(MODAL_MASS)}
        masses = dict(enumerate(self.modal_masses, 1))
        own = {int(name.removeprefix(MODAL_MASS)): values[name] for name in values if name not in plain}
        masses |= {place: float(value) for place, value in own.items()}
        row = tuple(masses.get(k, 0.0) for k in range(1, max(masses, default=0) + 1))
        return replace(self, **plain, modal_masses=row)

    def guide(self) -> Guide:
        """Return what simulates it."""
        half = 0.5 * self.viscous_difference
        return Guide(
            self.mass,
            self.viscous + half,
            self.viscous - half,
            self.coulomb + self.offset,
            self.coulomb - self.offset,
        )


MODAL_MASS = "modal_mass_"
"""What the name of a mode's mass begins with, before its number from 1."""


@dataclass(frozen=True, eq=False)
class AxisPoint:
    """The likelihood at some parameters and first velocities."""

    theta: FloatArray
    cost: float
    residuals: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class AxisFit:
    """A fit and what it leaves.

    Attributes
    ----------
    parameters : MassAndFriction
    names : tuple of str -- which of them were estimated
    covariance : ndarray, shape (n, n) -- of these, the colour of the residuals counted
    inflation : float -- by how much that colour widens the widest of the intervals, at least 1
    residuals : tuple of ndarray -- measured less simulated, piece by piece [m]
    converged, reason, iterations
    """

    parameters: MassAndFriction
    names: tuple[str, ...]
    covariance: FloatArray
    inflation: float
    residuals: tuple[FloatArray, ...]
    converged: bool
    reason: str
    iterations: int


class AxisOutputError:
    """Output error over the pieces of one or several records; implements ``levenberg_marquardt.Problem``.

    Parameters
    ----------
    pieces : sequence of (AxisRecord, Piece)
    start : MassAndFriction -- those that are not estimated keep its values
    names : sequence of str -- those that are estimated
    """

    def __init__(
        self, pieces: Sequence[tuple[AxisRecord, Piece]], start: MassAndFriction, names: Sequence[str]
    ) -> None:
        self.pieces, self.start, self.names = list(pieces), start, tuple(names)
        record = self.pieces[0][0]
        speed = max(own.speed_rms for own, _ in self.pieces)
        push = max(float(np.sqrt(np.mean(np.square(own.drive.values)))) for own, _ in self.pieces)
        scales = {
            "mass": start.mass,
            "viscous": push / speed,
            "coulomb": push,
            "offset": push,
            "delay": record.period_s,
            "viscous_difference": push / speed,
        }
        self._steps = _STEP * np.array([scales.get(name, start.mass) for name in self.names])
        self._velocity_step = _STEP * speed
        self._n_samples = sum(piece.n_samples for _, piece in self.pieces)
        self._forces: dict[tuple[int, float], GridForce] = {}

    def first(self) -> AxisPoint:
        """Return the start, every piece with the smoothed velocity."""
        theta = [self.start.value(name) for name in self.names]
        return self.state(np.array(theta + [piece.velocity for _, piece in self.pieces]))

    def parameters(self, theta: FloatArray) -> MassAndFriction:
        """Return the parameters that a vector stands for."""
        return self.start.changed(dict(zip(self.names, map(float, theta), strict=False)))

    def state(self, theta: FloatArray) -> AxisPoint:
        """Evaluate a point."""
        n = len(self.names)
        parameters = self.parameters(theta)
        if not parameters.mass > 0.0:
            return AxisPoint(theta, math.inf, ())
        residuals = self._residuals(parameters, theta[n:])
        power = sum(float(own @ own) for own in residuals)
        cost = (
            0.5 * self._n_samples * math.log(power / self._n_samples) if 0.0 < power < math.inf else math.inf
        )
        return AxisPoint(theta, cost, residuals)

    def slope(self, state: AxisPoint) -> tuple[FloatArray, FloatArray]:
        """Return the information matrix and the descent direction."""
        n = len(self.names)
        shared, own = self.derivatives(state)
        information = np.zeros((len(state.theta),) * 2)
        direction = np.zeros(len(state.theta))
        for j, (columns, column, e) in enumerate(zip(shared, own, state.residuals, strict=True)):
            information[:n, :n] += columns.T @ columns
            information[:n, n + j] = information[n + j, :n] = columns.T @ column
            information[n + j, n + j] = column @ column
            direction[:n] += columns.T @ e
            direction[n + j] = column @ e
        variance = sum(float(e @ e) for e in state.residuals) / self._n_samples
        return information / variance, direction / variance

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step may lead: the mass changes by a factor of two at most."""
        result = theta + step
        for j, name in enumerate(self.names):
            if name == "mass":
                result[j] = min(max(result[j], 0.5 * theta[j]), 2.0 * theta[j])
        return result

    def derivatives(self, state: AxisPoint) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return those of the simulated positions: by the parameters (n_samples, n), by the first velocity.

        The simulation finds its events exactly and depends smoothly on the parameters, so that differences will do.
        """
        n = len(self.names)
        velocities = state.theta[n:]
        columns = []
        for j, step in enumerate(self._steps):
            theta = state.theta[:n].copy()
            theta[j] += step
            moved = self._residuals(self.parameters(theta), velocities)
            columns.append([(a - b) / step for a, b in zip(state.residuals, moved, strict=True)])
        step = self._velocity_step
        moved = self._residuals(self.parameters(state.theta), velocities + step)
        own = [(a - b) / step for a, b in zip(state.residuals, moved, strict=True)]
        shared = [np.array([rows[j] for rows in columns]).reshape(n, len(own[j])).T for j in range(len(own))]
        return shared, own

    def covariance(self, state: AxisPoint) -> tuple[FloatArray, float]:
        """Return the covariance with the residuals' colour, and by how much that widens the intervals."""
        shared, own = self.derivatives(state)
        design = []
        for columns, column in zip(shared, own, strict=True):
            size = float(column @ column)
            along = (columns.T @ column) / size if size > 0.0 else np.zeros(columns.shape[1])
            design.append(columns - np.outer(column, along))
        rows, left = np.concatenate(design), np.concatenate(state.residuals)
        free = max(len(left) - len(self.names) - 2 * len(self.pieces), 1)
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        rows = rows / scale
        inverse = np.linalg.pinv(rows.T @ rows, rcond=1e-13, hermitian=True)
        white = inverse * float(left @ left) / free
        coloured = (
            inverse @ score_covariance(rows, autoregression(left)) @ inverse * float(left @ left) / free
        )
        inflation = float(np.max(np.diag(coloured) / np.diag(white), initial=1.0))
        return coloured / np.outer(scale, scale), max(math.sqrt(inflation), 1.0)

    def minimum(self) -> Minimum[AxisPoint]:
        """Return the most likely parameters and first velocities.

        Only where the simulation nearly follows the positions are more than a few iterations worth their time.
        """
        found = minimise(self, self.first(), _FIRST_ITERATIONS)
        if found.converged or self.covariance(found.state)[1] > COLOURED:
            return found
        return minimise(self, found.state, _MAX_ITERATIONS)

    def fit(self) -> AxisFit:
        """Return the best parameters, with their covariance."""
        found = self.minimum()
        covariance, inflation = self.covariance(found.state)
        return AxisFit(
            self.parameters(found.state.theta),
            self.names,
            covariance,
            inflation,
            found.state.residuals,
            found.converged,
            found.reason,
            found.iterations,
        )

    def _residuals(self, parameters: MassAndFriction, velocities: FloatArray) -> tuple[FloatArray, ...]:
        guide = parameters.guide()
        forces = {id(record): self._force(record, parameters) for record, _ in self.pieces}
        found = []
        for (record, piece), velocity in zip(self.pieces, velocities, strict=True):
            simulated = simulated_positions(guide, forces[id(record)], record, piece, float(velocity))
            e = record.positions[piece.samples] - simulated
            found.append(e - np.mean(e))
        return tuple(found)

    def _force(self, record: AxisRecord, parameters: MassAndFriction) -> GridForce:
        """Return the drive's force and that of what swings on the axis."""
        key = (id(record), parameters.delay)
        if key not in self._forces:
            kept = (self.start.delay, parameters.delay)
            self._forces = {known: force for known, force in self._forces.items() if known[1] in kept}
            self._forces[key] = record.grid_force(parameters.delay)
        if not any(parameters.modal_masses):
            return self._forces[key]
        masses = np.array(parameters.modal_masses)
        return self._forces[key].plus(masses @ record.reactions[: len(masses)])


def simulated_positions(
    guide: Guide, force: GridForce, record: AxisRecord, piece: Piece, velocity: float, position: float = 0.0
) -> FloatArray:
    """Return what the sensor would say of a piece that begins so [m]."""
    x, v = simulate_guide(guide, force, piece.first, piece.last, position, velocity)
    begin, period = record.start_s + piece.first * record.period_s, record.period_s
    times = record.times_s[piece.samples]
    exposure = record.output.exposure_s
    if exposure == 0.0:
        return at_stamps(x, v, begin, period, times)
    return 0.5 * (
        at_stamps(x, v, begin, period, times - exposure * _GAUSS)
        + at_stamps(x, v, begin, period, times + exposure * _GAUSS)
    )
