"""How late outputs are, to a few hundredths of a second, from phases alone: where a search for clocks may begin.

A delay turns the phase of every line of a spectrum in proportion to its frequency, while modes turn it by half a turn
at a few lines only.  So the inverse transform of the phases of ``Y conj(U)``, all lines alike, has its peak at the
delay, whatever the modes are (the generalised cross-correlation with phase transform; Knapp and Carter, IEEE
Transactions on Acoustics, Speech, and Signal Processing 24, 1976).

Lines that nothing drives show where the records end, and so how much sooner one of them does.  The lines that are
driven have their own peak, wider, as they are fewer: the sharp peak of all lines counts where theirs is, else theirs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import TimeRecord

_BAND = 0.4  # of an output's rate: the lines that it shows beside its aliases
_PER_CYCLE = 4  # samples of the fastest line
_MIN_SAMPLES = 64  # samples that show a delay
_CERTAIN = 3.0  # times what the highest peak of noise has on average, in power
_NEXT = 2.0  # times the power of what is farther away than a peak is wide
_WIDE = 4.0  # periods of the fastest line to either side


def coarse_delays(
    records: Sequence[TimeRecord], input_name: str, near_s: float = 0.0, driving_power: int = 0
) -> dict[str, float]:
    """Return by how much the outputs are late that show it without a doubt, by name [s].

    Parameters
    ----------
    records : sequence of TimeRecord
    input_name : str
    near_s : float
        What a search from here finds anyway: a second peak as near is no doubt, as a ringing mode has several.
    driving_power : int
        Power of s by which the input becomes what drives the modes.

    Returns
    -------
    dict
        Delays up to half of the shortest record, known to about a period of the fastest line. An output is left out
        where noise hides the peak, or another one is nearly as high.
    """
    found = {}
    for name in dict.fromkeys(name for record in records for name in record.output_names):
        with_it = [record for record in records if name in record.output_names]
        steps = [_step(record, name) for record in with_it]
        if not all(np.isfinite(steps)):
            continue
        step = max(steps)
        shortest = min(float(np.ptp(record.input(input_name).times_s)) for record in with_it)
        n_lags = int(0.5 * shortest / step)
        if n_lags < _MIN_SAMPLES:
            continue
        powers, driven = np.zeros((2, 2 * n_lags + 1))
        lobes = []
        for record in with_it:
            phases, weights = _phases(record, input_name, name, step, driving_power)
            powers += np.square(_correlation(phases, n_lags))
            driven += np.square(_correlation(phases * weights, n_lags))
            # A band of B shows a delay by a peak that is 1/B wide.
            lobes.append(2.0 * step / max(float(np.mean(weights)), 1e-300))
        near, lobe = max(_WIDE * _PER_CYCLE, near_s / step), max(lobes) / step
        sharp, wide = _certain_peak(powers, near), _certain_peak(driven, max(near, _WIDE * lobe))
        own = int(np.argmax(driven))
        if sharp is not None and abs(sharp - own) <= 0.5 * lobe:
            found[name] = (sharp - n_lags) * step
        elif wide is not None and abs(wide - n_lags) > _WIDE * lobe:
            found[name] = (wide - n_lags) * step
    return found


def _step(record: TimeRecord, name: str) -> float:
    """Return the step of a grid that both signals are put on [s]; infinite where the output has hardly a sample."""
    output = record.output(name)
    times = output.times_s[output.is_valid]
    if len(times) < _MIN_SAMPLES:
        return float("inf")
    return float(np.median(np.diff(times))) / (_BAND * _PER_CYCLE)


def _phases(
    record: TimeRecord, input_name: str, name: str, step: float, driving_power: int
) -> tuple[ComplexArray, FloatArray]:
    """Return the phases of an output against the input, and weights of the lines that are driven."""
    drive, output = record.input(input_name), record.output(name)
    seen = output.is_valid
    first, last = drive.span_s
    grid = np.arange(first, last, step)
    # A line from the first to the last value is taken out: what is left has no jump at its ends.
    u = _without_line(np.interp(grid, drive.times_s, drive.values))
    y = _without_line(np.interp(grid, output.times_s[seen], output.values[seen]))
    size = 2 ** int(np.ceil(np.log2(2 * len(grid))))
    pace = np.fft.rfftfreq(size)
    cross = np.fft.rfft(y, size) * np.conj(np.fft.rfft(u, size))
    cross[pace > 1.0 / _PER_CYCLE] = 0.0  # of a step: above, an output shows aliases
    # Faded, so that what the ends leave of slow lines does not pass for fast ones.
    power = np.square(np.abs(np.fft.rfft(u * np.hanning(len(u)), size)) * pace**driving_power)
    power[pace > 1.0 / _PER_CYCLE] = 0.0
    return cross / np.maximum(np.abs(cross), 1e-300), power / np.maximum(power + np.mean(power), 1e-300)


def _correlation(lines: ComplexArray, n_lags: int) -> FloatArray:
    """Return the inverse transform at lags from -n to n steps."""
    values = np.fft.irfft(lines)
    return np.asarray(np.concatenate([values[-n_lags:], values[: n_lags + 1]]))


def _certain_peak(powers: FloatArray, width: float) -> int | None:
    """Return where a correlation has its peak, unless noise may have made it or another is nearly as high."""
    place = int(np.argmax(powers))
    others = np.delete(powers, slice(max(place - round(width), 0), place + round(width) + 1))
    if not len(others):
        return None
    noise = float(np.mean(others)) * 2.0 * np.log(len(powers))
    is_certain = powers[place] > max(_CERTAIN * noise, _NEXT * float(np.max(others)))
    return place if is_certain else None


def _without_line(values: FloatArray) -> FloatArray:
    return np.asarray(values - np.linspace(values[0], values[-1], len(values)))
