"""Maximum-likelihood fit of a modal model: variable projection with exact gradients.

For given poles and clock all other parameters solve a linear least-squares problem
(QR on scaled columns).  What remains, ``log omega`` and ``zeta`` of every mode and, where
they are free, latency and clock rate, is found by Levenberg-Marquardt on the
concentrated likelihood ``sum_j n_j/2 log RSS_j`` with the Jacobian projected onto the
complement of the linear columns (Golub and Pereyra 1973, in Kaufman's form), so that
every output weighs by its own noise.  A step that does not lower the cost is never
taken, iterations are bounded, and the result says how it ended.  The covariance is
the inverse of the full information matrix, linear parameters included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.prior import Prior
from beam_ident.modal.regression import ClockState, ColumnBlock, ModalRegression
from beam_ident.noise.autoregression import autocorrelation, autoregression, score_covariance
from beam_ident.numerics.levenberg_marquardt import HOPELESS, Minimum, minimise
from beam_ident.numerics.linear_least_squares import LinearSolution

MIN_DAMPING = 1e-6
MAX_DAMPING = 0.95
MAX_LATENCY_S = 0.2

_MAX_CLOCK_RATE = 0.1


_NOISE_FLOOR = 1e-10  # of the output's size: where rounding ends what residuals can tell


@dataclass(frozen=True, eq=False)
class ModalFit:
    """The estimate and how it came about.

    Attributes
    ----------
    omegas, zetas : ndarray, shape (n_modes,) -- natural frequencies [rad/s], damping ratios
    clock : ClockState
    coefficients : tuple of ndarray -- linear parameters of every output
    residuals : tuple of ndarray -- measured minus modelled, per output
    sigmas : ndarray, shape (n_outputs,) -- noise standard deviations
    cost : float -- concentrated negative log-likelihood (up to a constant)
    covariance : ndarray
        Of (log omega.., zeta.., free clock parameters.., linear parameters of output 1, ..).
        Under the noise as it is: autocorrelated where the residuals are, and after
        ``WeightedFit`` with what noise on the input contributes.
    information_condition : float
        Condition of the scaled information matrix of poles and clock.
    input_noise_shares : ndarray, shape (n_outputs,)
        Share of each output's noise variance that noise on the input makes up.
    rank_deficient : tuple of str -- outputs whose linear columns depend on each other
    """

    omegas: FloatArray
    zetas: FloatArray
    clock: ClockState
    coefficients: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    sigmas: FloatArray
    cost: float
    covariance: FloatArray
    information_condition: float
    input_noise_shares: FloatArray
    rank_deficient: tuple[str, ...]
    converged: bool
    reason: str
    iterations: int

    @property
    def n_parameters(self) -> int:
        """Number of estimated parameters."""
        return len(self.covariance)


@dataclass(frozen=True, eq=False)
class _State:
    """Everything known at one point of the nonlinear parameters."""

    theta: FloatArray
    cost: float
    coefficients: list[FloatArray]
    residuals: list[FloatArray]
    rss: FloatArray
    blocks: list[ColumnBlock]
    solutions: list[LinearSolution]


class _Problem:
    """The likelihood of a regression as a function of its nonlinear parameters."""

    def __init__(self, regression: ModalRegression, n_modes: int, latency: Prior, rate: Prior) -> None:
        self.regression = regression
        self.n_modes = n_modes
        self.latency, self.rate = latency, rate
        self.n_theta = 2 * n_modes + int(latency.is_free) + int(rate.is_free)
        self.sizes = np.array([len(v) for v in regression.values], dtype=np.float64)
        scale = np.array([max(float(np.max(np.abs(v))), 1e-300) for v in regression.values])
        self.floor = self.sizes * (_NOISE_FLOOR * scale) ** 2

    def clock(self, theta: FloatArray) -> ClockState:
        place = 2 * self.n_modes
        latency, rate = self.latency.mean, self.rate.mean
        if self.latency.is_free:
            latency = float(theta[place])
            place += 1
        if self.rate.is_free:
            rate = float(theta[place])
        return ClockState(latency, rate)

    def prior_terms(self, theta: FloatArray) -> list[tuple[int, float, float]]:
        """Return (index, deviation / sd, 1 / sd) of every finite prior."""
        terms = []
        place = 2 * self.n_modes
        for prior in (self.latency, self.rate):
            if prior.is_free:
                if math.isfinite(prior.sd):
                    terms.append((place, (float(theta[place]) - prior.mean) / prior.sd, 1.0 / prior.sd))
                place += 1
        return terms

    def state(self, theta: FloatArray) -> _State:
        n = self.n_modes
        regression = self.regression
        blocks = regression.blocks(np.exp(theta[:n]), theta[n : 2 * n], self.clock(theta), gradients=True)
        solutions = [LinearSolution.of(block.matrix) for block in blocks]
        coefficients, residuals = [], []
        for values, block in zip(regression.values, regression.block_of, strict=True):
            found = solutions[block].coefficients(values)
            coefficients.append(found)
            residuals.append(values - blocks[block].matrix @ found)
        rss = np.array([float(e @ e) for e in residuals]) + self.floor
        cost = float(0.5 * np.sum(self.sizes * np.log(rss)))
        cost += 0.5 * sum(deviation**2 for _, deviation, _ in self.prior_terms(theta))
        return _State(theta, cost, coefficients, residuals, rss, blocks, solutions)

    def jacobian(self, state: _State, output: int) -> FloatArray:
        """Return the derivative of one output's model by the nonlinear parameters."""
        block = state.blocks[self.regression.block_of[output]]
        found = state.coefficients[output]
        n = self.n_modes
        result = np.empty((len(block.matrix), self.n_theta), order="F")
        for mode, touched in enumerate(block.modes):
            share = found[touched.columns]
            result[:, mode] = touched.by_log_omega @ share
            result[:, n + mode] = touched.by_zeta @ share
        place = 2 * n
        if place < self.n_theta:
            assert block.by_time is not None
            speed = block.by_time @ found
            if self.latency.is_free:
                result[:, place] = speed * block.latency_factor
                place += 1
            if self.rate.is_free:
                result[:, place] = speed * block.rate_factor
        return result

    def normal_equations(self, state: _State, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction of the nonlinear parameters."""
        information = np.zeros((self.n_theta, self.n_theta))
        direction = np.zeros(self.n_theta)
        for output in range(self.regression.n_outputs):
            jacobian = self.jacobian(state, output)
            basis = state.solutions[self.regression.block_of[output]].basis
            direction += jacobian.T @ state.residuals[output] / variances[output]
            jacobian -= basis @ (basis.T @ jacobian)
            information += jacobian.T @ jacobian / variances[output]
        for place, deviation, weight in self.prior_terms(state.theta):
            information[place, place] += weight**2
            direction[place] -= deviation * weight
        return information, direction

    def slope(self, state: _State) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction of the concentrated likelihood."""
        return self.normal_equations(state, state.rss / self.sizes)

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step leads, frequencies moving by at most 10 % and damping staying positive."""
        largest = float(np.max(np.abs(step[: self.n_modes]), initial=0.0))
        return self.clipped(theta + step * min(1.0, 0.1 / max(largest, 1e-300)))

    def clipped(self, theta: FloatArray) -> FloatArray:
        n = self.n_modes
        result = theta.copy()
        result[n : 2 * n] = np.clip(result[n : 2 * n], MIN_DAMPING, MAX_DAMPING)
        place = 2 * n
        if self.latency.is_free:
            result[place] = np.clip(result[place], -MAX_LATENCY_S, MAX_LATENCY_S)
            place += 1
        if self.rate.is_free:
            result[place] = np.clip(result[place], -_MAX_CLOCK_RATE, _MAX_CLOCK_RATE)
        return np.asarray(result)


def fit_modes(
    regression: ModalRegression,
    omegas: FloatArray,
    zetas: FloatArray,
    clock: ClockState,
    latency: Prior,
    clock_rate: Prior,
    max_iterations: int = 40,
    target: float = math.inf,
) -> ModalFit:
    """Fit all parameters of the modal model from a starting point.

    Parameters
    ----------
    regression : ModalRegression
    omegas, zetas : ndarray, shape (n_modes,) -- where to start [rad/s], [-]
    clock : ClockState -- where to start
    latency, clock_rate : Prior
    max_iterations : int -- bound on the accepted steps
    target : float -- cost that must come into sight for the iteration to go on

    Returns
    -------
    ModalFit
        With modes in order of frequency.
    """
    n = len(omegas)
    problem = _Problem(regression, n, latency, clock_rate)
    start = [np.log(omegas), zetas]
    if latency.is_free:
        start.append(np.array([clock.latency]))
    if clock_rate.is_free:
        start.append(np.array([clock.rate]))
    first = problem.state(problem.clipped(np.concatenate(start)))
    return _finish(problem, minimise(problem, first, max_iterations, target))


def _under_coloured_noise(
    problem: _Problem, state: _State, variances: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return the covariance with the autocorrelation of the residuals taken into account.

    ``H^-1 S H^-1 = H^-1 + H^-1 (S - H) H^-1``, S the covariance of the score.
    """
    regression, n_theta = problem.regression, problem.n_theta
    excess = np.zeros_like(covariance)
    place = n_theta
    for output, residuals in enumerate(state.residuals):
        matrix = state.blocks[regression.block_of[output]].matrix
        here = np.concatenate([np.arange(n_theta), np.arange(place, place + matrix.shape[1])])
        place += matrix.shape[1]
        colour = autoregression(residuals)
        if len(colour) == 1:
            continue
        design = np.concatenate([problem.jacobian(state, output), matrix], axis=1)
        correlation = autocorrelation(colour, len(residuals))
        difference = score_covariance(design, correlation) - design.T @ design
        excess[np.ix_(here, here)] += difference / variances[output]
    result = covariance + covariance @ excess @ covariance
    return np.asarray(0.5 * (result + result.T))


def _finish(problem: _Problem, minimum: Minimum[_State]) -> ModalFit:
    state, converged, reason = minimum.state, minimum.converged, minimum.reason
    regression, n, n_theta = problem.regression, problem.n_modes, problem.n_theta
    order = np.argsort(state.theta[:n])
    ranks = np.array([len(state.solutions[b].kept) for b in regression.block_of])
    freedom = problem.sizes - ranks - n_theta / regression.n_outputs
    variances = state.rss / np.maximum(freedom, 1.0)
    information, _ = problem.normal_equations(state, variances)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    condition = float(np.linalg.cond(scaled)) if n_theta else 1.0
    theta_covariance = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    if n_theta and not condition < 1e12:
        converged, reason = False, "the data do not determine all poles: the information matrix is singular"
    sizes = [len(c) for c in state.coefficients]
    covariance = np.zeros((n_theta + sum(sizes), n_theta + sum(sizes)))
    sensitivity = np.zeros((n_theta + sum(sizes), n_theta))
    sensitivity[:n_theta] = np.eye(n_theta)
    place = n_theta
    for output in range(regression.n_outputs):
        solution = state.solutions[regression.block_of[output]]
        here = slice(place, place + sizes[output])
        sensitivity[here] = -solution.coefficients(problem.jacobian(state, output))
        covariance[here, here] = variances[output] * solution.inverse_gram()
        place += sizes[output]
    covariance += sensitivity @ theta_covariance @ sensitivity.T
    if reason != HOPELESS:
        covariance = _under_coloured_noise(problem, state, variances, covariance)
    # Put the modes in order of frequency, in the parameters and in every linear block.
    n_fixed = regression.n_shared_fixed
    permutation = np.arange(len(covariance))
    permutation[:n] = order
    permutation[n : 2 * n] = n + order
    coefficients = []
    place = n_theta
    for output, found in enumerate(state.coefficients):
        local = np.arange(sizes[output])
        local[n_fixed : n_fixed + n] = n_fixed + order
        if regression.structure.has_free_response and n:
            n_own = regression.n_nuisance(n)
            for first in range(n_fixed + n, sizes[output], n_own):
                pairs = np.arange(first + n_own - 2 * n, first + n_own).reshape(n, 2)
                local[pairs.ravel()] = pairs[order].ravel()
        coefficients.append(found[local])
        permutation[place : place + sizes[output]] = place + local
        place += sizes[output]
    deficient = tuple(
        name
        for name, block, size in zip(regression.output_names, regression.block_of, sizes, strict=True)
        if len(state.solutions[block].kept) < size
    )
    return ModalFit(
        omegas=np.exp(state.theta[:n])[order],
        zetas=state.theta[n : 2 * n][order],
        clock=problem.clock(state.theta),
        coefficients=tuple(coefficients),
        residuals=tuple(state.residuals),
        sigmas=np.sqrt(variances),
        cost=state.cost,
        covariance=covariance[np.ix_(permutation, permutation)],
        information_condition=condition,
        input_noise_shares=np.zeros(regression.n_outputs),
        rank_deficient=deficient,
        converged=converged,
        reason=reason,
        iterations=minimum.iterations,
    )
