"""Averaged cross-spectra: frequency responses of long noise-like records.

``welch_response`` gives H1, H2, Hv or a response through a reference signal, with coherence.  On a single
chirp its segments see the modes ring long after the input has left them, and the estimate is biased: look, do
not fit.  For such a record take ``responses.local_polynomial``, for a periodic one
``responses.periodic_averaging``.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.signal import csd, welch

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.responses.signal_pair import LineEstimate, SignalPair, for_every_output
from beam_ident.responses.steady_periods import SHARED_BY_HANN, stretch_omegas, stretches

SpectralMethod = Literal["h1", "h2", "hv", "reference"]


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

    def estimate(pair: SignalPair) -> LineEstimate:
        return _welch(pair, method, segment_s)

    return for_every_output(record, output_names, input_name, reference_name, method, estimate)


def _welch(pair: SignalPair, method: SpectralMethod, segment_s: float | None) -> LineEstimate:
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
    compared = _compared(pair)
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
        return LineEstimate(omegas, response, variance, linked, averages, compared)
    h1 = cross / np.maximum(of_input, floor)
    h2 = of_output / np.where(np.abs(cross) > floor, np.conj(cross), floor)
    hv = np.sqrt(np.abs(h1) * np.abs(h2)) * np.exp(1j * np.angle(cross))
    response = {"h1": h1, "h2": h2, "hv": hv}[method]
    variance = np.abs(response) ** 2 * (1.0 - coherence) / np.maximum(coherence, 1e-12) / averages
    return LineEstimate(omegas, response, variance, coherence, averages, compared)


def _compared(pair: SignalPair) -> tuple[ComplexArray, ComplexArray, FloatArray, float, bool]:
    """Return spectra of stretches: what their common response makes of the input, and the output."""
    drives, answers = stretches(pair.drive), stretches(pair.output)
    power = np.maximum(np.sum(np.abs(drives) ** 2, axis=0), 1e-300)
    modelled = np.sum(answers * np.conj(drives), axis=0) / power * drives
    return modelled, answers, stretch_omegas(len(pair.output), pair.period), SHARED_BY_HANN, True
