"""Direct estimation of B(s)/A(s) from sampled data: state-variable filters, SRIVC, output error.

The chain that needs no hints: state-variable-filter least squares (LSSVF) and instrumental
variables (IVSVF) over a portfolio of cut-offs and a subspace estimate (PO-MOESP), of which the
best by simulated cost go on; the simplified refined instrumental variable (SRIVC; Young and
Jakeman 1980); and Levenberg-Marquardt on the output error with the same exact gradients to
finish.  Instruments and
gradients are exact responses of ``s^i B / A^2`` to the held input, so that SRIVC's fixed
point is the stationary point of the output-error cost; the interpolation of the
*measured* output inside the filters only affects the way there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beam_ident.blas_threads import on_one_thread
from beam_ident.errors import EstimationError
from beam_ident.levenberg_marquardt import minimise
from beam_ident.linear_solution import LinearSolution
from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial
from beam_ident.rational_response import RationalResponse, full_roots, upper_roots
from beam_ident.records import TimeRecord
from beam_ident.subspace import subspace_poles
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.validation import Scores, Whiteness

Method = Literal["auto", "srivc", "ivsvf", "lssvf"]
METHODS: tuple[Method, ...] = ("auto", "srivc", "ivsvf", "lssvf")

ComplexArray = NDArray[np.complex128]

_MIN_SAMPLES = 20
_SRIVC_ITERATIONS = 20
_PORTFOLIO = 7
_FINALISTS = 3
_NOISE_FLOOR = 1e-11


@dataclass(frozen=True, eq=False)
class TransferFunctionResult:
    """A transfer function and what is to be known about its estimation.

    Attributes
    ----------
    model : TransferFunctionModel
    method : str -- which estimator the numbers come from
    times_s, measured, modelled, residuals : ndarray, shape (n_used,)
    scores : Scores
    whiteness : Whiteness
    bic, yic : float
        Bayesian information criterion, and Young's information criterion
        ``ln(var e / var y) + ln(mean(var a_i / a_i^2))``, which the literature tabulates.
    condition : float -- of the scaled information matrix
    converged : bool
    reason : str
    iterations : int
    offset, ramp : float -- at the middle of the record, and over its whole length
    """

    model: TransferFunctionModel
    method: Method
    times_s: FloatArray
    measured: FloatArray
    modelled: FloatArray
    residuals: FloatArray
    scores: Scores
    whiteness: Whiteness
    bic: float
    yic: float
    condition: float
    converged: bool
    reason: str
    iterations: int
    offset: float
    ramp: float


@on_one_thread
def estimate_transfer_function(
    record: TimeRecord,
    n_poles: int,
    n_zeros: int,
    method: Method = "auto",
    has_offset: bool = False,
    has_ramp: bool = False,
    has_free_response: bool = False,
    delay: float = 0.0,
    input_name: str | None = None,
    output_name: str | None = None,
    cutoff: float | None = None,
) -> TransferFunctionResult:
    """Estimate B(s)/A(s) from one input to one output.

    Parameters
    ----------
    record : TimeRecord
    n_poles, n_zeros : int -- degrees of A and B, with n_zeros <= n_poles
    method : {"auto", "srivc", "ivsvf", "lssvf"}
        "auto" goes the whole way to the output-error optimum; the others stop at the
        estimator they name (LSSVF is biased under noise, IVSVF is not efficient).
    has_offset, has_ramp, has_free_response : bool
        Unknown constant, drift, and initial state, estimated along with the rest.
    delay : float -- known pure delay [s]
    input_name, output_name : str or None -- which signals, where there are several
    cutoff : float or None
        Cut-off of the state-variable filter [rad/s]; None tries a portfolio.

    Raises
    ------
    EstimationError
        Impossible degrees, too few samples, a constant output, an input at rest.
    """
    if method not in METHODS:
        raise EstimationError(f"method is {method!r}; expected one of {', '.join(METHODS)}")
    if not 1 <= n_poles <= 20 or not 0 <= n_zeros <= n_poles:
        raise EstimationError(
            f"{n_poles} poles and {n_zeros} zeros; expected 1 to 20 poles and no more zeros than poles "
            "(beyond that use the additive modal form: identify())"
        )
    problem = _OutputError(
        record, n_poles, n_zeros, (has_offset, has_ramp, has_free_response), delay, input_name, output_name
    )
    return _Estimation(problem, method, cutoff).run()


@dataclass(frozen=True, eq=False)
class _State:
    """Everything known at one denominator."""

    theta: FloatArray
    cost: float
    upper: ComplexArray
    response: RationalResponse | None
    coefficients: FloatArray
    residuals: FloatArray
    solution: LinearSolution | None
    matrix: FloatArray


class _OutputError:
    """Output-error likelihood as a function of the denominator; numerator and nuisances projected out."""

    def __init__(
        self,
        record: TimeRecord,
        n_poles: int,
        n_zeros: int,
        nuisances: tuple[bool, bool, bool],
        delay: float,
        input_name: str | None,
        output_name: str | None,
    ) -> None:
        for kind, signals, name in (
            ("inputs", record.inputs, input_name),
            ("outputs", record.outputs, output_name),
        ):
            if name is None and len(signals) > 1:
                raise EstimationError(
                    f"record {record.name!r} has {len(signals)} {kind}; say which one by its name"
                )
        self.n, self.m = n_poles, n_zeros
        self.has_offset, self.has_ramp, self.has_free = nuisances
        drive = record.inputs[0] if input_name is None else record.input(input_name)
        output = record.outputs[0] if output_name is None else record.output(output_name)
        self.input_name, self.output_name = drive.name, output.name
        self.delay = delay
        half = 0.5 * output.exposure_s
        first, last = drive.span_s
        keep = output.is_valid & (output.times_s - half >= first) & (output.times_s + half <= last)
        self.times = np.asarray(output.times_s[keep])
        self.values = np.asarray(output.values[keep])
        n_parameters = n_poles + n_zeros + 1 + (n_poles if self.has_free else 0) + 2
        if len(self.values) < max(_MIN_SAMPLES, 3 * n_parameters):
            raise EstimationError(
                f"output {output.name!r} has {len(self.values)} usable samples for {n_parameters} "
                "parameters; expected "
                f"at least {max(_MIN_SAMPLES, 3 * n_parameters)}"
            )
        if np.ptp(self.values) == 0.0:
            raise EstimationError(f"output {output.name!r} is constant; nothing can be identified from it")
        if np.ptp(drive.values) == 0.0 and not self.has_free and drive.values[0] == 0.0:
            raise EstimationError(f"input {drive.name!r} is zero throughout; it excites nothing")
        self.exposure = output.exposure_s
        self.drive = drive.signal(margin_s=max(delay, 0.0) + output.exposure_s, from_rest=True)
        self.drive_integral = self.drive.antiderivative()
        self.instants = Instants.on(self.drive, self.times - delay, output.exposure_s)
        self.measured = PiecewisePolynomial.from_samples(self.times, self.values, "linear")
        self.measured_integral = self.measured.antiderivative()
        self.at_stamps = Instants.on(self.measured, self.times, 0.0)
        self.middle = 0.5 * (self.times[0] + self.times[-1])
        self.length = self.times[-1] - self.times[0]
        steps = np.diff(self.times)
        self.nyquist = np.pi / float(np.median(steps))
        self.scale = float(np.sqrt(2.0 * np.pi / self.length * self.nyquist))
        self.floor = len(self.values) * (_NOISE_FLOOR * float(np.max(np.abs(self.values)))) ** 2

    def polynomial(self, theta: FloatArray) -> FloatArray:
        """Return the monic denominator in units of the scale."""
        return np.concatenate([[1.0], theta])

    def rescale(self, theta: FloatArray, scale: float) -> FloatArray:
        """Adopt another unit of frequency and return the parameters in it."""
        powers = np.arange(1, self.n + 1)
        converted = theta * (self.scale / scale) ** powers
        self.scale = scale
        return np.asarray(converted)

    def nuisance_columns(self, upper: ComplexArray) -> list[FloatArray]:
        columns: list[FloatArray] = []
        if self.has_offset:
            columns.append(np.ones_like(self.times))
        if self.has_ramp:
            columns.append((self.times - self.middle) / self.length)
        if self.has_free:
            for pole in upper:
                decay = self._decay(pole)
                columns.append(decay.real)
                if pole.imag > 0.0:
                    columns.append(decay.imag)
        return columns

    def _decay(self, pole: complex) -> ComplexArray:
        half = 0.5 * pole * self.scale * self.exposure
        shape = np.sinh(half) / half if abs(half) > 1e-6 else 1.0
        return np.asarray(np.exp(pole * self.scale * (self.times - self.times[0])) * shape)

    def state(self, theta: FloatArray) -> _State:
        upper = upper_roots(self.polynomial(theta)) if np.all(np.isfinite(theta)) else np.array([1.0 + 0j])
        size = float(np.max(np.abs(upper))) * self.scale
        if np.any(upper.real >= 0.0) or len(full_roots(upper)) != self.n or size > 1e4 * self.nyquist:
            return _State(theta, math.inf, upper, None, np.empty(0), self.values, None, np.empty((0, 0)))
        response = RationalResponse(
            upper, self.scale, self.drive, self.drive_integral, self.instants, squares=True
        )
        columns = [response.over(power) for power in range(self.m + 1)] + self.nuisance_columns(upper)
        matrix = np.stack(columns, axis=1)
        solution = LinearSolution.of(matrix)
        coefficients = solution.coefficients(self.values)
        residuals = self.values - matrix @ coefficients
        rss = float(residuals @ residuals) + self.floor
        cost = 0.5 * len(self.values) * math.log(rss)
        return _State(theta, cost, upper, response, coefficients, residuals, solution, matrix)

    def jacobian(self, state: _State) -> FloatArray:
        """Return d model / d a_i, i = 1 .. n (coefficient of s^(n-i)), in scaled units."""
        response = state.response
        assert response is not None
        squares = [response.over_square(power) for power in range(self.n + self.m)]
        columns = []
        for i in range(1, self.n + 1):
            total = np.zeros_like(self.values)
            for power, b in enumerate(state.coefficients[: self.m + 1]):
                total -= b * squares[self.n - i + power]
            columns.append(total)
        if self.has_free:
            self._add_free_slopes(state, columns)
        return np.stack(columns, axis=1)

    def _add_free_slopes(self, state: _State, columns: list[FloatArray]) -> None:
        place = self.m + 1 + int(self.has_offset) + int(self.has_ramp)
        everything = full_roots(state.upper)
        elapsed = self.scale * (self.times - self.times[0])
        for pole in state.upper:
            others = everything[np.arange(len(everything)) != int(np.argmin(np.abs(everything - pole)))]
            slope = np.prod(pole - others)
            amplitude = complex(state.coefficients[place])
            place += 1
            if pole.imag > 0.0:
                amplitude -= 1j * state.coefficients[place]
                place += 1
            moved = amplitude * elapsed * self._decay(pole)
            for i in range(1, self.n + 1):
                columns[i - 1] = columns[i - 1] + np.real(moved * (-(pole ** (self.n - i)) / slope))

    def slope(self, state: _State) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction."""
        assert state.solution is not None
        variance = (float(state.residuals @ state.residuals) + self.floor) / len(self.values)
        jacobian = self.jacobian(state)
        direction = jacobian.T @ state.residuals / variance
        basis = state.solution.basis
        jacobian = jacobian - basis @ (basis.T @ jacobian)
        return jacobian.T @ jacobian / variance, direction

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step leads; unstable points are refused by their cost."""
        return np.asarray(theta + step)

    def filtered_output(self, upper: ComplexArray) -> list[FloatArray]:
        """Return the responses of s^i/A to the measured output, i = 0 .. n-1, at the stamps."""
        response = RationalResponse(
            upper, self.scale, self.measured, self.measured_integral, self.at_stamps, squares=False
        )
        return [response.over(power) for power in range(self.n)]

    def instrumental_step(
        self, state: _State, instruments: FloatArray | None, regressors_u: FloatArray | None = None
    ) -> FloatArray:
        """Solve the linear regression of the filtered output; with no instruments by least squares.

        ``y = sum_i (alpha_i - a_i) s^i/F y + sum_j b_j s^j/F u``, F the present denominator.
        """
        filtered = self.filtered_output(state.upper)
        inputs = state.matrix if regressors_u is None else regressors_u
        present = self.polynomial(state.theta)[1:]
        # Columns of a_1 .. a_n stand for s^(n-1) .. s^0.
        outputs = np.stack(filtered[::-1], axis=1)
        regressors = np.concatenate([-outputs, inputs], axis=1)
        target = self.values - outputs @ present
        if instruments is None:
            found = LinearSolution.of(regressors).coefficients(target)
        else:
            basis = LinearSolution.of(np.concatenate([instruments, inputs], axis=1)).basis
            scale = np.linalg.norm(regressors, axis=0)
            scale[scale == 0.0] = 1.0
            found = np.linalg.lstsq(basis.T @ (regressors / scale), basis.T @ target, rcond=1e-13)[0] / scale
        return np.asarray(found[: self.n])

    def stable(self, theta: FloatArray) -> FloatArray:
        """Return the denominator with unstable roots mirrored into the left half-plane."""
        roots = np.roots(self.polynomial(theta))
        if not len(roots) or np.all(roots.real < 0.0):
            return theta
        margin = 1e-3 * np.maximum(np.abs(roots), 1e-6)
        mirrored = np.where(
            roots.real < 0.0, roots, -np.maximum(np.abs(roots.real), margin) + 1j * roots.imag
        )
        return np.asarray(np.real(np.poly(mirrored)))[1:]


class _Estimation:
    """The chain from state-variable filters to the output-error optimum."""

    def __init__(self, problem: _OutputError, method: Method, cutoff: float | None) -> None:
        self.problem = problem
        self.method = method
        self.cutoffs = [cutoff] if cutoff is not None else self._portfolio()

    def _portfolio(self) -> list[float]:
        problem = self.problem
        low = 4.0 * np.pi / problem.length
        return [float(w) for w in np.geomspace(low, 0.5 * problem.nyquist, _PORTFOLIO)]

    def run(self) -> TransferFunctionResult:
        problem = self.problem
        starts = []
        for cutoff in self.cutoffs:
            for state in self._state_variable_filter(cutoff):
                starts.append((state.cost, cutoff, state))
        starts += self._subspace()
        starts = [s for s in starts if math.isfinite(s[0])]
        if not starts:
            raise EstimationError(
                "no state-variable filter gave a stable start; give another cutoff, other degrees, or a "
                "longer record"
            )
        starts.sort(key=lambda item: item[0])
        if self.method in ("lssvf", "ivsvf"):
            return self._result(starts[0][2], False, f"{self.method.upper()} takes one step", 1)
        best: tuple[_State, bool, int] | None = None
        best_scale = problem.scale
        for _, cutoff, start in starts[:_FINALISTS]:
            problem.scale = cutoff
            state, converged, iterations = self._srivc(start)
            if best is None or state.cost < best[0].cost:
                best, best_scale = (state, converged, iterations), problem.scale
        assert best is not None
        state, converged, iterations = best
        problem.scale = best_scale
        if self.method == "srivc":
            reason = (
                "SRIVC reached its fixed point"
                if converged
                else f"SRIVC still moved after {iterations} iterations"
            )
            return self._result(state, converged, reason, iterations)
        size = float(np.exp(np.mean(np.log(np.abs(full_roots(state.upper)))))) * problem.scale
        state = problem.state(problem.rescale(state.theta, size))
        minimum = minimise(problem, state, 50)
        return self._result(minimum.state, minimum.converged, minimum.reason, iterations + minimum.iterations)

    def _subspace(self) -> list[tuple[float, float, _State]]:
        """Return the starts that a subspace estimate gives, each with its cost and its unit of frequency."""
        problem = self.problem
        if self.method in ("lssvf", "ivsvf"):
            return []
        starts = []
        times = problem.times - problem.delay
        for poles in subspace_poles([problem.drive], times, problem.values[:, None], problem.n):
            problem.scale = float(np.exp(np.mean(np.log(np.abs(poles)))))
            state = problem.state(np.real(np.poly(poles / problem.scale))[1:])
            starts.append((state.cost, problem.scale, state))
        return starts

    def _state_variable_filter(self, cutoff: float) -> list[_State]:
        """Return the least-squares and the instrumental estimate behind one filter."""
        problem = self.problem
        problem.scale = cutoff
        spread = 2.0 ** np.linspace(-0.5, 0.5, problem.n) if problem.n > 1 else np.ones(1)
        theta = np.real(np.poly(-spread))[1:]
        behind = problem.state(theta)
        if not math.isfinite(behind.cost):
            return []
        least_squares = problem.state(problem.stable(problem.instrumental_step(behind, None)))
        if self.method == "lssvf" or not math.isfinite(least_squares.cost):
            return [least_squares]
        simulated = PiecewisePolynomial.from_samples(
            problem.times, problem.values - least_squares.residuals, "linear"
        )
        filtered = RationalResponse(
            behind.upper,
            problem.scale,
            simulated,
            simulated.antiderivative(),
            problem.at_stamps,
            squares=False,
        )
        instruments = np.stack([-filtered.over(power) for power in range(problem.n - 1, -1, -1)], axis=1)
        instrumental = problem.state(problem.stable(problem.instrumental_step(behind, instruments)))
        return [instrumental] if self.method == "ivsvf" else [least_squares, instrumental]

    def _srivc(self, start: _State) -> tuple[_State, bool, int]:
        """Iterate the refined instrumental variable, and return the best point met."""
        problem = self.problem
        state, best = start, start
        for iteration in range(1, _SRIVC_ITERATIONS + 1):
            theta = problem.instrumental_step(state, problem.jacobian(state))
            following = problem.state(problem.stable(theta))
            if not math.isfinite(following.cost):
                return best, False, iteration
            if following.cost < best.cost:
                best = following
            information, _ = problem.slope(following)
            moved = following.theta - state.theta
            state = following
            if float(moved @ information @ moved) < 1e-4 * problem.n:
                return best, True, iteration
        return best, False, _SRIVC_ITERATIONS

    def _result(self, state: _State, converged: bool, reason: str, iterations: int) -> TransferFunctionResult:
        problem = self.problem
        n, m = problem.n, problem.m
        assert state.solution is not None
        n_all = n + len(state.coefficients)
        variance = float(state.residuals @ state.residuals) / max(len(problem.values) - n_all, 1)
        jacobian = problem.jacobian(state)
        sensitivity = -state.solution.coefficients(jacobian)
        basis = state.solution.basis
        projected = jacobian - basis @ (basis.T @ jacobian)
        information = projected.T @ projected / max(variance, 1e-300)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        condition = float(np.linalg.cond(scaled))
        if not condition < 1e14:
            converged, reason = (
                False,
                "the data do not determine all poles: the information matrix is singular",
            )
        of_a = np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(scale, scale)
        of_linear = variance * state.solution.inverse_gram() + sensitivity @ of_a @ sensitivity.T
        covariance = np.zeros((n + m + 2, n + m + 2))
        cross = of_a @ sensitivity.T
        covariance[:n, :n] = of_a
        order = np.arange(m, -1, -1)  # ascending powers inside, descending outside
        covariance[n : n + m + 1, n : n + m + 1] = of_linear[np.ix_(order, order)]
        covariance[:n, n : n + m + 1] = cross[:, order]
        covariance[n : n + m + 1, :n] = cross[:, order].T
        units = np.concatenate(
            [problem.scale ** np.arange(1, n + 1), problem.scale ** (n - order.astype(np.float64)), [1.0]]
        )
        model = TransferFunctionModel(
            numerator=state.coefficients[: m + 1][::-1] * units[n : n + m + 1],
            denominator=np.concatenate([[1.0], state.theta * units[:n]]),
            delay=problem.delay,
            covariance=covariance * np.outer(units, units),
            noise_sd=math.sqrt(variance),
            input_name=problem.input_name,
            output_name=problem.output_name,
        )
        relative = np.diag(of_a) / np.maximum(state.theta**2, 1e-300)
        spread = max(float(np.var(problem.values)), 1e-300)
        place = m + 1
        offset = float(state.coefficients[place]) if problem.has_offset else 0.0
        ramp = float(state.coefficients[place + int(problem.has_offset)]) if problem.has_ramp else 0.0
        n_samples = len(problem.values)
        return TransferFunctionResult(
            model=model,
            method=self.method,
            times_s=problem.times,
            measured=problem.values,
            modelled=problem.values - state.residuals,
            residuals=state.residuals,
            scores=Scores.of(problem.values, state.residuals),
            whiteness=Whiteness.of(state.residuals),
            bic=2.0 * state.cost + n_all * math.log(n_samples),
            yic=math.log(max(float(np.var(state.residuals)), 1e-300) / spread)
            + math.log(float(np.mean(relative))),
            condition=condition,
            converged=converged,
            reason=reason,
            iterations=iterations,
            offset=offset,
            ramp=ramp,
        )
