"""The quickest moves that end at rest: linear programs over the exact discrete motion of axis and beam.

The unknowns are the jerks of a move. Speed, acceleration and position follow from them by sums, every limited load
of the beam by a convolution, and what is left in a mode is a complex sum: all linear. So "is there a move in N
ticks" is a linear program, and the smallest N is found by halving. Solved for the least swing over beams whose
modes lie elsewhere, it is the most robust move of its length (T. Singh, P. Singla, U. Konda (2010), Polynomial
chaos based design of robust input shapers, Journal of Dynamic Systems, Measurement, and Control 132, 051010, doi
10.1115/1.4001793, with draws in place of their expansion).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, hstack, vstack

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.design.limits import ExcitationLimits
from beam_ident.errors import ExcitationError
from beam_ident.excitation.sampled import Quantity
from beam_ident.shaping.command import Move, exactly, hold_factor
from beam_ident.shaping.known_beam import KnownBeam
from beam_ident.shaping.residual import scatter_phasors

TIME_OPTIMAL = "time-optimal"
_MOST_KNOTS = 500
"""Longer moves hold their acceleration for several ticks: a program grows with the square of its unknowns."""
_DIRECTIONS = 8
"""A circle of amplitudes is a polygon of twice as many sides: 1.2 % wide of it."""
_SPREAD = 1.5
"""How far aside the beams lie for which a move is made robust, in standard deviations of frequency and damping."""
_ROUNDS = 6
_SLACK = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class MoveTask:
    """A way to go, and what must be kept.

    Parameters
    ----------
    start, end : float -- from home [m]
    limits : ExcitationLimits
        Of the axis, all finite (travel as seen from home), and of the beam.
    quantity : {"acceleration", "velocity", "position"} -- in which the device is commanded
    """

    start: float
    end: float
    limits: ExcitationLimits
    quantity: Quantity = "acceleration"

    def __post_init__(self) -> None:
        axis = self.limits.axis
        for name in ("start", "end"):
            value = getattr(self, name)
            if not (math.isfinite(value) and abs(value) <= axis.travel * (1.0 + 1e-9)):
                raise ExcitationError(
                    f"the move {name}s at {value!r} m: the travel ends at +-{axis.travel:g} m; give places between"
                )
        if abs(self.distance) < 1e-9:
            raise ExcitationError(
                f"the move goes from {self.start:g} to {self.end:g} m, nowhere; give an end that is not the start"
            )
        for name in ("speed", "acceleration", "jerk"):
            if not math.isfinite(getattr(axis, name)):
                raise ExcitationError(f"the axis has no largest {name}; expected a finite one: set it")

    @property
    def distance(self) -> float:
        """From start to end [m]."""
        return self.end - self.start

    @property
    def period_s(self) -> float:
        """Tick of the device [s]."""
        return self.limits.period_s

    def objection(self, move: Move) -> str:
        """Return which limit a move leaves and by how much, or nothing.

        The beam rings on after the end of the command: a period of its slowest mode is looked at, too.
        """
        after = round(self._slowest_s / move.period_s)
        shares = np.max(np.abs(self.limits.over_time(np.append(move.accelerations, np.zeros(after)))), axis=1)
        places = self.start + move.positions
        named = dict(zip(self.limits.names, shares.tolist(), strict=True))
        named["travel"] = float(np.max(np.abs(places))) / self.limits.axis.travel
        name, share = max(named.items(), key=lambda item: item[1])
        return f"{name} at {100.0 * share:.0f} % of its limit" if share > 1.0 + 1e-5 else ""

    @property
    def _slowest_s(self) -> float:
        every = [own.model.natural_frequencies for own in self.limits.responses]
        return 2.0 * math.pi / float(np.min(np.concatenate(every))) if every else 0.0


def time_optimal_move(
    task: MoveTask,
    beam: KnownBeam,
    n_ticks: int,
    *,
    disturbance: ComplexArray | None = None,
    aim: float | None = None,
) -> Move | None:
    """Return a move of a length that leaves the least swing, or None where the limits leave none.

    Parameters
    ----------
    task : MoveTask
    beam : KnownBeam
    n_ticks : int
    disturbance : ndarray of complex, shape (n_modes,), optional
        End phasors of what acts beside the command, which the command is to cancel [m/s].
    aim : float, optional
        Only ask whether a move exists after which no mode of the nominal beam swings by more at any output [m]: a
        necessary condition of keeping it, by which lengths are bounded from below.
    """
    program = _Program(task, n_ticks)
    if aim is None:
        program.minimise(*_robust(task, beam, disturbance), _of_acceleration(beam, n_ticks * task.period_s))
    else:
        program.bound(*_nominal(beam), aim)
    return program.solve()


def shortest(find: Callable[[int], Move | None], low: int, high: int) -> tuple[int, Move | None]:
    """Return the smallest length from low to high at which a move is found, and the move.

    Parameters
    ----------
    find : callable -- called with a length in ticks; what it finds at one length, it finds at all greater ones
    low, high : int -- in ticks; at ``high`` there is one
    """
    best: Move | None = None
    while low < high:
        middle = (low + high) // 2
        found = find(middle)
        if found is None:
            low = middle + 1
        else:
            high, best = middle, found
    return high, best


def lower_bound(task: MoveTask, beam: KnownBeam, aim: float, longest: int) -> int:
    """Return the fewest ticks in which a nominal beam could be moved within the limits and the aim.

    Parameters
    ----------
    longest : int -- ticks of a move that does it
    """
    least = max(2, math.floor(abs(task.distance) / task.limits.axis.speed / task.period_s))
    return shortest(lambda n: time_optimal_move(task, beam, n, aim=aim), min(least, longest), longest)[0]


def _nominal(beam: KnownBeam) -> tuple[ComplexArray, FloatArray]:
    """Return poles, and the swing of every output per phasor, shape (n_poles, n_outputs)."""
    poles = beam.model.poles
    return poles, np.abs(beam.model.residues.T) / poles.imag[:, None]


def _robust(
    task: MoveTask, beam: KnownBeam, disturbance: ComplexArray | None
) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """Return poles of beams at the middle and aside, the worst output's swing per phasor, and what disturbs them."""
    poles, swings = _nominal(beam)
    omegas = np.abs(poles)
    errors = np.stack([1j * omegas * np.maximum(beam.frequency_sd, 1e-6), -omegas * beam.damping_sd])
    every = [poles, *(poles + sign * _SPREAD * error for error in errors for sign in (-1.0, 1.0))]
    beside = np.zeros(len(poles)) if disturbance is None else disturbance
    repeated = np.tile(np.max(swings, axis=1), len(every))[:, None]
    return np.concatenate(every), repeated, np.tile(beside, len(every)).astype(np.complex128)


def _of_acceleration(beam: KnownBeam, duration_s: float) -> float:
    """Return the swing that each acceleration more is believed to add, by the hub's scatter [m per m/s^2]."""
    _, swings = _nominal(beam)
    per_scatter = float(np.max(scatter_phasors(beam, duration_s) @ swings))
    return math.sqrt(2.0) * per_scatter * beam.axis.scatter_slope


class _Program:
    """Variables: accelerations of all knots, velocities, positions after each, the swing that is left, the peak."""

    def __init__(self, task: MoveTask, n_ticks: int) -> None:
        self._task = task
        self._hold = -(-n_ticks // _MOST_KNOTS)
        self._knots = -(-n_ticks // self._hold)
        self._n_ticks = n_ticks
        # Knot k holds for its ticks; the last one may be shorter.
        edges = np.minimum(np.arange(self._knots + 1) * self._hold, n_ticks)
        self._ticks = np.diff(edges)
        self._rows: list[csr_array] = []
        self._most: list[FloatArray] = []
        self._cost = np.zeros(3 * self._knots + 2)
        self._most_swing: float | None = None
        self._slowest = -_SLACK

    def bound(self, poles: ComplexArray, swings: FloatArray, aim: float) -> None:
        """Keep every mode's swing at every output below an aim."""
        scale = self._swings(poles, np.max(swings, axis=1)[:, None] / aim, np.zeros_like(poles))
        self._most_swing = 1.0 / scale

    def minimise(
        self, poles: ComplexArray, swings: FloatArray, disturbances: ComplexArray, of_acceleration: float
    ) -> None:
        """Ask for the least of the largest swing, with what the largest acceleration adds to it."""
        most = float(np.max(swings))
        scale = self._swings(poles, swings / most, disturbances)
        self._cost[-2] = 1.0
        self._cost[-1] = of_acceleration * self._unit / (most * scale)
        self._slowest = 0.0  # every turn lets friction jerk the hub

    def _swings(self, poles: ComplexArray, swings: FloatArray, disturbances: ComplexArray) -> float:
        """Hold the swing of every pole below the variable of the swing, which counts in what is returned [m/s]."""
        task, k = self._task, self._knots
        step = np.exp(np.outer(poles, np.full(1, task.period_s)))
        turning = step ** (self._n_ticks - 1 - np.arange(self._n_ticks))[None, :]
        powers = turning * hold_factor(poles, task.period_s, task.quantity)[:, None]
        starts = np.concatenate([[0], np.cumsum(self._ticks)[:-1]])
        per_knot = np.add.reduceat(powers, starts, axis=1) * swings
        turns = np.exp(1j * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
        rows = np.real(per_knot[:, None, :] * turns[:, None]).reshape(-1, k)
        scale = abs(task.distance) / (self._n_ticks * task.period_s)
        rows = np.concatenate([rows, -rows]) / scale
        # The program moves forwards; a disturbance is that of the move as it is.
        sign = math.copysign(1.0, task.distance)
        beside = np.real((sign * disturbances[:, None] * swings) * turns).ravel() / scale
        blank = np.zeros((len(rows), 2 * k))
        of_swing = np.tile([-1.0, 0.0], (len(rows), 1))
        self._rows.append(csr_array(np.hstack([rows * self._unit, blank, of_swing])))
        self._most.append(np.concatenate([-beside, beside]))
        return scale

    @property
    def _unit(self) -> float:
        """The acceleration in which the program counts [m/s^2]."""
        return self._task.limits.axis.acceleration

    def solve(self) -> Move | None:
        """Return the move, with the beam's loads held where they would leave their limits."""
        for _ in range(_ROUNDS):
            move = self._solve_once()
            if move is None or not self._add_loads(move):
                return move
        return None

    def _solve_once(self) -> Move | None:
        task, k, unit = self._task, self._knots, self._unit
        axis, period = task.limits.axis, task.period_s
        spans = self._ticks * period
        ones, below = eye_array(k), eye_array(k, k=-1)
        blank, none = csr_array((k, k)), csr_array((k, 2))
        way = abs(task.distance)
        # v_k - v_(k-1) = h a_k, in units of the speed limit; x_k - x_(k-1) = h v_(k-1) + h^2 a_k / 2, in ways.
        v_unit = axis.speed
        of_speed = hstack([csr_array(np.diag(-spans * unit / v_unit)), ones - below, blank, none])
        of_place = hstack(
            [
                csr_array(np.diag(-0.5 * spans**2 * unit / way)),
                csr_array(-np.diag(spans * v_unit / way) @ below.toarray()),
                ones - below,
                none,
            ]
        )
        equal = vstack([of_speed, of_place]).tocsr()
        jerk = np.full(
            k, axis.jerk * period / unit
        )  # whatever holds longer also steps from one tick to the next
        of_jerk = hstack([ones - below, csr_array((k, 2 * k + 2))]).tocsr()
        last = csr_array((np.ones(1), ([0], [k - 1])), shape=(1, 3 * k + 2))
        peak = hstack([csr_array((k, 3 * k + 1)), csr_array(np.ones((k, 1)))])
        up, down = (hstack([sign * ones, csr_array((k, 2 * k + 2))]) - peak for sign in (1.0, -1.0))
        rows = vstack([*self._rows, of_jerk, -of_jerk, last, -last, up, down]).tocsr()
        most = np.concatenate([*self._most, jerk, jerk, [jerk[-1], jerk[-1]], np.zeros(2 * k)])
        room = np.sort(math.copysign(1.0, task.distance) * np.array([-1.0, 1.0]) * axis.travel / way)
        offset = math.copysign(1.0, task.distance) * task.start / way
        speeds = [(self._slowest, _SLACK)] * (k - 1) + [(0.0, 0.0)]
        places = [(room[0] - offset - 1e-9, room[1] - offset + 1e-9)] * (k - 1) + [(1.0, 1.0)]
        found = linprog(
            self._cost,
            A_ub=rows,
            b_ub=most,
            A_eq=equal,
            b_eq=np.zeros(2 * k),
            bounds=[(-_SLACK, _SLACK)] * k + speeds + places + [(0.0, self._most_swing), (0.0, 1.0)],
            method="highs",
        )
        if found.status != 0:
            return None
        sign = math.copysign(1.0, task.distance)
        accelerations = np.repeat(sign * unit * found.x[:k], self._ticks)
        # Without the solver's tolerance in end velocity and distance.
        return exactly(Move(TIME_OPTIMAL, period, accelerations, task.quantity), task.distance)

    def _add_loads(self, move: Move) -> bool:
        """Add the rows of what a move would load too much; return whether there are any."""
        task, sign = self._task, math.copysign(1.0, self._task.distance)
        if not task.limits.responses or not task.objection(move):
            return False
        names = task.limits.names
        loads = [
            row for row, name in enumerate(names) if name not in ("travel", "speed", "acceleration", "jerk")
        ]
        after = round(task._slowest_s / task.period_s)
        pulse = np.zeros(self._n_ticks + after)
        pulse[0] = 1.0
        answers = task.limits.over_time(pulse)[loads]
        shares = task.limits.over_time(np.append(move.accelerations, np.zeros(after)))[loads]
        starts = np.concatenate([[0], np.cumsum(self._ticks)[:-1]])
        added = False
        for answer, share in zip(answers, shares, strict=True):
            if np.max(np.abs(share)) <= 1.0 + 1e-5:
                continue
            added = True
            at = np.flatnonzero(np.abs(share) > 0.9)
            at = at[:: max(1, len(at) // 60)]
            matrix = toeplitz(answer, np.zeros(self._n_ticks))[at]
            per_knot = np.add.reduceat(matrix, starts, axis=1) * self._unit * sign
            blank = np.zeros((len(at), 2 * self._knots + 2))
            rows = csr_array(np.hstack([per_knot, blank]))
            self._rows += [rows, -rows]
            self._most += [np.full(len(at), 0.995)] * 2
        return added
