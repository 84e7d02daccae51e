"""Where an input excites: the band in which modes can be looked for.

The search for modes runs at true frequencies over the band of the *input*, at any
rate of the outputs, so that a mode above half the outputs' rate is found where
it is and not at its alias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import spectrogram
from scipy.special import ndtri

from beam_ident.arrays import FloatArray
from beam_ident.data.gaps import POOR_BRIDGE
from beam_ident.data.records import InputSignal

_BELOW, _BEYOND = 0.5, 1.3  # of a band's ends: how far a mode may stand outside
_MIN_CYCLES = 1.5  # in a record
_UPPER_SHARE = 1e-3  # of the largest density of the force-like quantity
_LOWER_SHARE = 1e-4
_ABOVE_FLOOR = 5.0  # times the noise floor: what a noisy or quantised position must stand out by
_STILL = 1.5  # times the noise's sigma: an input that moves no more than this stands still
_ROUGH = 1.25  # times the largest force-like value that is known: no bridge has more
_NOISE_BEYOND = 1e-6  # chance that noise alone has one value as large as makes a blow
_MIN_SEGMENT = 256
_SEGMENT_S = 2.0  # a sweep is loud at each frequency for a moment only


@dataclass(frozen=True)
class Band:
    """A band of frequencies [Hz]; ``is_excited`` is False for an input that stands still.

    Above ``unfolded_hz``, half the rate of the outputs, a frequency looks like another one below it.
    """

    low_hz: float
    high_hz: float
    is_excited: bool
    unfolded_hz: float = math.inf

    @property
    def reach_hz(self) -> tuple[float, float]:
        """Where a mode may stand that this band shows: somewhat beyond, but never beyond it among folded ones."""
        high = max(self.high_hz, min(_BEYOND * self.high_hz, self.unfolded_hz))
        return _BELOW * self.low_hz, high

    @staticmethod
    def without_input(length_s: float, output_rate_hz: float) -> Band:
        """Return where a record of this length and mean rate can show modes that nothing excites."""
        low = _MIN_CYCLES / length_s
        return Band(low, max(0.5 * output_rate_hz, 2.0 * low), False)


def excited_band(drive: InputSignal, differentiations: int, length_s: float, output_rate_hz: float) -> Band:
    """Return the band in which an input drives modes.

    Parameters
    ----------
    drive : InputSignal
    differentiations : int
        2 when the input is a position, 1 a velocity, 0 an acceleration or a force, whatever the outputs are.
    length_s : float -- length of the record [s]
    output_rate_hz : float -- mean rate of the outputs, for an input that stands still
    """
    values = drive.values - drive.values[0]
    if not np.any(values) or _is_still(values, drive.sigma):
        return Band.without_input(length_s, output_rate_hz)
    times, step = drive.times_s, drive.period_s
    if step is None:
        step = float(np.median(np.diff(times)))
        grid = np.arange(times[0], times[-1], step)
        values = np.interp(grid, times, values)
    segment = int(min(len(values), max(_MIN_SEGMENT, round(min(_SEGMENT_S, length_s / 4.0) / step))))
    if _is_at_an_end(np.diff(values, differentiations), segment):
        # Continued there, mirrored, so that a force stays without a jump, and a motion (mirrored about its end as
        # well) without a kink.
        mirrored: Literal["even", "odd"] = "odd" if differentiations else "even"
        values = np.pad(values, min(segment // 2, len(values) - 1), "reflect", reflect_type=mirrored)
    pieces = [values]
    if drive.gaps:
        pieces, segment = _between_gaps(drive, values, differentiations, step, segment)
    spectra = [
        spectrogram(
            piece, 1.0 / step, window="hann", nperseg=segment, noverlap=segment // 2, detrend="constant"
        )
        for piece in pieces
    ]
    frequencies, densities = (
        spectra[0][0][1:],
        _smooth(np.concatenate([own[2] for own in spectra], axis=1)[1:]),
    )
    loudest = np.max(densities, axis=1)
    force_like = loudest * (2.0 * np.pi * frequencies) ** (2 * differentiations)
    if differentiations:
        # Rounding or noise of a position is white; differentiated it would drown the excitation.
        stands_out = loudest > _ABOVE_FLOOR * np.quantile(loudest, 0.2)
        stands_out = median_filter(stands_out.astype(np.float64), 9, mode="nearest") > 0.5
        force_like = np.where(stands_out, force_like, 0.0) if np.any(stands_out) else force_like
    peak = float(np.max(force_like))
    above = frequencies[force_like > _UPPER_SHARE * peak]
    within = frequencies[force_like > _LOWER_SHARE * peak]
    high = float(above[-1]) + 1.0 / (segment * step)
    low = max(_MIN_CYCLES / length_s, 0.7 * float(within[0]))
    return Band(low, max(high, 2.0 * low), True)


def _between_gaps(
    drive: InputSignal, values: FloatArray, differentiations: int, step: float, segment: int
) -> tuple[list[FloatArray], int]:
    """Return what is known of an input between gaps whose bridges would look like excitation, and a segment's length.

    The error of a bridge is zero at both ends of its gap: it bends, and jumps in its slope, as a wave of that length
    does. An input that is nowhere known for long is returned as it is.
    """
    force_like = np.diff(drive.values, differentiations) / step**differentiations
    places = [
        [round((instant - drive.times_s[0]) / step) for instant in (gap.start_s, gap.end_s)]
        for gap in drive.gaps
    ]
    is_known = np.ones(len(force_like), dtype=bool)
    for first, last in places:
        is_known[max(first + 1 - differentiations, 0) : last] = False
    least = POOR_BRIDGE * float(np.std(force_like[is_known])) if np.any(is_known) else 0.0
    # A bridge may be rough as well, on a scale of its own.
    most = _ROUGH * float(np.max(np.abs(force_like[is_known]), initial=0.0))
    offset = (len(values) - len(drive.values)) // 2  # mirrored at the ends
    ends = [0, len(values)]
    for gap, (first, last) in zip(drive.gaps, places, strict=True):
        inside = np.abs(force_like[max(first + 1 - differentiations, 0) : last])
        is_smooth = np.max(inside, initial=0.0) < most
        if not (is_smooth and gap.sigma * (math.pi / (gap.end_s - gap.start_s)) ** differentiations < least):
            ends[-1:] = [offset + first + 1, offset + last, len(values)]
    pieces = [values[first:last] for first, last in zip(ends[::2], ends[1::2], strict=True)]
    longest = max(len(piece) for piece in pieces)
    if longest < _MIN_SEGMENT:
        return [values], segment
    segment = min(segment, longest)
    pieces = [piece for piece in pieces if len(piece) >= segment]
    # The last samples of a piece as well.
    return pieces + [piece[-segment:] for piece in pieces if len(piece) > segment], segment


def _is_at_an_end(force_like: FloatArray, segment: int) -> bool:
    """Return whether Hann windows that overlap by half, and see nothing at the ends of a record, miss most of it."""
    if len(force_like) <= segment // 2:
        return False
    energy = np.square(force_like - np.median(force_like))
    seen = np.ones(len(energy))
    flank = np.square(np.sin(0.5 * np.pi * (np.arange(segment // 2) + 0.5) / (segment // 2)))
    seen[: len(flank)] = flank
    seen[-len(flank) :] = np.minimum(seen[-len(flank) :], flank[::-1])
    return bool(seen @ energy < 0.5 * np.sum(energy))


def _is_still(values: FloatArray, sigma: float) -> bool:
    """Return whether noise of a standard deviation may be all there is: no power beyond it, and no single blow."""
    if sigma == 0.0:
        return False
    largest = float(np.max(np.abs(values - np.median(values))))
    is_blow = largest > sigma * float(-ndtri(0.5 * _NOISE_BEYOND / len(values)))
    return bool(np.std(values) < _STILL * sigma) and not is_blow


def _smooth(densities: FloatArray) -> FloatArray:
    """Average every five neighbouring lines."""
    return np.asarray(uniform_filter1d(densities, 5, axis=0, mode="nearest"))
