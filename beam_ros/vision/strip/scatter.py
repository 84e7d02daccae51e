"""How much more the points scatter than white noise of the pixels lets them.

A codec smooths a frame in blocks and rounds what is left: neighbouring pixels and rows err alike, the mean of a band
of rows is worse than the pixels' own noise says, and no residual of a fit shows it. The points do. Their distances e
from the curve through all of them, less what each has always had (a kink of the strip is no error), are differenced
twice along the strip, which leaves little of a smooth shape that the curve did not follow,

    d_j = e_(j-k) - 2 e_j + e_(j+k),

with points k apart so that no block holds rows of two of them. Their squares over the variances that they would have
from white noise average to the square of the factor. What is below 1, or no larger than chance makes it, is none.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ros.arrays import FloatArray

_BLOCK_ROWS = 8
"""Rows of a codec's block."""
_FIRST, _REMEMBERED = 30.0, 1500.0
"""Degrees of freedom of the expectation that the noise is white, and of all that is remembered."""
_USUAL_RATE = 0.05
_UNSEEN = 1e9
_OUTLIER = 12.0
"""Squares count no more than so many times what is usual: a point may be at the edge of a hand."""


class PointScatter:
    """Compares the points' scatter with that of white noise.

    Parameters
    ----------
    n_points, row_step : int -- number of points, rows of each

    Attributes
    ----------
    factor : float -- standard deviation of a point over that from white noise, at least 1
    """

    def __init__(self, n_points: int, row_step: int) -> None:
        self._apart = min(1 + math.ceil(_BLOCK_ROWS / row_step), (n_points - 1) // 2)
        self._usual = np.zeros(n_points)  # distance of every point from the curve,
        self._doubt = np.full(n_points, _UNSEEN)  # and the variance of that mean, in those of a point
        self._freedom = _FIRST
        self._freedom_each: float | None = None  # degrees of freedom of a difference
        self._square = 1.0
        self.factor = 1.0

    def learn(self, distance: FloatArray, left: FloatArray, sigma: FloatArray, is_ok: np.ndarray) -> None:
        """Learn from the points of a frame.

        Parameters
        ----------
        distance : ndarray, shape (n_points,) -- from the curve [px]
        left : ndarray, shape (n_points, n_points) -- what the curve leaves of the points: distance = left @ points
        sigma : ndarray, shape (n_points,) -- standard deviations from white noise [px]
        is_ok : ndarray of bool, shape (n_points,) -- the valid points
        """
        known = is_ok & (self._doubt < _UNSEEN)
        k = self._apart
        uses = known[: -2 * k] & known[k:-k] & known[2 * k :]
        changed = np.where(known, distance - self._usual, 0.0)
        spread = np.where(known, sigma * np.sqrt(1.0 + self._doubt), 0.0)
        rate = is_ok * np.maximum(_USUAL_RATE, self._doubt / (1.0 + self._doubt))
        self._usual += np.where(is_ok, rate * (distance - self._usual), 0.0)
        self._doubt = (1.0 - rate) ** 2 * self._doubt + rate**2
        if not np.any(uses):
            return
        of_noise = self._differences(left)[uses] * spread
        variance = np.maximum(np.einsum("ij,ij->i", of_noise, of_noise), 1e-12)
        squares = self._differences(changed)[uses] ** 2 / variance
        if self._freedom_each is None:
            # Differences share points and curve: n of them count as n / (their mean sum of squared correlations).
            correlation = of_noise @ of_noise.T / np.sqrt(np.outer(variance, variance))
            self._freedom_each = len(squares) / float(np.sum(correlation**2))
        freedom = len(squares) * self._freedom_each
        seen = float(np.mean(np.minimum(squares, _OUTLIER * self._square)))
        self._freedom += freedom
        self._square += (seen - self._square) * freedom / self._freedom
        self._freedom = min(self._freedom, _REMEMBERED)
        # An excess of two of its own standard deviations counts half, one of four 94 %: chance makes hardly any.
        excess = max(self._square - 1.0, 0.0)
        worth = (excess**2 * self._freedom / 2.0 / 4.0) ** 2
        self.factor = math.sqrt(1.0 + excess * worth / (1.0 + worth))

    def _differences(self, of_points: FloatArray) -> FloatArray:
        """Second differences along the first axis."""
        k = self._apart
        return np.asarray(of_points[: -2 * k] - 2.0 * of_points[k:-k] + of_points[2 * k :])
