"""Recursions of samples: filters with poles alone, solved as banded triangular systems.

    y[n] = x[n] - a_1 y[n-1] - .. - a_p y[n-p]

is a system ``T y = x`` whose matrix has ones on its diagonal and a_k on the k-th one below.  BLAS and LAPACK solve it
by forward substitution: with one pole the operations are those of ``scipy.signal.lfilter``, one by one, and with more
poles they are the same in another order.  To load ``scipy.signal`` takes longer than to load all of an estimator.

Samples are taken block by block: the band of a block stays in the cache, and serves every block.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from scipy.linalg import blas, lapack

from beam_ident.arrays import ComplexArray, FloatArray

_BLOCK = 8192  # samples: the complex band of one pole fills 256 KiB

Samples = TypeVar("Samples", FloatArray, ComplexArray)


def one_pole(feedback: complex, drive: Samples, before: complex = 0.0) -> Samples:
    """Return ``y[n] = feedback y[n-1] + drive[n]``.

    Parameters
    ----------
    feedback : float or complex -- of a real drive, real
    drive : ndarray, shape (n,)
    before : float or complex -- y before the first sample

    Returns
    -------
    ndarray, shape (n,)
    """
    solve = blas.ztbsv if np.iscomplexobj(drive) else blas.dtbsv
    found = np.array(drive)
    found[:1] += np.asarray(feedback * before, dtype=found.dtype)
    # Columns of the band: the diagonal, which is taken for ones unread, and what stands below it.
    band = np.full((min(len(found), _BLOCK), 2), -feedback, dtype=found.dtype)
    for first in range(0, len(found), _BLOCK):
        block = found[first : first + _BLOCK]
        if first:
            block[:1] += feedback * found[first - 1]
        block[:] = solve(1, band[: len(block)].T, block, lower=1, diag=1, overwrite_x=1)
    return found


def all_pole(coefficients: FloatArray, rows: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rows behind 1 / A, and the state after them.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, a_1 .. a_p
    rows : ndarray, shape (n_rows, n) -- every one is a signal of its own
    state : ndarray, shape (n_rows, order)
        What the samples before add to the next ``order`` samples, the state of the transposed direct form; zeros
        for a filter at rest.

    Returns
    -------
    filtered : ndarray, shape (n_rows, n)
    state : ndarray, shape (n_rows, order)
    """
    if not rows.size:  # LAPACK writes where nothing is
        return rows, state
    n = rows.shape[1]
    band = np.tile(coefficients, (min(n, _BLOCK), 1))
    found = np.empty_like(rows)
    for first in range(0, n, _BLOCK):
        block = np.array(rows[:, first : first + _BLOCK], order="C")
        reached = min(state.shape[1], block.shape[1])
        block[:, :reached] += state[:, :reached]
        block = lapack.dtbtrs(band[: block.shape[1]].T, block.T, uplo="L", diag="U", overwrite_b=1)[0].T
        found[:, first : first + _BLOCK] = block
        state = _state_after(block, coefficients, state)
    return found, state


def _state_after(filtered: FloatArray, coefficients: FloatArray, state: FloatArray) -> FloatArray:
    """Return the state after some samples, from the one before them."""
    order, n = state.shape[1], filtered.shape[1]
    after = np.zeros_like(state)
    after[:, : max(order - n, 0)] = state[:, n:]
    for back in range(min(n, order)):
        # A coefficient a_k of y[n-1-back] acts k samples after it, of which ``back`` have passed.
        after[:, : order - back] -= filtered[:, n - 1 - back, None] * coefficients[1 + back :]
    return after
