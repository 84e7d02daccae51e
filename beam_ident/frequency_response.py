"""Non-parametric frequency responses: what the data say before any model.

Three ways, each for its kind of record:

* ``welch_response``: averaged cross-spectra (H1, H2, Hv) with coherence, for long noise-like
  records.  On a single chirp its segments see the modes ring long after the input
  has left them, and the estimate is biased: look, do not fit.
* ``local_polynomial_response``: one record, any excitation; the transient that leaks into
  every line is a smooth function of frequency and is estimated along (Pintelon and
  Schoukens 2012, ch. 7).
* ``periodic_response``: steady periods of a multisine; the scatter between periods gives
  the variance of every line, and unexcited lines show noise and distortion.

The input is taken at the stamps of the output, through its hold and with the same
exposure, so that both have the same sampling; the outputs are never interpolated
except over single missing samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from beam_ident.errors import EstimationError
from beam_ident.piecewise import FloatArray, Instants, regular_period
from beam_ident.records import TimeRecord

SpectralMethod = Literal["h1", "h2", "hv"]

ComplexArray = NDArray[np.complex128]

_MOST_MISSING = 0.02


@dataclass(frozen=True, eq=False)
class FrequencyResponseEstimate:
    """A frequency response at discrete lines.

    Attributes
    ----------
    omegas : ndarray, shape (n,) -- [rad/s]
    response : complex ndarray, shape (n,)
    sd : ndarray, shape (n,)
        Standard deviation of the complex value (root of the sum of both parts' variances).
    coherence : ndarray or None, shape (n,)
    method : str
    input_name, output_name : str
    n_averages : float -- effective number of averages behind every line
    """

    omegas: FloatArray
    response: ComplexArray
    sd: FloatArray
    coherence: FloatArray | None
    method: str
    input_name: str
    output_name: str
    n_averages: float

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the lines [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class PeriodicResponseEstimate:
    """A frequency response from periods, with noise and distortion on the other lines.

    Attributes
    ----------
    excited : FrequencyResponseEstimate -- at the excited lines
    noise_sd : ndarray, shape (n_excited,) -- scatter of the output's lines between periods
    other_hz : ndarray -- lines of the period that were not excited [Hz]
    other_amplitude : ndarray -- amplitude of the output there
    other_noise_sd : ndarray
        Scatter there between periods: an amplitude far above it is nonlinear distortion.
    distortion_db : float
        Output power on unexcited lines, less the noise's share, over that on excited ones.
    """

    excited: FrequencyResponseEstimate
    noise_sd: FloatArray
    other_hz: FloatArray
    other_amplitude: FloatArray
    other_noise_sd: FloatArray
    distortion_db: float


@dataclass(frozen=True, eq=False)
class _Pair:
    """Input and output at common regular stamps."""

    period: float
    start: float
    drive: FloatArray
    output: FloatArray
    input_name: str
    output_name: str


def _common_samples(record: TimeRecord, output_name: str | None, input_name: str | None) -> _Pair:
    if (output_name is None and len(record.outputs) > 1) or (input_name is None and len(record.inputs) > 1):
        raise EstimationError(
            f"record {record.name!r} has several signals; say which input and output by their names"
        )
    drive = record.inputs[0] if input_name is None else record.input(input_name)
    output = record.outputs[0] if output_name is None else record.output(output_name)
    half = 0.5 * output.exposure_s
    first, last = drive.span_s
    keep = (output.times_s - half >= first) & (output.times_s + half <= last)
    times, values = np.asarray(output.times_s[keep]), np.array(output.values[keep])
    period = regular_period(times)
    if period is None or len(times) < 32:
        raise EstimationError(
            f"output {output.name!r} has {len(times)} usable stamps, "
            f"{'irregular ones' if period is None else 'too few'}; a non-parametric response needs at "
            "least 32 on a "
            "regular grid. Fit a model instead: identify() takes any stamps"
        )
    missing = ~np.isfinite(values)
    if np.mean(missing) > _MOST_MISSING:
        raise EstimationError(
            f"output {output.name!r}: {np.mean(missing):.1%} of the samples are missing; a non-parametric "
            "response "
            f"bridges at most {_MOST_MISSING:.0%}. Fit a model instead: identify() leaves them out"
        )
    values[missing] = np.interp(times[missing], times[~missing], values[~missing])
    signal = drive.signal()
    instants = Instants.on(signal, times, output.exposure_s)
    return _Pair(
        period,
        float(times[0]),
        instants.mean(signal, signal.antiderivative())[0],
        values,
        drive.name,
        output.name,
    )


def welch_response(
    record: TimeRecord,
    method: SpectralMethod = "h1",
    segment_s: float | None = None,
    output_name: str | None = None,
    input_name: str | None = None,
) -> FrequencyResponseEstimate:
    """Estimate a frequency response from averaged spectra.

    Parameters
    ----------
    record : TimeRecord
    method : {"h1", "h2", "hv"}
        H1 is unbiased by noise on the output, H2 by noise on the input, Hv assumes equal
        shares of both.
    segment_s : float or None
        Length of the Hann windows [s], overlapping by half; None takes an eighth of the
        record.
    output_name, input_name : str or None -- which signals, where there are several
    """
    if method not in ("h1", "h2", "hv"):
        raise EstimationError(f"method is {method!r}; expected h1, h2 or hv")
    pair = _common_samples(record, output_name, input_name)
    n = len(pair.output)
    length = n // 8 if segment_s is None else round(segment_s / pair.period)
    if not 16 <= length <= n:
        raise EstimationError(f"segments of {length} samples in a record of {n}; expected 16 to {n}")
    keywords = {"fs": 1.0 / pair.period, "nperseg": length, "window": "hann", "detrend": "constant"}
    frequencies, cross = csd(pair.drive, pair.output, **keywords)
    of_input = welch(pair.drive, **keywords)[1]
    of_output = welch(pair.output, **keywords)[1]
    frequencies, cross, of_input, of_output = frequencies[1:], cross[1:], of_input[1:], of_output[1:]
    floor = 1e-300
    coherence = np.clip(np.abs(cross) ** 2 / np.maximum(of_input * of_output, floor), 0.0, 1.0)
    h1 = cross / np.maximum(of_input, floor)
    h2 = of_output / np.where(np.abs(cross) > floor, np.conj(cross), floor)
    response = {"h1": h1, "h2": h2, "hv": np.sqrt(np.abs(h1) * np.abs(h2)) * np.exp(1j * np.angle(cross))}[
        method
    ]
    # Overlapping Hann segments by half: 36 % fewer independent averages (Welch 1967).
    averages = max(1.0, (2.0 * n / length - 1.0) / 1.36)
    sd = np.abs(response) * np.sqrt((1.0 - coherence) / np.maximum(coherence, 1e-12) / averages)
    return FrequencyResponseEstimate(
        2.0 * np.pi * frequencies,
        response,
        sd,
        coherence,
        method,
        pair.input_name,
        pair.output_name,
        averages,
    )


def local_polynomial_response(
    record: TimeRecord,
    degree: int = 2,
    half_width: int | None = None,
    output_name: str | None = None,
    input_name: str | None = None,
) -> FrequencyResponseEstimate:
    """Estimate a frequency response and the leaking transient by local polynomials.

    Parameters
    ----------
    record : TimeRecord
    degree : int -- of both polynomials
    half_width : int or None
        Lines on either side; None takes the least that leaves as many degrees of freedom
        as there are unknowns.
    output_name, input_name : str or None -- which signals, where there are several

    Notes
    -----
    The polynomials must be able to follow the resonances: at damping ratio zeta and
    frequency f the half-power band is 2 zeta f wide and should hold several lines
    (line spacing is one over the length of the record).
    """
    if degree < 0:
        raise EstimationError(f"degree is {degree}; expected 0 or more")
    unknowns = 2 * (degree + 1)
    width = unknowns if half_width is None else half_width
    if 2 * width + 1 <= unknowns:
        raise EstimationError(f"half_width is {width}; degree {degree} needs at least {unknowns // 2 + 1}")
    pair = _common_samples(record, output_name, input_name)
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
    freedom = 2 * width + 1 - unknowns
    variance = np.sum(np.abs(residual) ** 2, axis=1) / freedom
    scale = np.where(size[:, 0, 0] > 0.0, size[:, 0, 0], np.inf)
    gain = np.sum(np.abs(inverse[:, 0, :]) ** 2, axis=1)
    return FrequencyResponseEstimate(
        np.asarray(2.0 * np.pi * lines / (n * pair.period), dtype=np.float64),
        found[:, 0] / scale,
        np.sqrt(variance * gain) / scale,
        None,
        f"local polynomial of degree {degree} over {2 * width + 1} lines",
        pair.input_name,
        pair.output_name,
        float(freedom + 1),
    )


def periodic_response(
    record: TimeRecord,
    line_period_s: float,
    excited_hz: FloatArray,
    start_s: float,
    end_s: float,
    output_name: str | None = None,
    input_name: str | None = None,
) -> PeriodicResponseEstimate:
    """Estimate a frequency response from the steady periods of a periodic excitation.

    Parameters
    ----------
    record : TimeRecord
    line_period_s : float -- period of the excitation [s], a whole number of output samples
    excited_hz : ndarray -- its lines [Hz]
    start_s, end_s : float -- the steady part [s], with at least two whole periods
    output_name, input_name : str or None -- which signals, where there are several
    """
    pair = _common_samples(record, output_name, input_name)
    per_period = round(line_period_s / pair.period)
    if per_period < 4 or abs(per_period * pair.period / line_period_s - 1.0) > 1e-6:
        raise EstimationError(
            f"the period of {line_period_s} s is {line_period_s / pair.period:.4f} output samples; "
            "expected a whole "
            "number. Choose the period or the frame rate so that it is one"
        )
    first = int(np.ceil((start_s - pair.start) / pair.period - 1e-9))
    count = int(np.floor((end_s - pair.start) / pair.period + 1e-9)) - first
    n_periods = min(count, len(pair.output) - first) // per_period
    if first < 0 or n_periods < 2:
        raise EstimationError(
            f"between {start_s} and {end_s} s there are {max(n_periods, 0)} whole periods of "
            f"{line_period_s} s; expected "
            "at least two"
        )
    span = slice(first, first + n_periods * per_period)
    of_input = np.fft.rfft(pair.drive[span].reshape(n_periods, -1), axis=1) * 2.0 / per_period
    of_output = np.fft.rfft(pair.output[span].reshape(n_periods, -1), axis=1) * 2.0 / per_period
    numbers = np.round(np.asarray(excited_hz) * line_period_s).astype(np.intp)
    numbers = numbers[(numbers > 0) & (numbers < of_output.shape[1])]
    mean_u, mean_y = np.mean(of_input, axis=0), np.mean(of_output, axis=0)
    scatter = np.sqrt(np.sum(np.abs(of_output - mean_y) ** 2, axis=0) / (n_periods - 1))
    response = mean_y[numbers] / mean_u[numbers]
    sd = scatter[numbers] / np.sqrt(n_periods) / np.abs(mean_u[numbers])
    top = int(numbers[-1]) if len(numbers) else 0
    others = np.setdiff1d(np.arange(1, top + 1), numbers)
    noise_power = float(np.sum(scatter[others] ** 2)) / n_periods
    power = max(float(np.sum(np.abs(mean_y[others]) ** 2)) - noise_power, 0.0)
    total = max(float(np.sum(np.abs(mean_y[numbers]) ** 2)), 1e-300)
    distortion = 10.0 * np.log10(max(power / total, 1e-30))
    excited = FrequencyResponseEstimate(
        np.asarray(2.0 * np.pi * numbers / line_period_s, dtype=np.float64),
        response,
        sd,
        None,
        f"mean of {n_periods} periods",
        pair.input_name,
        pair.output_name,
        float(n_periods),
    )
    return PeriodicResponseEstimate(
        excited,
        scatter[numbers],
        others / line_period_s,
        np.abs(mean_y[others]),
        scatter[others],
        float(distortion),
    )
