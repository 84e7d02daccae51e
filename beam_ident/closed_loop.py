"""Transfer functions from data taken under feedback (CLSRIVC).

Under feedback the input contains the output's noise, and an estimator that treats the
input as given is biased as soon as that noise has a colour.  The closed-loop simplified
refined instrumental variable method (Gilson, Garnier, Young and Van den Hof 2008) takes its
instruments from a *simulated* loop instead: the known external reference drives the known
sampled controller and the present model without noise.  These instruments do not
know the noise whatever its colour, and what they pin down is the plant alone.

The estimate is the root of ``Z^T C(q) (y - B/A u) = 0``: u the measured input under its hold,
Z the gradients of the model at the simulated input, C(q) an autoregression that whitens
the residuals.  It starts at the open-loop estimate and is found by Newton's method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter, sosfilt, zpk2sos

from beam_ident.argument_checks import require_record, require_whole_number
from beam_ident.blas_threads import on_one_thread
from beam_ident.errors import EstimationError
from beam_ident.noise_correlation import autocorrelation, autoregression, score_covariance
from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial, regular_period
from beam_ident.rational_response import ComplexArray, RationalResponse, full_roots, upper_roots
from beam_ident.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.structure_gates import (
    criterion_of_nothing,
    information_criterion,
    transfer_function_warnings,
)
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.transfer_function_fit import estimate_transfer_function
from beam_ident.validation import Scores, Whiteness

_MAX_ITERATIONS = 40
_HALVINGS = 10
_STEP_TOLERANCE = 1e-3  # standard deviations
_ROUNDING = 1e-6  # of a coefficient: a thousandth of it is exact enough where there is no noise
_WHITENINGS = 3


@dataclass(frozen=True, eq=False)
class SampledController:
    """A linear controller that acts once in every period and holds its output.

    Parameters
    ----------
    numerator, denominator : ndarray -- coefficients of z^0, z^-1, z^-2 ..
    period_s : float -- [s]
    reference_enters : {"error", "input"}
        "error": ``u = C (r - y)``, the reference is compared with the output;
        "input": ``u = r - C y``, the reference is added to what the controller puts out.

    Raises
    ------
    EstimationError
        Empty or infinite coefficients, a denominator that begins with zero, no period.
    """

    numerator: FloatArray
    denominator: FloatArray
    period_s: float
    reference_enters: str = "error"

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator"):
            values = np.array(getattr(self, name), dtype=np.float64, copy=True, ndmin=1)
            if values.ndim != 1 or not np.all(np.isfinite(values)) or not np.any(values):
                raise EstimationError(
                    f"controller: {name} is {getattr(self, name)!r}; expected finite coefficients of "
                    "z^0, z^-1, .. in a row, not all zero"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.denominator[0] == 0.0:
            raise EstimationError(
                "controller: the denominator begins with 0; expected the coefficient of the present output first"
            )
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise EstimationError(f"controller: period_s is {self.period_s}; expected a time > 0 [s]")
        if self.reference_enters not in ("error", "input"):
            raise EstimationError(
                f"controller: reference_enters is {self.reference_enters!r}; expected 'error' or 'input'"
            )


@dataclass(frozen=True, eq=False)
class ClosedLoopResult:
    """The plant that was found in a loop.

    Attributes
    ----------
    model : TransferFunctionModel -- of the plant, with the covariance of the instrumental estimator
    times_s, measured, modelled, residuals : ndarray, shape (n_used,)
        The model's response to the measured input; the residuals contain the noise in its colour.
    noise_coefficients : ndarray -- 1, c_1 .. c_p of the autoregression that whitens the residuals
    scores : Scores
    whiteness : Whiteness -- of the whitened residuals
    condition : float -- of the scaled matrix Z^T Psi
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    model: TransferFunctionModel
    times_s: FloatArray
    measured: FloatArray
    modelled: FloatArray
    residuals: FloatArray
    noise_coefficients: FloatArray
    scores: Scores
    whiteness: Whiteness
    condition: float
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]


@on_one_thread
def estimate_in_closed_loop(
    record: TimeRecord,
    controller: SampledController,
    n_poles: int,
    n_zeros: int,
    reference_name: str,
    input_name: str,
    output_name: str | None = None,
    has_offset: bool = False,
    has_ramp: bool = False,
) -> ClosedLoopResult:
    """Estimate B(s)/A(s) of a plant that runs under a known sampled controller.

    Parameters
    ----------
    record : TimeRecord
        With the external reference and the plant's input among its inputs, both sampled
        by the controller's period; the output has stamps of its own.
    controller : SampledController
    n_poles, n_zeros : int -- degrees of A and B, with n_zeros < n_poles
    reference_name, input_name : str
    output_name : str or None -- where there are several
    has_offset, has_ramp : bool -- estimate a constant and a drift of the output along with the rest

    Raises
    ------
    EstimationError
        An input that is not held over the controller's period, signals that do not match,
        a plant with direct feedthrough, or whatever :func:`estimate_transfer_function` refuses.

    Notes
    -----
    The covariance is ``(Z^T Psi)^-1 Z^T R Z (Psi^T Z)^-1`` with Psi the gradients at the measured
    input and R the covariance of the whitened residuals.  An autoregression needs regular stamps;
    with irregular ones the noise is taken as white.
    """
    require_record(record)
    require_whole_number("n_poles", n_poles, 0)
    require_whole_number("n_zeros", n_zeros, 0)
    if n_zeros >= n_poles:
        raise EstimationError(
            f"{n_poles} poles and {n_zeros} zeros; a sampled controller cannot act on an output that "
            "follows its own action at once: expected fewer zeros than poles"
        )
    drive, reference = record.input(input_name), record.input(reference_name)
    for signal in (drive, reference):
        period = signal.period_s
        if period is None or abs(period / controller.period_s - 1.0) > 1e-6:
            found = "irregular" if period is None else f"{period:.9g} s"
            raise EstimationError(
                f"input {signal.name!r} has a period that is {found}; expected that of the controller, "
                f"{controller.period_s:.9g} s"
            )
    if drive.hold != "zoh":
        raise EstimationError(
            f"input {drive.name!r} has the hold {drive.hold!r}; a sampled controller holds its output: 'zoh'"
        )
    if len(drive.times_s) != len(reference.times_s) or drive.times_s[0] != reference.times_s[0]:
        raise EstimationError(
            f"inputs {drive.name!r} and {reference.name!r} are not sampled at the same instants: "
            f"{len(drive.times_s)} and {len(reference.times_s)} samples"
        )
    output = record.outputs[0] if output_name is None else record.output(output_name)
    pair = TimeRecord((drive,), (output,), record.start_ns, record.name)
    start = estimate_transfer_function(pair, n_poles, n_zeros, has_offset=has_offset, has_ramp=has_ramp)
    return _Loop(drive, reference, output, controller, n_zeros, (has_offset, has_ramp)).solve(start.model)


@dataclass(frozen=True, eq=False)
class _Point:
    """The model and its gradients at one set of coefficients."""

    theta: FloatArray  # a_1 .. a_n, b_0 .. b_m of ascending powers, in scaled units
    simulated: FloatArray
    gradients: FloatArray
    instruments: FloatArray


class _Loop:
    """The instrumental equations of one record."""

    def __init__(
        self,
        drive: InputSignal,
        reference: InputSignal,
        output: OutputSignal,
        controller: SampledController,
        n_zeros: int,
        nuisances: tuple[bool, bool],
    ) -> None:
        self.drive, self.reference, self.controller = drive, reference, controller
        self.output_name = output.name
        self.m = n_zeros
        half = 0.5 * output.exposure_s
        first, last = drive.span_s
        keep = output.is_valid & (output.times_s - half >= first) & (output.times_s + half <= last)
        self.times = np.asarray(output.times_s[keep])
        self.values = np.asarray(output.values[keep])
        self.exposure = output.exposure_s
        self.is_regular = regular_period(self.times) is not None
        columns = [np.ones_like(self.times)] if nuisances[0] else []
        if nuisances[1]:
            middle, length = self.times.mean(), self.times[-1] - self.times[0]
            columns.append((self.times - middle) / length)
        self.has_offset, self.has_ramp = nuisances
        self.nuisances = np.stack(columns, axis=1) if columns else np.empty((len(self.times), 0))
        self.measured_drive = drive.signal(margin_s=output.exposure_s, from_rest=True)
        self.measured_integral = self.measured_drive.antiderivative()
        self.instants = Instants.on(self.measured_drive, self.times, output.exposure_s)
        self.noise: FloatArray = np.ones(1)

    def solve(self, start: TransferFunctionModel) -> ClosedLoopResult:
        self.n = start.n_poles
        self.scale = float(np.exp(np.mean(np.log(np.abs(start.poles)))))
        units = self._units()
        theta = np.concatenate([start.denominator[1:], start.numerator[::-1]]) / units
        point = self._point(theta)
        if point is None:
            raise EstimationError(
                "the loop of this controller and the open-loop estimate of the plant is unstable; check the sign "
                "of the feedback (u = C (r - y)), the controller's coefficients and its period"
            )
        iterations, converged, reason = 0, False, ""
        for _ in range(_WHITENINGS):
            residuals = self._residuals(point)
            self.noise = autoregression(residuals) if self.is_regular else np.ones(1)
            point, count, converged, reason = self._newton(point)
            iterations += count
            if len(self.noise) == 1:
                break
        return self._result(point, converged, reason, iterations)

    def _newton(self, point: _Point) -> tuple[_Point, int, bool, str]:
        """Find the root of the instrumental equations, with steps halved until the loop is stable."""
        for iteration in range(1, _MAX_ITERATIONS + 1):
            step, sd = self._step(point)
            size = float(np.max(np.abs(step) / (sd + _ROUNDING * np.abs(point.theta))))
            if size < _STEP_TOLERANCE:
                return point, iteration, True, f"step below {_STEP_TOLERANCE} standard deviations"
            for halving in range(_HALVINGS):
                following = self._point(point.theta + step * 0.5**halving)
                if following is not None:
                    point = following
                    break
            else:
                return point, iteration, False, "stalled: every step makes the plant or the loop unstable"
        return point, _MAX_ITERATIONS, False, f"stopped after {_MAX_ITERATIONS} iterations"

    def _units(self) -> FloatArray:
        """Return what a coefficient of one in scaled frequency means in rad/s."""
        a = self.scale ** np.arange(1, self.n + 1)
        b = self.scale ** (self.n - np.arange(self.m + 1.0))
        return np.concatenate([a, b])

    def _point(self, theta: FloatArray) -> _Point | None:
        """Evaluate the coefficients; None where the plant or the simulated loop is unstable."""
        if not np.all(np.isfinite(theta)):
            return None
        upper = upper_roots(np.concatenate([[1.0], theta[: self.n]]))
        if np.any(upper.real >= 0.0) or len(full_roots(upper)) != self.n:
            return None
        simulated_input = self._simulated_input(theta)
        if simulated_input is None:
            return None
        clean = PiecewisePolynomial.from_samples(
            self.drive.times_s, simulated_input, "zoh", self.exposure, "zero"
        )
        simulated, gradients = self._gradients(theta, upper, self.measured_drive, self.measured_integral)
        instruments = self._gradients(theta, upper, clean, clean.antiderivative())[1]
        return _Point(theta, simulated, gradients, instruments)

    def _gradients(
        self,
        theta: FloatArray,
        upper: ComplexArray,
        drive: PiecewisePolynomial,
        integral: PiecewisePolynomial,
    ) -> tuple[FloatArray, FloatArray]:
        """Return B/A and its derivatives by the coefficients, shape (n, n_poles + n_zeros + 1)."""
        n, b = self.n, theta[self.n :]
        response = RationalResponse(upper, self.scale, drive, integral, self.instants, squares=True)
        plain = np.stack([response.over(power) for power in range(self.m + 1)], axis=1)
        squares = np.stack([response.over_square(power) for power in range(n + self.m)], axis=1)
        by_a = [-squares[:, n - i : n - i + self.m + 1] @ b for i in range(1, n + 1)]
        return plain @ b, np.concatenate([np.stack(by_a, axis=1), plain], axis=1)

    def _simulated_input(self, theta: FloatArray) -> FloatArray | None:
        """Return the plant's input in a loop without noise, or None where that loop is unstable."""
        n, period, c = self.n, self.controller.period_s, self.controller
        # Controller form of the plant in scaled time, and its exact sampling under the hold.
        system = np.zeros((n + 1, n + 1))
        system[0, :n] = -theta[:n]
        system[np.arange(1, n), np.arange(n - 1)] = 1.0
        system[0, n] = 1.0
        sampled = expm(system * self.scale * period)
        transition, entry = sampled[:n, :n], sampled[:n, n]
        readout = np.zeros(n)
        readout[n - 1 - np.arange(self.m + 1)] = theta[n:]
        size = max(len(c.numerator), len(c.denominator))
        above = np.pad(c.numerator, (0, size - len(c.numerator))) / c.denominator[0]
        below = np.pad(c.denominator, (0, size - len(c.denominator))) / c.denominator[0]
        # Observer form of the controller: v = above[0] e + first state.
        order = size - 1
        inner = np.zeros((order, order))
        inner[:, :1] = -below[1:, None]
        inner[np.arange(order - 1), np.arange(1, order)] = 1.0
        gains = above[1:] - below[1:] * above[0]
        first = np.zeros(order)
        first[:1] = 1.0
        loop = np.block(
            [
                [transition - above[0] * np.outer(entry, readout), np.outer(entry, first)],
                [-np.outer(gains, readout), inner],
            ]
        )
        poles = np.linalg.eigvals(loop)
        if np.any(np.abs(poles) >= 1.0):
            return None
        if c.reference_enters == "error":
            lead = int(np.flatnonzero(above)[0])
            zeros, gain = np.roots(above), above[lead]
        else:
            zeros, gain = np.linalg.eigvals(inner), 1.0
        zeros = np.concatenate([zeros, np.linalg.eigvals(transition)])
        return np.asarray(sosfilt(zpk2sos(zeros, poles, gain), self.reference.values))

    def _white(self, columns: FloatArray) -> FloatArray:
        """Apply the autoregression along the samples, without those that it starts on."""
        return np.asarray(lfilter(self.noise, [1.0], columns, axis=0)[len(self.noise) - 1 :])

    def _step(self, point: _Point) -> tuple[FloatArray, FloatArray]:
        """Return the Newton step of the coefficients and their standard deviations."""
        step, covariance, _, _ = self._solution(point, is_white=True)
        k = len(point.theta)
        return step[:k], np.sqrt(np.maximum(np.diag(covariance)[:k], 0.0))

    def _solution(self, point: _Point, is_white: bool) -> tuple[FloatArray, FloatArray, float, FloatArray]:
        """Solve the instrumental equations linearised at a point.

        Returns
        -------
        step, covariance : of the coefficients and the nuisances
        condition : float
        residuals : ndarray -- whitened, after the nuisances
        """
        psi = self._white(np.concatenate([point.gradients, self.nuisances], axis=1))
        z = self._white(np.concatenate([point.instruments, self.nuisances], axis=1))
        target = self._white(self.values - point.simulated)
        size_psi = np.maximum(np.linalg.norm(psi, axis=0), 1e-300)
        size_z = np.maximum(np.linalg.norm(z, axis=0), 1e-300)
        psi, z = psi / size_psi, z / size_z
        inverse = np.linalg.pinv(z.T @ psi, rcond=1e-13)
        step = inverse @ (z.T @ target)
        k = len(point.theta)
        residuals = target - psi[:, k:] @ step[k:]
        variance = float(residuals @ residuals) / max(len(residuals) - len(step), 1)
        if is_white:
            score = z.T @ z
        else:
            score = score_covariance(z, autocorrelation(autoregression(residuals), len(residuals)))
        covariance = variance * inverse @ score @ inverse.T / np.outer(size_psi, size_psi)
        return step / size_psi, covariance, float(np.linalg.cond(z.T @ psi)), residuals

    def _residuals(self, point: _Point) -> FloatArray:
        """Return the residuals in their colour, after the nuisances."""
        residuals = self.values - point.simulated
        if self.nuisances.shape[1]:
            k = len(point.theta)
            step = self._solution(point, is_white=True)[0]
            residuals = residuals - self.nuisances @ step[k:]
        return np.asarray(residuals)

    def _result(self, point: _Point, converged: bool, reason: str, iterations: int) -> ClosedLoopResult:
        _, covariance, condition, white = self._solution(point, is_white=not self.is_regular)
        if not condition < 1e13:
            converged, reason = False, "the reference does not determine all coefficients: singular equations"
        residuals = self._residuals(point)
        n, m = self.n, self.m
        order = np.concatenate([np.arange(n), n + np.arange(m, -1, -1)])
        units = self._units()
        complete = np.zeros((n + m + 2, n + m + 2))
        k = n + m + 1
        complete[:k, :k] = (covariance[:k, :k] * np.outer(units, units))[np.ix_(order, order)]
        theta = point.theta * units
        model = TransferFunctionModel(
            numerator=theta[n:][::-1],
            denominator=np.concatenate([[1.0], theta[:n]]),
            delay=0.0,
            covariance=complete,
            noise_sd=float(np.std(residuals)),
            input_name=self.drive.name,
            output_name=self.output_name,
        )
        of_nothing = criterion_of_nothing(self.times, self.values, self.has_offset, self.has_ramp)
        n_parameters = len(theta) + self.nuisances.shape[1]
        whiteness = Whiteness.of(white)
        is_worth_it = information_criterion(residuals, n_parameters) < of_nothing
        return ClosedLoopResult(
            model=model,
            times_s=self.times,
            measured=self.values,
            modelled=self.values - residuals,
            residuals=residuals,
            noise_coefficients=self.noise,
            scores=Scores.of(self.values, residuals),
            whiteness=whiteness,
            condition=condition,
            converged=converged,
            reason=reason,
            iterations=iterations,
            warnings=transfer_function_warnings([model], whiteness, is_worth_it, converged, reason),
        )
