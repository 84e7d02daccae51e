"""Sums of sines on the lines of a period, by the fast Fourier transform where the instants allow it."""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray

_ON_GRID = 1e-6  # of a step: instants this close to its multiples are on the grid


def sum_of_lines(
    times_s: FloatArray,
    numbers: IndexArray,
    amplitudes: FloatArray,
    phases: FloatArray,
    line_period_s: float,
) -> FloatArray:
    """Return ``sum_k amplitudes_k sin(2 pi numbers_k t / line_period + phases_k)``.

    Parameters
    ----------
    times_s : ndarray, shape (n,) -- any times [s]
    numbers : ndarray of int, shape (n_lines,) -- cycles in a period
    amplitudes, phases : ndarray, shape (n_lines,) -- phases in rad
    line_period_s : float -- [s]

    Notes
    -----
    On a grid that divides the period one transform gives all samples of the period; elsewhere
    every sine is computed, at a cost of lines times instants.
    """
    n = _points_of_period(times_s, line_period_s)
    if n > 2 * int(numbers[-1]):
        spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
        spectrum[numbers] = -0.5j * n * amplitudes * np.exp(1j * phases)
        places = np.rint(times_s * (n / line_period_s)).astype(np.int64) % n
        return np.asarray(np.fft.irfft(spectrum, n)[places])
    total = np.zeros(np.shape(times_s))
    for number, amplitude, phase in zip(numbers, amplitudes, phases, strict=True):
        total += amplitude * np.sin(2.0 * np.pi * number / line_period_s * times_s + phase)
    return total


def _points_of_period(times_s: FloatArray, line_period_s: float) -> int:
    """Return how many steps of the instants' grid make a period, 0 where there is no such grid."""
    if len(times_s) < 2 or not times_s[1] > times_s[0]:
        return 0
    n = round(line_period_s / float(times_s[1] - times_s[0]))
    if n < 1:
        return 0
    steps = times_s * (n / line_period_s)
    return n if bool(np.all(np.abs(steps - np.rint(steps)) < _ON_GRID)) else 0
