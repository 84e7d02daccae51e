"""One record's share of an output-error problem: where an output was measured, and what drove it.

Everything that is a record's own stands here: its clocks and inputs, its stamps and samples, its
offset, its drift and the motion that was there when it began.  What all records have in common, the
transfer functions, is the business of ``transfer_function_estimation.output_error``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from beam_ident.arrays import BoolArray, ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_input, require_output
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import PoleResponses
from beam_ident.numerics.rational_response import RationalResponse


class Response(Protocol):
    """Responses of one denominator at some instants."""

    poles: ComplexArray
    order: int
    has_squares: bool

    def combined(self, numerators: FloatArray, squared: bool = False) -> FloatArray:
        """Return the responses of several numerators over A, or over A^2, shape (n_instants, n_numerators)."""


class JoinedResponse:
    """The responses of one denominator in several records, one record after the other.

    Parameters
    ----------
    parts : sequence of RationalResponse
    """

    def __init__(self, parts: Sequence[RationalResponse]) -> None:
        self.parts = parts
        self.poles, self.order, self.has_squares = parts[0].poles, parts[0].order, parts[0].has_squares

    def combined(self, numerators: FloatArray, squared: bool = False) -> FloatArray:
        """Return the responses of several numerators over A, or over A^2, shape (n_instants, n_numerators)."""
        return np.concatenate([part.combined(numerators, squared) for part in self.parts])


def joined(parts: Sequence[RationalResponse]) -> Response:
    """Return responses in several records as one."""
    return parts[0] if len(parts) == 1 else JoinedResponse(parts)


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
        instants = self._instants(times, exposure_s, delay)
        return RationalResponse(upper, scale, self.signal, self.integral, instants, squares)

    def pole_responses(
        self, poles: ComplexArray, times: FloatArray, exposure_s: float, delay: float, n_direct: int
    ) -> tuple[ComplexArray, FloatArray]:
        """Return the responses of single poles, and the input itself with its derivatives, late, at output stamps.

        Parameters
        ----------
        poles : ndarray, complex, shape (n_poles,) -- [rad/s]
        times : ndarray, shape (n_times,)
        exposure_s, delay : float -- [s]
        n_direct : int -- how many of the input and its derivatives

        Returns
        -------
        responses, direct : ndarray, shape (n_poles, n_times) and (n_times, n_direct)
        """
        instants = self._instants(times, exposure_s, delay)
        responses = PoleResponses(poles, self.signal, gradients=False).sample(instants).values
        direct = [instants.mean(self.signal, order)[0][:, None] for order in range(n_direct)]
        return responses, np.concatenate([np.empty((len(times), 0)), *direct], axis=1)

    def seen(self, times: FloatArray, exposure_s: float, delay: float) -> FloatArray:
        """Return the input itself, late, at output stamps."""
        return self._instants(times, exposure_s, delay).mean(self.signal)[0]

    def _instants(self, times: FloatArray, exposure_s: float, delay: float) -> Instants:
        # Before the first knot nothing has happened, however far back a long delay looks.
        shifted = np.maximum(times - delay, self.signal.knots[0] + 0.5 * exposure_s)
        return Instants.on(self.signal, shifted, exposure_s)

    def delayed(self, delay: float) -> PiecewisePolynomial:
        """Return the input after the known integrators, late."""
        return PiecewisePolynomial(self.signal.knots + delay, self.signal.coefficients, self.signal.period)


@dataclass(frozen=True)
class Nuisances:
    """What is estimated beside the transfer functions, for every record by itself.

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

    def count(self, n_poles: int) -> int:
        """Return the number of columns in every record."""
        return self.has_offset + self.has_ramp + (n_poles if self.has_free_response else 0)


def usable_samples(output: OutputSignal, drives: list[InputSignal]) -> BoolArray:
    """Return which samples of an output lie, exposure included, where all inputs are known."""
    keep = output.is_valid
    for drive in drives:
        keep = keep & output.is_within(*drive.span_s)
    return np.asarray(keep)


@dataclass(frozen=True, eq=False)
class RecordShare:
    """The samples of one output in one record, and the inputs that caused them.

    Attributes
    ----------
    name : str -- of the record
    paths : tuple of Path -- the same in every record but for their signals
    times, values : ndarray, shape (n_samples,)
    exposure : float -- box average centred on every stamp [s]
    """

    name: str
    paths: tuple[Path, ...]
    times: FloatArray
    values: FloatArray
    exposure: float

    @staticmethod
    def of(
        record: TimeRecord,
        output_name: str,
        input_names: Sequence[str],
        n_zeros: Sequence[int],
        blocks: Sequence[int],
        delays: Sequence[Prior],
        n_integrators: int,
        is_past_unknown: bool,
    ) -> RecordShare:
        """Take one output of a record, where all its inputs are known.

        Parameters
        ----------
        record : TimeRecord
        output_name : str
        input_names : sequence of str
        n_zeros, blocks, delays : sequence -- of every input
        n_integrators : int -- known poles at zero
        is_past_unknown : bool
            Whether the inputs may not have been at rest before the record: then the samples that
            depend on what they were are left out.

        Raises
        ------
        EstimationError
            An output that is constant, or signals of an absurd size.
        """
        output, drives = record.output(output_name), [record.input(name) for name in input_names]
        for drive in drives:
            require_input(drive, is_needed=False)
        keep = usable_samples(output, drives)
        if is_past_unknown:
            for drive, prior in zip(drives, delays, strict=True):
                known = drive.span_s[0] + (0.0 if prior.is_free else prior.mean) + 0.5 * output.exposure_s
                keep = keep & (output.times_s >= known)
        times, values = np.asarray(output.times_s[keep]), np.asarray(output.values[keep])
        require_output(output.name, values)
        period = float(np.median(np.diff(output.times_s))) if len(output.times_s) > 1 else 0.0
        margin_s = output.exposure_s + 2.0 * period
        paths = tuple(
            Path.of(drive, m, block, prior, n_integrators, margin_s)
            for drive, m, block, prior in zip(drives, n_zeros, blocks, delays, strict=True)
        )
        return RecordShare(record.name, paths, times, values, output.exposure_s)

    @property
    def period(self) -> float:
        """Median distance of the stamps [s]."""
        return float(np.median(np.diff(self.times)))

    @property
    def length(self) -> float:
        """Time from the first to the last stamp [s]."""
        return float(self.times[-1] - self.times[0])

    @cached_property
    def measured(self) -> PiecewisePolynomial:
        """The samples joined by straight lines, at rest before; every stamp is a knot."""
        return self.joined(self.values)

    @cached_property
    def measured_integral(self) -> PiecewisePolynomial:
        """The antiderivative of the joined samples."""
        return self.measured.antiderivative()

    @cached_property
    def at_stamps(self) -> Instants:
        """The stamps, located on their own knots."""
        return Instants.on(self.measured, self.times, 0.0)

    def joined(self, values: FloatArray) -> PiecewisePolynomial:
        """Return values at the stamps joined by straight lines, at rest before; every stamp is a knot."""
        return PiecewisePolynomial.from_samples(
            self.times, values, "linear", margin_s=1e-3 * self.period, lead="zero"
        )

    def from_stamp(self, start_s: float) -> RecordShare:
        """Return the experiment without the samples before an instant."""
        keep = self.times >= start_s
        return replace(self, times=self.times[keep], values=self.values[keep])

    def forced(
        self, uppers: Sequence[ComplexArray], scale: float, delays: FloatArray, slopes: bool
    ) -> list[RationalResponse]:
        """Return the responses to every input at the stamps."""
        return [
            path.response(uppers[path.block], scale, self.times, self.exposure, delay, slopes)
            for path, delay in zip(self.paths, delays, strict=True)
        ]

    def free(self, upper: ComplexArray, scale: float, slopes: bool) -> RationalResponse:
        """Return the free motions at the stamps, of the motion that was there at the first one."""
        elapsed = self.times - self.times[0] + 0.5 * self.exposure
        return RationalResponse.to_impulse(upper, scale, elapsed, self.exposure, slopes)

    def drifts(self, nuisances: Nuisances, times: FloatArray | None = None) -> list[FloatArray]:
        """Return the columns of offset and ramp at the stamps, or at other instants [s]."""
        times = self.times if times is None else times
        columns = [np.ones_like(times)] if nuisances.has_offset else []
        if nuisances.has_ramp:
            columns.append((times - 0.5 * (self.times[0] + self.times[-1])) / self.length)
        return columns
