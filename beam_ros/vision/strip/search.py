"""The strip where nothing tells its place: the best path of its cross-section from the clamp to the tip."""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import FloatArray, IndexArray

_LEAN = 3
"""Columns that the path may move from band to band [px]."""
_TOLL = 0.02
"""What a column of lean costs, as a share of the most that a band counts."""
_MOST = 3.0
"""A band counts no more than so many times the median of the bands' best: nothing bright may outweigh the strip."""


def best_path(scores: FloatArray) -> IndexArray:
    """Find the path through all bands with the largest sum (dynamic programming).

    Parameters
    ----------
    scores : ndarray, shape (n_bands, n_columns) -- how well each column fits; minus infinity where it cannot be

    Returns
    -------
    ndarray of int, shape (n_bands,) -- a column for each band
    """
    n = len(scores)
    best = np.max(scores, axis=1)
    cap = abs(_MOST * float(np.median(best[np.isfinite(best)]))) if np.any(np.isfinite(best)) else 1.0
    scores = np.clip(scores, -cap, cap)
    # Bands lean against the curve by a few columns at most, and the less the better.
    leans = np.arange(-_LEAN, _LEAN + 1)
    toll = (_TOLL * cap * np.abs(leans))[:, None]
    came = np.zeros(scores.shape, dtype=np.intp)
    every = np.arange(scores.shape[1])
    total = scores[0]
    padded = np.full(scores.shape[1] + 2 * _LEAN, -np.inf)
    beside = np.lib.stride_tricks.sliding_window_view(padded, scores.shape[1])
    for k in range(1, n):
        padded[_LEAN:-_LEAN] = total
        views = beside - toll
        choice = views.argmax(axis=0)
        came[k] = every + leans[choice]
        total = scores[k] + views[choice, every]
    path = np.empty(n, dtype=np.intp)
    path[-1] = int(np.argmax(total))
    for k in range(n - 1, 0, -1):
        path[k - 1] = min(max(int(came[k, path[k]]), 0), scores.shape[1] - 1)
    return path
