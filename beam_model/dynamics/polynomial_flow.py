"""Linear motion within a tick as a polynomial of time, and the first instant at which something of it passes zero.

The Taylor series of X' = A X + B u about the tick's beginning is exact to rounding once it is long enough, and
its coefficients are linear in state and input, hence one matrix product. In Bernstein's form a polynomial lies
between its smallest and largest coefficient: where all are positive there is no zero, however it swings in
between. That test costs microseconds; only where it fails the interval is halved until each zero stands alone.

Equation numbers are those of docs/beam-equations.md.
"""

from __future__ import annotations

from math import comb

import numpy as np

from beam_model.arrays import FloatArray
from beam_model.parameters import check_number

_TERMS = 24
# 2^24/24! is below rounding.
_REACH = 2.0
# Leading coefficients below this share of the largest are rounding.
_ROUNDING = 1e-13
# Halvings after which two zeros are one that touches: 1e-12 of a piece.
_HALVINGS = 40

# Zeros are found to this part of a piece.
_ZERO_WIDTH = 4e-16
# Newton needs some six steps; one that creeps ends here.
_STEPS = 100

_POWERS = np.arange(_TERMS)
_TO_BERNSTEIN = np.array(
    [[comb(j, k) / comb(_TERMS - 1, k) if k <= j else 0.0 for k in range(_TERMS)] for j in range(_TERMS)]
)
_LEFT = np.array([[comb(j, k) / 2.0**j if k <= j else 0.0 for k in range(_TERMS)] for j in range(_TERMS)])
_RIGHT = _LEFT[::-1, ::-1]


class PolynomialFlow:
    """A linear system under a held input, as a polynomial over each piece of a tick.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n,)
    longest : float
        A piece is not longer than this [s], nor than the series reaches.
    scale : ndarray, shape (n,)
        Magnitudes of the states against each other.

    Attributes
    ----------
    piece : float
        h, the length of a piece [s].
    """

    def __init__(self, A: FloatArray, B: FloatArray, longest: float, scale: FloatArray) -> None:
        rate = float(np.linalg.norm(A * scale[:, None] / scale[None, :], 2))
        self._n = n = B.size
        self.piece = check_number("longest", longest, "s", above=0.0) / max(
            1, np.ceil(rate * longest / _REACH)
        )
        # (B.8): c_k = h/k (A c_(k-1)), c_1 = h (A X + B u), for all X and u at once.
        step = self.piece * A
        maps = np.zeros((_TERMS, n, n + 1))
        maps[0, :, :n] = np.eye(n)
        maps[1, :, :n], maps[1, :, n] = step, self.piece * B
        for k in range(2, _TERMS):
            maps[k] = step @ maps[k - 1] / k
        self._maps = maps.reshape(_TERMS * n, n + 1)
        self._start = np.empty(n + 1)

    def coefficients(self, state: FloatArray, value: float) -> FloatArray:
        """Return c with X(s h) = sum_k c[k] s^k for s from 0 to 1, shape (24, n).

        Parameters
        ----------
        state : ndarray, shape (n,)
        value : float
            The held input.
        """
        self._start[: self._n] = state
        self._start[self._n] = value
        return np.asarray((self._maps @ self._start).reshape(_TERMS, self._n))


def value_at(coefficients: FloatArray, s: float) -> FloatArray:
    """Return the polynomials' values at ``s``, shape of one coefficient."""
    if s == 1.0:
        return np.asarray(coefficients.sum(axis=0))
    return np.asarray(s**_POWERS @ coefficients)


def are_positive(coefficients: FloatArray) -> bool:
    """Return whether polynomials are surely positive from s = 0 to 1.

    Parameters
    ----------
    coefficients : ndarray, shape (24, n_polynomials)
        Of the powers of s.
    """
    return bool((_TO_BERNSTEIN @ coefficients).min() > 0.0)


def first_zero(coefficients: FloatArray, end: float) -> float | None:
    """Return the first s from 0 to ``end`` at which a polynomial passes from above zero to below, or None.

    Parameters
    ----------
    coefficients : ndarray, shape (24,)
        Of the powers of s.
    end : float
        At most 1.

    Notes
    -----
    A polynomial that begins at zero passes it there only if it then falls: zeros at the beginning are divided out.
    """
    scaled = coefficients * end**_POWERS
    size = np.abs(scaled)
    leading = int(np.argmax(size > _ROUNDING * size.max()))
    if size[leading] == 0.0:
        return None
    if scaled[leading] < 0.0:
        return 0.0
    shifted = np.zeros(_TERMS)
    shifted[: _TERMS - leading] = scaled[leading:]
    s = _isolated_zero(shifted, _TO_BERNSTEIN @ shifted)
    return None if s is None else s * end


def _isolated_zero(coefficients: FloatArray, bernstein: FloatArray) -> float | None:
    """Return the first zero of a polynomial that is positive at 0, by halving (de Casteljau)."""
    pieces = [(0.0, 1.0, bernstein, _HALVINGS)]
    while pieces:
        low, high, b, left = pieces.pop()
        if b.min() > 0.0:
            continue
        # As many zeros as changes of sign, or fewer by an even number (Descartes).
        changes = int(np.count_nonzero(np.diff(b < 0.0)))
        if changes == 1 and b[0] > 0.0 and b[-1] < 0.0:
            return _only_zero(coefficients[::-1].tolist(), low, high)
        if left == 0:
            # Two zeros so close are a touch, one is a passage that rounding hides from the test above.
            if b[-1] < 0.0:
                return low
            continue
        middle = 0.5 * (low + high)
        pieces.append((middle, high, _RIGHT @ b, left - 1))
        pieces.append((low, middle, _LEFT @ b, left - 1))
    return None


def _only_zero(falling: list[float], low: float, high: float) -> float:
    """Return the one zero between ``low``, where a polynomial is positive, and ``high``, where it is negative.

    Newton's method, held between two ends that close in; ``falling`` are the coefficients from the highest power.
    """
    s = 0.5 * (low + high)
    for _ in range(_STEPS):
        value = slope = 0.0
        for coefficient in falling:
            slope = slope * s + value
            value = value * s + coefficient
        if value > 0.0:
            low = s
        else:
            high = s
        step = value / slope if slope != 0.0 else 0.0
        if abs(step) <= _ZERO_WIDTH and low <= s - step <= high:
            return s - step
        s -= step
        if not low < s < high:
            s = 0.5 * (low + high)
    return s
