"""Where the outputs' clock may stand: a search over latency and clock rate that no cycle traps.

The likelihood of latency and clock rate has a crest for every half cycle of the fastest
mode, and an iteration that starts on a wrong one stays there.  Here every mode is
compressed, in every stretch of the record, to the two amplitudes with which its column and
the derivative of that by time appear in the data: a phasor, whose phase is the
shift of the clock at that time, ``tan(omega delta) = omega b / a``, up to half cycles.
A line ``delta(t) = latency + rate (t - m)`` must explain them all with one real residue for
each mode and output, and how well it does costs next to nothing to compute, so that
the whole plane of latencies and rates is looked at.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.own_clocks import OwnClock
from beam_ident.data.prior import Prior
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal_estimation.variable_projection import designs
from beam_ident.noise.autoregression import autoregression, score_covariance
from beam_ident.noise.outliers import outliers
from beam_ident.noise.scores import ScoreTest, Whiteness
from beam_ident.numerics.linear_least_squares import LinearSolution

_MAX_RATE = 4e-3  # NTSC's 1000/1001 is 1e-3; quartz is far below
_SEARCHED_SD = 5.0  # standard deviations of a finite prior
_STRETCHES = 16
_STEPS_PER_CYCLE = 10
_MOST_PLACES = 400  # to either side, of latency and of rate each: 40 cycles of the fastest mode
_RIDGE = 1e-4  # of a whole column's power: a stretch with less says nothing
_OWN_CLOCK_LEVEL = 1e-3  # how often some output without a delay, or a rate, of its own is taken to have one
_DEPENDENT = 1e-9  # of the largest information: delays that the common clock takes
_MAX_OWN_DELAY_S = 0.05
_MAX_STEPS = 60  # to either side
_APART = 4.0  # standard deviations by which outputs contradict a clock in common
_CROWDED = 0.15  # cycles of the fastest mode: places closer than this lead to the same crest


@dataclass(frozen=True)
class ClockPlace:
    """A clock, and the gain in log-likelihood over the present one that its phasors promise."""

    clock: ClockState
    gain: float


def clock_places(
    regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior, n_places: int
) -> list[ClockPlace]:
    """Return the most promising clocks for the modes of a fit, best first.

    Parameters
    ----------
    regression : ModalRegression -- thinned data will do
    fit : ModalFit -- with poles about right, its clock on any crest
    latency, clock_rate : Prior -- what is known; the search stays within it
    n_places : int -- how many crests to return
    """
    if not latency.is_free or not len(fit.omegas):
        return []
    phasors = _phasors(regression, fit)
    fastest = float(fit.omegas[-1])
    # The rate acts by the time since the middle: half a record away a step of 2/duration moves by one step.
    step = 2.0 * np.pi / fastest / _STEPS_PER_CYCLE
    latency_reach = min(regression.max_latency_s, _MOST_PLACES * step)
    rate_step = 2.0 * step / regression.duration_s
    rate_reach = min(_MAX_RATE, _MOST_PLACES * rate_step)
    latencies = _axis(fit.clock.latency, latency, latency_reach, step)
    rates = _axis(fit.clock.rate, clock_rate, rate_reach, rate_step)
    shifts, drifts = (grid.ravel() for grid in np.meshgrid(latencies, rates, indexing="ij"))
    gains = np.zeros(len(shifts))
    present = 0.0
    for phasor in phasors:
        # (I.20) over the whole plane, less what the priors charge.
        gains += phasor.explained(shifts - fit.clock.latency, drifts - fit.clock.rate)
        present += float(phasor.explained(np.zeros(1), np.zeros(1))[0])
    gains -= _penalty(shifts, latency) + _penalty(drifts, clock_rate)
    present -= float(_penalty(fit.clock.latency, latency) + _penalty(fit.clock.rate, clock_rate))
    places: list[ClockPlace] = []
    open_ones = np.ones(len(gains), dtype=bool)
    while len(places) < n_places and np.any(open_ones):
        best = int(np.argmax(np.where(open_ones, gains, -np.inf)))
        places.append(
            ClockPlace(ClockState(float(shifts[best]), float(drifts[best])), float(gains[best]) - present)
        )
        # The largest difference of the two clocks anywhere in the record.
        apart = np.abs(shifts - shifts[best]) + 0.5 * regression.duration_s * np.abs(drifts - drifts[best])
        open_ones &= apart > _CROWDED * 2.0 * np.pi / fastest
    return places


def _axis(present: float, prior: Prior, limit: float, step: float) -> FloatArray:
    """Return the values of one clock parameter to look at."""
    if not prior.is_free:
        return np.array([present])
    reach = min(limit, _SEARCHED_SD * prior.sd)
    n = math.ceil(reach / step)
    values = np.append(prior.mean + step * np.arange(-n, n + 1), present)
    return np.asarray(values[np.abs(values) <= max(limit, abs(present))])


def _penalty(values: FloatArray | float, prior: Prior) -> FloatArray:
    if not prior.is_free or not math.isfinite(prior.sd):
        return np.zeros_like(values)
    return np.asarray(0.5 * ((values - prior.mean) / prior.sd) ** 2)


@dataclass(frozen=True, eq=False)
class _Phasor:
    """One mode at the outputs of one block, stretch by stretch.

    Attributes
    ----------
    omega : float -- [rad/s]
    times : ndarray, shape (n_stretches,) -- when it rang, since the middle of its record [s]
    amplitudes : ndarray, shape (n_stretches, 2, n_outputs) -- of the column, and of its quadrature
    weights : ndarray, shape (n_stretches, 2, 2) -- Gram matrices of the two
    variances : ndarray, shape (n_outputs,) -- of the noise
    """

    omega: float
    times: FloatArray
    amplitudes: FloatArray
    weights: FloatArray
    variances: FloatArray

    def explained(self, shifts: FloatArray, drifts: FloatArray) -> FloatArray:
        """Return the gain in log-likelihood of real residues for changes of the clock."""
        # A later stamp was taken earlier: the instant moves by minus the shift.
        phases = -self.omega * (shifts[:, None] + drifts[:, None] * self.times)
        shape = np.stack([np.cos(phases), np.sin(phases)], axis=2)
        # Numerator and denominator of (I.20), the sums over stretches.
        met = np.einsum("psa,saj->pj", shape, self.weights @ self.amplitudes, optimize=True)
        power = np.einsum("psa,sab,psb->p", shape, self.weights, shape, optimize=True)
        return np.asarray(0.5 * np.sum(met**2 / self.variances, axis=1) / np.maximum(power, 1e-300))


def _phasors(regression: ModalRegression, fit: ModalFit) -> list[_Phasor]:
    """Compress every mode to its phasors, with all other columns beside it."""
    n, n_fixed = regression.n_forced * len(fit.omegas), regression.n_shared_fixed
    omegas = np.tile(fit.omegas, regression.n_forced)  # of every residue: under one input after the other
    blocks = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
    found = []
    for number, block in enumerate(blocks):
        assert block.by_time is not None
        outputs = [j for j, own in enumerate(regression.block_of) if own == number]
        # The clock's rate acts by the time since the middle of a record.
        elapsed = -block.rate_factor / np.abs(block.latency_factor)
        stretch = _stretches(elapsed)
        columns, owners = [], []
        # Beside the modes' pairs stand all other columns: gain, residual term, drifts, free motions.
        others = np.delete(block.matrix, np.arange(n_fixed, n_fixed + n), axis=1)
        for mode in range(n):
            # c and c'/omega of (I.19).
            pair = np.stack(
                [block.matrix[:, n_fixed + mode], block.by_time[:, n_fixed + mode] / omegas[mode]]
            )
            # One factor for both: the phase between them must stay.
            pair = pair / max(float(np.linalg.norm(pair[0])), 1e-300)
            for part in range(_STRETCHES):
                here = stretch == part
                if float(np.sum(pair[:, here] ** 2)) > 10.0 * _RIDGE:
                    columns.append(np.where(here, pair, 0.0))
                    owners.append(
                        (mode, float(np.average(elapsed[here], weights=np.sum(pair[:, here] ** 2, axis=0))))
                    )
        size = np.linalg.norm(others, axis=0)
        design = np.concatenate([others / np.where(size > 0.0, size, 1.0), np.concatenate(columns).T], axis=1)
        gram = design.T @ design
        # The ridge keeps pairs that a stretch hardly shows at zero instead of anywhere.
        gram[np.diag_indices_from(gram)] += _RIDGE
        values = np.stack([regression.values[j] for j in outputs], axis=1)
        solved = np.linalg.solve(gram, design.T @ values)
        variances = np.mean(np.square(values - design @ solved), axis=0)
        first = others.shape[1]
        for mode in range(n):
            mine = [k for k, (owner, _) in enumerate(owners) if owner == mode]
            places = first + 2 * np.array(mine)[:, None] + np.arange(2)
            found.append(
                _Phasor(
                    float(omegas[mode]),
                    np.array([owners[k][1] for k in mine]),
                    solved[places],
                    gram[places[:, :, None], places[:, None, :]],
                    variances,
                )
            )
    return found


def _stretches(elapsed: FloatArray) -> IndexArray:
    """Return for every instant in which part of the longest record it falls."""
    first, last = float(np.min(elapsed)), float(np.max(elapsed))
    share = (elapsed - first) / max(last - first, 1e-300)
    return np.minimum((share * _STRETCHES).astype(np.intp), _STRETCHES - 1)


def out_of_phase(regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior) -> ScoreTest:
    """Return the test of whether modes answer out of phase, by a part that real residues cannot have.

    Parameters
    ----------
    regression : ModalRegression -- thinned data will do
    fit : ModalFit -- of it
    latency, clock_rate : Prior
    """
    first = regression.n_shared_fixed
    blocks = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
    tested = []
    for j, present in enumerate(designs(regression, fit, latency, clock_rate)):
        quadrature = blocks[regression.block_of[j]].by_time
        assert quadrature is not None
        left_out = quadrature[:, first : first + len(fit.omegas)]  # c' of (I.19)
        tested.append((left_out, LinearSolution.of(present), fit.residuals[j], regression.values[j]))
    return ScoreTest.of(tested)


def own_delays(
    regression: ModalRegression,
    fit: ModalFit,
    present: Sequence[FloatArray],
    columns: Sequence[FloatArray],
    latency: Prior,
    known: Collection[int] = (),
) -> dict[int, float]:
    """Return which output has a delay of its own beside the clock that all share, and about how long [s]; or none.

    Parameters
    ----------
    regression : ModalRegression
    fit : ModalFit -- of it, with one clock for all outputs
    present : sequence of ndarray -- ``designs`` of both
    columns : sequence of ndarray -- of every output, the first of its ``own_clock_columns``
    latency : Prior -- of that clock
    known : collection of int -- outputs whose own delay is estimated already

    Notes
    -----
    A likelihood-ratio test by scores: with the linear parameters and poles and clock projected out, the derivatives
    of the outputs by their own delays meet nothing but noise where there are none. The most telling output is
    returned, if less than one record in a thousand without delays would tell as much.
    """
    rest = [j for j in range(regression.n_outputs) if j not in known]
    # A latency that is free takes the common part: one output fewer than there are can have a delay of its own.
    if regression.n_outputs < 2 or not len(fit.omegas) or len(rest) <= int(latency.is_free):
        return {}
    _, gains, colour = _own_steps(regression, fit, present, columns)
    needed = float(chi_squared_isf(1, _OWN_CLOCK_LEVEL / regression.n_outputs))
    places, left = np.zeros(1), np.zeros((regression.n_outputs, 1))
    is_told = max(gains[rest]) > needed
    if is_told or not all(Whiteness.of(noise).is_white for noise in fit.residuals):
        # Past half a cycle of a mode the derivatives point anywhere: what is left at every delay decides.
        places, left = _left_by_delay(regression, fit, _MAX_OWN_DELAY_S, _MAX_STEPS)
        sizes = np.array([len(values) for values in regression.values])
        gains = np.maximum(gains, sizes * np.log(left[:, len(places) // 2] / np.min(left, axis=1)) / colour)
    best = max(rest, key=lambda j: float(gains[j]))
    return {best: _best_delay(regression, fit, best, places, left[best])} if gains[best] > needed else {}


def own_rates(
    regression: ModalRegression,
    fit: ModalFit,
    present: Sequence[FloatArray],
    columns: Sequence[FloatArray],
    clock_rate: Prior,
    known: Collection[int] = (),
) -> dict[int, float]:
    """Return which output's clock runs at a rate of its own, and by about how much it is faster; or none.

    Parameters
    ----------
    regression : ModalRegression
    fit : ModalFit -- of it, with one clock rate for all outputs
    present : sequence of ndarray -- ``designs`` of both
    columns : sequence of ndarray -- of every output, the second of its ``own_clock_columns``
    clock_rate : Prior -- of the clock in common; one that is known leaves no rate open
    known : collection of int -- outputs whose own rate is estimated already
    """
    rest = [j for j in range(regression.n_outputs) if j not in known]
    if not clock_rate.is_free or len(rest) < 2 or not len(fit.omegas):
        return {}
    steps, gains, _ = _own_steps(regression, fit, present, columns)
    best = max(rest, key=lambda j: float(gains[j]))
    needed = float(chi_squared_isf(1, _OWN_CLOCK_LEVEL / regression.n_outputs))
    return {best: float(steps[best])} if gains[best] > needed else {}


def _own_steps(
    regression: ModalRegression,
    fit: ModalFit,
    present: Sequence[FloatArray],
    columns: Sequence[FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a parameter of its own would be at each output alone, its score statistic, and the noise's colour.

    Parameters
    ----------
    regression, fit, present : as of ``own_delays``
    columns : sequence of ndarray, each (n_rows,) -- of every output, the model's derivative by its own parameter
    """
    n_theta, n_outputs = fit.n_theta, regression.n_outputs
    of_theta, spread = np.zeros((n_theta, n_theta)), np.zeros(n_outputs)
    cross, score_of_theta = np.zeros((n_theta, n_outputs)), np.zeros(n_theta)
    scores, colour, power = np.zeros(n_outputs), np.ones(n_outputs), np.ones(n_outputs)
    for j, design in enumerate(present):
        linear = LinearSolution.of(design[:, n_theta:])
        both = np.column_stack([design[:, :n_theta], columns[j] / regression.row_levels(j)]) / fit.sigmas[j]
        both = linear.left_of(both)
        noise = fit.residuals[j] / fit.sigmas[j]
        # The estimates left these out, or nearly so.
        spread_of_rows = fit.spreads[j] if fit.spreads else 1.0
        far = outliers(noise / spread_of_rows)
        both[far], noise[far] = 0.0, 0.0
        shared, own = both[:, :-1], both[:, -1]
        of_theta += shared.T @ shared
        score_of_theta += shared.T @ noise
        cross[:, j], spread[j], scores[j] = shared.T @ own, own @ own, own @ noise
        own_free = noise - own * (own @ noise) / max(spread[j], 1e-300)
        power[j] = max(float(own_free @ own_free) / max(len(noise) - len(far), 1), 1.0)
        under_colour = float(score_covariance(own[:, None], autoregression(own_free))[0, 0])
        colour[j] = max(under_colour / max(spread[j], 1e-300), 1.0)
    scale = np.sqrt(np.maximum(np.diag(of_theta), 1e-300))
    inverse = np.linalg.pinv(of_theta / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    inverse = inverse / np.outer(scale, scale)
    information = np.diag(spread) - cross.T @ inverse @ cross
    scores = scores - cross.T @ inverse @ score_of_theta
    variances = np.where(np.diag(information) > _DEPENDENT * np.max(spread), np.diag(information), np.inf)
    return scores / variances, np.square(scores) / variances / (colour * power), colour


class OwnClocks(Exception):  # noqa: N818 - no error: a search begins anew with what it says
    """Some outputs have clocks of their own.

    Parameters
    ----------
    clocks : mapping -- by the output's name
    """

    def __init__(self, clocks: Mapping[str, OwnClock]) -> None:
        super().__init__(", ".join(clocks))
        self.clocks = dict(clocks)


def contradicting_clocks(
    alone: Mapping[str, ModalFit], known: ClockState | None = None
) -> dict[str, OwnClock]:
    """Return which outputs have clocks of their own, from what each one shows without the others.

    Parameters
    ----------
    alone : mapping -- by the output's name, a fit of it with a latency of its own; all with a rate or none
    known : ClockState or None -- what all outputs should agree with; None is the clock that most of them agree with

    Notes
    -----
    To agree is to be within four standard deviations.
    """
    references = [_clock_of(fit) for fit in alone.values()]
    if known is not None:
        references = [((known.latency, 0.0), (known.rate, 0.0))]
    found: dict[str, OwnClock] | None = None
    for reference in references:
        own: dict[str, OwnClock] = {}
        for name, fit in alone.items():
            apart = [
                (value - common, (value - common) ** 2 > _APART**2 * (variance + common_variance))
                for (value, variance), (common, common_variance) in zip(
                    _clock_of(fit), reference, strict=True
                )
            ]
            (delay, is_late), (rate, is_fast) = apart
            if is_late or is_fast:
                own[name] = OwnClock(delay, rate if is_fast else 0.0, is_fast)
        if found is None or len(own) < len(found):
            found = own
    return found or {}


def _clock_of(fit: ModalFit) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return latency [s] and rate of a fit, each with its variance; that of a rate which is known is zero."""
    place = 2 * len(fit.omegas)
    variances = np.append(np.diag(fit.covariance)[place : fit.n_theta], [0.0, 0.0])
    return (fit.clock.latency, float(variances[0])), (fit.clock.rate, float(variances[1]))


def moved_alone(regression: ModalRegression, fit: ModalFit) -> ClockState:
    """Return the clock of one output whose latency, as far as any is looked for, leaves least of it, poles held.

    Parameters
    ----------
    regression : ModalRegression -- of one output; thinned data will do
    fit : ModalFit -- with poles about right, its clock anywhere
    """
    places, left = _left_by_delay(regression, fit, regression.max_latency_s, _MOST_PLACES)
    delay = _best_delay(regression, fit, 0, places, left[0])
    return ClockState(fit.clock.latency + delay, fit.clock.rate)


def _left_by_delay(
    regression: ModalRegression, fit: ModalFit, farthest_s: float, most: int
) -> tuple[FloatArray, FloatArray]:
    """Return delays around none [s], and what each, poles held, leaves of every output, (n_outputs, n_delays)."""
    step = 2.0 * np.pi / float(fit.omegas[-1]) / _STEPS_PER_CYCLE
    n = min(math.ceil(min(farthest_s, regression.max_latency_s) / step), most)
    places = np.asarray(step * np.arange(-n, n + 1), dtype=np.float64)
    outputs = range(regression.n_outputs)
    return places, np.array([_left(regression, fit, float(delay), outputs) for delay in places]).T


def _left(regression: ModalRegression, fit: ModalFit, delay: float, outputs: Sequence[int]) -> list[float]:
    """Return the sums of squares that a delay leaves of some outputs, poles held."""
    clock = ClockState(fit.clock.latency + delay, fit.clock.rate)
    blocks = regression.blocks(fit.omegas, fit.zetas, clock, gradients=False)
    result = []
    for j in outputs:
        matrix, values = blocks[regression.block_of[j]].matrix, regression.values[j]
        left = values - matrix @ LinearSolution.of(matrix).coefficients(values)
        result.append(max(float(left @ left), 1e-300))
    return result


def _best_delay(
    regression: ModalRegression, fit: ModalFit, output: int, places: FloatArray, left: FloatArray
) -> float:
    """Return the delay of one output that leaves least of it, poles held, near the best of a grid [s]."""
    best, step = float(places[int(np.argmin(left))]), float(places[1] - places[0])
    found = minimize_scalar(
        lambda delay: _left(regression, fit, float(delay), [output])[0],
        bounds=(best - step, best + step),
        method="bounded",
        options={"xatol": 1e-7},
    )
    return float(found.x)


def own_clock_columns(regression: ModalRegression, fit: ModalFit) -> list[tuple[FloatArray, FloatArray]]:
    """Return of every output the derivatives of the model by delay and rate of its own, unweighed, each (n_rows,)."""
    columns: list[list[FloatArray]] = [[] for _ in fit.coefficients]
    for piece in regression.with_own_columns({}).pieces:
        blocks = piece.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
        for j, (number, found) in enumerate(zip(piece.block_of, fit.coefficients, strict=True)):
            block = blocks[number]
            assert block.by_time is not None
            speed = block.by_time @ found[: block.matrix.shape[1]] * piece.row_levels(j)
            columns[j].append(np.stack([speed * block.latency_factor, speed * block.rate_factor]))
    joined = [np.concatenate(parts, axis=1) for parts in columns]
    return [(by_delay, by_rate) for by_delay, by_rate in joined]
