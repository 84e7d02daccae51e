"""Rounded values: the step they are rounded to, and whether noise makes the errors independent of the signal.

Rounding to steps of q adds an error of deviation ``q / sqrt(12)``.  Noise of half a step or more before the rounding
makes that error independent of the signal to a percent (Widrow and Kollar, Quantization Noise, 2008, ch. 4): then it
is noise like any other, and least squares stays right.  With noise of sigma the mean error at y is, in first order,
``(q / pi) exp(-2 pi^2 (sigma / q)^2) sin(2 pi y / q)``: below a third of a step errors follow the signal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.noise.record_fit import RecordFit

_MULTIPLE = 0.02  # of a step, within which all differences are multiples of it
_MOST_STEPS = 1e6  # beyond which nothing can be said
_FEW = 8  # samples
_DITHER = 0.3  # steps of noise, below which a sixth of the rounding error and more follows the signal


def quantum(values: FloatArray) -> float:
    """Return the step to which values are rounded, 0 where there is none to be seen."""
    levels = np.unique(values[np.isfinite(values)])
    if not len(values) >= _FEW or len(levels) < 2:
        return 0.0
    steps = np.diff(levels)
    smallest = float(np.min(steps))
    if not smallest > 0.0 or float(np.ptp(levels)) > _MOST_STEPS * smallest:
        return 0.0
    # Levels that are missing leave multiples; the whole range knows the step best.
    counts = np.round(steps / smallest)
    found = float(np.ptp(levels)) / float(np.sum(counts))
    # Samples that are not rounded repeat no level.
    is_rounded = len(levels) < 0.9 * len(values) and np.max(np.abs(steps / found - counts)) < _MULTIPLE
    return found if is_rounded else 0.0


def rounding_warning(outputs: Sequence[tuple[str, Sequence[RecordFit]]]) -> str:
    """Return a warning of outputs whose rounding errors follow the signal, or an empty string.

    Parameters
    ----------
    outputs : sequence of (name, records) -- of every output
    """
    found = []
    for name, records in outputs:
        for own in records:
            step = quantum(own.measured)
            if not step:
                continue
            # What is left beside the rounding's own variance is the noise before it.
            before = float(np.mean(np.square(own.residuals))) - step**2 / 12.0
            noise = math.sqrt(max(before, 0.0)) / step
            if noise < _DITHER and float(np.std(own.residuals)) > 0.05 * step:
                found.append(f"{name} (steps of {step:.3g}, noise of {noise:.2g} steps)")
                break
    if not found:
        return ""
    return (
        f"Rounding: {', '.join(found)}. With noise of less than {_DITHER} steps its errors follow the "
        "signal and may bias the fit by as much as their own deviation, 0.29 steps; standard deviations take them "
        "to be noise. Choose a finer range, or let half a step of noise in before the rounding."
    )
