"""Inverse dynamics with instrumental variables, in weak form.

Newton's law of the axis, f = m x'' + c x' + R(x'), is averaged under a triangle about every stamp that is zero at
the stamps beside it: what that leaves of m x'' is m times the second difference of the positions, exactly, and the
mean of a force that is known between its samples is exact too. So nothing is lost by sampling, however short the
windows are. Smooth windows over these means make the equations, linear in the parameters; they lie where the
direction of the motion is sure, and overlap. They also filter: force and positions pass through the same low-pass,
which is what filtered derivatives are for (Gautier and Poignet, Control Engineering Practice 9 (2001) 1361-1372).

An unmeasured force enters as an error of f, and a servo that holds the axis to its reference keeps it out of the
motion; noise of the position enters x and is what least squares is biased by. Instruments mend that (Janot, Vandanjon
and Gautier, IEEE Trans. Control Systems Technology 22 (2014) 132-145): the same columns made of a motion without that
noise, the reference of the loop or the motion that a model makes of the force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray, IndexArray
from beam_ident.axis.axis_output_error import MODAL_MASS, MassAndFriction, shown
from beam_ident.axis.axis_record import AxisRecord, runs
from beam_ident.axis.axis_result import AxisTerm
from beam_ident.errors import EstimationError
from beam_ident.noise.autoregression import coloured_covariance
from beam_ident.numerics.convolution import eroded, inner_convolution

_POWER = 4  # of the window (1 - s^2)^4
_TRIANGLE = np.array([1.0, 10.0, 1.0]) / 12.0  # of a smooth signal at its knots: its mean under a triangle
_SPACING = 8  # windows in the length of one
_NARROWEST = 9  # samples of a window
_MAX_SHARE = 0.25  # of the longest stretch in one direction, for a window
_MIN_EQUATIONS = 96  # of windows that overlap eightfold
NAMES = ("mass", "viscous", "coulomb", "offset")
WITH_DIFFERENCE = (*NAMES, "viscous_difference")
_OWN = ("the acceleration", "the speed", "the direction", "nothing, a constant", "the speed, by direction")
_SEEN = 4.0  # standard deviations
_MAX_SHARED = 1e3  # by how much other terms may widen a term's variance
_MATTERS = 5e-3  # of the force's rms
_SHARE = 0.07  # of the longest piece, the window of the search for unmodelled forces
_SLOW = 0.1  # of the velocity's rms: the speed within which friction may rise towards rest


@dataclass(frozen=True, eq=False)
class InverseDynamicsFit:
    """A fit of the equation of motion.

    Attributes
    ----------
    parameters : MassAndFriction
    names : tuple of str -- which of them were estimated
    covariance : ndarray, shape (n, n) -- the colour of the residuals counted
    window_s : float -- length of the windows [s]
    residuals : ndarray, shape (n_windows,) -- of the mean force [N]
    """

    parameters: MassAndFriction
    names: tuple[str, ...]
    covariance: FloatArray
    window_s: float
    residuals: FloatArray

    def needed(self, further: Sequence[str], n_values: int) -> tuple[str, ...]:
        """Return which of further parameters the fit shows, as ``shown`` says."""
        return shown(self.parameters, self.names, self.covariance, further, n_values)

    @property
    def volume(self) -> float:
        """Logarithm of the determinant of the covariance: what is compared between windows."""
        return float(np.linalg.slogdet(self.covariance)[1])


@dataclass(frozen=True, eq=False)
class _Motion:
    """A motion on a regular grid: means under a triangle about every knot, and the direction, shape (n,) each."""

    acceleration: FloatArray
    speed: FloatArray
    direction: FloatArray


@dataclass(frozen=True, eq=False)
class _Even:
    """Motion and force on the regular grid that the positions nearly have; what is not known is not ``is_moving``."""

    period_s: float
    positions: FloatArray
    force: FloatArray
    motion: _Motion
    is_moving: BoolArray
    instrument: _Motion
    reactions: FloatArray


def fit_inverse_dynamics(
    records: Sequence[AxisRecord],
    delay_s: float = 0.0,
    names: Sequence[str] = NAMES,
    motions: Sequence[FloatArray] | None = None,
    lead_s: float = 0.0,
) -> InverseDynamicsFit:
    """Estimate the parameters, with the window that leaves the smallest covariance.

    Parameters
    ----------
    records : sequence of AxisRecord
    delay_s : float -- by how much the force acts later than its stamps say [s]
    names : sequence of str -- ``NAMES``, and "viscous_difference" and "delay" where they are wanted
    motions : sequence of ndarray, optional
        A motion for every record, at its positions' stamps, that instruments are made of; None: the measured one,
        which is least squares.

    Raises
    ------
    EstimationError
        The moving pieces are too short for the narrowest windows.
    """
    even = [
        _on_grid(record, delay_s, None if motions is None else motions[j]) for j, record in enumerate(records)
    ]
    longest = max(_longest_run(own.is_moving) for own in even)
    best: InverseDynamicsFit | None = None
    width = _NARROWEST
    while width <= max(_MAX_SHARE * longest, _NARROWEST):
        found = _solved(even, width, names, delay_s)
        if found is not None and (best is None or found.volume < best.volume):
            best = found
        width = 2 * width - 1
    if best is None:
        raise EstimationError(
            f"the axis moves for {longest} samples at the longest; its equation of motion needs some {_NARROWEST} "
            f"samples in one stretch and {_MIN_EQUATIONS} windows in all: record longer moves, or sample more often"
        )
    return best


def unmodelled_forces(
    records: Sequence[AxisRecord], parameters: MassAndFriction, is_fit: bool
) -> list[AxisTerm]:
    """Return forces that a record shows beyond a model, those over four standard deviations.

    Parameters
    ----------
    records : sequence of AxisRecord
    parameters : MassAndFriction -- of the model
    is_fit : bool -- whether it was fitted to these records, so that its own terms leave nothing
    """
    even = [_on_grid(record, parameters.delay, None) for record in records]
    longest = max(_longest_run(own.is_moving) for own in even)
    width = int(min(max(_NARROWEST, _SHARE * longest), _MAX_SHARE * longest)) | 1
    equations = [_of_terms(own, parameters, width, is_fit) for own in even]
    left = np.concatenate([e for e, _ in equations])
    names = tuple(equations[0][1])
    X = np.concatenate([np.stack([own[name] for name in names], axis=1) for _, own in equations])
    size = np.linalg.norm(X, axis=0)
    kept = size > 0.0
    X, names = (
        X[:, kept] / size[kept],
        tuple(name for name, is_kept in zip(names, kept, strict=True) if is_kept),
    )
    if len(left) < _MIN_EQUATIONS + len(names):
        return []
    inverse = np.linalg.pinv(X.T @ X, rcond=1e-13, hermitian=True)
    found = inverse @ (X.T @ left)
    noise = left - X @ found
    spread = coloured_covariance(inverse, X, noise)
    z = found / np.sqrt(np.maximum(np.diag(spread), 1e-300))
    # Only what no other term can stand for counts as a term's force.
    rms = np.abs(found) / np.sqrt(np.maximum(np.diag(inverse), 1e-300) * len(left))
    is_own = np.diag(inverse) < _MAX_SHARED
    rows = zip(names, rms, z, is_own, strict=True)
    terms = [AxisTerm(name, float(f), float(k)) for name, f, k, is_its_own in rows if is_its_own]
    least = _MATTERS * math.sqrt(float(np.mean(np.square(np.concatenate([own.force for own in even])))))
    return [
        term
        for term in terms
        if abs(term.z) > _SEEN and term.force > least and not (is_fit and term.name in _OWN)
    ]


def _of_terms(
    own: _Even, parameters: MassAndFriction, width: int, is_fit: bool
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return what the windows leave of the force, and what each force that a model may lack would add."""
    places, direction = _places(own, width), own.motion.direction
    columns = _columns(own.motion, width, WITH_DIFFERENCE)[places]
    model = columns @ np.array([parameters.value(name) for name in WITH_DIFFERENCE])
    left = _windowed(own.force, width)[places] - model
    for modal_mass, reaction in zip(parameters.modal_masses, own.reactions, strict=False):
        left = left + modal_mass * _windowed(reaction, width)[places]
    velocity = inner_convolution(
        np.pad(own.motion.speed, (width // 2, (width - 1) // 2)), np.ones(width) / width
    )
    fast = float(np.sqrt(np.mean(np.square(velocity[own.is_moving]))))
    x = own.positions - float(np.mean(own.positions[own.is_moving]))
    signals = {
        "slow motion": direction * np.exp(-np.abs(velocity) / (_SLOW * fast)),
        "the square of the speed": velocity * np.abs(velocity) / fast,
        "the position": x,
        "the square of the position": np.square(x),
    }
    terms = {name: _windowed(signal, width)[places] for name, signal in signals.items()}
    return left, dict(zip(_OWN, columns.T, strict=True)) | terms


def _on_grid(record: AxisRecord, delay_s: float, given: FloatArray | None) -> _Even:
    t = record.times_s
    period = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1] + 0.5 * period, period)
    nearest = np.clip(np.searchsorted(t, even - 0.5 * period), 0, len(t) - 1)
    known = np.abs(t[nearest] - even) <= 0.75 * period
    moving = known & ~record.is_slow[nearest]
    for gap in record.drive.gaps:
        moving &= ~((even - delay_s > gap.start_s - period) & (even - delay_s < gap.end_s + period))
    moving &= even - delay_s - period >= record.start_s
    # A triangle reaches to the neighbours, and a mean speed to theirs.
    moving = eroded(moving, 5)
    velocity = np.interp(even, t, record.velocities)
    x = np.interp(even, t, record.positions)
    motion = _motion(x, velocity, period)
    instrument = motion
    if given is not None:
        followed = np.interp(even, t, given)
        moving &= eroded(np.isfinite(followed), 5)
        followed = np.where(np.isfinite(followed), followed, 0.0)
        instrument = _motion(followed, np.gradient(followed, period), period)
    at_knots = [np.interp(even, _knots(record), own) for own in record.reactions]
    return _Even(
        period,
        x,
        record.mean_force(even - delay_s, period),
        motion,
        moving,
        instrument,
        np.array([np.convolve(own, _TRIANGLE, "same") for own in at_knots]),
    )


def _motion(x: FloatArray, velocity: FloatArray, period: float) -> _Motion:
    """Return means under triangles of a motion known at its knots, the two at either end unknown."""
    acceleration, speed = np.zeros(len(x)), np.zeros(len(x))
    acceleration[1:-1] = np.diff(x, 2) / period**2
    # The mean speed is the change of the mean position from step to step, by cubics.
    mean = 0.5 * (x[1:-2] + x[2:-1]) - (x[3:] - x[2:-1] - x[1:-2] + x[:-3]) / 24.0
    speed[2:-2] = np.diff(mean) / period
    return _Motion(acceleration, speed, np.sign(velocity))


def _knots(record: AxisRecord) -> FloatArray:
    return np.asarray(record.start_s + record.period_s * np.arange(record.n_steps + 1))


def _longest_run(flags: BoolArray) -> int:
    return max((end - begin for begin, end in runs(flags)), default=0)


def _solved(
    even: Sequence[_Even], width: int, names: Sequence[str], delay_s: float
) -> InverseDynamicsFit | None:
    """Return the estimate with windows of ``width`` samples, None where there are too few of them."""
    columns, instruments, forces = [], [], []
    for own in even:
        places = _places(own, width)
        plain = [name for name in names if name != "delay" and not name.startswith(MODAL_MASS)]
        swinging = [name for name in names if name.startswith(MODAL_MASS)]
        X, Z = (_columns(motion, width, plain)[places] for motion in (own.motion, own.instrument))
        f = _windowed(own.force, width)[places]
        for name in swinging:
            # What swings on the axis helps to move it: its part of the force is on the other side of the equation.
            column = -_windowed(own.reactions[int(name.removeprefix(MODAL_MASS)) - 1], width)[places]
            X, Z = np.column_stack([X, column]), np.column_stack([Z, column])
        if "delay" in names:
            # f(t - T) = f - T f': the force's slope is a column, and that of the force which the motion needs, by the
            # first terms as least squares know them, is its instrument.
            mass, viscous, coulomb = np.zeros(3)
            if len(f) >= _MIN_EQUATIONS:
                mass, viscous, coulomb = np.linalg.lstsq(X[:, :4], f, rcond=None)[0][:3]
            motion = own.instrument
            needed = mass * motion.acceleration + viscous * motion.speed + coulomb * motion.direction
            slopes = [_windowed(np.gradient(push, own.period_s), width) for push in (own.force, needed)]
            X, Z = np.column_stack([X, slopes[0][places]]), np.column_stack([Z, slopes[1][places]])
        columns.append(X)
        instruments.append(Z)
        forces.append(f)
    X, Z, f = np.concatenate(columns), np.concatenate(instruments), np.concatenate(forces)
    names = [*plain, *swinging, *(["delay"] if "delay" in names else [])]
    if len(f) < _MIN_EQUATIONS:
        return None
    scale = np.linalg.norm(X, axis=0)
    size = np.linalg.norm(Z, axis=0)
    if not (np.all(scale > 0.0) and np.all(size > 0.0)):
        return None
    X, Z = X / scale, Z / size
    product = Z.T @ X
    if np.linalg.cond(product) > 1e10:
        return None
    theta = np.linalg.solve(product, Z.T @ f)
    left = f - X @ theta
    covariance = coloured_covariance(np.linalg.inv(product), Z, left)
    values = dict(zip(names, map(float, theta / scale), strict=True))
    values["delay"] = delay_s + values.get("delay", 0.0)
    return InverseDynamicsFit(
        MassAndFriction(0.0, 0.0, 0.0, 0.0).changed(values),
        tuple(names),
        covariance / np.outer(scale, scale),
        width * even[0].period_s,
        left,
    )


def _places(own: _Even, width: int) -> IndexArray:
    """Return where windows begin that lie wholly within motion in one direction."""
    is_whole = inner_convolution(own.is_moving.astype(np.float64), np.ones(width)) > width - 0.5
    places = np.arange(0, len(is_whole), max(1, width // _SPACING))
    return np.asarray(places[is_whole[places]])


def _columns(motion: _Motion, width: int, names: Sequence[str]) -> FloatArray:
    """Return what the windows make of the terms of the equation, shape (n_windows, n_terms)."""
    terms = {
        "mass": motion.acceleration,
        "viscous": motion.speed,
        "coulomb": motion.direction,
        "offset": np.ones(len(motion.speed)),
        # (c + d/2) x' forward, (c - d/2) x' backward: d |x'| / 2.
        "viscous_difference": 0.5 * motion.direction * motion.speed,
    }
    return np.stack([_windowed(terms[name], width) for name in names], axis=1)


def _windowed(values: FloatArray, width: int) -> FloatArray:
    """Return the means of a signal under a window at every place."""
    window = (1.0 - np.linspace(-1.0, 1.0, width + 2)[1:-1] ** 2) ** _POWER
    return inner_convolution(values, window / np.sum(window))
