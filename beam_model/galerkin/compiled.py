"""Loops that are compiled where Numba is installed (the extra ``compiled``); what they compute is the same without.

Numba is imported when a loop is first asked for: it takes a second, and only long records are worth it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from beam_model.arrays import FloatArray

Pairs = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], None]


def step_pairs(blocks: FloatArray, effects: FloatArray, values: FloatArray, states: FloatArray) -> None:
    """Step pairs of states under an input, ``X_(k+1) = F X_k + G u_k`` from ``states[0]`` on, in place.

    Parameters
    ----------
    blocks : ndarray, shape (4, n_pairs) -- F of every pair, row by row
    effects : ndarray, shape (2, n_pairs) -- G
    values : ndarray, shape (n_ticks,) -- u
    states : ndarray, shape (n_ticks + 1, 2 n_pairs) -- the first of all pairs, then the second of all
    """
    n_pairs = effects.shape[1]
    for k in range(values.size):
        held = values[k]
        for i in range(n_pairs):
            first, second = states[k, i], states[k, n_pairs + i]
            states[k + 1, i] = blocks[0, i] * first + blocks[1, i] * second + effects[0, i] * held
            states[k + 1, n_pairs + i] = blocks[2, i] * first + blocks[3, i] * second + effects[1, i] * held


@cache
def compiled_pairs() -> Pairs | None:
    """Return ``step_pairs`` as machine code, or None without Numba."""
    try:
        from numba import njit
    except ImportError:
        return None
    compiled: Pairs = njit(cache=True, nogil=True)(step_pairs)
    return compiled
