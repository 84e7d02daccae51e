"""Poles elsewhere: what the likelihood of one denominator gains where some of its poles stand in other places.

Local optima of the output error differ by where a pole stands: one explains little, while another is missing.  The
responses of single poles are exact, and any denominator is a weighted sum of them.  So a pool of poles answers all
inputs once, a QR decomposition keeps what these responses and the output have in common, and in its triangle the
likelihood of any poles of the pool, all linear parameters solved anew, costs a least-squares problem of a few
hundred rows.  From a point of the likelihood every pole, pair, and couple of real poles is exchanged for those of the
pool which explain most without it (the exchange of Fedorov (1972), as matching pursuit with replacement).

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg import qr

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.rational_response import PartialFractions, full_roots, poles_keep_apart
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.transfer_function_estimation.record_share import RecordShare

_MOST_SAMPLES = 8000  # spread over longer records: a start needs no more
_SLOWEST = 0.1  # of one period in the record: a slower pole is an integrator for this record
_DAMPINGS = (
    0.03,
    0.2,
    0.7,
)  # of pairs of the grid, light to heavy; lighter ones than these the starts have seen
_BEYOND = 1000.0  # of the Nyquist frequency: there a pole hardly shows
_ALIKE = 0.02  # of a pole's decay, or of what the record resolves: nearer to another one it is no other start

_TRIALS = 3  # of the best exchanges, until one of them leads to a lower cost
_VISIBLE = 1e-3  # of the log-likelihood: what a better optimum gains at least

Poles = tuple[int, ...]  # places in the pool of poles with imaginary part >= 0
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Place:
    """Where an estimation of one denominator ended.

    Attributes
    ----------
    poles : ndarray, complex -- with imaginary part >= 0 [rad/s]
    delays : ndarray -- the free ones [s]
    cost : float
    """

    poles: ComplexArray
    delays: FloatArray
    cost: float = math.inf

    @staticmethod
    def of(state: OutputErrorState) -> Place:
        """Return where a state lies; of a point that is not allowed nothing but an infinite cost."""
        if not state.uppers:
            return Place(np.empty(0, dtype=np.complex128), np.empty(0))
        (upper,) = state.uppers
        return Place(upper * state.scale, state.theta[len(full_roots(upper)) :], state.cost)

    @property
    def scale(self) -> float:
        """Unit of frequency in which the coefficients stay near one: the geometric mean of the poles [rad/s]."""
        return float(np.exp(np.mean(np.log(np.abs(full_roots(self.poles))))))

    @property
    def theta(self) -> FloatArray:
        """Coefficients of the denominator after the first, in that unit, then the delays."""
        return np.concatenate([np.real(np.poly(full_roots(self.poles) / self.scale))[1:], self.delays])


def exchanged(
    problems: Sequence[OutputErrorProblem],
    found: Found,
    place_of: Callable[[Found], Place],
    refined: Callable[[Place, float], Found],
    pool: Sequence[ComplexArray],
) -> Found:
    """Return an optimum, or a better one to which exchanges of its poles lead, one after the other.

    Parameters
    ----------
    problems : sequence of OutputErrorProblem -- of every output, which share one denominator
    found : Found -- an optimum
    place_of : callable -- tells where an optimum lies
    refined : callable -- returns the optimum near a place; a search may end where it does not reach the given cost
    pool : sequence of ndarray -- poles that are worth a try beside those of a grid [rad/s]
    """
    while True:
        place = place_of(found)
        exchange = PoleExchange(problems, place.delays, [place.poles, *pool])
        for _, poles in exchange.exchanges(exchange.nearest(place.poles))[:_TRIALS]:
            other = refined(Place(exchange.pool[list(poles)], place.delays), place.cost)
            if place_of(other).cost < place.cost - _VISIBLE:
                found = other
                break
        else:
            return found


def completed(
    problem: OutputErrorProblem, inside: Sequence[Place], pool: Sequence[ComplexArray] = ()
) -> list[Place]:
    """Return where structures inside that of a problem ended, with the poles that they lack."""
    places = []
    for own in inside:
        delays = own.delays
        if len(delays) < len(problem.free_delays):
            delays = np.array([problem.paths[k].delay.mean for k in problem.free_delays])
        exchange = PoleExchange([problem], delays, [own.poles, *pool])
        poles = exchange.completed(exchange.nearest(own.poles))[1]
        if poles:
            places.append(Place(exchange.pool[list(poles)], delays))
    return places


def _grid(length: float, nyquist: float) -> ComplexArray:
    """Return poles [rad/s] all over what a record can show, and one that lies so far out that it does not show."""
    slowest = _SLOWEST * 2.0 * np.pi / length
    omegas = np.geomspace(slowest, nyquist, math.ceil(math.log2(nyquist / slowest)) + 1)
    angles = [complex(-zeta, math.sqrt(1.0 - zeta**2)) for zeta in _DAMPINGS]
    return np.concatenate([-omegas, [-_BEYOND * nyquist], np.outer(omegas, angles).ravel()])


class PoleExchange:
    """The likelihood of poles of a pool, for outputs that share one denominator.

    Parameters
    ----------
    problems : sequence of OutputErrorProblem -- one for each output, of one denominator
    delays : ndarray -- the free delays [s]
    poles : sequence of ndarray, complex
        Candidates with imaginary part >= 0 [rad/s], beside those of a grid; the first stay as they are.
    """

    def __init__(
        self, problems: Sequence[OutputErrorProblem], delays: FloatArray, poles: Sequence[ComplexArray]
    ) -> None:
        longest = max(problem.length for problem in problems)
        candidates = np.concatenate([*poles, _grid(longest, max(own.nyquist for own in problems))])
        self.pool = _apart(candidates, len(poles[0]), 2.0 * np.pi / longest)
        self.n_poles = problems[0].n_a
        self.is_pair = self.pool.imag > 0.0
        self._outputs = [_Output(problem, delays, self.pool) for problem in problems]

    def cost(self, chosen: Poles) -> float:
        """Return the negative log-likelihood of poles, on the samples that were taken."""
        upper = self.pool[list(chosen)]
        if not len(upper) or not poles_keep_apart(full_roots(upper)):
            return math.inf
        return sum(output.cost(chosen, upper) for output in self._outputs)

    def nearest(self, poles: ComplexArray) -> Poles:
        """Return the places in the pool of poles with imaginary part >= 0 [rad/s], the nearest ones."""
        return tuple(int(np.argmin(np.abs(self.pool - pole))) for pole in poles)

    def completed(self, kept: Poles, without: Poles = ()) -> tuple[float, Poles]:
        """Return the cost and all poles, once those of the pool that explain most have joined some that are kept."""
        cost, room = math.inf, self.n_poles - sum(1 + int(self.is_pair[k]) for k in kept)
        while room:
            others = [
                k for k in range(len(self.pool)) if k not in (*kept, *without) and self.is_pair[k] < room
            ]
            cost, kept = min(((self.cost((*kept, k)), (*kept, k)) for k in others), default=(math.inf, ()))
            if not math.isfinite(cost):
                return cost, kept
            room = self.n_poles - sum(1 + int(self.is_pair[k]) for k in kept)
        return cost, kept

    def exchanges(self, chosen: Poles) -> list[tuple[float, Poles]]:
        """Return cost and poles of the best exchange for every pole and couple of real poles, the best first."""
        reals = [k for k in chosen if not self.is_pair[k]]
        left_out = [(k,) for k in chosen] + list(itertools.combinations(reals, 2))
        found = {}
        for own in left_out:
            kept = tuple(k for k in chosen if k not in own)
            cost, poles = self.completed(kept, own)
            if math.isfinite(cost):
                found[tuple(sorted(poles))] = cost
        return sorted((cost, poles) for poles, cost in found.items())


def _apart(poles: ComplexArray, n_first: int, resolution: float) -> ComplexArray:
    """Return poles without those that a record can hardly tell from others before them; the first stay."""
    kept = [complex(pole) for pole in poles[:n_first]]
    for pole in poles[n_first:]:
        if all(abs(pole - other) > _ALIKE * max(-pole.real, resolution) for other in kept):
            kept.append(complex(pole))
    return np.array(kept)


class _Output:
    """The triangles of all records of one output."""

    def __init__(self, problem: OutputErrorProblem, delays: FloatArray, pool: ComplexArray) -> None:
        self.problem, self.n_samples = problem, len(problem.values)
        step = max(1, self.n_samples // _MOST_SAMPLES)
        self.floor = problem.floor / step
        every = problem.delays(np.concatenate([np.zeros(problem.n_a), delays]))
        levels = np.ones(len(problem.rows)) if problem.noise is None else problem.noise.levels
        self.records = [
            _Record(problem, own, step, every, pool, float(level))
            for own, level in zip(problem.experiments, levels, strict=True)
        ]

    def cost(self, chosen: Poles, upper: ComplexArray) -> float:
        """Return half the log of the squares left, times the samples."""
        size = float(np.exp(np.mean(np.log(np.abs(upper)))))
        fractions = PartialFractions(upper / size, full_roots(upper) / size)
        n = len(fractions.full)
        weights = [fractions.single(np.arange(min(path.n_zeros, n - 1) + 1)).T for path in self.problem.paths]
        n_own = [record.shape(chosen) for record in self.records]
        parts, targets, first = [], [], 0
        for record, width in zip(self.records, n_own, strict=True):
            own, shared, target = record.columns(chosen, weights)
            placed = np.zeros((len(target), sum(n_own)))
            placed[:, first : first + width] = own
            first += width
            parts.append(np.concatenate([placed, shared], axis=1))
            targets.append(target)
        solution = LinearSolution.of(np.concatenate(parts))
        left = solution.left_of(np.concatenate(targets))
        return 0.5 * self.n_samples * math.log(float(left @ left) + self.floor)


class _Record:
    """The triangle of one record: nuisances, responses of the pool, the input itself, and the output."""

    def __init__(
        self,
        problem: OutputErrorProblem,
        share: RecordShare,
        step: int,
        delays: FloatArray,
        pool: ComplexArray,
        level: float,
    ) -> None:
        times, terms = share.times[::step], problem.nuisances
        self.n_pool, self.has_free = len(pool), terms.has_free_response
        drifts = [column[:, None] for column in share.drifts(terms, times)]
        free = []
        if self.has_free:
            # A free numerator spans what the poles' own free motions do, exposures included.
            values = np.exp(np.outer(times - share.times[0], pool))
            free = [values.real, -values.imag]
        forced, direct = [], []
        for path, delay in zip(share.paths, delays, strict=True):
            answered, itself = path.pole_responses(
                pool, times, share.exposure, delay, path.n_zeros - problem.n_a + 1
            )
            forced += [answered.real.T, -answered.imag.T]
            direct.append(itself)
        groups = [*drifts, *free, *forced, *direct, share.values[::step, None]]
        everything = np.concatenate(groups, axis=1) / level
        scales = np.linalg.norm(everything[:, :-1], axis=0)
        everything[:, :-1] /= np.where(scales > 0.0, scales, 1.0)
        triangle = qr(everything, mode="r", check_finite=False)[0][: everything.shape[1]]
        self.scales = scales
        self.triangle = triangle
        self.n_drifts, self.n_direct = len(drifts), [own.shape[1] for own in direct]

    def shape(self, chosen: Poles) -> int:
        """Return the number of columns that are this record's alone."""
        return self.n_drifts + 2 * len(chosen) * self.has_free

    def columns(self, chosen: Poles, weights: list[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return this record's own columns, those that records share, and the output, all in the triangle's rows."""
        own = list(range(self.n_drifts))
        first = self.n_drifts
        both = np.concatenate([np.array(chosen), np.array(chosen) + self.n_pool])
        if self.has_free:
            own += (first + both).tolist()
            first += 2 * self.n_pool
        shared = []
        for weight in weights:
            places = first + both
            # (T.2): columns of s^i / A from those of its poles; the scales of the columns come back.
            shared.append(self.triangle[:, places] @ (self.scales[places, None] * weight))
            first += 2 * self.n_pool
        shared.append(self.triangle[:, first:-1])
        return self.triangle[:, own], np.concatenate(shared, axis=1), self.triangle[:, -1]
