"""Where an input excites: the band in which modes can be looked for.

The search for modes runs at true frequencies over the band of the *input*, whatever
the rate of the outputs, so that a mode above half the outputs' rate is found where
it is and not at its alias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from beam_ident.piecewise import FloatArray
from beam_ident.records import InputSignal

_UPPER_SHARE = 1e-3  # of the largest density of the force-like quantity
_LOWER_SHARE = 1e-4
_ABOVE_FLOOR = 20.0  # times the least density: what a quantised position must stand out by


@dataclass(frozen=True)
class Band:
    """A band of frequencies [Hz]; ``is_excited`` is False for an input that stands still."""

    low_hz: float
    high_hz: float
    is_excited: bool


def excited_band(drive: InputSignal, differentiations: int, length_s: float, output_rate_hz: float) -> Band:
    """Return the band in which an input drives modes.

    Parameters
    ----------
    drive : InputSignal
    differentiations : int
        2 when the input is a position, 1 a velocity, 0 an acceleration or a force.
    length_s : float -- length of the record [s]
    output_rate_hz : float -- mean rate of the outputs, for an input that stands still
    """
    least = 1.5 / length_s
    values = drive.values - drive.values[0]
    if not np.any(values):
        return Band(least, max(0.5 * output_rate_hz, 2.0 * least), False)
    times, step = drive.times_s, drive.period_s
    if step is None:
        step = float(np.median(np.diff(times)))
        grid = np.arange(times[0], times[-1], step)
        values = np.interp(grid, times, values)
    segment = int(min(len(values), max(256, round(min(4.0, length_s / 4.0) / step))))
    frequencies, density = welch(values, 1.0 / step, window="hann", nperseg=segment, detrend="constant")
    frequencies, density = frequencies[1:], density[1:]
    force_like = density * (2.0 * np.pi * frequencies) ** (2 * differentiations)
    if differentiations:
        stands_out = density > _ABOVE_FLOOR * np.min(_smooth(density))
        force_like = np.where(stands_out, force_like, 0.0) if np.any(stands_out) else force_like
    peak = float(np.max(force_like))
    above = frequencies[force_like > _UPPER_SHARE * peak]
    within = frequencies[force_like > _LOWER_SHARE * peak]
    high = float(above[-1]) + 1.0 / (segment * step)
    low = max(least, 0.7 * float(within[0]))
    return Band(low, max(high, 2.0 * low), True)


def _smooth(density: FloatArray) -> FloatArray:
    width = max(3, len(density) // 50)
    kernel = np.ones(width) / width
    return np.asarray(np.convolve(density, kernel, mode="valid"))
