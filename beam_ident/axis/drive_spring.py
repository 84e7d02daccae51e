"""Whether the drive of an axis is compliant: where to begin, and what is known of a spring that is not seen.

An axis whose drive pulls the hub by a spring moves as a stiff one and, beside that, rings at the resonance of drive
and hub. A stiff spring would have to carry T, the hub's share of the force and its friction, and

    x_drive = stiff + W T / m_d,    x_hub = stiff - W T / m_h,    W = 1 / (s^2 + 2 zeta omega s + omega^2)

Of what a stiff axis leaves, this is a column without a free factor, for every resonance that is tried. Where it
explains most, the estimation begins. Where it would leave far more than there is, no spring can be: the softest of
those that a record does not exclude is what it says of a spring that it does not show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.axis.axis_output_error import AxisOutputError, AxisPoint, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord, Piece
from beam_ident.numerics.pole_response import recursion

_SLOWEST = 2.0  # periods in the longest piece, of resonances that are tried
_FASTEST = 20.0  # rad from knot to knot
_RATIO = 1.1  # from resonance to resonance at most
_DAMPING = (0.03, 0.1, 0.4)  # damping ratios that are tried
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)  # of the mass that the drive may have, where it is not known
_MIN_PART = 0.2  # of what a spring should ring with
_EXCLUDED = 0.5 * 1.645**2  # lost log-likelihood: a normal error costs as much in one of twenty, on one side


@dataclass(frozen=True)
class SpringLook:
    """What a search for a spring came to.

    Attributes
    ----------
    starts : tuple of MassAndFriction
        For every damping ratio that is tried, the axis with the spring that explains most of what is left.
    gain : float -- by how much the best of them raises the log-likelihood, 0 where there is none
    stiffer_than : float
        The softest spring that the record does not exclude with 95 % [N/m], whatever its damping; infinite where all
        that were tried are excluded.
    """

    starts: tuple[MassAndFriction, ...]
    gain: float
    stiffer_than: float


class SpringSearch:
    """What a stiff axis leaves of its positions, and what springs would explain of it.

    Parameters
    ----------
    problem : AxisOutputError -- of the stiff axis
    point : AxisPoint -- its optimum
    drive_mass : float or None -- where it is known [kg]
    inflation : float -- by how much the colour of what is left widens intervals
    """

    def __init__(
        self, problem: AxisOutputError, point: AxisPoint, drive_mass: float | None, inflation: float
    ) -> None:
        self._problem, self._parameters = problem, problem.parameters(point.theta)
        self._shares = _SHARES if drive_mass is None else (drive_mass / self._parameters.mass,)
        self._is_of_drive = problem.pieces[0][0].is_of_drive
        self._inflation = inflation
        shared, own = problem.derivatives(point)
        # What every piece explains by itself, and then what the parameters of all do, is taken away.
        self._own = [_basis(np.column_stack([rows, np.ones(len(rows))])) for rows in own]
        self._shared = _basis(self._without_own(shared))
        self._left = self._without_shared(list(point.residuals))
        self._forces = [self._forces_in(record, piece) for record, piece in problem.pieces]

    def look(self) -> SpringLook:
        """Try springs of all resonances, and those masses of the drive that there may be."""
        mass, power = self._parameters.mass, float(self._left @ self._left)
        most = power * math.exp(2.0 * _EXCLUDED * self._inflation**2 / len(self._left))
        least, softest, starts = power, math.inf, []
        for zeta in _DAMPING:
            own_least, start = power, None
            # Resonances closer than their damping ratio ring alike; further off, nothing of a ringing is seen.
            ratio = min(_RATIO, 1.0 + zeta)
            for omega in map(float, self._resonances(ratio)):
                pushed, carried = self._rung(omega, zeta)
                for share in self._shares:
                    reduced = share * (1.0 - share) * mass
                    column = self._column(share, pushed, carried) / reduced
                    size, along = float(column @ column), float(column @ self._left)
                    if power - 2.0 * along + size < most:
                        # The one before, a step of the search softer, was still excluded.
                        softest = min(softest, reduced * (omega / ratio) ** 2)
                    # Between two resonances that are tried, less of the column is of use than all of it.
                    part = min(max(along / size, _MIN_PART), 1.0) if size > 0.0 else 1.0
                    remains = power - part * (2.0 * along - part * size)
                    if remains < own_least:
                        own_least = remains
                        start = replace(
                            self._parameters,
                            resonance=omega,
                            resonance_damping=zeta,
                            drive_mass=share * mass,
                        )
            starts += [] if start is None else [start]
            least = min(least, own_least)
        return SpringLook(tuple(starts), 0.5 * len(self._left) * math.log(power / least), softest)

    def _column(self, share: float, pushed: FloatArray, carried: FloatArray) -> FloatArray:
        """Return by how much a spring moves the encoder for 1 m/N: the other side's share of T, away from it."""
        side = 1.0 - share if self._is_of_drive else -share
        return side * ((1.0 - share) * pushed + carried)

    def _resonances(self, ratio: float) -> FloatArray:
        period = max(record.period_s for record, _ in self._problem.pieces)
        longest = max(piece.last - piece.first for _, piece in self._problem.pieces)
        slowest = 2.0 * math.pi * _SLOWEST / longest
        n = max(round(math.log(max(_FASTEST / slowest, ratio)) / math.log(ratio)), 1)
        return np.asarray(np.geomspace(slowest, _FASTEST, n + 1) / period)

    def _rung(self, omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
        """Return what W makes of the force that accelerates and of friction, at the stamps."""
        responses = []
        for (record, piece), forces in zip(self._problem.pieces, self._forces, strict=True):
            # W = Im(1 / (s - p)) / Im p under forces that are held, from where the first of them has bent the spring.
            # What moves the encoder has acted before: a line to the next force would carry the noise of the position
            # that this force answers.
            pole = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
            step = np.exp(pole * record.period_s)
            gain = (step - 1.0) / pole
            states = (recursion(np.array([step]), gain * row, -row[0] / pole)[1:] for row in forces)
            rows = [state.imag / pole.imag for state in states]
            knots, times = _knots(record, piece), record.times_s[piece.samples]
            responses.append([np.interp(times, knots, row) for row in rows])
        pushed, carried = ([pair[i] for pair in responses] for i in (0, 1))
        return self._without_shared(pushed), self._without_shared(carried)

    def _without_own(self, columns: list[FloatArray]) -> FloatArray:
        """Return columns of all pieces without what every piece explains by itself."""
        pairs = zip(columns, self._own, strict=True)
        return np.concatenate([column - basis @ (basis.T @ column) for column, basis in pairs])

    def _without_shared(self, columns: list[FloatArray]) -> FloatArray:
        whole = self._without_own(columns)
        return np.asarray(whole - self._shared @ (self._shared.T @ whole))

    def _forces_in(self, record: AxisRecord, piece: Piece) -> FloatArray:
        """Return the force that accelerates, and the one that friction takes, before the knots of a piece [N]."""
        velocity = np.interp(_knots(record, piece), record.times_s, record.velocities)
        guide = self._parameters.guide()
        forward = guide.viscous(1) * velocity + guide.resistance(1)
        backward = guide.viscous(-1) * velocity + guide.resistance(-1)
        carried = np.where(velocity >= 0.0, forward, backward)
        force = self._problem.force_on(record, self._parameters)
        mean = (force.at_start + 0.5 * force.slope * force.period_s)[np.maximum(_steps(piece) - 1, 0)]
        return np.array([mean - carried, carried])


def _knots(record: AxisRecord, piece: Piece) -> FloatArray:
    return np.asarray(record.start_s + record.period_s * _steps(piece))


def _steps(piece: Piece) -> IndexArray:
    return np.arange(piece.first, piece.last + 1)


def _basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of columns; what is nothing stays nothing."""
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])[0])
