"""Random numbers of a seed, the same in every NumPy.

NumPy keeps the raw stream of ``PCG64`` and its seeding, but reserves the right to change what
its distributions make of it.  The few numbers that a recipe draws are made here from the raw
stream.
"""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray


def uniform(seed: int, n: int) -> FloatArray:
    """Return ``n`` numbers from 0 up to, but without, 1, in steps of 2^-53."""
    raw = np.random.PCG64(seed).random_raw(n)
    return np.asarray((np.asarray(raw, dtype=np.uint64) >> np.uint64(11)) * 2.0**-53, dtype=np.float64)


def phases(seed: int, n: int) -> FloatArray:
    """Return ``n`` uniform phases [rad]."""
    return np.asarray(2.0 * np.pi * uniform(seed, n))


def choices(seed: int, n: int, n_options: int) -> IndexArray:
    """Return ``n`` whole numbers from 0 up to, but without, ``n_options``."""
    return np.asarray(np.floor(uniform(seed, n) * n_options), dtype=np.intp)
