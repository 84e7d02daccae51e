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
from beam_ident.axis.compliant_motion import DriveSpring, TwoMotions, simulate_compliant
from beam_ident.axis.first_ringing import FirstRinging
from beam_ident.axis.hub_motion import GridForce, Guide, at_stamps, simulate_guide
from beam_ident.noise.autoregression import coloured_covariance
from beam_ident.numerics.levenberg_marquardt import Minimum, minimise

_STEP = 1e-6  # of a parameter's scale, for derivatives by differences
_FIRST_ITERATIONS, _MAX_ITERATIONS = 12, 60
_WORSE_DELAYS = 4  # whole periods beyond the best delay that are looked at
COLOURED = 2.0
"""By how much the residuals' colour may widen intervals while they are still taken for a sensor's noise."""
_RING_STEP = 1e-3  # of the deflection that the force's rms makes, likewise
_RING = 3.0
"""Most that a spring may ring with at the beginning of a piece, in units of that deflection: standard deviation."""
_MAX_DAMPING = 3.0  # damping ratio of a drive's spring
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
    resonance : float
        At which drive and hub swing against each other without friction [rad/s]; 0: the drive is stiff.
    resonance_damping : float -- damping ratio of that
    drive_mass : float -- the part of the mass that is ahead of the spring [kg]
    """

    mass: float
    viscous: float
    coulomb: float
    offset: float
    delay: float = 0.0
    viscous_difference: float = 0.0
    modal_masses: tuple[float, ...] = ()
    resonance: float = 0.0
    resonance_damping: float = 0.0
    drive_mass: float = 0.0

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

    @property
    def fading(self) -> float:
        """How fast a ringing of drive and hub fades [1/s]."""
        return self.resonance_damping * self.resonance

    def guide(self) -> Guide:
        """Return what simulates it."""
        half = 0.5 * self.viscous_difference
        return Guide(
            self.mass - self.drive_mass if self.resonance else self.mass,
            self.viscous + half,
            self.viscous - half,
            self.coulomb + self.offset,
            self.coulomb - self.offset,
        )

    def spring(self) -> DriveSpring | None:
        """Return the drive's spring; None where the drive is stiff.

        Two masses on a spring swing against each other as their reduced mass does: omega^2 = k / m_r.
        """
        if not self.resonance:
            return None
        reduced = self.drive_mass * (self.mass - self.drive_mass) / self.mass
        return DriveSpring(
            self.drive_mass,
            self.resonance**2 * reduced,
            2.0 * self.resonance_damping * self.resonance * reduced,
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
    state : AxisPoint -- where the iteration ended
    converged, reason, iterations
    """

    parameters: MassAndFriction
    names: tuple[str, ...]
    covariance: FloatArray
    inflation: float
    state: AxisPoint
    converged: bool
    reason: str
    iterations: int

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Measured less simulated, piece by piece [m]."""
        return self.state.residuals

    @property
    def power(self) -> float:
        """Sum of their squares [m^2]."""
        return _power(self.residuals)

    @property
    def is_noise(self) -> bool:
        """Whether what the simulation leaves is the noise of a sensor."""
        return self.converged and self.inflation < COLOURED

    def needed(self, further: Sequence[str], n_values: int) -> tuple[str, ...]:
        """Return which of further parameters the fit shows, as ``shown`` says."""
        return shown(self.parameters, self.names, self.covariance, further, n_values)


def shown(
    parameters: MassAndFriction,
    names: Sequence[str],
    covariance: FloatArray,
    further: Sequence[str],
    n_values: int,
) -> tuple[str, ...]:
    """Return which of further parameters a fit shows, as the Bayesian information criterion asks of each."""
    least = math.sqrt(math.log(n_values))
    return tuple(
        name
        for j, name in enumerate(names)
        if name in further and abs(parameters.value(name)) > least * math.sqrt(covariance[j, j])
    )


class AxisOutputError:
    """Output error over the pieces of one or several records; implements ``levenberg_marquardt.Problem``.

    Parameters
    ----------
    pieces : sequence of (AxisRecord, Piece)
    start : MassAndFriction -- those that are not estimated keep its values
    names : sequence of str -- those that are estimated
    ringing : ndarray, shape (2,), optional
        Mean squares of what a spring rings with, as ``ringing`` returns them; wide where they are not known.
    """

    def __init__(
        self,
        pieces: Sequence[tuple[AxisRecord, Piece]],
        start: MassAndFriction,
        names: Sequence[str],
        ringing: FloatArray | None = None,
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
            "resonance": start.resonance,
            "resonance_damping": 1.0,
        }
        self._push = push
        # Of every piece: the velocity, and what the spring's deflection and rate have beyond those of a slow motion.
        self._n_own = 3 if start.resonance else 1
        self._own_steps = np.array([_STEP * speed, _RING_STEP, _RING_STEP][: self._n_own])
        expected = np.full(2, _RING**2) if ringing is None else ringing
        self._own_weights = np.array([0.0, *(1.0 / expected)])[: self._n_own]
        self._first_ringing: FirstRinging | None = None
        self._steps = _STEP * np.array([scales.get(name, start.mass) for name in self.names])
        self._n_samples = sum(piece.n_samples for _, piece in self.pieces)
        self._forces: dict[tuple[int, float], GridForce] = {}
        self._derived: tuple[FloatArray, list[FloatArray], list[FloatArray]] | None = None

    def first(self, own: FloatArray | None = None) -> AxisPoint:
        """Return the start, with what is the pieces' own; where that is not known, the smoothed velocity.

        Parameters
        ----------
        own : ndarray, shape (n_pieces, 1), or (n_pieces, 3) behind a spring, optional
        """
        if own is None:
            own = np.zeros((len(self.pieces), self._n_own))
            own[:, 0] = [piece.velocity for _, piece in self.pieces]
        theta = np.concatenate([[self.start.value(name) for name in self.names], own.ravel()])
        self._first_ringing = None
        if self.start.resonance:
            self._first_ringing = self._ringing_at(self.state(theta))
        return self.state(theta)

    def _ringing_at(self, state: AxisPoint) -> FirstRinging | None:
        """Return what the positions show of the ringing at the beginning of every piece."""
        if not math.isfinite(state.cost):
            return None
        n, m = len(self.names), self._n_own
        information, _ = self.slope(state)
        places = [slice(n + j * m, n + (j + 1) * m) for j in range(len(self.pieces))]
        return FirstRinging.of(
            self._own_weights[1:],
            [information[here, here] - np.diag(self._own_weights) for here in places],
            [(piece.last - piece.first) * record.period_s for record, piece in self.pieces],
            self.parameters(state.theta).fading,
        )

    def parameters(self, theta: FloatArray) -> MassAndFriction:
        """Return the parameters that a vector stands for."""
        return self.start.changed(dict(zip(self.names, map(float, theta), strict=False)))

    def state(self, theta: FloatArray) -> AxisPoint:
        """Evaluate a point."""
        parameters, own = self.parameters(theta), self.own(theta)
        if not self._is_allowed(parameters):
            return AxisPoint(theta, math.inf, ())
        residuals = self._residuals(parameters, own)
        power = _power(residuals)
        if not 0.0 < power < math.inf:
            return AxisPoint(theta, math.inf, ())
        rings = 0.5 * float(np.sum(np.square(own) @ self._own_weights))
        if self._first_ringing is not None:
            rings += self._first_ringing.cost(parameters.fading)
        return AxisPoint(theta, 0.5 * self._n_samples * math.log(power / self._n_samples) + rings, residuals)

    def slope(self, state: AxisPoint) -> tuple[FloatArray, FloatArray]:
        """Return the information matrix and the descent direction."""
        n = len(self.names)
        shared, own = self.derivatives(state)
        variance = _power(state.residuals) / self._n_samples
        information = self._information(shared, own) / variance
        direction = self._along(shared, own, state.residuals) / variance
        weights = np.tile(self._own_weights, len(self.pieces))
        information[n:, n:] += np.diag(weights)
        direction[n:] -= weights * state.theta[n:]
        if self._first_ringing is not None:
            at = self.parameters(state.theta)
            slope = self._first_ringing.slope(at.fading)
            for name, share in (("resonance", at.resonance_damping), ("resonance_damping", at.resonance)):
                if name in self.names:
                    direction[self.names.index(name)] -= share * slope
        return information, direction

    def likeliest_delay(self, state: AxisPoint) -> float:
        """Return the delay, whole periods of the force beside that of ``state`` or none, that leaves the least [s].

        A servo feeds the noise of the position back into the force. At a wrong delay that noise is in the simulated
        positions too, and every whole period is a minimum of its own, from which no step leads to the next. All other
        parameters follow linearly.
        """
        shared, own = self.derivatives(state)
        inverse = np.linalg.pinv(self._information(shared, own), rcond=1e-13, hermitian=True)
        parameters, starts = self.parameters(state.theta), self.own(state.theta)
        period = self.pieces[0][0].period_s

        def left(periods: int) -> float:
            moved = parameters.changed({"delay": parameters.delay + periods * period})
            residuals = self._residuals(moved, starts)
            along = self._along(shared, own, residuals)
            return _power(residuals) - float(along @ inverse @ along)

        best, least = 0, left(0)
        for way in (1, -1):
            periods = way
            while abs(periods) <= max(way * best, 0) + _WORSE_DELAYS:
                power = left(periods)
                if power < least:
                    best, least = periods, power
                periods += way
        return parameters.delay + best * period

    def _information(self, shared: list[FloatArray], own: list[FloatArray]) -> FloatArray:
        """Return the products of the derivatives, shape (n_theta, n_theta)."""
        n, m = len(self.names), self._n_own
        found = np.zeros((n + m * len(self.pieces),) * 2)
        for j, (columns, rows) in enumerate(zip(shared, own, strict=True)):
            here = slice(n + j * m, n + (j + 1) * m)
            found[:n, :n] += columns.T @ columns
            found[:n, here] = columns.T @ rows
            found[here, :n] = found[:n, here].T
            found[here, here] = rows.T @ rows
        return found

    def _along(
        self, shared: list[FloatArray], own: list[FloatArray], residuals: Sequence[FloatArray]
    ) -> FloatArray:
        """Return the products of the derivatives and residuals, shape (n_theta,)."""
        common = sum(columns.T @ e for columns, e in zip(shared, residuals, strict=True))
        return np.concatenate(
            [np.asarray(common), *(rows.T @ e for rows, e in zip(own, residuals, strict=True))]
        )

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step may lead: masses and a resonance change by a factor of two at most."""
        result = theta + step
        for j, name in enumerate(self.names):
            if name in ("mass", "drive_mass", "resonance"):
                result[j] = min(max(result[j], 0.5 * theta[j]), 2.0 * theta[j])
            elif name == "resonance_damping":
                result[j] = min(max(result[j], 0.5 * theta[j]), _MAX_DAMPING)
        return result

    def derivatives(self, state: AxisPoint) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return those of the simulated positions, piece by piece, by the parameters and by what is a piece's own.

        The simulation finds its events exactly and depends smoothly on the parameters, so that differences will do.

        Returns
        -------
        shared : list of ndarray, shape (n_samples, n)
        own : list of ndarray, shape (n_samples, 1), or (n_samples, 3) behind a spring
        """
        # Slope, covariance and the first ringing are asked for at one and the same point.
        if self._derived is None or self._derived[0] is not state.theta:
            self._derived = (state.theta, *self._differences(state))
        return self._derived[1:]

    def _differences(self, state: AxisPoint) -> tuple[list[FloatArray], list[FloatArray]]:
        own = self.own(state.theta)
        values = state.theta[: len(self.names)]
        shared: list[list[FloatArray]] = [[] for _ in self.pieces]
        for j, step in enumerate(self._steps):
            theta = values.copy()
            theta[j] += step
            moved = self._residuals(self.parameters(theta), own)
            for columns, a, b in zip(shared, state.residuals, moved, strict=True):
                columns.append((a - b) / step)
        mine: list[list[FloatArray]] = [[] for _ in self.pieces]
        for step in np.diag(self._own_steps):
            moved = self._residuals(self.parameters(values), own + step)
            for columns, a, b in zip(mine, state.residuals, moved, strict=True):
                columns.append((a - b) / float(np.sum(step)))
        return [_side_by_side(c, e) for c, e in zip(shared, state.residuals, strict=True)], [
            _side_by_side(c, e) for c, e in zip(mine, state.residuals, strict=True)
        ]

    def covariance(self, state: AxisPoint) -> tuple[FloatArray, float]:
        """Return the covariance with the residuals' colour, and by how much that widens the intervals."""
        shared, own = self.derivatives(state)
        left = np.concatenate(state.residuals)
        variance = float(left @ left) / len(left)
        design = []
        for columns, rows in zip(shared, own, strict=True):
            # What a piece's own parameters explain is taken away; those of the spring are known to ring so much.
            size = np.linalg.norm(rows, axis=0)
            size = np.where(size > 0.0, size, 1.0)
            unit = rows / size
            normal = unit.T @ unit + np.diag(variance * self._own_weights / np.square(size))
            along = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (unit.T @ columns)
            design.append(columns - unit @ along)
        rows = np.concatenate(design)
        n_left = max(len(left) - len(self.names), 1)
        free = max(n_left - (1 + self._n_own) * len(self.pieces), 1)
        scale = np.linalg.norm(rows, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        rows = rows / scale
        inverse = np.linalg.pinv(rows.T @ rows, rcond=1e-13, hermitian=True)
        white = inverse * float(left @ left) / free
        coloured = coloured_covariance(inverse, rows, left) * n_left / free
        inflation = float(np.max(np.diag(coloured) / np.diag(white), initial=1.0))
        return coloured / np.outer(scale, scale), max(math.sqrt(inflation), 1.0)

    def minimum(self, own: FloatArray | None = None, is_patient: bool = False) -> Minimum[AxisPoint]:
        """Return the most likely parameters and first velocities.

        Only where the simulation nearly follows the positions are more than a few iterations worth their time.

        Parameters
        ----------
        own : ndarray, optional -- as for ``first``
        is_patient : bool -- whether many iterations are worth their time in any case
        """
        found = minimise(self, self.first(own), _FIRST_ITERATIONS)
        if found.converged:
            return found
        if not is_patient and self.covariance(found.state)[1] > COLOURED:
            return found
        return minimise(self, found.state, _MAX_ITERATIONS)

    def fit(self, own: FloatArray | None = None) -> AxisFit:
        """Return the best parameters, with their covariance; ``own`` is as for ``first``."""
        found = self.minimum(own)
        covariance, inflation = self.covariance(found.state)
        return AxisFit(
            self.parameters(found.state.theta),
            self.names,
            covariance,
            inflation,
            found.state,
            found.converged,
            found.reason,
            found.iterations,
        )

    def own(self, theta: FloatArray) -> FloatArray:
        """Return what is every piece's own, shape (n_pieces, 1 or 3)."""
        return theta[len(self.names) :].reshape(len(self.pieces), self._n_own)

    def _is_allowed(self, parameters: MassAndFriction) -> bool:
        if not parameters.mass > 0.0:
            return False
        return not parameters.resonance or 0.0 < parameters.drive_mass < parameters.mass

    def _residuals(self, parameters: MassAndFriction, own: FloatArray) -> tuple[FloatArray, ...]:
        found = []
        forces = {id(record): self.force_on(record, parameters) for record, _ in self.pieces}
        for (record, piece), start in zip(self.pieces, own, strict=True):
            force = forces[id(record)]
            if parameters.resonance:
                simulated = self._behind_spring(parameters, force, record, piece, start)
            else:
                if any(parameters.modal_masses):
                    force = force.plus(_load(record, parameters))
                motion = simulate_guide(
                    parameters.guide(), force, piece.first, piece.last, 0.0, float(start[0])
                )
                simulated = _seen(*motion, record, piece)
            e = record.positions[piece.samples] - simulated
            found.append(e - np.mean(e))
        return tuple(found)

    def _behind_spring(
        self,
        parameters: MassAndFriction,
        force: GridForce,
        record: AxisRecord,
        piece: Piece,
        start: FloatArray,
    ) -> FloatArray:
        """Return what the sensor would say of a piece in which the drive pulls the hub by a spring [m]."""
        motion = self._motions(parameters, force, record, piece, start)
        if record.is_of_drive:
            return _seen(motion.drive, motion.drive_velocity, record, piece)
        return _seen(motion.hub, motion.hub_velocity, record, piece)

    def _motions(
        self,
        parameters: MassAndFriction,
        force: GridForce,
        record: AxisRecord,
        piece: Piece,
        start: FloatArray,
    ) -> TwoMotions:
        """Return the motion of drive and hub over a piece."""
        guide, spring = parameters.guide(), parameters.spring()
        assert spring is not None
        load = _load(record, parameters) if any(parameters.modal_masses) else None
        velocity, further, rate = map(float, start)
        own = 0.0 if load is None else float(load[piece.first])
        slow = float(_slow_deflection(parameters, spring, velocity, force.at(piece.first, 0.0), own))
        unit = self._push / spring.stiffness
        turning = unit * parameters.resonance * rate
        of_hub = velocity - turning if record.is_of_drive else velocity
        steps = (piece.first, piece.last)
        return simulate_compliant(guide, spring, force, load, steps, (of_hub, slow + unit * further, turning))

    def ringing(self, state: AxisPoint) -> FloatArray:
        """Return the mean squares of what the spring rings with throughout: deflection and rate, shape (2,).

        They are beyond those of a slow motion and in units of the deflection that the force's rms makes, as at the
        beginning of a piece.
        """
        parameters = self.parameters(state.theta)
        spring = parameters.spring()
        assert spring is not None
        unit = self._push / spring.stiffness
        rows = []
        for (record, piece), start in zip(self.pieces, self.own(state.theta), strict=True):
            force, here = self.force_on(record, parameters), slice(piece.first, piece.last)
            motion = self._motions(parameters, force, record, piece, start)
            velocity = motion.drive_velocity if record.is_of_drive else motion.hub_velocity
            load = _load(record, parameters)[here] if any(parameters.modal_masses) else 0.0
            slow = _slow_deflection(parameters, spring, velocity[:-1], force.at_start[here], load)
            further = (motion.drive - motion.hub)[:-1] - slow
            rate = (motion.drive_velocity - motion.hub_velocity)[:-1] / parameters.resonance
            rows.append(np.array([further, rate]) / unit)
        return np.asarray(np.mean(np.square(np.concatenate(rows, axis=1)), axis=1))

    def force_on(self, record: AxisRecord, parameters: MassAndFriction) -> GridForce:
        """Return the drive's force, as late as it acts."""
        key = (id(record), parameters.delay)
        if key not in self._forces:
            kept = (self.start.delay, parameters.delay)
            self._forces = {known: force for known, force in self._forces.items() if known[1] in kept}
            self._forces[key] = record.grid_force(parameters.delay)
        return self._forces[key]


def _power(residuals: Sequence[FloatArray]) -> float:
    return sum(float(e @ e) for e in residuals)


def _load(record: AxisRecord, parameters: MassAndFriction) -> FloatArray:
    """Return the force on the hub of what swings on it, at the knots [N]."""
    masses = np.array(parameters.modal_masses)
    return np.asarray(masses @ record.reactions[: len(masses)])


def _slow_deflection(
    parameters: MassAndFriction,
    spring: DriveSpring,
    velocity: FloatArray | float,
    push: FloatArray | float,
    load: FloatArray | float,
) -> FloatArray:
    """Return the deflection of the spring in slow motion: it pulls the hub's share of the mass, and friction [m]."""
    guide = parameters.guide()
    forward = guide.viscous(1) * velocity + guide.resistance(1)
    backward = guide.viscous(-1) * velocity + guide.resistance(-1)
    on_hub = np.where(np.asarray(velocity) >= 0.0, forward, backward) - load
    tension = on_hub + guide.mass / parameters.mass * (push - on_hub)
    return np.asarray(tension / spring.stiffness)


def _seen(x: FloatArray, v: FloatArray, record: AxisRecord, piece: Piece) -> FloatArray:
    """Return the mean position over every exposure, from positions and velocities at the knots of a piece [m]."""
    begin, period = record.start_s + piece.first * record.period_s, record.period_s
    times = record.times_s[piece.samples]
    exposure = record.output.exposure_s
    if exposure == 0.0:
        return at_stamps(x, v, begin, period, times)
    return 0.5 * (
        at_stamps(x, v, begin, period, times - exposure * _GAUSS)
        + at_stamps(x, v, begin, period, times + exposure * _GAUSS)
    )


def _side_by_side(columns: list[FloatArray], like: FloatArray) -> FloatArray:
    """Return columns as a matrix, (n_samples, n), where there may be none."""
    return np.asarray(np.array(columns).reshape(len(columns), len(like)).T)
