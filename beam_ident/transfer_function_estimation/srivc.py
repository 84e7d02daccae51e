"""From no start at all to the output-error optimum of one denominator.

A subspace estimate (PO-MOESP) or, where that does not lead to residuals that look like noise,
state-variable-filter least squares (LSSVF) over a portfolio of cut-offs with instrumental
variables behind the best of them (IVSVF); then the simplified refined instrumental variable
(SRIVC; Young and Jakeman 1980), and Levenberg-Marquardt on the output error with the same exact
gradients to finish.  Residuals that look like anything but noise may mean a local optimum:
then the other starts have their turn, and the lowest cost wins.  Where the winner has not converged, a pole is hardly
known, or the input is still seen in the residuals, poles are exchanged for others (``pole_exchange``).

Instruments and gradients are exact responses of ``s^i B / A^2`` to the held input, so
that SRIVC's fixed point is the stationary point of the output-error cost; the
interpolation of the *measured* output inside the filters only affects the way there.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import EstimationError
from beam_ident.noise.scores import ScoreTest, Whiteness
from beam_ident.numerics.levenberg_marquardt import minimise
from beam_ident.numerics.root_uncertainty import root_covariances
from beam_ident.subspace.po_moesp import Stretch, subspace_poles
from beam_ident.transfer_function_estimation.delay_search import delay_candidates
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.transfer_function_estimation.pole_exchange import Place, completed, exchanged
from beam_ident.transfer_function_estimation.state_variable_filter import (
    filter_coefficients,
    filtered_simulation,
    instrumental_step,
    least_squares_step,
    stable_coefficients,
)

Method = Literal["auto", "rivc", "white", "srivc", "output_error", "ivsvf", "lssvf"]
METHODS: tuple[Method, ...] = ("auto", "rivc", "white", "srivc", "output_error", "ivsvf", "lssvf")

_SRIVC_ITERATIONS = 20
_SRIVC_TOLERANCE = 1e-4  # of a variance, per coefficient
_LM_ITERATIONS = 50
_PORTFOLIO = 7  # cut-offs
_INSTRUMENTED = 1  # cut-offs behind which instrumental variables are tried
FINALISTS = 3  # starts behind filters that are refined, at most
WHITE = 0.01  # level of the whiteness test below which residuals do not look like noise
_SAMPLES_BESIDE = 4  # half samples beyond a period of the fastest mode in which other delays are tried
_MAX_STEPS_BESIDE = 40  # on each side
_SHARPNESS = 0.01  # of a period, to which such a delay is found while the poles are kept
_MAX_POLE_SD = 0.5  # of the pole's modulus
_WORSE_BESIDE = 30.0  # log-likelihood that a refinement may still win over poles that are kept
_NO_START = (
    "no state-variable filter gave a stable start; give another cutoff, other degrees, or a longer record"
)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where an estimator ended, and why.

    Attributes
    ----------
    state : OutputErrorState
    converged : bool
    reason : str
    iterations : int
    """

    state: OutputErrorState
    converged: bool
    reason: str
    iterations: int


def portfolio(problem: OutputErrorProblem) -> list[float]:
    """Return cut-offs of the state-variable filter [rad/s] that span what the record can show."""
    # From two periods in the record to half the Nyquist frequency of the stamps.
    low = 4.0 * np.pi / problem.length
    return [float(w) for w in np.geomspace(low, 0.5 * problem.nyquist, _PORTFOLIO)]


def estimate_denominator(
    problem: OutputErrorProblem,
    method: Method,
    cutoff: float | None = None,
    n_finalists: int = FINALISTS,
    inside: Sequence[Place] = (),
    looks_elsewhere: bool = True,
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate a problem of one denominator without a start.

    Parameters
    ----------
    problem : OutputErrorProblem
    method : str -- which estimator to stop at; "auto", "rivc", "white" and "output_error" go to the optimum
    cutoff : float or None -- of the state-variable filter [rad/s]; None tries a portfolio
    n_finalists : int
        How many starts behind filters are refined while the residuals do not look like noise.
    inside : sequence of Place
        Where this denominator ended with fewer nuisances, or smaller ones did, as far as that is known.
    looks_elsewhere : bool
        Whether other places of the poles are tried, where the optimum is not sure to be the best.

    Returns
    -------
    problem, optimum
        The problem as it was solved: with an unknown past and a delay found, without the
        samples that depend on that past; with several records, weighed by their noise as a start shows it.

    Raises
    ------
    EstimationError
        No filter gives a stable start.
    """
    cutoffs = [cutoff] if cutoff is not None else portfolio(problem)
    delays = [np.array([problem.paths[k].delay.mean for k in problem.free_delays])]
    if problem.free_delays:
        delays = delay_candidates(problem, cutoffs)
        if problem.nuisances.has_free_response:
            longest = max(float(np.max(d)) for d in delays) + 1.5 * problem.period
            problem = problem.from_stamps([own.times[0] + longest for own in problem.experiments])
    if len(problem.experiments) > 1:
        # Levels of several records differ; the first start is enough to see them, and all others are
        # weighed by them.
        start = next(_Chain(problem, method, cutoffs, delays, 1).in_turn(), None)
        if start is not None:
            problem = problem.reweighed(start, as_it_is=False)
    chain = _Chain(problem, method, cutoffs, delays, n_finalists)
    found = chain.run()
    if method in ("auto", "rivc", "white", "output_error"):
        found = chain.beyond(found, inside)
        found = chain.elsewhere(found) if looks_elsewhere else found
    return problem, found


def refine(
    problem: OutputErrorProblem, state: OutputErrorState, method: Method, target: float = math.inf
) -> Optimum:
    """Refine a state to a method's end: SRIVC's fixed point, or the output-error optimum.

    Parameters
    ----------
    problem : OutputErrorProblem -- in the state's unit of frequency
    state : OutputErrorState
    method : str
    target : float -- cost that must be reached to be of use, as of ``minimise``
    """
    iterations = 0
    if method != "output_error":
        found = srivc(problem, state)
        if method == "srivc":
            return found
        state, iterations = found.state, found.iterations
    minimum = minimise(problem, state, _LM_ITERATIONS, target)
    return Optimum(minimum.state, minimum.converged, minimum.reason, iterations + minimum.iterations)


def srivc(problem: OutputErrorProblem, start: OutputErrorState) -> Optimum:
    """Iterate the refined instrumental variable at given delays, and return the best point met.

    Parameters
    ----------
    problem : OutputErrorProblem -- in the start's unit of frequency
    start : OutputErrorState
    """
    state, best, iteration = start, start, 0
    n = problem.n_a
    for iteration in range(1, _SRIVC_ITERATIONS + 1):
        jacobian = problem.jacobian(state)
        # (T.7) with F = A and the gradients (T.8) as instruments, both at the present point.
        theta = instrumental_step(problem, state, jacobian[:, :n])
        following = problem.state(theta)
        if not math.isfinite(following.cost):
            break
        if following.cost < best.cost:
            best = following
        # The step in units of its standard deviation.
        information, _ = problem.slope(following)
        moved = (following.theta - state.theta)[:n]
        state = following
        if float(moved @ information[:n, :n] @ moved) < _SRIVC_TOLERANCE * n:
            return Optimum(best, True, "SRIVC reached its fixed point", iteration)
    return Optimum(best, False, f"SRIVC still moved after {iteration} iterations", iteration)


def are_known(problem: OutputErrorProblem, theta: FloatArray, information: FloatArray) -> bool:
    """Return whether all poles of a problem of one denominator are known well enough to mean something, and to decay.

    Parameters
    ----------
    problem : OutputErrorProblem
    theta : ndarray, shape (n_theta,)
    information : ndarray, shape (n_theta, n_theta) -- on theta
    """
    n = problem.n_a
    spread = np.asarray(np.linalg.pinv(information, rcond=1e-15, hermitian=True)[:n, :n], dtype=np.float64)
    poles, scatter = root_covariances(problem.polynomial(theta), spread)
    sd = np.sqrt(np.maximum(np.trace(scatter, axis1=1, axis2=2), 0.0))
    decay_sd = np.sqrt(np.maximum(scatter[:, 0, 0], 0.0))
    return bool(np.all((sd < _MAX_POLE_SD * np.abs(poles)) & (decay_sd < -poles.real)))


def follow_inputs(problems: Sequence[OutputErrorProblem], states: Sequence[OutputErrorState]) -> bool:
    """Return whether what states leave still follows the inputs, whatever the colour of the noise.

    Parameters
    ----------
    problems : sequence of OutputErrorProblem -- of every output, in the unit of frequency of its state
    states : sequence of OutputErrorState
    """
    pairs = zip(problems, states, strict=True)
    return ScoreTest.of([problem.followed_inputs(state) for problem, state in pairs]).p_value < WHITE


def _place_of(found: Optimum) -> Place:
    return Place.of(found.state)


class _Chain:
    """The chain of estimators, from filters to the optimum."""

    def __init__(
        self,
        problem: OutputErrorProblem,
        method: Method,
        cutoffs: list[float],
        delays: list[FloatArray],
        n_finalists: int,
    ) -> None:
        self.problem, self.method, self.cutoffs, self.delays = problem, method, cutoffs, delays
        self.n_finalists = n_finalists
        self.pool: list[ComplexArray] = []

    def run(self) -> Optimum:
        if self.method in ("lssvf", "ivsvf"):
            starts = self._filtered_starts()
            if not starts:
                raise EstimationError(_NO_START)
            return Optimum(starts[0], False, f"{self.method.upper()} takes one step", 1)
        best: Optimum | None = None
        for start in self.in_turn():
            found = self._refined(start, math.inf if best is None else best.state.cost)
            self.pool.append(found.state.uppers[0] * found.state.scale)
            if best is None or found.state.cost < best.state.cost:
                best = found
            # White residuals: the optimum is not only local. Otherwise the next start has its turn.
            if found.converged and self.is_noise(best):
                break
        if best is None:
            raise EstimationError(_NO_START)
        for place in range(len(self.problem.free_delays)):
            best = self._at_another_delay(best, self.problem.n_a + place)
        return best

    def is_noise(self, found: Optimum) -> bool:
        """Return whether what an optimum leaves looks like noise."""
        return Whiteness.of(self.problem.standardised(found.state.residuals)).p_value > WHITE

    def elsewhere(self, found: Optimum) -> Optimum:
        """Return an optimum, or a better one that has some of its poles, or its delays, elsewhere.

        Other poles are looked for where the optimum may not be the best: it has not converged, some pole is hardly
        known, or the input is still seen in what it leaves. The structure without delays is always estimated: a fit
        that has found a delay may have found the wrong one of many.
        """
        problem = self.problem
        is_sure = found.converged and not self._is_doubtful(found)
        if problem.free_delays:
            known = problem.at_mean_delays()
            chain = _Chain(known, self.method, self.cutoffs, [np.empty(0)], self.n_finalists)
            with contextlib.suppress(EstimationError):
                end = chain.run()
                found = self.beyond(found, [_place_of(end if is_sure else chain.elsewhere(end))])
        return found if is_sure else exchanged([problem], found, _place_of, self._refined_at, self.pool)

    def _is_doubtful(self, found: Optimum) -> bool:
        """Return whether an optimum has poles that are hardly known, or leaves what follows the inputs."""
        problem, state = self.problem, found.state
        problem.scale = state.scale
        if not are_known(problem, state.theta, problem.slope(state)[0]):
            return True
        return not self.is_noise(found) and follow_inputs([problem], [state])

    def beyond(self, found: Optimum, inside: Sequence[Place]) -> Optimum:
        """Return an optimum, or a better one from where a structure inside this one ended.

        A structure that holds another can do whatever that one does: it must not end in a worse optimum.
        """
        for place in completed(self.problem, inside, self.pool):
            found = min(found, self._refined_at(place, found.state.cost), key=lambda own: own.state.cost)
        return found

    def _refined_at(self, place: Place, target: float) -> Optimum:
        self.problem.scale = place.scale
        start = self.problem.state(place.theta)
        if not math.isfinite(start.cost):
            return Optimum(start, False, "the starting point is not allowed", 0)
        return self._refined(start, target)

    def _at_another_delay(self, found: Optimum, place: int) -> Optimum:
        """Return an optimum, or the better one that lies at another delay beside it.

        A free numerator makes up for a delay that is wrong by part of a period of the fastest
        mode almost entirely: the poles stay where they are and the residuals look white.  So the
        poles are kept, delays on both sides are tried in half samples, and the deepest
        minimum among them is refined.
        """
        problem, state = self.problem, found.state
        problem.scale = state.scale
        step = 0.5 * problem.period
        fastest = float(np.max(np.abs(np.concatenate(state.uppers)))) * state.scale
        reach = min(math.ceil(2.0 * np.pi / fastest / step) + _SAMPLES_BESIDE, _MAX_STEPS_BESIDE)
        thetas = np.tile(state.theta, (2 * reach + 1, 1))
        thetas[:, place] += step * np.arange(-reach, reach + 1)
        tried = [
            problem.state(theta, slopes=False) if abs(k - reach) > 1 and theta[place] >= 0.0 else None
            for k, theta in enumerate(thetas)
        ]
        costs = np.array([math.inf if other is None else other.cost for other in tried])
        costs[reach] = state.cost
        padded = np.concatenate([[math.inf], costs, [math.inf]])
        is_minimum = (costs <= padded[:-2]) & (costs <= padded[2:]) & np.isfinite(costs)
        is_minimum[reach] = False
        if not np.any(is_minimum):
            return found
        at = thetas[int(np.argmin(np.where(is_minimum, costs, math.inf)))]

        def cost_at(delay: float) -> float:
            at[place] = delay
            return problem.state(at, slopes=False).cost

        bounds = (max(at[place] - step, 0.0), at[place] + step)
        at[place] = minimize_scalar(
            cost_at, bounds=bounds, method="bounded", options={"xatol": _SHARPNESS * problem.period}
        ).x
        deepest = problem.state(at, slopes=False)
        if not deepest.cost <= state.cost + _WORSE_BESIDE:
            return found
        other = self._refined(deepest)
        return other if other.state.cost < state.cost else found

    def in_turn(self) -> Iterator[OutputErrorState]:
        """Yield starts in the order in which they are worth the work of refining them.

        A subspace is the quickest start and sees light modes under noise that filters lose; but
        it takes a delay as given, so that where delays are searched the filters come first.
        """
        subspace = sorted(self._subspace_starts(), key=lambda state: state.cost)[:1]
        if not self.problem.free_delays:
            yield from subspace
            if self.n_finalists:
                yield from self._filtered_starts()[: self.n_finalists]
            return
        filtered = self._filtered_starts()[: self.n_finalists]
        yield from filtered[:1] + subspace + filtered[1:]

    def _filtered_starts(self) -> list[OutputErrorState]:
        """Return least-squares and instrumental estimates behind filters, the best by simulation first."""
        plain = []
        for delays in self.delays:
            for cutoff in self.cutoffs:
                behind, found = self._least_squares(cutoff, delays)
                if math.isfinite(found.cost):
                    plain.append((behind, found))
        plain.sort(key=lambda pair: pair[1].cost)
        if self.method == "lssvf":
            return [found for _, found in plain]
        instrumental = [self._instrumental(behind, found) for behind, found in plain[:_INSTRUMENTED]]
        instrumental = [state for state in instrumental if math.isfinite(state.cost)]
        everything = instrumental if self.method == "ivsvf" else instrumental + [s for _, s in plain]
        return sorted(everything, key=lambda state: state.cost)

    def _least_squares(self, cutoff: float, delays: FloatArray) -> tuple[OutputErrorState, OutputErrorState]:
        problem = self.problem
        problem.scale = cutoff
        # A Butterworth filter of the cut-off, as if it were the denominator: its point has the columns of
        # (T.5).
        theta = np.concatenate([filter_coefficients(problem.n_a), delays])
        behind = problem.point(theta, slopes=False)
        if not behind.matrix.size:
            return behind, behind
        return behind, problem.state(least_squares_step(problem, behind), slopes=False)

    def _instrumental(self, behind: OutputErrorState, found: OutputErrorState) -> OutputErrorState:
        problem = self.problem
        problem.scale = behind.scale
        # The output simulated by the least-squares model, behind the same filter: correlated with the
        # regressors, free of their noise.
        simulated = problem.values - problem.unweighed_residuals(found)
        instruments = -problem.weighed(filtered_simulation(problem, behind.uppers[0], simulated))
        return problem.state(instrumental_step(problem, behind, instruments), slopes=False)

    def _subspace_starts(self) -> list[OutputErrorState]:
        problem = self.problem
        delays = self.delays[0]
        every = problem.delays(np.concatenate([np.zeros(problem.n_a), delays]))
        levels = np.ones(len(problem.rows)) if problem.noise is None else problem.noise.levels
        stretches = [
            Stretch(
                [path.delayed(delay) for path, delay in zip(own.paths, every, strict=True)],
                [(own.times, own.values)],
                float(level),
            )
            for own, level in zip(problem.experiments, levels, strict=True)
        ]
        states = []
        for poles in subspace_poles(stretches, problem.n_a):
            self.pool.append(poles[poles.imag >= 0.0])
            # The geometric mean of the poles is the unit of frequency in which the coefficients stay near
            # one.
            problem.scale = float(np.exp(np.mean(np.log(np.maximum(np.abs(poles), 1e-9 * problem.nyquist)))))
            coefficients = stable_coefficients(np.real(np.poly(poles / problem.scale))[1:])
            states.append(problem.state(np.concatenate([coefficients, delays]), slopes=False))
        return [state for state in states if math.isfinite(state.cost)]

    def _refined(self, start: OutputErrorState, target: float = math.inf) -> Optimum:
        """Refine a start to the method's end, in the unit of frequency of its own poles."""
        problem = self.problem
        size = float(np.exp(np.mean(np.log(np.abs(start.responses[0].poles))))) * start.scale
        theta = problem.converted(start, size)
        problem.scale = size
        moved = problem.state(theta)
        if not math.isfinite(moved.cost):
            # Poles so far apart that they are no point any more in their own unit.
            problem.scale = start.scale
            return Optimum(start, False, "the start cannot be refined", 0)
        return refine(problem, moved, self.method, target)
