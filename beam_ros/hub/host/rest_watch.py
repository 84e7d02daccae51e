"""Whether the hub stands still, by what was measured last."""

from __future__ import annotations

from collections import deque

import numpy as np

from beam_ros.arrays import FloatArray

REST_S = 0.05
"""A hub rests that has not moved for so long [s]."""
_ROUNDING_S = 1e-6
"""Of times in seconds since 1970, 0.2 us as doubles."""


class RestWatch:
    """Remembers where the hub was in the last 50 ms.

    Parameters
    ----------
    noise : float
        By how much positions differ of a hub that stands still [m].
    """

    def __init__(self, noise: float) -> None:
        self._noise = noise
        self._past: deque[tuple[float, float]] = deque()

    def add(self, times: FloatArray, positions: FloatArray) -> None:
        """Take the newest samples: when the hub was measured [s], and where it was [m]."""
        if self._past and times[0] <= self._past[-1][0]:
            self.forget()
        self._past.extend(zip(times.tolist(), positions.tolist(), strict=True))
        oldest = self._past[-1][0] - REST_S + _ROUNDING_S
        while len(self._past) > 1 and self._past[1][0] <= oldest:
            self._past.popleft()

    def forget(self) -> None:
        """Begin anew: nothing is known of the motion."""
        self._past.clear()

    @property
    def is_moving(self) -> bool:
        """Whether the hub has been seen to move within 50 ms; where less is known, it has not."""
        if not self._is_full:
            return False
        positions = [position for _, position in self._past]
        return max(positions) - min(positions) > self._noise

    @property
    def speed(self) -> float:
        """Mean speed in the last 50 ms [m/s]; 0 while it is not known."""
        if not self._is_full:
            return 0.0
        past = np.array(self._past)
        early, late = past[: len(past) // 2], past[len(past) // 2 :]
        span, way = np.mean(late, axis=0) - np.mean(early, axis=0)
        return abs(float(way / span))

    @property
    def _is_full(self) -> bool:
        return len(self._past) > 1 and self._past[-1][0] - self._past[0][0] >= REST_S - _ROUNDING_S
