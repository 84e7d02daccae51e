"""Loops that are compiled where Numba is installed (the extra ``compiled``); what they compute is the same without.

Numba is imported when a loop is first asked for: it takes a second, and only long records are worth it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from beam_model.arrays import FloatArray

Pairs = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], None]

STRAND = 8  # ticks
FEW_PAIRS = 5  # so few leave a processor idle while each tick waits for the one before


def step_pairs(blocks: FloatArray, effects: FloatArray, values: FloatArray, states: FloatArray) -> None:
    """Step pairs of states under an input, ``X_(k+1) = F X_k + G u_k`` from ``states[0]`` on, in place.

    Parameters
    ----------
    blocks : ndarray, shape (4, n_pairs) -- F of every pair, row by row
    effects : ndarray, shape (2, n_pairs) -- G
    values : ndarray, shape (n_ticks,) -- u
    states : ndarray, shape (n_ticks + 1, 2 n_pairs) -- the first of all pairs, then the second of all

    Notes
    -----
    A product and two sums must end before the next tick's may begin. Of few pairs four strands of eight ticks each
    are stepped at once: where the next strand begins follows from where the one before began,
    ``X_(k+8) = F^8 X_k + sum_j F^(7-j) G u_(k+j)``, without its ticks. Many pairs keep a processor busy themselves.
    """
    n_pairs = effects.shape[1]
    n_groups = values.size // (4 * STRAND) if n_pairs <= FEW_PAIRS else 0
    # F^8 of every pair, and F^(7-j) G: what the inputs of a strand do to the state after it.
    longer, reached = np.empty((4, n_pairs)), np.empty((2, STRAND, n_pairs))
    for i in range(n_pairs):
        a, b, c, d = 1.0, 0.0, 0.0, 1.0
        for tick in range(STRAND - 1, -1, -1):
            reached[0, tick, i] = a * effects[0, i] + b * effects[1, i]
            reached[1, tick, i] = c * effects[0, i] + d * effects[1, i]
            a, b = a * blocks[0, i] + b * blocks[2, i], a * blocks[1, i] + b * blocks[3, i]
            c, d = c * blocks[0, i] + d * blocks[2, i], c * blocks[1, i] + d * blocks[3, i]
        longer[0, i], longer[1, i], longer[2, i], longer[3, i] = a, b, c, d
    for group in range(n_groups):
        k0 = 4 * STRAND * group
        k1, k2, k3 = k0 + STRAND, k0 + 2 * STRAND, k0 + 3 * STRAND
        for i in range(n_pairs):
            j = n_pairs + i
            p0 = q0 = p1 = q1 = p2 = q2 = 0.0
            for tick in range(STRAND):
                r, s = reached[0, tick, i], reached[1, tick, i]
                u0, u1, u2 = values[k0 + tick], values[k1 + tick], values[k2 + tick]
                p0, q0 = p0 + r * u0, q0 + s * u0
                p1, q1 = p1 + r * u1, q1 + s * u1
                p2, q2 = p2 + r * u2, q2 + s * u2
            a, b, c, d = longer[0, i], longer[1, i], longer[2, i], longer[3, i]
            x0, y0 = states[k0, i], states[k0, j]
            x1, y1 = a * x0 + b * y0 + p0, c * x0 + d * y0 + q0
            x2, y2 = a * x1 + b * y1 + p1, c * x1 + d * y1 + q1
            x3, y3 = a * x2 + b * y2 + p2, c * x2 + d * y2 + q2
            a, b, c, d = blocks[0, i], blocks[1, i], blocks[2, i], blocks[3, i]
            g, h = effects[0, i], effects[1, i]
            for tick in range(STRAND):
                u0, u1, u2, u3 = values[k0 + tick], values[k1 + tick], values[k2 + tick], values[k3 + tick]
                x0, y0 = a * x0 + b * y0 + g * u0, c * x0 + d * y0 + h * u0
                x1, y1 = a * x1 + b * y1 + g * u1, c * x1 + d * y1 + h * u1
                x2, y2 = a * x2 + b * y2 + g * u2, c * x2 + d * y2 + h * u2
                x3, y3 = a * x3 + b * y3 + g * u3, c * x3 + d * y3 + h * u3
                states[k0 + tick + 1, i], states[k0 + tick + 1, j] = x0, y0
                states[k1 + tick + 1, i], states[k1 + tick + 1, j] = x1, y1
                states[k2 + tick + 1, i], states[k2 + tick + 1, j] = x2, y2
                states[k3 + tick + 1, i], states[k3 + tick + 1, j] = x3, y3
    for k in range(4 * STRAND * n_groups, values.size):
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
    # A product and a sum may be one instruction; nothing else is rounded otherwise.
    compiled: Pairs = njit(cache=True, nogil=True, fastmath={"contract"})(step_pairs)
    return compiled
