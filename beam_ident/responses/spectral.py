"""Averaged cross-spectra: frequency responses of long noise-like records.

``welch_response`` gives H1, H2, Hv or a response through a reference signal, with coherence.  On a single
chirp its segments see the modes ring long after the input has left them, and the estimate is biased: look, do
not fit.  For such a record take ``responses.local_polynomial``, for a periodic one
``responses.periodic_averaging``.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.numerics.convolution import inner_convolution
from beam_ident.numerics.segment_spectra import segment_spectra
from beam_ident.responses.signal_pair import LineEstimate, SignalPair, for_every_output
from beam_ident.responses.steady_periods import SHARED_BY_HANN, stretch_omegas, stretches

SpectralMethod = Literal["h1", "h2", "hv", "reference"]

_MIN_LENGTH = 16  # samples of a segment
_MAIN_LOBE = 4.0  # lines: of a Hann window
_SEEN = 3.0  # standard deviations
_POWER = 0.1  # of what the response makes of the input
_LINES = 3  # fewer may be so by chance


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
    if not _MIN_LENGTH <= length <= n:
        raise EstimationError(
            f"segments of {length} samples in a record of {n}; expected {_MIN_LENGTH} to {n}"
        )
    found = _averaged(pair, method, length)
    doubts: tuple[str, ...] = ()
    if length >= 2 * _MIN_LENGTH:
        power = np.abs(found.response) ** 2 * _spectra(pair.drive, pair.drive, pair.period, length)[1].real
        doubts = _leakage(found, _averaged(pair, method, length // 2), power, length * pair.period)
    resolution_hz = _MAIN_LOBE / (length * pair.period)
    left = _left(pair, found.response, length)
    return replace(found, compared=_compared(pair), left=left, doubts=doubts, resolution_hz=resolution_hz)


def _spectra(
    first: FloatArray, second: FloatArray, period: float, length: int
) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies [Hz] and the cross-spectrum between zero and half the rate, where lines are complex."""
    frequencies, spectra = segment_spectra(first, period, length)
    others = spectra if second is first else segment_spectra(second, period, length)[1]
    cross = np.mean(np.conj(spectra) * others, axis=0)
    inner = slice(1, len(frequencies) - (1 - length % 2))
    return frequencies[inner], cross[inner]


def _averaged(pair: SignalPair, method: SpectralMethod, length: int) -> LineEstimate:
    """Return the response from segments of a length [samples]."""

    def spectrum(first: FloatArray, second: FloatArray) -> ComplexArray:
        return _spectra(first, second, pair.period, length)[1]

    frequencies, cross = _spectra(pair.drive, pair.output, pair.period, length)
    of_input, of_output = spectrum(pair.drive, pair.drive).real, spectrum(pair.output, pair.output).real
    if not np.max(of_input) > 0.0:
        raise EstimationError(
            f"the input stands still in every segment of {length * pair.period:.3g} s; take segments, or a part of "
            "the record, in which it moves"
        )
    floor = 1e-300
    coherence = np.clip(np.abs(cross) ** 2 / np.maximum(of_input * of_output, floor), 0.0, 1.0)
    # Overlapping Hann segments by half: 36 % fewer independent averages (Welch 1967).
    averages = max(1.0, (2.0 * len(pair.output) / length - 1.0) / 1.36)
    omegas = np.asarray(2.0 * np.pi * frequencies, dtype=np.float64)
    if pair.reference is not None:
        to_output = spectrum(pair.reference, pair.output)
        to_input = spectrum(pair.reference, pair.drive)
        of_reference = spectrum(pair.reference, pair.reference).real
        strength = np.maximum(np.abs(to_input) ** 2, floor)
        response = to_output * np.conj(to_input) / strength
        left = of_output - 2.0 * np.real(np.conj(response) * cross) + np.abs(response) ** 2 * of_input
        # One degree of freedom of every line went into the response.
        variance = np.maximum(left, 0.0) * of_reference / strength / max(averages - 1.0, 1.0)
        linked = np.clip(np.abs(to_output) ** 2 / np.maximum(of_reference * of_output, floor), 0.0, 1.0)
        return LineEstimate(omegas, response, variance, linked, averages)
    h1 = cross / np.maximum(of_input, floor)
    h2 = of_output / np.where(np.abs(cross) > floor, np.conj(cross), floor)
    hv = np.sqrt(np.abs(h1) * np.abs(h2)) * np.exp(1j * np.angle(cross))
    response = {"h1": h1, "h2": h2, "hv": hv}[method]
    variance = np.abs(response) ** 2 * (1.0 - coherence) / np.maximum(coherence, 1e-12) / averages
    return LineEstimate(omegas, response, variance, coherence, averages)


def _left(pair: SignalPair, response: ComplexArray, length: int) -> FloatArray | None:
    """Return what a response leaves of the output where its weights, as long as a segment, lie inside the record."""
    if len(pair.output) < 2 * length:
        return None
    half = length // 2
    lines = np.zeros(half + 1, dtype=np.complex128)
    lines[1 : len(response) + 1] = response
    lines[0] = response[0].real  # smooth, so that no offset of its own stands at every sample
    weights = np.roll(np.fft.irfft(lines, length), half)
    modelled = inner_convolution(pair.drive - np.mean(pair.drive), weights)
    return np.asarray(pair.output[length - half - 1 :][: len(modelled)] - modelled)


def _leakage(
    found: LineEstimate, shorter: LineEstimate, power: FloatArray, segment_s: float
) -> tuple[str, ...]:
    """Return what is to be known of a response that depends on the segments' length.

    Parameters
    ----------
    found, shorter : LineEstimate -- from segments, and from segments half as long
    power : ndarray, shape (n_lines,) -- of the output that the response makes of the input
    segment_s : float

    Notes
    -----
    What the input does before or at the end of a segment rings on in it, or after it: the response is wrong by a
    share that falls with the segments' length.
    """
    n = min(len(found.omegas) // 2, len(shorter.omegas))
    shared = slice(1, 2 * n, 2)  # every second line is one of the shorter segments', too
    apart = np.abs(found.response[shared] - shorter.response[:n])
    moved = apart > _SEEN * np.sqrt(found.variance[shared])
    share = float(np.sum(power[shared][moved]) / max(float(np.sum(power[shared])), 1e-300))
    if share < _POWER or np.count_nonzero(moved) < _LINES:
        return ()
    hertz = found.omegas[shared][moved] / (2.0 * np.pi)
    return (
        f"segments of {segment_s:.3g} s and of half of it give responses more than {_SEEN:g} standard deviations "
        f"apart at lines that hold {share:.0%} of the output, between {hertz[0]:.4g} and {hertz[-1]:.4g} Hz: modes "
        "ring longer than the input stays (a sweep, blows, steps) or than a segment, and the response is biased by "
        "what leaks. Fit samples, identify(); take hammer_response() for blows, periodic_response() for whole "
        "periods, or longer segments of noise",
    )


def _compared(pair: SignalPair) -> tuple[ComplexArray, ComplexArray, FloatArray, float, bool]:
    """Return spectra of stretches: what their common response makes of the input, and the output."""
    drives, answers = stretches(pair.drive), stretches(pair.output)
    power = np.maximum(np.sum(np.abs(drives) ** 2, axis=0), 1e-300)
    modelled = np.sum(answers * np.conj(drives), axis=0) / power * drives
    return modelled, answers, stretch_omegas(len(pair.output), pair.period), SHARED_BY_HANN, True
