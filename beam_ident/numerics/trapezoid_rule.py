"""The rule of trapezoids: NumPy renamed its own between the versions that are served."""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray


def trapezoid_rule(values: FloatArray, places: FloatArray) -> FloatArray:
    """Return the integral of values of shape (n, ...) over rising places of shape (n,)."""
    return np.asarray(np.tensordot(0.5 * np.diff(places), values[1:] + values[:-1], axes=1))
