"""How late outputs are, to a few hundredths of a second, from phases alone: where a search for clocks may begin.

A delay turns the phase of every line of a spectrum in proportion to its frequency, while modes turn it by half a turn
at a few lines only.  So the inverse transform of the phases of ``Y conj(U)``, all lines alike, has its peak at the
delay, whatever the modes are (the generalised cross-correlation with phase transform; Knapp and Carter, IEEE
Transactions on Acoustics, Speech, and Signal Processing 24, 1976).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import TimeRecord

_BAND = 0.4  # of an output's rate: the lines that it shows beside its aliases
_PER_CYCLE = 4  # samples of the fastest line
_MIN_SAMPLES = 64  # samples that show a delay
_CERTAIN = 3.0  # times what the highest peak of noise has on average, in power
_NEXT = 2.0  # times the power of what is farther away than a peak is wide
_WIDE = 4.0  # periods of the fastest line to either side


def coarse_delays(records: Sequence[TimeRecord], input_name: str, near_s: float = 0.0) -> dict[str, float]:
    """Return by how much the outputs are late that show it without a doubt, by name [s].

    Parameters
    ----------
    records : sequence of TimeRecord
    input_name : str
    near_s : float
        What a search from here finds anyway: a second peak as near is no doubt, as a ringing mode has several.

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
        powers = np.zeros(2 * n_lags + 1)
        for record in with_it:
            powers += np.square(_phase_correlation(record, input_name, name, step, n_lags))
        place = int(np.argmax(powers))
        width = max(round(_WIDE * _PER_CYCLE), round(near_s / step))
        others = np.delete(powers, slice(max(place - width, 0), place + width + 1))
        if not len(others):
            continue
        noise = float(np.mean(others)) * 2.0 * np.log(len(powers))
        if powers[place] > _CERTAIN * noise and powers[place] > _NEXT * float(np.max(others)):
            found[name] = (place - n_lags) * step
    return found


def _step(record: TimeRecord, name: str) -> float:
    """Return the step of a grid that both signals are put on [s]; infinite where the output has hardly a sample."""
    output = record.output(name)
    times = output.times_s[output.is_valid]
    if len(times) < _MIN_SAMPLES:
        return float("inf")
    return float(np.median(np.diff(times))) / (_BAND * _PER_CYCLE)


def _phase_correlation(
    record: TimeRecord, input_name: str, name: str, step: float, n_lags: int
) -> FloatArray:
    """Return the correlation of an output with the input at lags from -n to n steps, all lines of equal weight."""
    drive, output = record.input(input_name), record.output(name)
    seen = output.is_valid
    first, last = drive.span_s
    grid = np.arange(first, last, step)
    # A line from the first to the last value is taken out: what is left has no jump at its ends.
    u = _without_line(np.interp(grid, drive.times_s, drive.values))
    y = _without_line(np.interp(grid, output.times_s[seen], output.values[seen]))
    size = 2 ** int(np.ceil(np.log2(2 * len(grid))))
    cross = np.fft.rfft(y, size) * np.conj(np.fft.rfft(u, size))
    cross[np.fft.rfftfreq(size) > 1.0 / _PER_CYCLE] = 0.0  # of a step: above, an output shows aliases
    correlation = np.fft.irfft(cross / np.maximum(np.abs(cross), 1e-300), size)
    return np.asarray(np.concatenate([correlation[-n_lags:], correlation[: n_lags + 1]]))


def _without_line(values: FloatArray) -> FloatArray:
    return np.asarray(values - np.linspace(values[0], values[-1], len(values)))
