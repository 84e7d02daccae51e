"""Blur of the lens, by vote: the cross-section that leaves least of the rows of the first frames."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, IndexArray
from beam_ros.vision.strip.profile import PHASES, ProfileTable

_BLURS_PX = tuple(np.geomspace(0.3, 4.0, 27))
_MOST = 4.0
"""A row counts no more than so many times the median: it may show something else."""


@lru_cache(maxsize=64)
def _candidate(width_px: float, k: int) -> ProfileTable:
    """Return the cross-section at rest with one of the blurs; all of them look at the same pixels."""
    half = None if k == len(_BLURS_PX) - 1 else _candidate(width_px, len(_BLURS_PX) - 1).half
    return ProfileTable(width_px, float(_BLURS_PX[k]), 0.0, half)


@lru_cache(maxsize=4)
def _bases(width_px: float) -> Float32Array:
    """Return what fits rows of one phase with all of the blurs, shape (PHASES, size, 3 len(_BLURS_PX))."""
    bases = np.stack([_candidate(width_px, k).basis for k in range(len(_BLURS_PX))], axis=1)
    return np.ascontiguousarray(bases.reshape(PHASES, 3 * len(_BLURS_PX), -1).transpose(0, 2, 1))


class BlurVotes:
    """Misfits of the rows of all frames so far.

    Parameters
    ----------
    width_px : float -- of the strip [px]

    Attributes
    ----------
    half : int -- pixels on either side of a row's column that a vote takes
    """

    def __init__(self, width_px: float) -> None:
        self._width_px = width_px
        self._misfits = np.zeros(len(_BLURS_PX))
        self.half = _candidate(width_px, len(_BLURS_PX) - 1).half

    def add(self, u: FloatArray, pixels: Float32Array) -> float:
        """Count the votes of a frame.

        Parameters
        ----------
        u : ndarray, shape (n,) -- column of the strip in every row [px]
        pixels : ndarray, shape (n, 2 half + 1) -- about the pixel nearest to it [grey levels]

        Returns
        -------
        float -- blur that leaves least of all frames [px]
        """
        phases: IndexArray = _candidate(self._width_px, 0).entries(u, np.zeros(len(u)))[1]
        order = np.argsort(phases)
        ends = np.searchsorted(phases[order], np.arange(PHASES + 1))
        ordered = pixels[order]
        misfits = np.empty((len(u), len(_BLURS_PX)))
        misfits[:] = np.einsum("rw,rw->r", ordered, ordered)[:, None]
        for bases, first, last in zip(_bases(self._width_px), ends[:-1], ends[1:], strict=True):
            parts = (ordered[first:last] @ bases).astype(np.float64)
            misfits[first:last] -= (parts * parts).reshape(-1, len(_BLURS_PX), 3).sum(axis=2)
        self._misfits += np.minimum(misfits, _MOST * np.median(misfits, axis=0)).sum(axis=0)
        k = int(np.clip(np.argmin(self._misfits), 1, len(_BLURS_PX) - 2))
        left, middle, right = self._misfits[k - 1 : k + 2]
        bend = left - 2 * middle + right
        shift = float(np.clip(0.5 * (left - right) / bend, -1, 1)) if bend > 0 else 0.0
        return float(_BLURS_PX[k] * (_BLURS_PX[1] / _BLURS_PX[0]) ** shift)
