"""Maximum-likelihood fit of modes: variable projection with exact gradients.

The values of every output j (samples of a record or of a decay, lines of a frequency response) are linear in
gains, residues, offsets and free responses once the poles and the clock, ``theta``, are known; equation numbers are
those of ``docs/likelihood.md``:

    y_j = X_j(theta) b_j + e_j                                                                       (I.7)

For given theta the best ``b_j`` solve a linear least-squares problem (QR on scaled columns). What remains is a
function of theta alone (Golub and Pereyra 1973): with the residuals ``r_j`` of that problem,

    V(theta) = sum_j n_j/2 log |r_j|^2      where the level of the noise is unknown                  (I.8)
    V(theta) = sum_j |r_j|^2 / 2            where rows are divided by the noise's standard deviation

so that every output weighs by its own noise. theta holds ``log omega`` and ``zeta`` of every mode and, where they are
free, latency and clock rate. Levenberg-Marquardt minimises V. A step that does not lower it is never taken,
iterations are bounded, and the result says how it ended. The covariance is the inverse of the full information
matrix, linear parameters included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.prior import Prior
from beam_ident.modal.block_rows import ColumnBlock
from beam_ident.modal.condensed_columns import CondensedColumns, residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState
from beam_ident.noise.autoregression import ScoreCovariance, autoregression
from beam_ident.numerics.levenberg_marquardt import HOPELESS, Minimum, minimise
from beam_ident.numerics.linear_least_squares import LinearSolution

MIN_DAMPING = 1e-6
MAX_DAMPING = 0.95
SINGULAR = 1e12  # condition of the scaled information matrix: beyond it the poles are not determined

_MAX_CLOCK_RATE = 0.1
_NOISE_FLOOR = 1e-10  # of the output's size: where rounding ends what residuals can tell


class ModalProblem(Protocol):
    """Data that are linear in everything but poles and clock: a time record, lines, a decay."""

    @property
    def values(self) -> Sequence[FloatArray]:
        """What was measured, of every output; weighed where the rows are."""

    @property
    def block_of(self) -> Sequence[int]:
        """Which block of columns goes with each output."""

    @property
    def pieces(self) -> Sequence[ModalProblem]:
        """Itself, or the rows piece by piece where all their columns would take too much memory."""

    @property
    def is_noise_known(self) -> bool:
        """Whether rows and values are divided by the noise's standard deviation."""

    @property
    def is_sequence(self) -> bool:
        """Whether neighbouring rows are neighbours in time, so that their noise may be coloured."""

    @property
    def n_forced(self) -> int:
        """Columns of a mode that the input drives; those of its free motion follow."""

    @property
    def max_latency_s(self) -> float:
        """How far a latency may go [s]."""

    @property
    def n_samples(self) -> int:
        """Number of rows, over all outputs."""

    @property
    def n_parameters_of_a_mode(self) -> int:
        """Number of parameters that one more mode adds."""

    def n_columns(self, n_modes: int) -> int:
        """Number of linear parameters of one output."""

    def blocks(
        self, omegas: FloatArray, zetas: FloatArray, clock: ClockState, gradients: bool
    ) -> list[ColumnBlock]:
        """Return the columns of every block, and their derivatives where asked for."""

    def candidates(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[FloatArray]:
        """Return the columns of single modes in every block, each (n_candidates, n_columns of a mode, n_rows)."""


@dataclass(frozen=True, eq=False)
class _State:
    """Everything known at one point of the nonlinear parameters; a long problem is condensed."""

    theta: FloatArray
    cost: float
    coefficients: list[FloatArray]
    residuals: list[FloatArray]
    rss: FloatArray
    blocks: list[ColumnBlock]
    solutions: list[LinearSolution]


class _Likelihood:
    """The cost as a function of the nonlinear parameters."""

    def __init__(self, problem: ModalProblem, n_modes: int, latency: Prior, rate: Prior) -> None:
        self.problem = problem
        self.n_modes = n_modes
        self.latency, self.rate = latency, rate
        self.n_theta = 2 * n_modes + int(latency.is_free) + int(rate.is_free)
        self.is_long = len(problem.pieces) > 1
        self.sizes = np.array([len(v) for v in problem.values], dtype=np.float64)
        scale = np.array([max(float(np.max(np.abs(v))), 1e-300) for v in problem.values])
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
        n, problem = self.n_modes, self.problem
        point = np.exp(theta[:n]), theta[n : 2 * n], self.clock(theta)
        measured = problem.values
        if self.is_long:
            condensed = CondensedColumns.of(problem, *point)
            measured, blocks = condensed.values, condensed.blocks
        else:
            blocks = problem.blocks(*point, gradients=True)
        # One decomposition serves all outputs of a block: X = Q R, b = R^-1 Q^T y, r = (1 - Q Q^T) y.
        solutions = [LinearSolution.of(block.matrix) for block in blocks]
        coefficients, residuals = [], []
        for values, block in zip(measured, problem.block_of, strict=True):
            found = solutions[block].coefficients(values)
            coefficients.append(found)
            residuals.append(values - blocks[block].matrix @ found)
        rss = np.array([float(e @ e) for e in residuals]) + self.floor
        # V of (I.8). A prior on the clock is one more observation, of weight 1 / sd.
        cost = float(0.5 * np.sum(rss if problem.is_noise_known else self.sizes * np.log(rss)))
        cost += 0.5 * sum(deviation**2 for _, deviation, _ in self.prior_terms(theta))
        return _State(theta, cost, coefficients, residuals, rss, blocks, solutions)

    def jacobian(self, state: _State, output: int) -> FloatArray:
        """Return ``J = (dX/dtheta) b``, the derivative of one output's model with b held."""
        block = state.blocks[self.problem.block_of[output]]
        return block.slopes(state.coefficients[output], self.latency.is_free, self.rate.is_free)

    def normal_equations(self, state: _State, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction of the nonlinear parameters.

        Notes
        -----
        With ``P = 1 - Q Q^T`` and ``D = dX/dtheta`` the residuals are ``P y``. Their exact derivative is
        ``-P D b - (P D X^+)^T y`` (Golub and Pereyra 1973, from the derivative of the projector). The second
        term lies in the space of X, at right angles to the first and to the residuals, and is as small as
        they are. Kaufman (1975) leaves it out, which is (I.9), ``dr/dtheta = -P J``. Then

            information = sum_j J_j^T P_j J_j / s_j,    -gradient = sum_j J_j^T P_j r_j / s_j

        with the variances ``s_j = |r_j|^2 / n_j``, or 1 where the rows are weighed. The gradient of V is
        exact all the same. ``J^T P J`` is the Schur complement of ``X^T X`` in the information on theta and b
        together, so that its inverse is the covariance of theta with b unknown.
        """
        information = np.zeros((self.n_theta, self.n_theta))
        direction = np.zeros(self.n_theta)
        for output, residuals in enumerate(state.residuals):
            # r stands at right angles to X: with P J the direction is the same, and what columns that are nearly
            # dependent leave of rounding in r, times their large coefficients in J, is no part of it.
            solution = state.solutions[self.problem.block_of[output]]
            jacobian = solution.left_of(self.jacobian(state, output))
            direction += jacobian.T @ residuals / variances[output]
            information += jacobian.T @ jacobian / variances[output]
        for place, deviation, weight in self.prior_terms(state.theta):
            information[place, place] += weight**2
            direction[place] -= deviation * weight
        return information, direction

    def variances(self, state: _State, paid: FloatArray | float = 0.0) -> FloatArray:
        """Return the noise's variance at every output, ``paid`` rows of each taken up by parameters."""
        if self.problem.is_noise_known:
            return np.ones(len(self.sizes))
        return np.asarray(state.rss / np.maximum(self.sizes - paid, 1.0))

    def slope(self, state: _State) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction of the concentrated likelihood."""
        return self.normal_equations(state, self.variances(state))

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
            farthest = self.problem.max_latency_s
            result[place] = np.clip(result[place], -farthest, farthest)
            place += 1
        if self.rate.is_free:
            result[place] = np.clip(result[place], -_MAX_CLOCK_RATE, _MAX_CLOCK_RATE)
        return np.asarray(result)

    def at_an_end(self, theta: FloatArray) -> str:
        """Return which parameter stands where its search ends, beyond which the likelihood rises; or nothing.

        A damping ratio that ran to zero is left to the gates of the modes.
        """
        n, clock = self.n_modes, self.clock(theta)
        for log_omega, zeta in zip(theta[:n].tolist(), theta[n : 2 * n].tolist(), strict=True):
            if zeta >= MAX_DAMPING:
                return f"the damping ratio at {math.exp(log_omega) / (2.0 * math.pi):.4g} Hz"
        if self.latency.is_free and abs(clock.latency) >= self.problem.max_latency_s:
            return "the latency"
        return "the clock rate" if self.rate.is_free and abs(clock.rate) >= _MAX_CLOCK_RATE else ""


def fit_modes(
    problem: ModalProblem,
    omegas: FloatArray,
    zetas: FloatArray,
    clock: ClockState,
    latency: Prior,
    clock_rate: Prior,
    max_iterations: int = 40,
    target: float = math.inf,
) -> ModalFit:
    """Fit poles, clock and all linear parameters from a starting point.

    Parameters
    ----------
    problem : ModalProblem
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
    likelihood = _Likelihood(problem, len(omegas), latency, clock_rate)
    start = [np.log(omegas), zetas]
    if latency.is_free:
        start.append(np.array([clock.latency]))
    if clock_rate.is_free:
        start.append(np.array([clock.rate]))
    first = likelihood.state(likelihood.clipped(np.concatenate(start)))
    return _finished(likelihood, minimise(likelihood, first, max_iterations, target))


def held_cost(problem: ModalProblem, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> float:
    """Return the cost with poles and clock held, without priors: V of (I.8).

    Parameters
    ----------
    problem : ModalProblem
    omegas, zetas : ndarray, shape (n_modes,) -- [rad/s], [-]
    clock : ClockState
    """
    condensed = CondensedColumns.of(problem, omegas, zetas, clock, gradients=False)
    cost = 0.0
    for values, whole, number in zip(condensed.values, problem.values, problem.block_of, strict=True):
        matrix = condensed.blocks[number].matrix
        left = values - matrix @ LinearSolution.of(matrix).coefficients(values)
        power = max(float(left @ left), 1e-300)
        cost += 0.5 * (power if problem.is_noise_known else len(whole) * math.log(power))
    return cost


def designs(problem: ModalProblem, fit: ModalFit, latency: Prior, clock_rate: Prior) -> list[FloatArray]:
    """Return of every output the derivative of the model by (theta, its linear parameters), (n_rows, ..)."""
    blocks = problem.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
    own = [blocks[block] for block in problem.block_of]
    return [
        np.concatenate([b.slopes(found, latency.is_free, clock_rate.is_free), b.matrix], axis=1)
        for b, found in zip(own, fit.coefficients, strict=True)
    ]


def _under_coloured_noise(
    likelihood: _Likelihood,
    state: _State,
    whole: Sequence[FloatArray],
    variances: FloatArray,
    covariance: FloatArray,
) -> FloatArray:
    """Return the covariance with the autocorrelation of the residuals taken into account.

    The sandwich (I.11), as ``H^-1 + H^-1 (S - H) H^-1``: H is the information under white noise, S the covariance
    of the score under the noise as it is.
    """
    problem, n, n_theta = likelihood.problem, likelihood.n_modes, likelihood.n_theta
    colours = [autoregression(residuals) for residuals in whole]
    sums = {output: ScoreCovariance(colour) for output, colour in enumerate(colours) if len(colour) > 1}
    if not sums:
        return covariance
    theta = state.theta
    for piece in problem.pieces:
        blocks = state.blocks
        if likelihood.is_long:
            point = np.exp(theta[:n]), theta[n : 2 * n], likelihood.clock(theta)
            blocks = piece.blocks(*point, gradients=True)
        for output, own in sums.items():
            block = blocks[problem.block_of[output]]
            slopes = block.slopes(
                state.coefficients[output], likelihood.latency.is_free, likelihood.rate.is_free
            )
            own.add(np.concatenate([slopes, block.matrix], axis=1))
    excess = np.zeros_like(covariance)
    place = n_theta
    for output, found in enumerate(state.coefficients):
        here = np.concatenate([np.arange(n_theta), np.arange(place, place + len(found))])
        place += len(found)
        if output in sums:
            excess[np.ix_(here, here)] += (sums[output].total - sums[output].white) / variances[output]
    result = covariance + covariance @ excess @ covariance
    return np.asarray(0.5 * (result + result.T))


def _finished(likelihood: _Likelihood, minimum: Minimum[_State]) -> ModalFit:
    state, converged, reason = minimum.state, minimum.converged, minimum.reason
    if converged and (ended := likelihood.at_an_end(state.theta)):
        converged, reason = False, f"{ended} ran to the end of its search"
    problem, n, n_theta = likelihood.problem, likelihood.n_modes, likelihood.n_theta
    n_outputs = len(state.residuals)
    solutions = [state.solutions[block] for block in problem.block_of]
    ranks = np.array([len(solution.kept) for solution in solutions])
    variances = likelihood.variances(state, ranks + n_theta / n_outputs)
    information, _ = likelihood.normal_equations(state, variances)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    condition = float(np.linalg.cond(scaled)) if n_theta else 1.0
    theta_covariance = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    if n_theta and not condition < SINGULAR:
        converged, reason = False, "the data do not determine all poles: the information matrix is singular"
    # With theta held, b_j scatters by s_j (X^T X)^-1; a change of theta moves it by B = -X^+ J. Together
    # cov(theta, b) = (1, B)^T cov(theta) (1, B) + diag(0, s_j (X^T X)^-1), the inverse of the full information.
    sizes = [len(c) for c in state.coefficients]
    total = n_theta + sum(sizes)
    covariance, sensitivity = np.zeros((total, total)), np.zeros((total, n_theta))
    sensitivity[:n_theta] = np.eye(n_theta)
    place = n_theta
    for output, solution in enumerate(solutions):
        here = slice(place, place + sizes[output])
        sensitivity[here] = -solution.coefficients(likelihood.jacobian(state, output))
        covariance[here, here] = variances[output] * solution.inverse_gram()
        place += sizes[output]
    covariance += sensitivity @ theta_covariance @ sensitivity.T
    omegas, zetas, clock = np.exp(state.theta[:n]), state.theta[n : 2 * n], likelihood.clock(state.theta)
    residuals = state.residuals
    if likelihood.is_long and reason != HOPELESS:
        residuals = residuals_of(problem, omegas, zetas, clock, state.coefficients)
    if problem.is_sequence and n and reason != HOPELESS:  # nobody asks what is known of no modes
        covariance = _under_coloured_noise(likelihood, state, residuals, variances, covariance)
    # Put the modes in order of frequency, in the parameters and in every output's coefficients.
    order = np.argsort(state.theta[:n])
    permutation = np.arange(total)
    permutation[: 2 * n] = np.concatenate([order, n + order])
    mode_columns = tuple(state.blocks[block].mode_columns for block in problem.block_of)
    coefficients = []
    place = n_theta
    for found, columns in zip(state.coefficients, mode_columns, strict=True):
        local = np.arange(len(found))
        local[columns] = columns[order]
        coefficients.append(found[local])
        permutation[place : place + len(found)] = place + local
        place += len(found)
    return ModalFit(
        omegas=omegas[order],
        zetas=zetas[order],
        clock=clock,
        coefficients=tuple(coefficients),
        mode_columns=mode_columns,
        residuals=tuple(residuals),
        sigmas=np.sqrt(variances),
        cost=state.cost,
        covariance=covariance[np.ix_(permutation, permutation)],
        information_condition=condition,
        input_noise_shares=np.zeros(n_outputs),
        rank_deficient=tuple(np.flatnonzero(ranks < sizes).tolist()),
        converged=converged,
        reason=reason,
        iterations=minimum.iterations,
    )
