"""A record of force and position, cut into the pieces in which the axis moves.

At rest the friction is what holds the axis, and says nothing but that it is large enough; how an axis breaks loose is
a law of its own. So rests are left out, and every piece begins with a position and a velocity of its own. A reversal
is no rest. A gap in the force ends a piece too; a gap in the position does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.axis.hub_motion import GridForce
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.errors import EstimationError
from beam_ident.numerics.convolution import inner_convolution
from beam_ident.numerics.piecewise import PiecewisePolynomial
from beam_ident.numerics.pole_response import phi_functions, recursion
from beam_ident.sensing.noise_floor import noise_floor

_SHARE_OF_SPEED = 0.01  # of the velocity's rms that the smoothed velocity's noise may have
_REST = 0.02  # of the velocity's rms: slower is rest, where it lasts
_DEVIATIONS = 4.0  # of the smoothed velocity's noise that are no motion
_NARROWEST = 7  # samples of the smoothing window
_WIDEST = 0.02  # of the record
_MIN_SAMPLES = 20  # samples of a piece
_GAUSS_POINTS = 5  # exact to the ninth degree
_REAL_MOVE = 30.0  # standard deviations of the position's noise


@dataclass(frozen=True)
class Piece:
    """A stretch of motion.

    Attributes
    ----------
    first, last : int -- knots of the force's grid
    samples : slice -- of the position
    velocity : float -- at the first knot, roughly [m/s]
    """

    first: int
    last: int
    samples: slice
    velocity: float

    @property
    def n_samples(self) -> int:
        """Number of positions."""
        return int(self.samples.stop) - int(self.samples.start)


@dataclass(frozen=True, eq=False)
class AxisRecord:
    """Force and position of one experiment.

    Parameters
    ----------
    drive : InputSignal -- the force, or what is proportional to it
    output : OutputSignal -- the position
    reference : InputSignal, optional -- the position that the axis was to have
    modes : tuple of (natural frequency [rad/s], damping ratio)
        Of what swings on the axis while that is held still.
    is_of_drive : bool
        Whether the position is that of the drive, ahead of its spring; else it is the hub's.
    """

    drive: InputSignal
    output: OutputSignal
    reference: InputSignal | None = None
    modes: tuple[tuple[float, ...], ...] = ()
    is_of_drive: bool = False

    @cached_property
    def _seen(self) -> BoolArray:
        first, last = self.drive.span_s
        return np.asarray(self.output.is_valid & self.output.is_within(first, last))

    @cached_property
    def times_s(self) -> FloatArray:
        """Stamps of the positions [s]."""
        return np.asarray(self.output.times_s[self._seen])

    @cached_property
    def positions(self) -> FloatArray:
        """[m]."""
        return np.asarray(self.output.values[self._seen])

    @cached_property
    def force(self) -> PiecewisePolynomial:
        """The force between its samples."""
        return self.drive.signal()

    @cached_property
    def period_s(self) -> float:
        """Step of the simulation's grid: the force's period, or the median step where it has none [s]."""
        return self.drive.period_s or float(np.median(np.diff(self.drive.times_s)))

    @cached_property
    def start_s(self) -> float:
        """First knot of that grid [s]."""
        return float(self.drive.times_s[0])

    @cached_property
    def n_steps(self) -> int:
        """Steps of that grid."""
        return max(math.ceil(float(self.times_s[-1] - self.start_s) / self.period_s - 1e-6), 1)

    def grid_force(self, delay_s: float) -> GridForce:
        """Return the force on the grid, acting ``delay_s`` later."""
        return GridForce.of(self.force, self._integrals, self.start_s, self.period_s, self.n_steps, delay_s)

    @cached_property
    def _integrals(self) -> tuple[PiecewisePolynomial, PiecewisePolynomial]:
        once = self.force.antiderivative()
        return once, once.antiderivative()

    def mean_force(self, times_s: FloatArray, period_s: float) -> FloatArray:
        """Return the force's mean under a triangle about each of evenly spaced times, zero at its neighbours [N].

        Sums over the force's own intervals, so that a long record costs no digits.
        """
        first = times_s[0] - period_s
        last = times_s[-1] + period_s
        own = np.clip(self.force.knots, first, last)
        edges = np.unique(np.concatenate([[first], times_s, [last], own]))
        places, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
        half = 0.5 * np.diff(edges)[:, None]
        nodes = (0.5 * (edges[:-1] + edges[1:])[:, None] + half * places).ravel()
        known = np.clip(nodes, self.force.knots[0], self.force.knots[-1])
        impulses = self.force(known) * (half * weights).ravel()
        along = (nodes - first) / period_s
        before = np.minimum(along.astype(np.intp), len(times_s))
        along -= before
        n = len(times_s) + 2
        sums = np.bincount(before, (1.0 - along) * impulses, n) + np.bincount(before + 1, along * impulses, n)
        return np.asarray(sums[1:-1] / period_s)

    @cached_property
    def reactions(self) -> FloatArray:
        """Forces on the axis of what swings on it, for 1 kg of every mode, at the knots, (n_modes, n_steps + 1) [N].

        A mode is a mass on a spring that stands on the axis: under the axis's known position x it moves by w, from
        rest at the beginning, and pushes back with omega^2 (w - x) + 2 zeta omega (w' - x').
        """
        knots = self.start_s + self.period_s * np.arange(self.n_steps + 1)
        seen = PiecewisePolynomial.from_samples(self.times_s, self.positions, "cubic")
        x = seen(np.clip(knots, self.times_s[0], self.times_s[-1])) - self.positions[0]
        found = np.zeros((len(self.modes), len(knots)))
        for j, (omega, zeta) in enumerate(self.modes):
            drag = 2.0 * zeta * omega
            # W = Im((2 zeta omega p + omega^2) / (s - p)) / Im p, under lines from knot to knot.
            pole = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
            step, held, ramped = phi_functions(np.array([pole * self.period_s]), 2)
            pushed = self.period_s * (held * x[:-1] + ramped * np.diff(x))
            w = ((drag * pole + omega**2) * recursion(step, pushed, 0.0)).imag / pole.imag
            found[j] = omega**2 * (w - x) + drag * np.gradient(w - x, self.period_s)
        return found

    @cached_property
    def noise_sd(self) -> float:
        """Noise of the positions at most, rounding counted [m]."""
        return noise_floor(self.times_s, self.positions)

    @cached_property
    def _smoothed(self) -> tuple[FloatArray, float, int]:
        """The velocity at the positions [m/s], the standard deviation of its noise, and the window's samples."""
        t, y = self.times_s, self.positions
        step = float(np.median(np.diff(t)))
        even = np.arange(t[0], t[-1] + 0.5 * step, step)
        on_grid = np.interp(even, t, y)
        rough = float(np.sqrt(np.mean(np.square(np.diff(on_grid[:: max(len(even) // 500, 1)]))))) / (
            step * max(len(even) // 500, 1)
        )
        needed = (self.noise_sd * math.sqrt(12.0) / (step * _SHARE_OF_SPEED * max(rough, 1e-300))) ** (
            2.0 / 3.0
        )
        most = max(_NARROWEST, int(_WIDEST * len(even)))
        width = int(min(max(needed, _NARROWEST), most)) | 1
        velocity = _slopes(on_grid, width) / step
        sd = self.noise_sd * math.sqrt(12.0 / width**3) / step
        return np.interp(t, even, velocity), sd, width

    @cached_property
    def speed_rms(self) -> float:
        """Of the smoothed velocity [m/s]."""
        return float(np.sqrt(np.mean(np.square(self._smoothed[0]))))

    @property
    def velocities(self) -> FloatArray:
        """Smoothed, at the positions [m/s]."""
        return self._smoothed[0]

    @cached_property
    def is_slow(self) -> BoolArray:
        """Where the axis rests or turns, so that the direction of its motion is not sure, shape (n,)."""
        velocity, sd, _ = self._smoothed
        return np.asarray(np.abs(velocity) < max(_DEVIATIONS * sd, _REST * self.speed_rms))

    @cached_property
    def is_rest(self) -> BoolArray:
        """Which positions belong to a rest, or decided where it begins and ends, shape (n,).

        The velocity is smoothed over half a window to either side. Were these positions part of a piece, it would
        begin and end where its own noise says so, and that noise would not be zero on average any more.
        """
        result = np.zeros(len(self.is_slow), dtype=bool)
        reach = self._smoothed[2] // 2 + 1
        for begin, end in runs(self.is_slow):
            if end - begin >= _MIN_SAMPLES:
                result[max(begin - reach, 0) : end + reach] = True
        return result

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The stretches of motion."""
        t = self.times_s
        usable = ~self.is_rest & (t >= self.start_s)
        usable[: self._smoothed[2] // 2 + 1] = False  # where the velocity is smoothed from one side
        borders = [0.5 * (gap.start_s + gap.end_s) for gap in self.drive.gaps]
        for gap in self.drive.gaps:
            usable &= ~((t > gap.start_s) & (t < gap.end_s))
        found = []
        for begin, end in runs(usable):
            # A gap in the force between two positions ends a piece, too.
            parts = np.flatnonzero(np.diff(np.searchsorted(borders, t[begin:end]))) + 1
            edges = [begin, *(begin + parts).tolist(), end]
            found += [self._piece(self._in_motion(i), j) for i, j in pairwise(edges)]
        return tuple(piece for piece in found if piece is not None)

    def _in_motion(self, begin: int) -> int:
        """Return where from there on the axis surely moves.

        About rest the first velocity hardly matters, and not linearly: an estimate of it would find no end.
        """
        if not self.is_slow[begin]:
            return begin
        moving = np.flatnonzero(~self.is_slow[begin:])
        return begin + (int(moving[0]) if len(moving) else len(self.is_slow)) + self._smoothed[2] // 2 + 1

    def _piece(self, begin: int, end: int) -> Piece | None:
        if end - begin < _MIN_SAMPLES:
            return None
        first = math.floor((self.times_s[begin] - self.start_s) / self.period_s + 1e-6)
        last = math.ceil((self.times_s[end - 1] - self.start_s) / self.period_s - 1e-6)
        first = max(first, 0)
        return Piece(
            first, min(max(last, first + 1), self.n_steps), slice(begin, end), float(self.velocities[begin])
        )


def require_motion(records: Sequence[AxisRecord]) -> None:
    """Raise EstimationError where an axis never moved, or never in both directions.

    Raises
    ------
    EstimationError
    """
    for record in records:
        if len(record.times_s) < 3 * _MIN_SAMPLES:
            raise EstimationError(
                f"output {record.output.name!r} has {len(record.times_s)} positions under the force; an axis needs "
                f"at least {3 * _MIN_SAMPLES}: record longer"
            )
        if math.isnan(record.noise_sd):
            raise EstimationError(
                f"output {record.output.name!r} has no 32 positions in a row without a hole, which tell its noise: "
                "expected even stamps and few missing samples. Check the stamps, or sample without losses"
            )
    travel = max(float(np.ptp(record.positions)) for record in records)
    noise = max(record.noise_sd for record in records)
    pieces = [(record, piece) for record in records for piece in record.pieces]
    if travel <= _REAL_MOVE * noise or not pieces:
        raise EstimationError(
            f"the axis never moved: its position stays within {travel:.3g} m, with noise of {noise:.2g} m; record "
            "moves forward and backward that are long against the noise, under a force that overcomes the friction"
        )
    for word, side in (("forward", 1.0), ("backward", -1.0)):
        moving = sum(
            int(np.count_nonzero(side * record.velocities[piece.samples] > _REST * record.speed_rms))
            for record, piece in pieces
        )
        if moving < _MIN_SAMPLES:
            raise EstimationError(
                f"the axis never moved {word} for long ({moving} samples): friction, constant force and viscous "
                "friction cannot be told apart; record moves in both directions, at two speeds or more"
            )


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return begin and end of every run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _slopes(values: FloatArray, width: int) -> FloatArray:
    """Return the slopes per sample of the parabolas that fit ``width`` samples about every sample, an odd number.

    At the ends they are those of the first and the last whole window.

    Notes
    -----
    Savitzky and Golay, Analytical Chemistry 36 (1964), 1627.
    """
    half = width // 2
    places = np.arange(-half, half + 1.0)
    bends = np.square(places) - np.mean(np.square(places))  # orthogonal to a line
    slopes = inner_convolution(values, -places / (places @ places))
    first, last = (2.0 * float(bends @ own) / (bends @ bends) for own in (values[:width], values[-width:]))
    before, after = slopes[0] + first * places[:half], slopes[-1] + last * places[half + 1 :]
    return np.concatenate([before, slopes, after])
