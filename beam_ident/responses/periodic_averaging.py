"""Responses from the steady periods of a periodic excitation, each line with its noise.

Over whole periods a Fourier transform leaks nothing: an excited line holds the response,
the scatter from period to period is the noise, and lines that were not excited show
distortion (Pintelon and Schoukens 2012, ch. 2 and 4).  Where the input is measured and noisy
itself, the response is the ratio of the averaged spectra, and its variance counts the
noise of both and what they have in common (errors in variables):

    var H = |H|^2 [ var Y / |Y|^2 + var U / |U|^2 - 2 Re( cov(Y, U) / (Y conj U) ) ]

Input and outputs keep their own clocks.  The input's Fourier coefficients follow exactly
from its samples and its hold, images included; an output sampled slower than twice the
highest line folds it, and every line is reported at the frequency that was excited, above
half the output's rate too.  What else falls on a line stands in its ``Folding``.

Equation numbers are those of docs/frequency-domain.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import AnyArray, BoolArray, ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import chosen_input, finite_row, require_output, require_record
from beam_ident.data.frequency_record import TAIL_POWERS, Folding, FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.numerics.piecewise import HOLDS, Hold, Instants, PiecewisePolynomial, regular_period
from beam_ident.responses.doubts import with_doubts
from beam_ident.responses.steady_periods import (
    changing_warnings,
    drift_of_periods,
    input_changes,
    unsteady_warnings,
)

_MAX_MISSING = 0.02
_LINE_TOLERANCE = 1e-6  # of a period: how whole a number of samples must be
_EXCITED = 1e-3  # of the strongest line: what counts as excited where nobody says
_IMAGE_FLOOR = 1e-6  # of the line: images that matter less go into the tail
_MAX_IMAGES = 32
_IMAGES_ABOVE = 8  # multiples of the input's rate up to which images are looked at
_AUDIBLE = 15.0  # times the noise's power: below this a line of the input holds nothing but noise
_ENOUGH_FREEDOM = 40.0  # degrees of freedom at which a variance weighs almost as a known one


@dataclass(frozen=True, eq=False)
class PeriodicResponse:
    """A frequency response from periods, and the outputs' whole spectra.

    Attributes
    ----------
    response : FrequencyRecord -- at the excited lines
    n_periods : int
    line_period_s : float
    bins : ndarray, shape (n_bins,) -- lines below half the outputs' rate, as multiples of 1 / line_period_s
    spectrum : complex ndarray, shape (n_bins, n_outputs)
        Amplitude (peak of the sine) of the outputs' mean period.
    spectrum_variance : ndarray, shape (n_bins, n_outputs)
        ``E |error|^2`` of a single period's amplitude, from the scatter between periods.
    input_spectrum : complex ndarray, shape (n_bins,) -- amplitude of the input as the outputs sample it
    is_excited : ndarray of bool, shape (n_bins,) -- whether an excited line, or its fold, stands there
    drift : ndarray, shape (n_outputs,)
        Power of the change from the first period to the last over what the noise between
        other periods explains; about 1 when steady.  Where noise does not explain it, the response says so
        in its ``warnings``, and every fit to it too.
    """

    response: FrequencyRecord
    n_periods: int
    line_period_s: float
    bins: IndexArray
    spectrum: ComplexArray
    spectrum_variance: FloatArray
    input_spectrum: ComplexArray
    is_excited: BoolArray
    drift: FloatArray

    @property
    def bins_hz(self) -> FloatArray:
        """Frequencies of the bins [Hz]."""
        return np.asarray(self.bins / self.line_period_s)


# The B-spline of degree 9 at 0 and twice at 1 .. 4 samples from its middle: Eulerian numbers over 9!.
_BASIS_OF_DEGREE_9 = np.array([156190.0, 176468.0, 29216.0, 1004.0, 2.0]) / 362880.0


def hold_gain(hold: Hold, omegas: FloatArray, period_s: float) -> ComplexArray:
    """Return the Fourier coefficient of a held signal over that of its samples.

    Parameters
    ----------
    hold : {"zoh", "linear", "cubic", "band_limited"}
    omegas : ndarray -- any frequencies, images included [rad/s]
    period_s : float -- of the samples [s]

    Notes
    -----
    With ``x = omega T / 2``: zero-order hold ``sinc(x) e^(-jx)``, straight lines ``sinc(x)^2``, the cubic
    spline ``3 sinc(x)^4 / (2 + cos 2x)`` (Unser 1999, for the cardinal spline), and likewise the
    spline of degree 9 ``sinc(x)^10`` over the transform of its basis at the samples.
    """
    half = 0.5 * np.asarray(omegas, dtype=np.float64) * period_s
    sinc = np.sinc(half / np.pi)
    if hold == "zoh":
        return np.asarray(sinc * np.exp(-1j * half))
    if hold == "linear":
        return np.asarray(sinc**2 + 0j)
    if hold == "cubic":
        return np.asarray(3.0 * sinc**4 / (2.0 + np.cos(2.0 * half)) + 0j)
    if hold == "band_limited":
        cosines = np.cos(np.multiply.outer(half, 2.0 * np.arange(5)))
        return np.asarray(sinc**10 / (cosines @ _BASIS_OF_DEGREE_9) + 0j)
    raise EstimationError(f"the hold {hold!r} has no Fourier gain here; expected {', '.join(HOLDS)}")


def exposure_gain(omegas: FloatArray, exposure_s: float) -> FloatArray:
    """Return what the box average over an exposure leaves of a frequency."""
    return np.asarray(np.sinc(np.asarray(omegas) * exposure_s / (2.0 * np.pi)))


def angular(numbers: IndexArray, line_period_s: float) -> FloatArray:
    """Return the frequencies of line numbers [rad/s]."""
    return np.asarray(2.0 * np.pi * numbers / line_period_s, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Input:
    """The input's periods that go with the outputs' periods."""

    signal: InputSignal
    period_s: float
    per_period: int
    ticks: FloatArray  # (n_periods, per_period)
    start_s: float  # of the first tick, relative to the outputs' first stamp

    @staticmethod
    def of(drive: InputSignal, first_s: float, n_periods: int, line_period_s: float, half: float) -> _Input:
        period = drive.period_s
        if period is None:
            raise EstimationError(
                f"input {drive.name!r} has irregular stamps; a periodic response needs a regular input. "
                "Fit a model instead: identify() takes any stamps"
            )
        per_period = whole_number(line_period_s, period, f"input {drive.name!r}")
        first = int(np.floor((first_s - half - drive.times_s[0]) / period + 1e-6))
        last = first + n_periods * per_period
        if first < 0 or last > len(drive.values):
            raise EstimationError(
                f"input {drive.name!r} is known from {drive.span_s[0]:.3f} to {drive.span_s[1]:.3f} s; the steady "
                f"periods need it from {first_s:.3f} to {first_s + n_periods * line_period_s:.3f} s"
            )
        ticks = drive.values[first:last].reshape(n_periods, per_period)
        return _Input(drive, period, per_period, ticks, float(drive.times_s[first]) - first_s)

    def coefficients(self, numbers: IndexArray, line_period_s: float) -> ComplexArray:
        """Return the Fourier coefficients at any line numbers, shape (n_periods, n_numbers)."""
        spectra = np.fft.fft(self.ticks, axis=1) / self.per_period
        omegas = angular(numbers, line_period_s)
        # (F.3): the samples' spectrum is periodic in the line number, the hold's gain is not.
        gain = hold_gain(self.signal.hold, omegas, self.period_s) * np.exp(-1j * omegas * self.start_s)
        return np.asarray(spectra[:, numbers % self.per_period] * gain)

    def quiet(self, numbers: IndexArray) -> _Input:
        """Return the mean period as the only one, without lines in which nothing but noise was measured."""
        n_periods = len(self.ticks)
        spectra = np.fft.rfft(self.ticks, axis=1)
        mean = np.mean(spectra, axis=0)
        scatter = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (n_periods - 1) / n_periods
        level = _moving_mean(scatter, int(min(np.ceil(_ENOUGH_FREEDOM / (n_periods - 1)), len(scatter))))
        # Noise that was measured at the input did not excite anything: it must not enter as an image.
        is_kept = np.abs(mean) ** 2 > _AUDIBLE * level
        is_kept[numbers] = True
        ticks = np.fft.irfft(np.where(is_kept, mean, 0.0), self.per_period)
        return _Input(self.signal, self.period_s, self.per_period, ticks[None], self.start_s)

    def integrals(self, times: FloatArray, exposure_s: float) -> list[FloatArray]:
        """Return second derivative .. second integral of the first period, as the outputs sample it."""
        mean = self.ticks[0]
        samples = np.tile(mean - np.mean(mean), 3)
        ticks = np.arange(len(samples), dtype=np.float64) - self.per_period
        grid: FloatArray = self.start_s + self.period_s * ticks
        hold = self.signal.hold
        own = PiecewisePolynomial.from_samples(grid, samples, hold)
        span = self.per_period * self.period_s
        begin = self.start_s
        chain = [own]
        for _ in range(2):
            integral = chain[-1].antiderivative()
            # Each integral without its mean, so that the next one is periodic as well.
            twice = integral.antiderivative()
            ends = twice(np.array([begin, begin + span]))
            chain.append(integral.shifted(-float(ends[1] - ends[0]) / span))
        instants = Instants.on(own, times, exposure_s)
        found = [np.full(len(times), np.nan)] * 2  # a held input jumps: it has no derivatives
        if hold != "zoh":
            # Where two derivatives are asked of straight lines, the spline through the ticks has them.
            source: Hold = "cubic" if hold == "linear" else hold
            smooth = PiecewisePolynomial.from_samples(grid, samples, source)
            found = [instants.mean(smooth, 2)[0], instants.mean(own, 1)[0]]
        return found + [instants.mean(chain[k])[0] for k in range(3)]


def whole_number(line_period_s: float, period_s: float, what: str) -> int:
    """Return how many samples a period of the excitation holds, or raise EstimationError."""
    count = line_period_s / period_s
    if not 4 <= count < math.inf or abs(round(count) / count - 1.0) > _LINE_TOLERANCE:
        raise EstimationError(
            f"{what}: the period of {line_period_s} s is {count:.4f} samples; expected a whole number, at least "
            "4. Choose the period or the frame rate so that it is one"
        )
    return round(count)


def _steady(
    outputs: Sequence[OutputSignal], line_period_s: float, start_s: float, end_s: float
) -> tuple[FloatArray, FloatArray, int, int]:
    """Return stamps and values (n_outputs, n) of the whole steady periods, their number and length."""
    first_output = outputs[0]
    for output in outputs[1:]:
        if not np.array_equal(output.times_s, first_output.times_s):
            raise EstimationError(
                f"outputs {first_output.name!r} and {output.name!r} have different stamps; estimate them one at "
                "a time, with output_names"
            )
    times = first_output.times_s
    keep = (times >= start_s - 1e-9) & (times <= end_s + 1e-9)
    times = times[keep]
    period = regular_period(times)
    if period is None:
        raise EstimationError(
            f"output {first_output.name!r} has irregular stamps, or fewer than two, between {start_s} and {end_s} "
            "s; a periodic response needs a regular grid. Fit a model instead: identify() takes any stamps"
        )
    per_period = whole_number(line_period_s, period, f"output {first_output.name!r}")
    n_periods = len(times) // per_period
    if n_periods < 2:
        raise EstimationError(
            f"between {start_s} and {end_s} s there are {n_periods} whole periods of {line_period_s} s; "
            "expected at least two"
        )
    rows = []
    n = n_periods * per_period
    for output in outputs:
        values = np.array(output.values[keep][:n])
        missing = ~np.isfinite(values)
        if np.mean(missing) > _MAX_MISSING:
            raise EstimationError(
                f"output {output.name!r}: {np.mean(missing):.1%} of the samples are missing; a periodic response "
                f"bridges at most {_MAX_MISSING:.0%}. Fit a model instead: identify() leaves them out"
            )
        values[missing] = np.interp(times[:n][missing], times[:n][~missing], values[~missing])
        require_output(output.name, values)
        rows.append(values)
    return times[:n], np.array(rows), n_periods, per_period


def periodic_response(
    record: TimeRecord,
    line_period_s: float,
    excited_hz: FloatArray | None = None,
    start_s: float = -np.inf,
    end_s: float = np.inf,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
) -> PeriodicResponse:
    """Estimate a frequency response from the steady periods of a periodic excitation.

    Parameters
    ----------
    record : TimeRecord
        Outputs with common regular stamps, a regular input.
    line_period_s : float
        Period of the excitation [s], a whole number of samples of input and outputs.
    excited_hz : ndarray or None
        Its lines [Hz]; None takes the lines whose input stands out.
    start_s, end_s : float
        The steady part [s], with at least two whole periods.
    output_names : sequence of str or None -- None takes all
    input_name : str or None -- which input, where there are several

    Raises
    ------
    EstimationError
        Irregular stamps, periods that are not whole numbers of samples, fewer than two.

    Notes
    -----
    The noise's covariance is averaged over neighbouring lines until it has some forty
    degrees of freedom, because weights from two or three periods alone would cost much
    of the accuracy of a fit; this takes the noise of input and outputs, not the
    response, to be smooth over a few lines.
    """
    require_record(record)
    drive = chosen_input(record, input_name)
    outputs = [record.output(n) for n in (record.output_names if output_names is None else output_names)]
    if len({o.exposure_s for o in outputs}) > 1:
        raise EstimationError(
            f"outputs {', '.join(o.name for o in outputs)} have different exposures; estimate them one at a time, "
            "with output_names"
        )
    half = 0.5 * outputs[0].exposure_s
    first, last = drive.span_s
    times, values, n_periods, n_bins = _steady(
        outputs, line_period_s, max(start_s, first + half), min(end_s, last - half)
    )
    source = _Input.of(drive, float(times[0]), n_periods, line_period_s, half)
    # Two-sided Fourier coefficients of every period, referred to the first stamp.
    spectra = np.fft.fft(_level(values.reshape(len(outputs), n_periods, n_bins)), axis=2) / n_bins
    bins = np.arange(1, (n_bins - 1) // 2 + 1)
    spectra = spectra[:, :, bins]
    numbers = _excited_numbers(source, excited_hz, line_period_s)
    lines = _Lines.of(source, numbers, n_bins, line_period_s, outputs[0].exposure_s)
    at = lines.bins - 1
    # A bin above half the rate holds the conjugate of the line that folded there.
    measured = np.where(lines.sign > 0, spectra[:, :, at], np.conj(spectra[:, :, at]))
    of_input = lines.input_of(source, outputs[0].exposure_s, line_period_s)
    drives = np.stack([of_input] * len(outputs))
    mean_y, mean_u = np.mean(measured, axis=1), np.mean(drives, axis=1)
    # (F.1); noise on the input averages out before the division and does not bias it.
    response = mean_y / mean_u
    covariance, freedom = _covariance(measured - mean_y[:, None], drives - mean_u[:, None], response, mean_u)
    scatter = np.sum(np.abs(spectra - np.mean(spectra, axis=1)[:, None]) ** 2, axis=1) / (n_periods - 1)
    own_times = times[:n_bins] - times[0]
    quiet = source.quiet(numbers)
    integrals = quiet.integrals(own_times, outputs[0].exposure_s)
    # The sums over all images behind (F.5), from the held input's derivatives and integrals.
    sampled = [np.fft.fft(part)[bins] / n_bins for part in integrals]
    drift, is_unsteady = drift_of_periods(spectra)
    has_input_changed = input_changes(source.ticks)
    found = FrequencyRecord(
        omegas=lines.omegas,
        response=response.T,
        covariance=covariance,
        output_names=tuple(o.name for o in outputs),
        input_names=(drive.name,),
        output_units=tuple(o.unit for o in outputs),
        input_units=(drive.unit,),
        degrees_of_freedom=freedom,
        method=f"mean of {n_periods} periods",
        folding=lines.folding(quiet, sampled, n_bins, line_period_s, outputs[0].exposure_s),
        name=record.name,
        warnings=unsteady_warnings(record.name, has_input_changed, drift[is_unsteady]),
    )
    changes = [
        said
        for output, own, line, u in zip(outputs, measured, response, drives, strict=True)
        for said in changing_warnings(output.name, line * u, own, lines.omegas, leaks=True)
    ]
    is_excited = np.zeros(len(bins), dtype=bool)
    folded = numbers % n_bins
    folded = np.minimum(folded, n_bins - folded)
    is_excited[folded[(folded > 0) & (folded <= len(bins))] - 1] = True
    return PeriodicResponse(
        response=with_doubts(found, outputs, drive, () if has_input_changed else changes),
        n_periods=n_periods,
        line_period_s=line_period_s,
        bins=bins,
        spectrum=2.0 * np.mean(spectra, axis=1).T,
        spectrum_variance=4.0 * scatter.T,
        input_spectrum=2.0 * sampled[2],
        is_excited=is_excited,
        drift=drift,
    )


def _level(periods: FloatArray) -> FloatArray:
    """Return the periods without the straight drift that their means show; it would leak into every line."""
    n_periods, n = periods.shape[1:]
    turn = np.arange(n_periods) - 0.5 * (n_periods - 1)
    # Least squares of the periods' means over their number; the ramp runs on inside the periods.
    slope = np.mean(periods, axis=2) @ turn / float(turn @ turn)
    ramp = turn[:, None] + (np.arange(n) - 0.5 * (n - 1)) / n
    return np.asarray(periods - slope[:, None, None] * ramp)


def _excited_numbers(source: _Input, excited_hz: FloatArray | None, line_period_s: float) -> IndexArray:
    top = (source.per_period - 1) // 2
    if excited_hz is None:
        size = np.abs(np.mean(source.coefficients(np.arange(1, top + 1), line_period_s), axis=0))
        numbers = 1 + np.flatnonzero(size > _EXCITED * np.max(size))
    else:
        exact = finite_row("excited_hz [Hz]", excited_hz) * line_period_s
        numbers = np.unique(np.round(exact).astype(np.intp))
        if np.any(np.abs(exact - np.round(exact)) > 1e-3) or np.any((numbers < 1) | (numbers > top)):
            raise EstimationError(
                f"excited_hz: the lines must be multiples of {1.0 / line_period_s:.6g} Hz, from that to below "
                f"{top / line_period_s:.6g} Hz, half the rate of the input"
            )
    if not len(numbers):
        raise EstimationError("no line is excited; give excited_hz, or an input that moves")
    return np.asarray(numbers)


@dataclass(frozen=True, eq=False)
class _Lines:
    """The strongest excited line of every bin, and what else falls there."""

    numbers: IndexArray
    bins: IndexArray
    sign: IndexArray  # -1 where the bin holds the conjugate
    omegas: FloatArray

    @staticmethod
    def of(
        source: _Input, numbers: IndexArray, n_bins: int, line_period_s: float, exposure_s: float
    ) -> _Lines:
        # Where a line falls when the outputs sample it, and on which side.
        place = numbers % n_bins
        sign = np.where(place <= n_bins // 2, 1, -1)
        bins = np.where(sign > 0, place, n_bins - place)
        omegas = angular(numbers, line_period_s)
        size = np.abs(np.mean(source.coefficients(numbers, line_period_s), axis=0))
        size = size * np.abs(exposure_gain(omegas, exposure_s))
        usable = (bins > 0) & (2 * bins < n_bins) & (size > 0.0)
        # Of several lines in one bin the strongest is reported; the others become its images.
        best: dict[int, int] = {}
        for k in np.flatnonzero(usable):
            if bins[k] not in best or size[k] > size[best[int(bins[k])]]:
                best[int(bins[k])] = int(k)
        chosen = np.array(sorted(best.values()), dtype=np.intp)
        if not len(chosen):
            raise EstimationError("no excited line falls on a line of the outputs; sample them faster")
        return _Lines(
            numbers[chosen], bins[chosen], sign[chosen], np.asarray(omegas[chosen], dtype=np.float64)
        )

    def input_of(self, source: _Input, exposure_s: float, line_period_s: float) -> ComplexArray:
        """Return the input at the lines, exposed, shape (n_periods, n_lines)."""
        gain = exposure_gain(self.omegas, exposure_s)
        return np.asarray(source.coefficients(self.numbers, line_period_s) * gain)

    def folding(
        self, source: _Input, sampled: list[Any], n_bins: int, line_period_s: float, exposure_s: float
    ) -> Folding:
        """Return images and tails of every line."""
        highest = _IMAGES_ABOVE * max(source.per_period, n_bins)
        turns = np.arange(-(highest // n_bins), highest // n_bins + 1)
        # Line numbers in the same bin, of the sign under which the line is reported.
        others = self.numbers[:, None] + turns[None, :] * n_bins
        omegas = angular(others, line_period_s)
        own = self.input_of(source, exposure_s, line_period_s)[0]
        strength = source.coefficients(others.ravel(), line_period_s).reshape(others.shape)
        # w_i of (F.4).
        weights = strength * exposure_gain(omegas, exposure_s) / own[:, None]
        # Structures fall like 1/omega^2 above their modes: what counts of an image is its weight times that.
        importance = np.abs(weights) * np.minimum(
            1.0, (self.omegas[:, None] / np.maximum(np.abs(omegas), 1e-300)) ** 2
        )
        importance[:, len(turns) // 2] = 0.0
        importance[others == 0] = 0.0
        kept = min(_MAX_IMAGES, int(np.max(np.count_nonzero(importance > _IMAGE_FLOOR, axis=1), initial=0)))
        order = np.argsort(-importance, axis=1)[:, :kept]
        image_omegas = np.take_along_axis(omegas, order, axis=1)
        image_weights = np.take_along_axis(weights, order, axis=1)
        absent = np.take_along_axis(importance, order, axis=1) <= _IMAGE_FLOOR
        image_omegas = np.where(absent, self.omegas[:, None], image_omegas)
        image_weights = np.where(absent, 0.0, image_weights)
        tails = np.empty((len(self.numbers), len(TAIL_POWERS)), dtype=np.complex128)
        for column, power in enumerate(TAIL_POWERS):
            total = sampled[column][self.bins - 1]
            total = np.where(self.sign > 0, total, np.conj(total)) / own
            # Tail = everything that the sampled integral holds, less the line itself and the listed images.
            counted = (1j * self.omegas) ** -power
            counted = counted + np.sum(image_weights * (1j * image_omegas) ** float(-power), axis=1)
            tails[:, column] = total - counted
        return Folding(image_omegas, image_weights, tails)


def _covariance(
    of_outputs: ComplexArray, of_inputs: ComplexArray, response: ComplexArray, mean_u: ComplexArray
) -> tuple[ComplexArray, float]:
    """Return the response's covariance by line, shape (n_lines, n_outputs, n_outputs), and its freedom."""
    n_outputs, n_periods, n_lines = of_outputs.shape
    # Sigma and J of (F.2), over outputs and, for each, the input as it sees it.
    together = np.concatenate([of_outputs, of_inputs], axis=0)
    second = np.einsum("apl,bpl->lab", together, np.conj(together)) / (n_periods - 1)
    width = int(min(np.ceil(_ENOUGH_FREEDOM / (n_periods - 1)), n_lines))
    smooth = _moving_mean(second, width)
    jacobian = np.zeros((n_lines, n_outputs, 2 * n_outputs), dtype=np.complex128)
    index = np.arange(n_outputs)
    jacobian[:, index, index] = 1.0 / mean_u.T
    jacobian[:, index, n_outputs + index] = -(response / mean_u).T
    covariance = jacobian @ smooth @ np.conj(np.swapaxes(jacobian, 1, 2)) / n_periods
    return np.asarray(covariance), float(width * (n_periods - 1))


def _moving_mean(values: AnyArray, width: int) -> AnyArray:
    """Return the mean over ``width`` neighbouring lines, fewer of them on one side at the ends."""
    n = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:]), dtype=values.dtype), np.cumsum(values, axis=0)])
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    return np.asarray((total[first + width] - total[first]) / width)
