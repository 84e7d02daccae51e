"""Transfer functions from data taken under feedback (CLSRIVC).

Under feedback the input contains the output's noise, and an estimator that treats the
input as given is biased as soon as that noise has a colour.  The closed-loop simplified
refined instrumental variable method (Gilson, Garnier, Young and Van den Hof 2008) takes its
instruments from a *simulated* loop instead: the known external reference drives the known
sampled controller and the present model without noise.  These instruments are
independent of the noise, of any colour, so that the estimate is that of the plant alone.

The estimate is the root of ``Z^T C(q) (y - B/A u) = 0``: u the measured input under its hold,
Z the gradients of the model at the simulated input, C(q) what whitens the residuals: an autoregression
or, at stamps of any spacing, a process in continuous time.  It starts at the open-loop estimate and is
found by Newton's method.

Several records of one loop are one set of equations: every record has its own reference, offset and
drift, and its residuals their own colour and level, by which it weighs.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_records, require_whole_number
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.noise_model import Colour, Whitening, colour_of
from beam_ident.noise.record_fit import OverOneOutput, RecordFit, pooled_scores
from beam_ident.noise.relation import is_related
from beam_ident.noise.scores import Scores, Whiteness, are_rounding
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.rational_response import RationalResponse, full_roots, upper_roots
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.misfit_causes import input_misfit_warnings
from beam_ident.sensing.quantisation import clipped_warnings
from beam_ident.summary import SummarisedModes, SummaryPart, result_parts
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.sampled_controller import SampledController
from beam_ident.transfer_function.structure_gates import (
    transfer_function_warnings,
)
from beam_ident.transfer_function_estimation.estimation import estimate_transfer_function

_MAX_ITERATIONS = 40
_HALVINGS = 10
_STEP_TOLERANCE = 1e-3  # standard deviations
_ROUNDING = 1e-6  # of a coefficient: a thousandth of it is exact enough where there is no noise
_WHITENINGS = 3


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ClosedLoopResult(SummarisedModes, OverOneOutput):
    """The plant that was found in a loop.

    Attributes
    ----------
    model : TransferFunctionModel -- of the plant, with the covariance of the instrumental estimator
        Beside it, everything that ``OverOneOutput`` lists: ``modelled`` is the model's response to the measured
        input, ``residuals`` contain the noise in its colour, ``condition`` is that of the scaled matrix Z^T Psi.
    """

    model: TransferFunctionModel

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, (self.model,), (self.model.output_name,))


@on_one_thread
def estimate_in_closed_loop(
    record: TimeRecord | Sequence[TimeRecord],
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
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the plant and the controller.  With the external reference
        and the plant's input among the inputs, both sampled by the controller's period; the output
        has stamps of its own.
    controller : SampledController
    n_poles, n_zeros : int -- degrees of A and B, with n_zeros < n_poles
    reference_name, input_name : str
    output_name : str or None -- where there are several
    has_offset, has_ramp : bool -- estimate a constant and a drift of the output along with the rest

    Raises
    ------
    EstimationError
        An input that is not held over the controller's period, signals that do not match,
        a plant with direct feedthrough, or anything that ``estimate_transfer_function`` refuses.

    Notes
    -----
    The covariance is ``(Z^T Psi)^-1 Z^T R Z (Psi^T Z)^-1`` with Psi the gradients at the measured
    input and R the covariance of the whitened residuals.
    """
    records = require_records(record)
    require_whole_number("n_poles", n_poles, 0)
    require_whole_number("n_zeros", n_zeros, 0)
    if n_zeros >= n_poles:
        raise EstimationError(
            f"{n_poles} poles and {n_zeros} zeros; a sampled controller cannot act on an output that "
            "follows its own action at once: expected fewer zeros than poles"
        )
    if output_name is None:
        output_name = records[0].outputs[0].name
    nuisances = (has_offset, has_ramp)
    parts = [
        _LoopRecord(one, controller.period_s, reference_name, input_name, output_name, nuisances)
        for one in records
    ]
    pairs = [
        TimeRecord((own.drive,), (own.output,), one.start_ns, one.name)
        for own, one in zip(parts, records, strict=True)
    ]
    start = estimate_transfer_function(pairs, n_poles, n_zeros, has_offset=has_offset, has_ramp=has_ramp)
    return _Loop(parts, controller, n_zeros, nuisances).solve(start.model)


class _LoopRecord:
    """One record of the loop, and the noise that it has."""

    def __init__(
        self,
        record: TimeRecord,
        period_s: float,
        reference_name: str,
        input_name: str,
        output_name: str,
        nuisances: tuple[bool, bool],
    ) -> None:
        drive, reference = record.input(input_name), record.input(reference_name)
        output = record.output(output_name)
        _require_sampled_by(period_s, drive, reference)
        self.name, self.drive, self.output, self.reference = record.name, drive, output, reference.values
        keep = output.is_valid & output.is_within(*drive.span_s)
        self.times = np.asarray(output.times_s[keep])
        self.values = np.asarray(output.values[keep])
        columns = [np.ones_like(self.times)] if nuisances[0] else []
        if nuisances[1]:
            middle, length = self.times.mean(), self.times[-1] - self.times[0]
            columns.append((self.times - middle) / length)
        self.nuisances = np.stack(columns, axis=1) if columns else np.empty((len(self.times), 0))
        self.measured_drive = drive.signal(margin_s=output.exposure_s, from_rest=True)
        self.measured_integral = self.measured_drive.antiderivative()
        self.instants = Instants.on(self.measured_drive, self.times, output.exposure_s)
        self.noise: Colour = Whitening(np.ones(1), self.times)
        self.level = 1.0

    def white(self, columns: FloatArray) -> FloatArray:
        """Return samples as independent noise of this record's level sees them."""
        return np.asarray(self.noise.apply(columns) / self.level)

    def clean_drive(self, simulated: FloatArray) -> PiecewisePolynomial:
        """Return the input as it would be without noise, under its hold."""
        return PiecewisePolynomial.from_samples(
            self.drive.times_s, simulated, "zoh", self.output.exposure_s, "zero"
        )


def _require_sampled_by(period_s: float, drive: InputSignal, reference: InputSignal) -> None:
    """Raise EstimationError for signals that a controller of this period cannot have dealt in."""
    for signal in (drive, reference):
        period = signal.period_s
        if period is None or abs(period / period_s - 1.0) > 1e-6:
            found = "irregular" if period is None else f"{period:.9g} s"
            raise EstimationError(
                f"input {signal.name!r} has a period that is {found}; expected that of the controller, "
                f"{period_s:.9g} s"
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


@dataclass(frozen=True, eq=False)
class _Point:
    """The model and its gradients at one set of coefficients, all in every record."""

    theta: FloatArray  # a_1 .. a_n, b_0 .. b_m of ascending powers, in scaled units
    simulated: list[FloatArray]
    gradients: list[FloatArray]
    instruments: list[FloatArray]


class _Loop:
    """The instrumental equations of all records."""

    def __init__(
        self,
        records: Sequence[_LoopRecord],
        controller: SampledController,
        n_zeros: int,
        nuisances: tuple[bool, bool],
    ) -> None:
        self.records, self.controller, self.m = list(records), controller, n_zeros
        self.has_offset, self.has_ramp = nuisances
        self.n_own = int(self.has_offset) + int(self.has_ramp)

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
            self._weigh(point)
            point, count, converged, reason = self._newton(point)
            iterations += count
            if len(self.records) == 1 and not self.records[0].noise.n_parameters:
                break
        return self._result(point, converged, reason, iterations)

    def _weigh(self, point: _Point) -> None:
        """Give every record the colour and, where there are several, the level that its residuals have."""
        for own, left in zip(self.records, self._residuals(point), strict=True):
            # C(q) and, with several records, the level: both are weights only, so that the estimate stays
            # consistent whatever they are.
            own.noise = Whitening(np.ones(1), own.times)
            if not are_rounding(own.values, left):
                own.noise = colour_of(left, own.times)
            own.level = 1.0
            if len(self.records) > 1:
                innovations = own.white(left)
                n_free = max(len(innovations) - self.n_own, 1)
                own.level = max(math.sqrt(float(innovations @ innovations) / n_free), 1e-300)

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
        # The gradients of an unstable plant grow without end; Newton's step is halved until this does not
        # happen.
        if np.any(upper.real >= 0.0) or len(full_roots(upper)) != self.n:
            return None
        references = [own.reference for own in self.records]
        inputs = self.controller.plant_inputs(theta, self.n, self.scale, references)
        if inputs is None:
            return None
        simulated, gradients, instruments = [], [], []
        for own, simulated_input in zip(self.records, inputs, strict=True):
            measured = (own.measured_drive, own.measured_integral)
            response, slopes = self._gradients(theta, upper, measured, own.instants)
            # Z: the gradients (T.8) at the input u_s of the loop without noise. It does not know the noise of
            # y.
            clean = own.clean_drive(simulated_input)
            clean_slopes = self._gradients(theta, upper, (clean, clean.antiderivative()), own.instants)[1]
            simulated.append(response)
            gradients.append(slopes)
            instruments.append(clean_slopes)
        return _Point(theta, simulated, gradients, instruments)

    def _gradients(
        self,
        theta: FloatArray,
        upper: ComplexArray,
        signals: tuple[PiecewisePolynomial, PiecewisePolynomial],
        instants: Instants,
    ) -> tuple[FloatArray, FloatArray]:
        """Return B/A and its derivatives by the coefficients, shape (n, n_poles + n_zeros + 1)."""
        n, b = self.n, theta[self.n :]
        response = RationalResponse(upper, self.scale, *signals, instants, squares=True)
        # (T.8): -s^(n-i) B/A^2 u = -sum_k b_k s^(n-i+k)/A^2 u, from one table of s^k/A^2 u.
        plain = np.stack([response.over(power) for power in range(self.m + 1)], axis=1)
        squares = np.stack([response.over_square(power) for power in range(n + self.m)], axis=1)
        by_a = [-squares[:, n - i : n - i + self.m + 1] @ b for i in range(1, n + 1)]
        return plain @ b, np.concatenate([np.stack(by_a, axis=1), plain], axis=1)

    def _white(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return samples of all records as independent noise of one level sees them."""
        return _in_a_row([own.white(part) for own, part in zip(self.records, parts, strict=True)])

    def _with_nuisances(self, parts: Sequence[FloatArray]) -> list[FloatArray]:
        """Return columns of every record with the nuisances of all of them, zero outside their own."""
        result = []
        for number, (own, part) in enumerate(zip(self.records, parts, strict=True)):
            placed = np.zeros((len(part), self.n_own * len(self.records)))
            placed[:, number * self.n_own : (number + 1) * self.n_own] = own.nuisances
            result.append(np.concatenate([part, placed], axis=1))
        return result

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
        # (T.13), with offset and ramp of every record as their own instruments.
        psi = self._white(self._with_nuisances(point.gradients))
        z = self._white(self._with_nuisances(point.instruments))
        simulated = zip(self.records, point.simulated, strict=True)
        target = self._white([own.values - response for own, response in simulated])
        size_psi = np.linalg.norm(psi, axis=0)
        k = len(point.theta)
        if not np.all(size_psi[:k] > 1e-150):
            raise EstimationError(
                f"the reference moves nothing of output {self.records[0].output.name!r} in record "
                f"{self.records[0].name!r}, so that no coefficient can be told; record while the reference moves"
            )
        size_psi = np.maximum(size_psi, 1e-150)
        size_z = np.maximum(np.linalg.norm(z, axis=0), 1e-300)
        psi, z = psi / size_psi, z / size_z
        inverse = np.linalg.pinv(z.T @ psi, rcond=1e-13)
        step = inverse @ (z.T @ target)
        residuals = target - psi[:, k:] @ step[k:]
        # Less the nuisances only: at the root the step of the coefficients is zero.
        variance = float(residuals @ residuals) / max(len(residuals) - len(step), 1)
        # (T.14): R is the unit matrix while the residuals are white, else what colour the autoregression has
        # left.
        score = z.T @ z if is_white else self._score(z, residuals)
        covariance = variance * inverse @ score @ inverse.T / np.outer(size_psi, size_psi)
        return step / size_psi, covariance, float(np.linalg.cond(z.T @ psi)), residuals

    def _score(self, z: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return the covariance of the score under the colour that whitened residuals still have."""
        score = np.zeros((z.shape[1], z.shape[1]))
        for own, rows in zip(self.records, self._rows(), strict=True):
            left = residuals[rows]
            is_exact = are_rounding(own.values, left * own.level)
            score += z[rows].T @ z[rows] if is_exact else colour_of(left, own.times).score_covariance(z[rows])
        return score

    def _rows(self) -> list[slice]:
        """Return where every record's samples stand."""
        ends = np.cumsum([0, *(len(own.values) for own in self.records)])
        return [slice(int(first), int(end)) for first, end in itertools.pairwise(ends)]

    def _residuals(self, point: _Point) -> list[FloatArray]:
        """Return the residuals of every record in their colour, after the nuisances."""
        left = [own.values - response for own, response in zip(self.records, point.simulated, strict=True)]
        if not self.n_own:
            return left
        nuisances = self._nuisances(point)
        pairs = zip(self.records, nuisances, strict=True)
        return [part - own.nuisances @ found for part, (own, found) in zip(left, pairs, strict=True)]

    def _nuisances(self, point: _Point) -> FloatArray:
        """Return the coefficients of offset and ramp, shape (n_records, n_own)."""
        step = self._solution(point, is_white=True)[0]
        return step[len(point.theta) :].reshape(len(self.records), self.n_own)

    def _result(self, point: _Point, converged: bool, reason: str, iterations: int) -> ClosedLoopResult:
        _, covariance, condition, white = self._solution(point, is_white=False)
        if not condition < 1e13:
            converged, reason = False, "the reference does not determine all coefficients: singular equations"
        parts = self._residuals(point)
        values, residuals = _in_a_row([own.values for own in self.records]), _in_a_row(parts)
        n, m = self.n, self.m
        # From ascending to descending powers of B, and from units of the scale to rad/s.
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
            input_name=self.records[0].drive.name,
            output_name=self.records[0].output.name,
        )
        n_parameters = len(theta) + self.n_own * len(self.records)
        whiteness = Whiteness.of(white)
        signals = [(own.times, own.values) for own in self.records]
        is_worth_it = is_related(signals, parts, n_parameters, self.has_offset, self.has_ramp)
        fits = self._record_fits(point, parts, white)
        return ClosedLoopResult(
            model=model,
            times_s=_in_a_row([own.times for own in self.records]),
            measured=values,
            modelled=values - residuals,
            residuals=residuals,
            noise_coefficients=self.records[0].noise.coefficients,
            records=fits,
            scores=pooled_scores([(own.values, left) for own, left in zip(self.records, parts, strict=True)]),
            whiteness=whiteness,
            condition=condition,
            converged=converged,
            reason=reason,
            iterations=iterations,
            warnings=(
                *transfer_function_warnings([model], fits, whiteness, is_worth_it, converged, reason),
                *(said for own in self.records for said in damage_warnings([own.output], [own.drive])),
                *clipped_warnings([own.output for own in self.records]),
                *(
                    said
                    for own, fit in zip(self.records, fits, strict=True)
                    for said in _bent_input(own, fit, model)
                ),
            ),
        )

    def _record_fits(
        self, point: _Point, parts: Sequence[FloatArray], white: FloatArray
    ) -> tuple[RecordFit, ...]:
        """Return the fit of every record at the estimate."""
        nuisances = self._nuisances(point) if self.n_own else np.zeros((len(parts), 0))
        return tuple(
            RecordFit(
                name=own.name,
                times_s=own.times,
                measured=own.values,
                modelled=own.values - left,
                residuals=left,
                noise_sd=float(np.std(left)),
                noise_coefficients=own.noise.coefficients,
                noise=str(own.noise) if own.noise.n_parameters else "",
                scores=Scores.of(own.values, left),
                whiteness=Whiteness.of(white[rows]),
                offset=float(found[0]) if self.has_offset else 0.0,
                ramp=float(found[-1]) if self.has_ramp else 0.0,
            )
            for own, left, rows, found in zip(self.records, parts, self._rows(), nuisances, strict=True)
        )


def _bent_input(record: _LoopRecord, fit: RecordFit, model: TransferFunctionModel) -> list[str]:
    """Return that the input of a loop was bent on its way, where residuals hold the answer to its cube."""
    return input_misfit_warnings(
        model.output_name,
        record.drive,
        (fit.times_s, fit.modelled, fit.residuals),
        lambda drive: model.simulate(drive, fit.times_s, record.output.exposure_s),
        only_bent=True,
    )


def _in_a_row(parts: Sequence[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
