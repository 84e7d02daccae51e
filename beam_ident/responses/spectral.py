"""Non-parametric frequency responses: what the data say before any model.

Two ways for records that are not periodic (for those that are, see
``responses.periodic_averaging``):

* ``welch_response``: averaged cross-spectra (H1, H2, Hv, or through a reference signal) with
  coherence, for long noise-like records.  On a single chirp its segments see the modes ring
  long after the input has left them, and the estimate is biased: look, do not fit.
* ``local_polynomial_response``: one record, any excitation; the transient that leaks into
  every line is a smooth function of frequency and is estimated along (Pintelon and
  Schoukens 2012, ch. 7).

The input is taken at the stamps of the output, through its hold and with the same
exposure, so that both have the same sampling; the outputs are never interpolated
except over single missing samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import csd, welch

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import (
    require_moving_input,
    require_output,
    require_record,
    require_whole_number,
)
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.numerics.piecewise import Instants, regular_period

SpectralMethod = Literal["h1", "h2", "hv", "reference"]

_MAX_DEGREE = 10  # of local polynomials: beyond it their powers tell nothing apart
_MOST_MISSING = 0.02


@dataclass(frozen=True, eq=False)
class _Pair:
    """Input, output and perhaps a reference at common regular stamps."""

    period: float
    drive: FloatArray
    output: FloatArray
    reference: FloatArray | None


@dataclass(frozen=True, eq=False)
class _Estimate:
    """A response of one output: lines [rad/s], complex values, variances, coherence."""

    omegas: FloatArray
    response: ComplexArray
    variance: FloatArray
    coherence: FloatArray | None
    freedom: float
    shared_lines: float = 1.0


def _pair(drive: InputSignal, output: OutputSignal, reference: InputSignal | None) -> _Pair:
    half = 0.5 * output.exposure_s
    first, last = drive.span_s
    if reference is not None:
        first, last = max(first, reference.span_s[0]), min(last, reference.span_s[1])
    keep = (output.times_s - half >= first) & (output.times_s + half <= last)
    times, values = np.asarray(output.times_s[keep]), np.array(output.values[keep])
    period = regular_period(times)
    if period is None or len(times) < 32:
        raise EstimationError(
            f"output {output.name!r} has {len(times)} usable stamps, "
            f"{'irregular ones' if period is None else 'too few'}; a non-parametric response needs at least 32 on "
            "a regular grid. Fit a model instead: identify() takes any stamps"
        )
    missing = ~np.isfinite(values)
    if np.mean(missing) > _MOST_MISSING:
        raise EstimationError(
            f"output {output.name!r}: {np.mean(missing):.1%} of the samples are missing; a non-parametric response "
            f"bridges at most {_MOST_MISSING:.0%}. Fit a model instead: identify() leaves them out"
        )
    values[missing] = np.interp(times[missing], times[~missing], values[~missing])
    require_output(output.name, values)

    def seen(source: InputSignal) -> FloatArray:
        signal = source.signal()
        return Instants.on(signal, times, output.exposure_s).mean(signal, signal.antiderivative())[0]

    return _Pair(period, seen(drive), values, None if reference is None else seen(reference))


def _for_every_output(
    record: TimeRecord,
    output_names: Sequence[str] | None,
    input_name: str | None,
    reference_name: str | None,
    method: str,
    estimate: Callable[[_Pair], _Estimate],
) -> FrequencyRecord:
    require_record(record)
    if input_name is None and len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has the inputs {', '.join(s.name for s in record.inputs)}; say which with "
            "input_name"
        )
    drive = record.inputs[0] if input_name is None else record.input(input_name)
    require_moving_input(drive)
    reference = None if reference_name is None else record.input(reference_name)
    outputs = [record.output(n) for n in (record.output_names if output_names is None else output_names)]
    found = [estimate(_pair(drive, output, reference)) for output in outputs]
    for output, one in zip(outputs, found, strict=True):
        if not np.array_equal(one.omegas, found[0].omegas):
            raise EstimationError(
                f"outputs {outputs[0].name!r} and {output.name!r} have different stamps, and so different lines; "
                "estimate them one at a time, with output_names"
            )
    coherences = [one.coherence for one in found if one.coherence is not None]
    return FrequencyRecord(
        omegas=found[0].omegas,
        response=np.stack([one.response for one in found], axis=1),
        variance=np.stack([one.variance for one in found], axis=1),
        output_names=tuple(output.name for output in outputs),
        input_names=(drive.name,),
        output_units=tuple(output.unit for output in outputs),
        input_units=(drive.unit,),
        coherence=np.stack(coherences, axis=1) if coherences else None,
        degrees_of_freedom=min(one.freedom for one in found),
        method=method,
        name=record.name,
        shared_lines=max(one.shared_lines for one in found),
    )


def welch_response(
    record: TimeRecord,
    method: SpectralMethod = "h1",
    segment_s: float | None = None,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
    reference_name: str | None = None,
) -> FrequencyRecord:
    """Estimate a frequency response from averaged spectra.

    Parameters
    ----------
    record : TimeRecord
    method : {"h1", "h2", "hv", "reference"}
        H1 is unbiased by noise on the output, H2 by noise on the input, Hv assumes equal
        shares of both.  "reference" is unbiased by noise on either, and in a closed loop:
        ``S_yr / S_ur`` with a signal r that is known and depends on neither noise.
    segment_s : float or None
        Length of the Hann windows [s], overlapping by half; None takes an eighth of the
        record.
    output_names : sequence of str or None -- None takes all, which then share their stamps
    input_name : str or None -- which input, where there are several
    reference_name : str or None -- the input of the record that is the reference

    Raises
    ------
    EstimationError
        Irregular stamps, too short a record, a method without its reference.

    Notes
    -----
    With a reference, ``var H = S_ee S_rr / (n |S_ur|^2)`` with e = y - H u: the variance of an
    instrumental variable (Soderstrom and Stoica 1989, line by line).
    """
    if method not in ("h1", "h2", "hv", "reference"):
        raise EstimationError(f"method is {method!r}; expected h1, h2, hv or reference")
    if (method == "reference") != (reference_name is not None):
        raise EstimationError(
            f"method is {method!r} and reference_name {reference_name!r}; one needs the other"
        )

    def estimate(pair: _Pair) -> _Estimate:
        return _welch(pair, method, segment_s)

    return _for_every_output(record, output_names, input_name, reference_name, method, estimate)


def _welch(pair: _Pair, method: SpectralMethod, segment_s: float | None) -> _Estimate:
    n = len(pair.output)
    if segment_s is not None and not (math.isfinite(segment_s) and segment_s > 0.0):
        raise EstimationError(
            f"segment_s is {segment_s}; expected a time > 0, or None for an eighth of the record"
        )
    length = n // 8 if segment_s is None else round(segment_s / pair.period)
    if not 16 <= length <= n:
        raise EstimationError(f"segments of {length} samples in a record of {n}; expected 16 to {n}")
    keywords = {"fs": 1.0 / pair.period, "nperseg": length, "window": "hann", "detrend": "constant"}
    frequencies, cross = csd(pair.drive, pair.output, **keywords)
    of_input = welch(pair.drive, **keywords)[1]
    of_output = welch(pair.output, **keywords)[1]
    last = len(frequencies) - (1 - length % 2)  # the line at half the rate is real
    inner = slice(1, last)
    frequencies, cross, of_input, of_output = (x[inner] for x in (frequencies, cross, of_input, of_output))
    floor = 1e-300
    coherence = np.clip(np.abs(cross) ** 2 / np.maximum(of_input * of_output, floor), 0.0, 1.0)
    # Overlapping Hann segments by half: 36 % fewer independent averages (Welch 1967).
    averages = max(1.0, (2.0 * n / length - 1.0) / 1.36)
    omegas = np.asarray(2.0 * np.pi * frequencies, dtype=np.float64)
    if pair.reference is not None:
        to_output = csd(pair.reference, pair.output, **keywords)[1][inner]
        to_input = csd(pair.reference, pair.drive, **keywords)[1][inner]
        of_reference = welch(pair.reference, **keywords)[1][inner]
        strength = np.maximum(np.abs(to_input) ** 2, floor)
        response = to_output * np.conj(to_input) / strength
        left = of_output - 2.0 * np.real(np.conj(response) * cross) + np.abs(response) ** 2 * of_input
        # One degree of freedom of every line went into the response.
        variance = np.maximum(left, 0.0) * of_reference / strength / max(averages - 1.0, 1.0)
        linked = np.clip(np.abs(to_output) ** 2 / np.maximum(of_reference * of_output, floor), 0.0, 1.0)
        return _Estimate(omegas, response, variance, linked, averages)
    h1 = cross / np.maximum(of_input, floor)
    h2 = of_output / np.where(np.abs(cross) > floor, np.conj(cross), floor)
    hv = np.sqrt(np.abs(h1) * np.abs(h2)) * np.exp(1j * np.angle(cross))
    response = {"h1": h1, "h2": h2, "hv": hv}[method]
    variance = np.abs(response) ** 2 * (1.0 - coherence) / np.maximum(coherence, 1e-12) / averages
    return _Estimate(omegas, response, variance, coherence, averages)


def local_polynomial_response(
    record: TimeRecord,
    degree: int = 2,
    half_width: int | None = None,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
) -> FrequencyRecord:
    """Estimate a frequency response and the leaking transient by local polynomials.

    Parameters
    ----------
    record : TimeRecord
    degree : int -- of both polynomials
    half_width : int or None
        Lines on either side; None takes the least that leaves as many degrees of freedom
        as there are unknowns.
    output_names : sequence of str or None -- None takes all, which then share their stamps
    input_name : str or None -- which input, where there are several

    Raises
    ------
    EstimationError
        Irregular stamps, a record too short for the polynomials, an input or output that is constant.

    Notes
    -----
    The polynomials must be able to follow the resonances: at damping ratio zeta and
    frequency f the half-power band is 2 zeta f wide and should hold several lines
    (line spacing is one over the length of the record).  Neighbouring lines share data, so
    that their errors depend on each other.
    """
    require_whole_number("degree", degree, 0, _MAX_DEGREE)
    unknowns = 2 * (degree + 1)
    width = unknowns if half_width is None else half_width
    if 2 * width + 1 <= unknowns:
        raise EstimationError(f"half_width is {width}; degree {degree} needs at least {unknowns // 2 + 1}")

    def estimate(pair: _Pair) -> _Estimate:
        return _local_polynomial(pair, degree, width)

    method = f"local polynomial of degree {degree} over {2 * width + 1} lines"
    return _for_every_output(record, output_names, input_name, None, method, estimate)


def _local_polynomial(pair: _Pair, degree: int, width: int) -> _Estimate:
    n = len(pair.output)
    of_input = np.fft.rfft(pair.drive - np.mean(pair.drive)) / np.sqrt(n)
    of_output = np.fft.rfft(pair.output - np.mean(pair.output)) / np.sqrt(n)
    lines = np.arange(1, len(of_input) - (1 - n % 2))
    if len(lines) < 2 * width + 1:
        raise EstimationError(
            f"{len(lines)} lines in the record; half_width {width} needs at least {2 * width + 1}"
        )
    centres = np.clip(lines, 1 + width, lines[-1] - width)
    around = centres[:, None] + np.arange(-width, width + 1)
    distance = (around - lines[:, None]) / width
    powers = distance[:, :, None] ** np.arange(degree + 1)
    u, y = of_input[around], of_output[around]
    matrix = np.concatenate([powers * u[:, :, None], powers.astype(np.complex128)], axis=2)
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    matrix = matrix / np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(matrix, rcond=1e-10)
    found = np.einsum("kij,kj->ki", inverse, y)
    residual = y - np.einsum("kij,kj->ki", matrix, found)
    freedom = 2 * width + 1 - 2 * (degree + 1)
    variance = np.sum(np.abs(residual) ** 2, axis=1) / freedom
    scale = np.where(size[:, 0, 0] > 0.0, size[:, 0, 0], np.inf)
    gain = np.sum(np.abs(inverse[:, 0, :]) ** 2, axis=1)
    return _Estimate(
        np.asarray(2.0 * np.pi * lines / (n * pair.period), dtype=np.float64),
        found[:, 0] / scale,
        variance * gain / scale**2,
        None,
        float(freedom),
        _reach(degree, width),
    )


def _reach(degree: int, width: int) -> float:
    """Return the sum of the correlations of a line's error with all lines, 1 / h'h for a smoother of weights h."""
    powers = (np.arange(-width, width + 1.0) / width)[:, None] ** np.arange(degree + 1)
    weights = np.linalg.pinv(powers)[0]
    return max(1.0 / float(weights @ weights), 1.0)
