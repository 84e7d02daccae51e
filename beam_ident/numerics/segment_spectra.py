"""Spectra of a signal's segments under Hann windows that overlap by half (Welch, IEEE Trans. AU-15 (1967), 70).

Products of two signals' spectra, in the mean of the segments, are their one-sided cross-density.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from beam_ident.arrays import ComplexArray, FloatArray


def segment_spectra(values: FloatArray, period_s: float, length: int) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies [Hz], and the spectra of segments, each without its mean.

    Parameters
    ----------
    values : ndarray, shape (n,)
    period_s : float -- [s]
    length : int -- of a segment, 2 to n [samples]

    Returns
    -------
    frequencies : ndarray, shape (n_lines,) -- from zero to half the rate
    spectra : ndarray, shape (n_segments, n_lines)
        Their squared magnitudes are one-sided densities [unit of the values squared / Hz].
    """
    segments = sliding_window_view(values, length)[:: length - length // 2]
    window = np.square(np.sin(np.pi * np.arange(length) / length))
    scale = np.full(length // 2 + 1, math.sqrt(2.0 * period_s / float(window @ window)))
    # Zero, and half the rate where it is a line, have no counterpart at a negative frequency.
    scale[[0] if length % 2 else [0, -1]] /= math.sqrt(2.0)
    centred = segments - np.mean(segments, axis=1, keepdims=True)
    frequencies = np.arange(len(scale)) / (length * period_s)
    return frequencies, scale * np.fft.rfft(window * centred, axis=1)
