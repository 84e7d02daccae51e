"""Maximum likelihood over poles: the linear parameters are projected out.

Frequency responses and free decays are linear in residues and static terms once the
poles are known.  ``PoleProblem`` states what such a problem consists of: for every mode, columns
that depend on its natural frequency and damping alone, and for every block (an output, or a
pair of output and input) values and weights.  ``fit_poles`` then runs Levenberg-Marquardt on
``log omega``, ``zeta`` and, where it is free, a latency, with the Jacobian projected onto the
complement of the linear columns (Golub and Pereyra 1973, Kaufman's form); ``scan_poles`` finds
where a further mode would lower the cost most.

Where the noise is known, the cost is half the sum of squared weighted residuals; where it
is not, every block is concentrated over its own noise, ``n/2 log RSS``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.prior import Prior
from beam_ident.modal_estimation.variable_projection import MAX_DAMPING, MIN_DAMPING
from beam_ident.numerics.levenberg_marquardt import Minimum, minimise
from beam_ident.numerics.linear_least_squares import LinearSolution

_NOISE_FLOOR = 1e-10  # of a block's weighted size: where rounding ends what residuals can tell


@dataclass(frozen=True, eq=False)
class Columns:
    """Real columns of one mode (or the fixed ones) with their derivatives, each (n_rows, n_columns)."""

    value: FloatArray
    by_log_omega: FloatArray
    by_zeta: FloatArray
    by_latency: FloatArray


class PoleBasis(Protocol):
    """Rows that share columns: the lines of a record, the samples of a decay."""

    def fixed(self, latency: float) -> Columns:
        """Return the columns that no mode touches (derivatives by a mode are not used)."""

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return the columns of one mode."""

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return the columns of many candidate modes, shape (n_rows, n_candidates, n_columns)."""


@dataclass(frozen=True, eq=False)
class Part:
    """What one record holds of a block: rows of a basis, measured values and weights, each (n_rows,)."""

    basis: int
    values: FloatArray
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class PoleProblem:
    """A set of blocks over shared bases.

    Attributes
    ----------
    bases : tuple of PoleBasis
    blocks : tuple of tuple of Part -- linear parameters are common to the parts of a block
    is_noise_known : bool -- whether weights are one over the noise's standard deviation
    latency : Prior
    """

    bases: tuple[PoleBasis, ...]
    blocks: tuple[tuple[Part, ...], ...]
    is_noise_known: bool = True
    latency: Prior = Prior()  # noqa: RUF009 -- frozen

    @property
    def n_rows(self) -> int:
        """Number of real equations."""
        return sum(len(part.values) for block in self.blocks for part in block)


@dataclass(frozen=True, eq=False)
class PoleFit:
    """The estimate and how it came about.

    Attributes
    ----------
    omegas, zetas : ndarray, shape (n_modes,) -- in order of frequency
    latency : float
    coefficients : ndarray, shape (n_blocks, n_fixed + n_modes * n_columns)
    residuals : tuple of ndarray -- weighted, of every block
    variances : ndarray, shape (n_blocks,) -- of the weighted residuals; 1 where the noise is known
    cost : float -- negative log-likelihood, up to a constant
    covariance : ndarray
        Of (log omega.., zeta.., latency if free, coefficients of block 1, ..).
    jacobians : tuple of ndarray
        Derivative of the weighted model of every block by (poles, latency, its coefficients).
    condition : float -- of the scaled information matrix of poles and latency
    converged, reason, iterations
        How the fit ended.
    n_columns : int -- columns of every mode
    """

    omegas: FloatArray
    zetas: FloatArray
    latency: float
    coefficients: FloatArray
    residuals: tuple[FloatArray, ...]
    variances: FloatArray
    cost: float
    covariance: FloatArray
    jacobians: tuple[FloatArray, ...]
    condition: float
    converged: bool
    reason: str
    iterations: int

    n_columns: int

    @property
    def n_parameters(self) -> int:
        """Number of estimated parameters."""
        return len(self.covariance)


@dataclass(frozen=True, eq=False)
class _State:
    theta: FloatArray
    cost: float
    fixed: list[Columns]
    modes: list[list[Columns]]
    solutions: list[LinearSolution]
    coefficients: list[FloatArray]
    residuals: list[FloatArray]
    rss: FloatArray


class _Likelihood:
    """The cost as a function of poles and latency."""

    def __init__(self, problem: PoleProblem, n_modes: int) -> None:
        self.problem, self.n_modes = problem, n_modes
        self.is_late = problem.latency.is_free
        self.n_theta = 2 * n_modes + int(self.is_late)
        self.sizes = np.array(
            [sum(len(p.values) for p in block) for block in problem.blocks], dtype=np.float64
        )
        self.values = [np.concatenate([p.weights * p.values for p in block]) for block in problem.blocks]
        self.floors = np.array([float(v @ v) for v in self.values]) * _NOISE_FLOOR**2 + 1e-300

    def latency(self, theta: FloatArray) -> float:
        return float(theta[2 * self.n_modes]) if self.is_late else self.problem.latency.mean

    def stacked(self, block: int, parts: list[FloatArray]) -> FloatArray:
        """Return weighted rows of a block from arrays given for every basis."""
        return np.concatenate([p.weights[:, None] * parts[p.basis] for p in self.problem.blocks[block]])

    def state(self, theta: FloatArray) -> _State:
        n, late = self.n_modes, self.latency(theta)
        omegas, zetas = np.exp(theta[:n]), theta[n : 2 * n]
        bases = self.problem.bases
        fixed = [basis.fixed(late) for basis in bases]
        modes = [
            [basis.modal(float(w), float(z), late) for w, z in zip(omegas, zetas, strict=True)]
            for basis in bases
        ]
        plain = [
            np.concatenate([f.value, *(m.value for m in own)], axis=1)
            for f, own in zip(fixed, modes, strict=True)
        ]
        solutions, coefficients, residuals = [], [], []
        for block, values in enumerate(self.values):
            matrix = self.stacked(block, plain)
            solution = LinearSolution.of(matrix)
            found = solution.coefficients(values)
            solutions.append(solution)
            coefficients.append(found)
            residuals.append(values - matrix @ found)
        rss = np.array([float(e @ e) for e in residuals]) + self.floors
        if self.problem.is_noise_known:
            cost = 0.5 * float(np.sum(rss))
        else:
            cost = 0.5 * float(np.sum(self.sizes * np.log(rss)))
        prior = self.problem.latency
        if self.is_late and math.isfinite(prior.sd):
            cost += 0.5 * ((late - prior.mean) / prior.sd) ** 2
        return _State(theta, cost, fixed, modes, solutions, coefficients, residuals, rss)

    def jacobian(self, state: _State, block: int) -> FloatArray:
        """Return the derivative of a block's weighted model by poles and latency, (n_rows, n_theta)."""
        n, found = self.n_modes, state.coefficients[block]
        parts = []
        for fixed, modes in zip(state.fixed, state.modes, strict=True):
            n_fixed = fixed.value.shape[1]
            result = np.empty((len(fixed.value), self.n_theta))
            late = fixed.by_latency @ found[:n_fixed] if self.is_late else np.zeros(0)
            place = n_fixed
            for k, mode in enumerate(modes):
                share = found[place : place + mode.value.shape[1]]
                place += len(share)
                result[:, k] = mode.by_log_omega @ share
                result[:, n + k] = mode.by_zeta @ share
                if self.is_late:
                    late = late + mode.by_latency @ share
            if self.is_late:
                result[:, 2 * n] = late
            parts.append(result)
        return self.stacked(block, parts)

    def variances(self, state: _State) -> FloatArray:
        if self.problem.is_noise_known:
            return np.ones(len(self.sizes))
        return np.asarray(state.rss / self.sizes)

    def normal_equations(self, state: _State, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        information, direction = np.zeros((self.n_theta, self.n_theta)), np.zeros(self.n_theta)
        for block, residuals in enumerate(state.residuals):
            jacobian = self.jacobian(state, block)
            direction += jacobian.T @ residuals / variances[block]
            basis = state.solutions[block].basis
            jacobian = jacobian - basis @ (basis.T @ jacobian)
            information += jacobian.T @ jacobian / variances[block]
        prior = self.problem.latency
        if self.is_late and math.isfinite(prior.sd):
            information[-1, -1] += prior.sd**-2
            direction[-1] -= (state.theta[-1] - prior.mean) / prior.sd**2
        return information, direction

    def slope(self, state: _State) -> tuple[FloatArray, FloatArray]:
        return self.normal_equations(state, self.variances(state))

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        largest = float(np.max(np.abs(step[: self.n_modes]), initial=0.0))
        return self.clipped(theta + step * min(1.0, 0.1 / max(largest, 1e-300)))

    def clipped(self, theta: FloatArray) -> FloatArray:
        n, result = self.n_modes, theta.copy()
        result[n : 2 * n] = np.clip(result[n : 2 * n], MIN_DAMPING, MAX_DAMPING)
        return np.asarray(result)


def fit_poles(
    problem: PoleProblem,
    omegas: FloatArray,
    zetas: FloatArray,
    latency: float | None = None,
    max_iterations: int = 40,
) -> PoleFit:
    """Fit poles and all linear parameters from a starting point.

    Parameters
    ----------
    problem : PoleProblem
    omegas, zetas : ndarray, shape (n_modes,) -- where to start [rad/s], [-]
    latency : float or None -- where to start [s]; None takes the prior's mean
    max_iterations : int -- bound on the iterations
    """
    n = len(omegas)
    likelihood = _Likelihood(problem, n)
    start = [np.log(omegas), np.asarray(zetas, dtype=np.float64)]
    if likelihood.is_late:
        start.append(np.array([problem.latency.mean if latency is None else latency]))
    first = likelihood.state(likelihood.clipped(np.concatenate(start)))
    return _finished(likelihood, minimise(likelihood, first, max_iterations))


def scan_poles(problem: PoleProblem, fit: PoleFit, omegas: FloatArray, zetas: FloatArray) -> FloatArray:
    """Return by how much each candidate mode would lower the cost, with all poles held.

    Parameters
    ----------
    problem : PoleProblem
    fit : PoleFit -- the modes there are
    omegas, zetas : ndarray, shape (n_candidates,)
    """
    likelihood = _Likelihood(problem, len(fit.omegas))
    theta = [np.log(fit.omegas), fit.zetas] + ([np.array([fit.latency])] if likelihood.is_late else [])
    state = likelihood.state(np.concatenate(theta))
    candidates = [basis.scanned(omegas, zetas, fit.latency) for basis in problem.bases]
    n_columns = candidates[0].shape[2]
    flat = [c.reshape(len(c), -1) for c in candidates]
    squares = [c**2 for c in flat] if n_columns == 1 else []
    gain = np.zeros(len(omegas))
    for block, residuals in enumerate(state.residuals):
        basis = state.solutions[block].basis
        if n_columns == 1:
            lowered = _lowered(problem.blocks[block], flat, squares, residuals, basis)
        else:
            columns = likelihood.stacked(block, flat)
            columns = columns - basis @ (basis.T @ columns)
            along = (residuals @ columns).reshape(-1, n_columns)
            shaped = columns.reshape(len(columns), -1, n_columns)
            gram = np.einsum("rka,rkb->kab", shaped, shaped)
            gram += 1e-10 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(
                n_columns
            ) + 1e-300 * np.eye(n_columns)
            lowered = np.einsum("ka,ka->k", along, np.linalg.solve(gram, along[:, :, None])[:, :, 0])
        if problem.is_noise_known:
            gain += 0.5 * lowered
        else:
            share = np.clip(lowered / state.rss[block], 0.0, 1.0 - 1e-12)
            gain -= 0.5 * likelihood.sizes[block] * np.log1p(-share)
    return gain


def _lowered(
    block: tuple[Part, ...],
    candidates: list[FloatArray],
    squares: list[FloatArray],
    residuals: FloatArray,
    basis: FloatArray,
) -> FloatArray:
    """Return by how much single columns lower a block's sum of squares, none of them weighted or projected itself."""
    count, first = candidates[0].shape[1], 0
    size, along, within = np.zeros(count), np.zeros(count), np.zeros((basis.shape[1], count))
    for part in block:
        rows = slice(first, first + len(part.values))
        first += len(part.values)
        size = size + part.weights**2 @ squares[part.basis]
        along = along + (part.weights * residuals[rows]) @ candidates[part.basis]
        within = within + (part.weights[:, None] * basis[rows]).T @ candidates[part.basis]
    # The residuals are orthogonal to the basis already.
    power = size - np.sum(np.square(within), axis=0)
    # A candidate that the present columns already span would divide rounding by rounding.
    power = np.where(power > 1e-10 * size, power, np.inf)
    return np.asarray(np.square(along) / power)


def _finished(likelihood: _Likelihood, minimum: Minimum[_State]) -> PoleFit:
    state, n, n_theta = minimum.state, likelihood.n_modes, likelihood.n_theta
    n_blocks = len(likelihood.sizes)
    if likelihood.problem.is_noise_known:
        variances = np.ones(n_blocks)
    else:
        ranks = np.array([len(s.kept) for s in state.solutions])
        variances = state.rss / np.maximum(likelihood.sizes - ranks - n_theta / n_blocks, 1.0)
    information, _ = likelihood.normal_equations(state, variances)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    condition = float(np.linalg.cond(scaled)) if n_theta else 1.0
    of_theta = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    # Modes in order of frequency, in the poles and in every block's coefficients.
    order = np.argsort(state.theta[:n])
    n_fixed = state.fixed[0].value.shape[1]
    n_columns = state.modes[0][0].value.shape[1] if n else 0
    local = np.concatenate(
        [np.arange(n_fixed), *(n_fixed + k * n_columns + np.arange(n_columns) for k in order)]
    ).astype(np.intp)
    poles = np.concatenate([order, n + order, np.arange(2 * n, n_theta)]).astype(np.intp)
    size = n_theta + n_blocks * len(local)
    covariance, sensitivity = np.zeros((size, size)), np.zeros((size, n_theta))
    sensitivity[:n_theta] = np.eye(n_theta)[poles]
    jacobians = []
    for block, solution in enumerate(state.solutions):
        jacobian = likelihood.jacobian(state, block)
        here = n_theta + block * len(local) + np.arange(len(local))
        covariance[np.ix_(here, here)] = variances[block] * solution.inverse_gram()[np.ix_(local, local)]
        sensitivity[here] = -solution.coefficients(jacobian)[local]
        plain = [
            np.concatenate([f.value, *(m.value for m in own)], axis=1)
            for f, own in zip(state.fixed, state.modes, strict=True)
        ]
        matrix = likelihood.stacked(block, plain)
        jacobians.append(np.concatenate([jacobian[:, poles], matrix[:, local]], axis=1))
    covariance += sensitivity @ of_theta @ sensitivity.T
    converged, reason = minimum.converged, minimum.reason
    if n_theta and not condition < 1e12:
        converged, reason = False, "the data do not determine all poles: the information matrix is singular"
    return PoleFit(
        omegas=np.exp(state.theta[:n])[order],
        zetas=state.theta[n : 2 * n][order],
        latency=likelihood.latency(state.theta),
        coefficients=np.array([c[local] for c in state.coefficients]),
        residuals=tuple(state.residuals),
        variances=variances,
        cost=state.cost,
        covariance=covariance,
        jacobians=tuple(jacobians),
        condition=condition,
        converged=converged,
        reason=reason,
        iterations=minimum.iterations,
        n_columns=n_columns,
    )
