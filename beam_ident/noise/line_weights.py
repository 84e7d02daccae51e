"""How the lines of a frequency record weigh: by their own noise, where that is known."""

from __future__ import annotations

import math

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.frequency_record import FrequencyRecord


def line_weights(record: FrequencyRecord, output: int, drive: int) -> FloatArray:
    """Return one over the standard deviation of real and imaginary part, 0 for missing lines.

    Without variances every line counts the same, in units of the response's own size.
    """
    values = record.response[:, output, drive]
    seen = np.isfinite(values)
    if record.variance is None:
        size = math.sqrt(float(np.mean(np.abs(values[seen]) ** 2))) if np.any(seen) else 1.0
        weights = np.full(len(values), 1.0 / max(size, 1e-300))
    else:
        variance = record.variance[:, output, drive]
        largest = float(np.max(np.abs(values[seen]), initial=0.0))
        # A variance of zero would be an infinite weight: rounding is the least there is.
        floor = max((1e-10 * largest) ** 2, 1e-300)
        weights = np.sqrt(2.0 / np.maximum(variance, floor))
    weights = np.where(seen, weights, 0.0)
    return np.concatenate([weights, weights])


def stacked_values(values: ComplexArray) -> FloatArray:
    """Return real parts above imaginary ones, 0 where nothing was measured."""
    plain = np.where(np.isfinite(values), values, 0.0)
    return np.concatenate([plain.real, plain.imag])
