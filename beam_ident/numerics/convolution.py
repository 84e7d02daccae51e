"""Convolutions of sampled signals: filters of finite length, sums under a window, running means.

``scipy.signal`` and ``scipy.ndimage`` have these, too; to load them takes longer than to load all of an estimator.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, next_fast_len, rfft

from beam_ident.arrays import BoolArray, FloatArray


def causal_convolution(weights: FloatArray, values: FloatArray, axis: int = -1) -> FloatArray:
    """Return ``sum_k weights[k] values[n-k]`` along an axis, for every n; before the first value there are zeros."""

    def along(own: FloatArray) -> FloatArray:
        return np.convolve(own, weights)[: len(own)]

    return along(values) if values.ndim == 1 else np.apply_along_axis(along, axis, values)


def inner_convolution(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the convolution where all weights lie on values, by one Fourier transform.

    Parameters
    ----------
    values : ndarray, shape (n,)
    weights : ndarray, shape (n_weights,) -- not longer than the values

    Returns
    -------
    ndarray, shape (n - n_weights + 1,)
    """
    size = next_fast_len(
        len(values), real=True
    )  # what wraps around falls where weights lie beyond the values
    whole = irfft(rfft(values, size) * rfft(weights, size), size)
    return np.asarray(whole[len(weights) - 1 : len(values)])


def running_mean(values: FloatArray, width: int, axis: int = -1) -> FloatArray:
    """Return the means of ``width`` neighbours about every place; beyond the ends, the end's value goes on."""
    values = np.moveaxis(values, axis, 0)
    before = width // 2
    ends = [(before, width - 1 - before)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values, ends, "edge")
    total = np.zeros_like(values)
    for first in range(
        width
    ):  # not by a sum that runs along: that would lose what is small beside what is large
        total += padded[first : first + len(values)]
    return np.moveaxis(total / width, 0, axis)


def eroded(mask: BoolArray, width: int) -> BoolArray:
    """Return where a mask holds under a whole window of odd width, which must not reach beyond its ends."""
    return np.asarray(np.all(sliding_window_view(np.pad(mask, width // 2), width), axis=-1))
