"""The output-error likelihood of transfer functions from one or several inputs to one output.

    y = sum_k B_k(s) / (s^q A_k(s)) e^(-s T_k) u_k + nuisances + noise

The denominators (one for all inputs, or one each) and the unknown delays are searched; the
numerators, offset, ramp and free motion enter linearly and are projected out (variable
projection).  All responses and gradients are exact under each input's own hold, at the
stamps as they are; the known integrators ``s^-q`` are applied to the inputs, whose
antiderivatives are exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from beam_ident.errors import EstimationError
from beam_ident.linear_solution import LinearSolution
from beam_ident.modal_fit import Prior
from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial
from beam_ident.rational_response import RationalResponse, full_roots, upper_roots
from beam_ident.records import InputSignal, OutputSignal

ComplexArray = NDArray[np.complex128]

_MIN_SAMPLES = 20
_NOISE_FLOOR = 1e-11
_MAX_POLE = 1e4  # of the Nyquist frequency
_LEAST_DAMPING = 1e-9  # nearer to the imaginary axis a pole is on it but for rounding
_EARLIEST = 1.0  # sampling periods: an estimated delay may come out this much below zero


@dataclass(frozen=True, eq=False)
class Path:
    """How one input reaches the output.

    Attributes
    ----------
    name : str -- of the input
    signal, integral : PiecewisePolynomial -- the input after the known integrators, and its antiderivative
    n_zeros : int -- degree of the numerator
    block : int -- which denominator
    delay : Prior -- knowledge of the delay [s]
    """

    name: str
    signal: PiecewisePolynomial
    integral: PiecewisePolynomial
    n_zeros: int
    block: int
    delay: Prior

    @staticmethod
    def of(
        drive: InputSignal, n_zeros: int, block: int, delay: Prior, n_integrators: int, margin_s: float
    ) -> Path:
        """Prepare an input that was at rest before its record begins."""
        signal = drive.signal(margin_s=margin_s, from_rest=True)
        for _ in range(n_integrators):
            signal = signal.antiderivative()
        return Path(drive.name, signal, signal.antiderivative(), n_zeros, block, delay)

    def response(
        self,
        upper: ComplexArray,
        scale: float,
        times: FloatArray,
        exposure_s: float,
        delay: float,
        squares: bool,
    ) -> RationalResponse:
        """Return the responses of a denominator to this input at output stamps."""
        # Before the first knot nothing has happened, however far back a long delay looks.
        shifted = np.maximum(times - delay, self.signal.knots[0] + 0.5 * exposure_s)
        instants = Instants.on(self.signal, shifted, exposure_s)
        return RationalResponse(upper, scale, self.signal, self.integral, instants, squares)


@dataclass(frozen=True)
class Nuisances:
    """What is estimated beside the transfer functions.

    Attributes
    ----------
    has_offset, has_ramp, has_free_response : bool
    """

    has_offset: bool = False
    has_ramp: bool = False
    has_free_response: bool = False

    def with_integrators(self, n_integrators: int) -> Nuisances:
        """Return the nuisances with the free motion of known integrators: a constant, and a ramp."""
        if not self.has_free_response:
            return self
        return replace(
            self,
            has_offset=self.has_offset or n_integrators >= 1,
            has_ramp=self.has_ramp or n_integrators >= 2,
        )


@dataclass(frozen=True, eq=False)
class OutputErrorState:
    """Everything known at one set of denominators and delays.

    Attributes
    ----------
    theta : ndarray -- coefficients of all denominators in units of ``scale``, then the free delays
    scale : float -- unit of frequency [rad/s]
    cost : float -- negative log-likelihood, infinite where the point is not allowed
    uppers : tuple of ndarray -- poles of each denominator with imaginary part >= 0
    coefficients : ndarray -- of the columns of ``matrix``
    residuals : ndarray, shape (n_samples,)
    """

    theta: FloatArray
    scale: float
    cost: float
    uppers: tuple[ComplexArray, ...]
    responses: tuple[RationalResponse, ...] = ()
    free: tuple[RationalResponse, ...] = ()
    coefficients: FloatArray = field(default_factory=lambda: np.empty(0))
    residuals: FloatArray = field(default_factory=lambda: np.empty(0))
    matrix: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    solution: LinearSolution | None = None


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Covariance of searched and linear parameters together, in scaled units.

    Attributes
    ----------
    values : ndarray, shape (n_theta + n_columns, n_theta + n_columns)
    variance : float -- of the residuals
    condition : float -- of the scaled information matrix
    """

    values: FloatArray
    variance: float
    condition: float


def usable_samples(output: OutputSignal, drives: list[InputSignal]) -> NDArray[np.bool_]:
    """Return which samples of an output lie, exposure included, where all inputs are known."""
    half = 0.5 * output.exposure_s
    keep = output.is_valid
    for drive in drives:
        first, last = drive.span_s
        keep = keep & (output.times_s - half >= first) & (output.times_s + half <= last)
    return np.asarray(keep)


class OutputErrorProblem:
    """The likelihood of one output as a function of denominators and delays.

    Parameters
    ----------
    paths : tuple of Path
    orders : tuple of int -- degree of every denominator
    times, values : ndarray, shape (n_samples,)
    exposure_s : float
    nuisances : Nuisances
    """

    def __init__(
        self,
        paths: tuple[Path, ...],
        orders: tuple[int, ...],
        times: FloatArray,
        values: FloatArray,
        exposure_s: float,
        nuisances: Nuisances,
    ) -> None:
        self.paths, self.orders, self.nuisances = paths, orders, nuisances
        self.times, self.values, self.exposure = times, values, exposure_s
        self.n_a = sum(orders)
        self.free_delays = [k for k, path in enumerate(paths) if path.delay.is_free]
        self.n_columns = sum(path.n_zeros + 1 for path in paths) + self.n_nuisances
        n_parameters = self.n_a + len(self.free_delays) + self.n_columns
        least = max(_MIN_SAMPLES, 3 * n_parameters)
        if len(values) < least:
            raise EstimationError(
                f"the output has {len(values)} usable samples for {n_parameters} parameters; expected at least "
                f"{least}. Record longer, or ask for a lower order"
            )
        if np.ptp(values) == 0.0:
            raise EstimationError(
                f"the output is constant ({values[0]:g}); nothing can be identified from it. Check the sensor"
            )
        self.period = float(np.median(np.diff(times)))
        self.measured = self.joined(values)
        self.measured_integral = self.measured.antiderivative()
        self.at_stamps = Instants.on(self.measured, times, 0.0)
        self.noise: FloatArray = np.ones(1)  # coefficients of the autoregression: white
        self.middle = 0.5 * (times[0] + times[-1])
        self.length = float(times[-1] - times[0])
        self.nyquist = np.pi / self.period
        self.scale = float(np.sqrt(2.0 * np.pi / self.length * self.nyquist))
        self.floor = len(values) * (_NOISE_FLOOR * float(np.max(np.abs(values)))) ** 2
        self.parts = np.split(np.arange(self.n_a), np.cumsum(orders)[:-1])

    @property
    def n_nuisances(self) -> int:
        """Number of columns beside the numerators."""
        terms = self.nuisances
        return terms.has_offset + terms.has_ramp + (sum(self.orders) if terms.has_free_response else 0)

    def joined(self, values: FloatArray) -> PiecewisePolynomial:
        """Return values at the stamps joined by straight lines, at rest before; every stamp is a knot."""
        return PiecewisePolynomial.from_samples(
            self.times, values, "linear", margin_s=1e-3 * self.period, lead="zero"
        )

    def from_stamp(self, start_s: float) -> OutputErrorProblem:
        """Return the problem without the samples before an instant."""
        keep = self.times >= start_s
        return OutputErrorProblem(
            self.paths, self.orders, self.times[keep], self.values[keep], self.exposure, self.nuisances
        )

    def of_values(self, values: FloatArray, paths: tuple[Path, ...]) -> OutputErrorProblem:
        """Return the problem of one denominator that explains other values at the same stamps."""
        order = (self.orders[paths[0].block],)
        alone = tuple(replace(path, block=0) for path in paths)
        return OutputErrorProblem(alone, order, self.times, values, self.exposure, self.nuisances)

    def delays(self, theta: FloatArray) -> FloatArray:
        """Return the delay of every path [s]."""
        result = np.array([path.delay.mean for path in self.paths])
        result[self.free_delays] = theta[self.n_a :]
        return result

    def polynomial(self, theta: FloatArray, block: int = 0) -> FloatArray:
        """Return a monic denominator in units of the scale, descending powers."""
        return np.concatenate([[1.0], theta[self.parts[block]]])

    def converted(self, state: OutputErrorState, scale: float) -> FloatArray:
        """Return a state's parameters in another unit of frequency."""
        powers = np.concatenate([np.arange(1, n + 1) for n in self.orders])
        theta = state.theta.copy()
        theta[: self.n_a] *= (state.scale / scale) ** powers
        return np.asarray(theta)

    def point(self, theta: FloatArray, slopes: bool = True) -> OutputErrorState:
        """Compute all columns of a point, without solving for the coefficients.

        Parameters
        ----------
        theta : ndarray
        slopes : bool -- whether the point is to be improved, not only ranked

        Returns
        -------
        OutputErrorState -- of infinite cost; with no matrix where the point is not allowed
        """
        refused = OutputErrorState(theta, self.scale, math.inf, ())
        if not np.all(np.isfinite(theta)):
            return refused
        uppers = tuple(upper_roots(self.polynomial(theta, block)) for block in range(len(self.orders)))
        largest = _MAX_POLE * self.nyquist / self.scale
        for upper, n in zip(uppers, self.orders, strict=True):
            if (
                np.any(upper.real > -_LEAST_DAMPING * np.abs(upper))
                or len(full_roots(upper)) != n
                or np.max(np.abs(upper)) > largest
            ):
                return refused
        delays = self.delays(theta)
        if any(delays[k] < -_EARLIEST * self.period or delays[k] > self.length for k in self.free_delays):
            return refused
        responses = tuple(
            path.response(uppers[path.block], self.scale, self.times, self.exposure, delay, slopes)
            for path, delay in zip(self.paths, delays, strict=True)
        )
        columns = [
            response.combined(np.eye(path.n_zeros + 1))
            for path, response in zip(self.paths, responses, strict=True)
        ]
        columns += [column[:, None] for column in self.drifts()]
        free: tuple[RationalResponse, ...] = ()
        if self.nuisances.has_free_response:
            free = tuple(self._free_response(upper, slopes) for upper in uppers)
            columns += [response.combined(np.eye(response.order)) for response in free]
        matrix = np.concatenate(columns, axis=1)
        if not np.all(np.isfinite(matrix)):
            return refused
        return OutputErrorState(theta, self.scale, math.inf, uppers, responses, free, matrix=matrix)

    def state(self, theta: FloatArray, slopes: bool = True) -> OutputErrorState:
        """Evaluate a point; without slopes it can be ranked but not improved."""
        point = self.point(theta, slopes)
        if not point.matrix.size:
            return point
        solution = LinearSolution.of(point.matrix)
        coefficients = solution.coefficients(self.values)
        residuals = self.values - point.matrix @ coefficients
        cost = 0.5 * len(self.values) * math.log(float(residuals @ residuals) + self.floor)
        delays = self.delays(theta)
        for k in self.free_delays:
            prior = self.paths[k].delay
            cost += 0.5 * ((delays[k] - prior.mean) / prior.sd) ** 2
        return replace(point, cost=cost, coefficients=coefficients, residuals=residuals, solution=solution)

    def drifts(self) -> list[FloatArray]:
        """Return the columns of offset and ramp."""
        columns = [np.ones_like(self.times)] if self.nuisances.has_offset else []
        if self.nuisances.has_ramp:
            columns.append((self.times - self.middle) / self.length)
        return columns

    def _free_response(self, upper: ComplexArray, slopes: bool) -> RationalResponse:
        elapsed = self.times - self.times[0] + 0.5 * self.exposure
        return RationalResponse.to_impulse(upper, self.scale, elapsed, self.exposure, slopes)

    def numerator(self, state: OutputErrorState, path: int) -> FloatArray:
        """Return the numerator of a path in units of the scale, ascending powers."""
        place = sum(p.n_zeros + 1 for p in self.paths[:path])
        return np.asarray(state.coefficients[place : place + self.paths[path].n_zeros + 1])

    def jacobian(self, state: OutputErrorState) -> FloatArray:
        """Return the model's gradient by theta, shape (n_samples, n_theta), in scaled units."""
        result = np.zeros((len(self.values), len(state.theta)))
        sources = [
            (response, self.numerator(state, k), path.block)
            for k, (path, response) in enumerate(zip(self.paths, state.responses, strict=True))
        ]
        place = self.n_columns - self.n_a
        for block, response in enumerate(state.free):
            n = self.orders[block]
            sources.append((response, state.coefficients[place : place + n], block))
            place += n
        for response, ascending, block in sources:
            # d/da_i of B/A with a_i at s^(n-i): -s^(n-i) B / A^2
            n = self.orders[block]
            products = np.zeros((n, n - 1 + len(ascending)))
            for i in range(n):
                products[i, n - 1 - i : n - 1 - i + len(ascending)] = -ascending
            result[:, self.parts[block]] += response.combined(products, squared=True)
        for column, k in enumerate(self.free_delays):
            ascending = self.numerator(state, k)
            derivative = np.concatenate([[0.0], ascending])[None]  # s B / A: by time, in units of 1/scale
            result[:, self.n_a + column] = -self.scale * state.responses[k].combined(derivative)[:, 0]
        return result

    def _information(self, state: OutputErrorState, jacobian: FloatArray, variance: float) -> FloatArray:
        """Return the information on theta with the linear parameters unknown, prior knowledge included."""
        assert state.solution is not None
        basis = state.solution.basis
        projected = jacobian - basis @ (basis.T @ jacobian)
        information = projected.T @ projected / max(variance, 1e-300)
        for column, k in enumerate(self.free_delays):
            information[self.n_a + column, self.n_a + column] += 1.0 / self.paths[k].delay.sd ** 2
        return np.asarray(information)

    def slope(self, state: OutputErrorState) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction."""
        variance = (float(state.residuals @ state.residuals) + self.floor) / len(self.values)
        jacobian = self.jacobian(state)
        direction = jacobian.T @ state.residuals / variance
        for column, k in enumerate(self.free_delays):
            prior, place = self.paths[k].delay, self.n_a + column
            direction[place] += (prior.mean - state.theta[place]) / prior.sd**2
        return self._information(state, jacobian, variance), direction

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step leads; a delay moves by one sampling period at most."""
        step = step.copy()
        step[self.n_a :] = np.clip(step[self.n_a :], -self.period, self.period)
        return np.asarray(theta + step)

    def covariance(self, state: OutputErrorState, also: FloatArray | None = None) -> JointCovariance:
        """Return the joint covariance of theta and the linear coefficients at an optimum.

        Parameters
        ----------
        state : OutputErrorState
        also : ndarray or None, shape (n_theta, n_theta) -- information on theta from elsewhere
        """
        assert state.solution is not None
        n_all = len(state.theta) + len(state.coefficients)
        rss = float(state.residuals @ state.residuals)
        variance = rss / max(len(self.values) - n_all, 1)
        jacobian = self.jacobian(state)
        information = self._information(state, jacobian, variance)
        if also is not None:
            information = information + also
        sensitivity = -state.solution.coefficients(jacobian)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        condition = float(np.linalg.cond(scaled))
        of_theta = np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(scale, scale)
        cross = of_theta @ sensitivity.T
        of_linear = variance * state.solution.inverse_gram() + sensitivity @ cross
        return JointCovariance(np.block([[of_theta, cross], [cross.T, of_linear]]), variance, condition)
