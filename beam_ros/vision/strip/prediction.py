"""Where the strip will be in the next frame: what moved in the last ones goes on."""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import FloatArray

_ORDER = 8
_REMEMBERED = 64
_ENOUGH = _ORDER + 8
_REFIT_FRAMES = 4
_RIDGE = 1e-4


class CurvePrediction:
    """Predicts the coefficients of a curve by one linear recursion for all of them.

    A beam in n modes obeys a recursion of order 2 n, and so does whatever is linear in its coordinates.

    Parameters
    ----------
    curve : ndarray, shape (n_coefficients,) -- of the first frame
    """

    def __init__(self, curve: FloatArray) -> None:
        self._past = [curve]
        self._frames = 0
        self._recursion: FloatArray | None = None
        self._mean = np.zeros_like(curve)

    @property
    def last(self) -> FloatArray:
        """The last curve."""
        return self._past[-1]

    def steps(self, count: int) -> FloatArray:
        """Return how the curve changed in its last steps, shape (count, n_coefficients); 0 before it was seen."""
        past = [self._past[0]] * (count + 1 - len(self._past)) + self._past[-count - 1 :]
        return np.diff(past, axis=0)

    def remember(self, curve: FloatArray) -> None:
        """Take note of a frame's curve."""
        self._past = [*self._past[1 - _REMEMBERED :], curve]
        self._frames += 1

    def forget(self) -> None:
        """Keep the last curve alone: frames are missing behind it."""
        self._past, self._recursion = self._past[-1:], None

    def next(self) -> tuple[FloatArray, FloatArray | None]:
        """Predict the curve of the next frame and its speed then [per frame]; None where nobody knows that yet."""
        past = self._past
        if len(past) < _ENOUGH:
            return np.asarray(past[-1] if len(past) < 2 else 2 * past[-1] - past[-2]), None
        if self._recursion is None or self._frames % _REFIT_FRAMES == 0:
            record = np.array(past)
            self._mean = record.mean(axis=0)
            record -= self._mean
            n = len(record) - _ORDER
            design = np.stack(
                [record[_ORDER - lag : _ORDER - lag + n].ravel() for lag in range(1, _ORDER + 1)]
            )
            normal = design @ design.T + _RIDGE * len(record) * np.eye(_ORDER)
            self._recursion = np.linalg.solve(normal, design @ record[_ORDER:].ravel())
        lately = np.empty((_ORDER + 3, len(self._mean)))
        np.subtract(past[: -_ORDER - 1 : -1], self._mean, out=lately[3:])
        for k in (2, 1, 0):
            lately[k] = self._recursion @ lately[k + 1 : k + 1 + _ORDER]
        after, soon, now, last, before = lately[:5]
        # Central difference of fourth order: a mode at a quarter of the frame rate is at 0.85 of its speed.
        return np.asarray(self._mean + now), np.asarray((8.0 * (soon - last) - (after - before)) / 12.0)
