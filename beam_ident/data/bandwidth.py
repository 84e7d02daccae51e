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
from scipy.special import ndtri

from beam_ident.arrays import FloatArray
from beam_ident.data.gaps import POOR_BRIDGE, Bridge
from beam_ident.data.records import InputSignal
from beam_ident.numerics.convolution import running_mean
from beam_ident.numerics.segment_spectra import segment_spectra

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
    bridged = _bridged_force(drive, values, differentiations, step) if drive.gaps else None
    if _is_at_an_end(np.diff(values, differentiations) if bridged is None else bridged, segment):
        # Continued there, mirrored, so that a force stays without a jump, and a motion (mirrored about its end as
        # well) without a kink.
        values = _mirrored(values, segment, is_odd=differentiations > 0)
        bridged = None if bridged is None else _mirrored(bridged, segment)
    frequencies, loudest = _loudest(values if bridged is None else bridged, step, segment)
    weights = (2.0 * np.pi * frequencies) ** (2 * differentiations)
    if bridged is not None:
        loudest = loudest / weights
    force_like = loudest * weights
    if differentiations:
        # Rounding or noise of a position is white; differentiated it would drown the excitation.
        stands_out = loudest > _ABOVE_FLOOR * np.quantile(loudest, 0.2)
        stands_out = running_mean(stands_out.astype(np.float64), 9) > 0.5  # as most of nine neighbours do
        force_like = np.where(stands_out, force_like, 0.0) if np.any(stands_out) else force_like
    peak = float(np.max(force_like))
    above = frequencies[force_like > _UPPER_SHARE * peak]
    within = frequencies[force_like > _LOWER_SHARE * peak]
    high = float(above[-1]) + 1.0 / (segment * step)
    low = max(_MIN_CYCLES / length_s, 0.7 * float(within[0]))
    return Band(low, max(high, 2.0 * low), True)


def _loudest(values: FloatArray, step: float, segment: int) -> tuple[FloatArray, FloatArray]:
    """Return frequencies [Hz], and the largest density that any part of a signal has there."""
    segment = min(segment, len(values))
    frequencies, spectra = segment_spectra(values, step, segment)
    densities = np.square(spectra.real) + np.square(spectra.imag)
    return frequencies[1:], np.max(running_mean(densities[:, 1:], 5), axis=0)


def _mirrored(values: FloatArray, segment: int, is_odd: bool = False) -> FloatArray:
    """Return a signal with what is next to its ends repeated beyond them, backwards."""
    kind: Literal["odd", "even"] = "odd" if is_odd else "even"
    return np.asarray(np.pad(values, min(segment // 2, len(values) - 1), "reflect", reflect_type=kind))


def _bridged_force(
    drive: InputSignal, values: FloatArray, differentiations: int, step: float
) -> FloatArray | None:
    """Return the force-like derivative of an input bridged by itself; None where the input's own bridges will do.

    The error of a bridge is zero at both ends of its gap: it bends, and jumps in its slope, as a wave of that length
    does. Differentiated it would look like excitation, and to leave out what is near it would leave out what is
    excited there alone, as by a sweep.

    They will do as well where nothing moves beside the gaps.

    Parameters
    ----------
    drive : InputSignal -- with gaps
    values : ndarray, shape (n,) -- its samples at regular stamps
    differentiations : int -- from the input to what is like a force
    step : float -- between the samples [s]
    """
    force_like: FloatArray = np.diff(values, differentiations) / step**differentiations
    places = [
        [round((instant - drive.times_s[0]) / step) for instant in (gap.start_s, gap.end_s)]
        for gap in drive.gaps
    ]
    holes = [slice(max(first + 1 - differentiations, 0), last) for first, last in places]
    is_known = np.ones(len(force_like), dtype=bool)
    for hole in holes:
        is_known[hole] = False
    least = POOR_BRIDGE * float(np.std(force_like[is_known])) if np.any(is_known) else 0.0
    # A bridge may be rough as well, on a scale of its own.
    most = _ROUGH * float(np.max(np.abs(force_like[is_known]), initial=0.0))
    is_poor = np.zeros(len(force_like) + 2, dtype=bool)
    for gap, hole in zip(drive.gaps, holes, strict=True):
        is_smooth = np.max(np.abs(force_like[hole]), initial=0.0) < most
        if not (is_smooth and gap.sigma * (math.pi / (gap.end_s - gap.start_s)) ** differentiations < least):
            is_poor[1:-1][hole] = True
    if not np.any(is_poor):
        return None
    times = np.asarray(step * np.arange(len(force_like)), dtype=np.float64)
    unknown = np.where(is_poor[1:-1], np.nan, force_like)
    for first, last in np.flatnonzero(np.diff(is_poor)).reshape(-1, 2):
        force_like[first:last] = 0.0
        if first > 0 and last < len(force_like):  # at an end nothing is beside it
            found = Bridge(times, unknown, first, last - first).values
            force_like[first:last] = found if np.max(np.abs(found)) < most else 0.0
    return force_like if np.any(force_like) else None


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
