"""Maximum-likelihood fit of a transfer function to frequency data.

The start is a rational approximation by Sanathanan and Koerner (1963): linear least squares
for ``B - H A``, repeated with the last ``1/|A|`` as weight.  Where its optimum is none, or leaves more than noise,
vector fitting (``numerics.vector_fitting``) gives further starts, which hold at any order.  Levenberg-Marquardt with
exact gradients minimises the weighted errors of the response itself, holds and folded lines
included (``beam_ident.data.frequency_record.Folding``).  Frequencies are scaled by the geometric
middle of the band.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_frequency_record, require_responses, require_whole_number
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.noise.line_misfit import UNKNOWN_NOISE, LineMisfit, weighting_loss
from beam_ident.noise.line_weights import line_weights, stacked_values
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.levenberg_marquardt import Minimum, minimise
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.vector_fitting import full_poles, relocated_poles, spread_poles
from beam_ident.sensing.line_causes import FittedLines, line_causes
from beam_ident.summary import SummarisedModes, SummaryPart, result_parts
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.structure_gates import information_criterion, structure_complaint
from beam_ident.transfer_function_estimation.estimation import DelayLike, delay_prior

_MAX_POLES = 30
_SK_ITERATIONS = 20
_RELOCATIONS = 20
_COLOURED = 3.0  # standard deviations: what residuals of neighbouring lines may have in common by chance
_ITERATIONS = 60
_DELAY_STEPS = 60
_STARTS = 3
_DEEP = 0.4  # of a period of the highest line: steps in which a delay is looked for


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyTransferFunctionResult(SummarisedModes):
    """A transfer function from frequency data.

    Attributes
    ----------
    model : TransferFunctionModel
    record : FrequencyRecord
    modelled : complex ndarray, shape (n_lines,) -- at the lines, folding included
    misfit : LineMisfit
    converged, reason, iterations
        How the fit ended.
    warnings : tuple of str
    """

    model: TransferFunctionModel
    record: FrequencyRecord
    modelled: ComplexArray
    misfit: LineMisfit
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, (self.model,), (self.model.output_name,))

    @property
    def residuals(self) -> ComplexArray:
        """Response less what the model says, shape (n_lines,); NaN where none was measured."""
        return np.asarray(self.record.response[:, 0, 0] - self.modelled)


@dataclass(frozen=True, eq=False)
class _State:
    theta: FloatArray
    cost: float
    lines: ComplexArray
    residuals: FloatArray
    gradient: FloatArray


class _Likelihood:
    """Half the sum of squared weighted errors, as a function of scaled coefficients and delay."""

    def __init__(self, record: FrequencyRecord, n_poles: int, n_zeros: int, delay: Prior) -> None:
        self.n, self.m, self.delay = n_poles, n_zeros, delay
        self.scale = math.sqrt(float(record.omegas[0] * record.omegas[-1]))
        self.s = record.s[:, None] / self.scale
        self.fold = np.ones(self.s.shape, dtype=np.complex128)
        self.tails: ComplexArray | None = None
        if record.folding is not None:
            self.s = np.concatenate([self.s, 1j * record.folding.omegas / self.scale], axis=1)
            self.fold = np.concatenate([self.fold, record.folding.weights], axis=1)
            # 1 / s^k in scaled frequency.
            self.tails = record.folding.tails[:, 2:] * self.scale ** np.arange(3)
        # s^max(n, m) .. s^0: every state needs them all.
        self.powers = self.s[:, :, None] ** np.arange(max(n_poles, n_zeros), -1, -1)
        self.response = record.response[:, 0, 0]
        self.weights = line_weights(record, 0, 0)
        self.values = stacked_values(self.response)
        self.is_known = record.variance is not None
        self.n_theta = n_poles + n_zeros + 1 + int(delay.is_free)
        self.n_rows = int(np.count_nonzero(self.weights))
        weighted = self.weights * self.values
        self.floor = float(weighted @ weighted) * 1e-26 + 1e-300

    def lag(self, theta: FloatArray) -> float:
        """Return the delay in scaled time."""
        return float(theta[-1]) if self.delay.is_free else self.delay.mean * self.scale

    def _polynomial(self, coefficients: FloatArray) -> ComplexArray:
        """Return a polynomial at all frequencies, from its coefficients in descending powers."""
        return np.asarray(self.powers[:, :, self.powers.shape[2] - len(coefficients) :] @ coefficients)

    def state(self, theta: FloatArray) -> _State:
        n, m = self.n, self.m
        a = np.concatenate([[1.0], theta[:n]])
        b = theta[n : n + m + 1]
        lines = np.zeros(0, dtype=np.complex128)
        if not np.all(np.isfinite(theta)) or (n and np.max(np.roots(a).real) >= 0.0):
            return _State(theta, math.inf, lines, np.zeros(0), np.zeros((0, 0)))
        inverse = 1.0 / self._polynomial(a)
        lag = self.lag(theta)
        terms = self.fold * inverse
        if lag:
            terms = terms * np.exp(-self.s * lag)
        values = self._polynomial(b) * terms
        width = self.powers.shape[2]
        by_a = np.einsum("lc,lck->lk", -values * inverse, self.powers[:, :, width - n :])
        by_b = np.einsum("lc,lck->lk", terms, self.powers[:, :, width - m - 1 :])
        lines = np.sum(values, axis=1)
        gradient = np.concatenate([by_a, by_b], axis=1)
        if self.tails is not None:
            expansion, by_theta = self._expansion(a, b)
            lines = lines + self.tails @ expansion
            gradient = gradient + self.tails @ by_theta
        if self.delay.is_free:
            gradient = np.concatenate([gradient, np.sum(-self.s * values, axis=1)[:, None]], axis=1)
        residuals = self.weights * (self.values - np.concatenate([lines.real, lines.imag]))
        stacked = self.weights[:, None] * np.concatenate([gradient.real, gradient.imag])
        rss = float(residuals @ residuals) + self.floor
        cost = 0.5 * rss if self.is_known else 0.5 * self.n_rows * math.log(rss)
        if self.delay.is_free and math.isfinite(self.delay.sd):
            cost += 0.5 * ((self.lag(theta) / self.scale - self.delay.mean) / self.delay.sd) ** 2
        return _State(theta, cost, lines, residuals, stacked)

    def _expansion(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the first three terms of B/A in powers of 1/s, and their derivatives by (a, b)."""
        n, m = self.n, self.m
        padded = np.zeros(n + 1)
        padded[n - m :] = b
        terms, slopes = np.zeros(3), np.zeros((3, n + m + 1))
        for k in range(3):
            if k <= n:
                terms[k] += padded[k]
                if k >= n - m:
                    slopes[k, n + k - (n - m)] += 1.0
            for i in range(1, min(k, n) + 1):
                terms[k] -= a[i] * terms[k - i]
                slopes[k] -= a[i] * slopes[k - i]
                slopes[k, i - 1] -= terms[k - i]
        return terms, slopes

    def variance(self, state: _State) -> float:
        rss = float(state.residuals @ state.residuals) + self.floor
        return 1.0 if self.is_known else rss / max(self.n_rows - self.n_theta, 1)

    def slope(self, state: _State) -> tuple[FloatArray, FloatArray]:
        variance = self.variance(state)
        information = state.gradient.T @ state.gradient / variance
        direction = state.gradient.T @ state.residuals / variance
        if self.delay.is_free and math.isfinite(self.delay.sd):
            sd = self.delay.sd * self.scale
            information[-1, -1] += sd**-2
            direction[-1] -= (state.theta[-1] - self.delay.mean * self.scale) / sd**2
        return information, direction

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        return np.asarray(theta + step)

    def start(self, delay_s: float) -> FloatArray:
        """Return coefficients by Sanathanan and Koerner's iteration for a delay [s]."""
        n, m = self.n, self.m
        s = self.s[:, 0]
        seen = self.weights[: len(s)] > 0.0
        s, weight = s[seen], self.weights[: len(self.s)][seen]
        response = self.response[seen] * np.exp(s * delay_s * self.scale)
        powers = s[:, None] ** np.arange(max(n, m), -1, -1)
        bottom, top = powers[:, -n:] if n else powers[:, :0], powers[:, powers.shape[1] - m - 1 :]
        best, best_cost = np.zeros(0), math.inf
        size = np.ones(len(s))
        for _ in range(_SK_ITERATIONS):
            rows = np.concatenate([-response[:, None] * bottom, top], axis=1) * (weight / size)[:, None]
            right = response * s**n * weight / size
            matrix = np.concatenate([rows.real, rows.imag])
            scale = np.linalg.norm(matrix, axis=0)
            scale[scale == 0.0] = 1.0
            found = (
                np.linalg.lstsq(matrix / scale, np.concatenate([right.real, right.imag]), rcond=1e-13)[0]
                / scale
            )
            a = _stable(np.concatenate([[1.0], found[:n]]))
            theta = np.concatenate([a[1:], found[n:]])
            if self.delay.is_free:
                theta = np.append(theta, delay_s * self.scale)
            cost = self.state(theta).cost
            if cost < best_cost:
                best, best_cost = theta, cost
            size = np.maximum(np.abs(np.polyval(a, s)), 1e-12)
        return best

    def relocated(self, delay_s: float, is_geometric: bool) -> FloatArray:
        """Return coefficients by vector fitting for a delay [s], from poles spread over the band."""
        s, seen = self.s[:, 0], self.weights[: len(self.s)] > 0.0
        s, weight = s[seen], self.weights[: len(self.s)][seen]
        response = np.asarray(self.response[seen] * np.exp(s * delay_s * self.scale), dtype=np.complex128)
        powers = s[:, None] ** np.arange(self.m, -1, -1)
        best, best_cost = np.zeros(0), math.inf
        start = spread_poles(np.asarray(s.imag), self.n, is_geometric)
        moves = relocated_poles(s.astype(np.complex128), response, weight, start, self.m == self.n)
        for uppers in itertools.islice(moves, _RELOCATIONS):
            # The numerator is linear in the response for given poles.
            inverse = weight / np.prod(s[:, None] - full_poles(uppers), axis=1)
            rows = powers * inverse[:, None]
            right = stacked_values(weight * response)
            found = LinearSolution.of(np.concatenate([rows.real, rows.imag])).coefficients(right)
            a = np.real(np.poly(full_poles(uppers)))
            theta = np.concatenate([a[1:], found, [delay_s * self.scale] * self.delay.is_free])
            cost = self.state(theta).cost
            if cost < best_cost:
                best, best_cost = theta, cost
        return best

    def misfit(self, state: _State, freedom: float) -> LineMisfit:
        """Return what a state leaves against what noise alone would, which has a number of degrees of freedom."""
        if not self.is_known:
            return UNKNOWN_NOISE
        chi_squared = float(state.residuals @ state.residuals)
        return LineMisfit.of(chi_squared, self.n_rows, self.n_theta, 1, freedom)

    def leaves_noise(self, state: _State, freedom: float) -> bool:
        """Return whether what a state leaves looks like noise: by its size, or by what neighbouring lines share."""
        if self.is_known:
            return self.misfit(state, freedom).is_noise
        lines = len(self.weights) // 2
        errors = (state.residuals[:lines] + 1j * state.residuals[lines:])[self.weights[:lines] > 0.0]
        shared = abs(np.vdot(errors[1:], errors[:-1])) / max(float(np.vdot(errors, errors).real), 1e-300)
        return bool(shared * math.sqrt(len(errors)) < _COLOURED)

    def delays(self, record: FrequencyRecord) -> FloatArray:
        """Return where a free delay is looked for [s]."""
        if not self.delay.is_free:
            return np.array([self.delay.mean])
        hertz = record.frequencies_hz
        step = _DEEP / float(hertz[-1])
        widest = 0.5 / float(np.min(np.diff(hertz))) if len(hertz) > 1 else step
        if math.isfinite(self.delay.sd):
            reach = min(3.0 * self.delay.sd, 0.5 * _DELAY_STEPS * step)
            return np.asarray(np.arange(self.delay.mean - reach, self.delay.mean + reach + step, step))
        return np.asarray(step * np.arange(min(_DELAY_STEPS, max(int(widest / step), 1))))


def _lowest(minima: list[Minimum[_State]]) -> Minimum[_State]:
    return min(minima, key=lambda minimum: minimum.state.cost)


def _stable(a: FloatArray) -> FloatArray:
    roots = np.roots(a)
    if not len(roots) or np.max(roots.real) < 0.0:
        return a
    floor = -1e-6 * np.maximum(np.abs(roots), 1e-6)
    return np.asarray(np.real(np.poly(np.minimum(-np.abs(roots.real), floor) + 1j * roots.imag)))


def _require_resolved(delay: Prior, record: FrequencyRecord) -> None:
    """Raise EstimationError for a delay longer than the period that the closest two lines have together."""
    if record.n_lines < 2:
        return
    longest = 1.0 / float(np.min(np.diff(record.frequencies_hz)))
    if delay.mean > longest:
        raise EstimationError(
            f"the delay is {delay.mean:.6g} s; lines {1.0 / longest:.4g} Hz apart cannot separate delays that differ "
            f"by {longest:.6g} s. Subtract a whole number of these, or measure over a longer time"
        )


@on_one_thread
def fit_frequency_transfer_function(
    record: FrequencyRecord, n_poles: int, n_zeros: int, delay: DelayLike = 0.0
) -> FrequencyTransferFunctionResult:
    """Fit ``B(s)/A(s) e^(-sT)`` to frequency data of one input and one output.

    Parameters
    ----------
    record : FrequencyRecord
    n_poles, n_zeros : int -- degrees of A and B, ``0 <= n_zeros <= n_poles``
    delay : float, Prior or "estimate"
        The delay T [s] where it is known, or what is known of it; "estimate" is ``Prior(0, inf)`` and looks for it
        up to sixty steps of 0.4 / (highest frequency).

    Raises
    ------
    EstimationError
        Several inputs or outputs, degrees that do not fit, fewer lines than unknowns, a delay below 0
        or longer than the time that the lines resolve.
    """
    require_frequency_record(record)
    if record.n_outputs != 1 or record.n_inputs != 1:
        raise EstimationError(
            f"frequency record {record.name!r} has {record.n_outputs} outputs and {record.n_inputs} inputs; a "
            "transfer function takes one of each. Use select()"
        )
    for what, value in (("n_poles", n_poles), ("n_zeros", n_zeros)):
        require_whole_number(what, value, 0)
    if not (1 <= n_poles <= _MAX_POLES and n_zeros <= n_poles):
        raise EstimationError(
            f"{n_poles} poles and {n_zeros} zeros; expected 1 to {_MAX_POLES} poles, and no more zeros"
        )
    require_responses(record)
    prior = delay_prior(delay)
    _require_resolved(prior, record)
    likelihood = _Likelihood(record, n_poles, n_zeros, prior)
    if likelihood.n_rows < 2 * likelihood.n_theta:
        raise EstimationError(
            f"{likelihood.n_rows // 2} measured lines for {likelihood.n_theta} unknowns; expected at least "
            f"{likelihood.n_theta} lines. Ask for fewer poles"
        )
    starts = [likelihood.start(float(value)) for value in likelihood.delays(record)]
    states = sorted((likelihood.state(s) for s in starts if len(s)), key=lambda state: state.cost)[:_STARTS]
    if not states or not math.isfinite(states[0].cost):
        raise EstimationError(
            "no stable start was found; the response may be constant, or the order too high"
        )
    minima = [minimise(likelihood, state, _ITERATIONS) for state in states[: _STARTS if prior.is_free else 1]]
    found = _lowest(minima)
    if not (found.converged and likelihood.leaves_noise(found.state, record.degrees_of_freedom)):
        lag = likelihood.lag(found.state.theta) / likelihood.scale
        others = (likelihood.relocated(lag, is_geometric) for is_geometric in (True, False))
        minima += [
            minimise(likelihood, likelihood.state(theta), _ITERATIONS) for theta in others if len(theta)
        ]
        found = _lowest(minima)
    state, converged, reason = found.state, found.converged, found.reason
    information, _ = likelihood.slope(state)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(unit, unit)
    if not np.linalg.cond(scaled) < 1e13:
        converged, reason = (
            False,
            "the lines do not determine all coefficients: the information matrix is singular",
        )
    covariance = np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(unit, unit)
    misfit = likelihood.misfit(state, record.degrees_of_freedom)
    if record.variance is not None:
        noise = math.sqrt(float(np.nanmean(record.variance)))
    else:
        noise = math.sqrt(2.0 * likelihood.variance(state)) / max(float(np.max(likelihood.weights)), 1e-300)
    covariance = covariance * (weighting_loss(record.degrees_of_freedom) * misfit.inflation)
    n, m, scale = n_poles, n_zeros, likelihood.scale
    units = np.concatenate(
        [scale ** np.arange(1.0, n + 1.0), scale ** (n - m + np.arange(m + 1.0)), [1.0 / scale]]
    )
    whole = np.zeros((n + m + 2, n + m + 2))
    size = likelihood.n_theta
    whole[:size, :size] = covariance
    theta = state.theta
    model = TransferFunctionModel(
        numerator=theta[n : n + m + 1] * units[n : n + m + 1],
        denominator=np.concatenate([[1.0], theta[:n] * units[:n]]),
        delay=likelihood.lag(theta) / scale,
        covariance=whole * np.outer(units, units),
        noise_sd=noise,
        input_name=record.input_names[0],
        output_name=record.output_names[0],
    )
    warnings = [misfit.warning] if misfit.warning else []
    lines = FittedLines.of(record, stacked_values(state.lines)[:, None], [state.residuals], [state.gradient])
    warnings += line_causes(lines, likelihood.is_known)
    warnings += record.fit_warnings
    if not converged:
        warnings.append(f"the fit did not converge: {reason}")
    seen = likelihood.weights > 0.0
    of_nothing = information_criterion([(likelihood.weights * likelihood.values)[seen]], 0)
    if not information_criterion([state.residuals[seen]], size) < of_nothing:
        warnings.append("the model explains no more than chance would: BIC prefers no model")
    complaint = structure_complaint(model)
    if complaint:
        warnings.append(complaint)
    return FrequencyTransferFunctionResult(
        model, record, state.lines, misfit, converged, reason, found.iterations, tuple(warnings)
    )
