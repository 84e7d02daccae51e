"""Whether the hub stands still, by what was measured last."""

from __future__ import annotations

from collections import deque

import numpy as np

from beam_ros.hub.host.motion_watch import NOISE_COUNTS
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

REST_S = 0.05
"""A hub rests that has not moved for so long [s]."""


class RestWatch:
    """Remembers where the hub was in the last 50 ms.

    Parameters
    ----------
    parameters : AxisParameters
        Tick and encoder.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self._period = parameters.period
        self._resolution = parameters.encoder_resolution
        self._n_ticks = max(2, round(REST_S / parameters.period))
        self._counts: deque[int] = deque(maxlen=self._n_ticks)

    def add(self, ticks: TickBatch) -> None:
        """Take the newest ticks."""
        self._counts.extend(ticks.position_counts[-self._n_ticks :].tolist())

    def forget(self) -> None:
        """Begin anew: nothing is known of the motion."""
        self._counts.clear()

    @property
    def is_at_rest(self) -> bool:
        """Whether the hub has been seen at rest for 50 ms."""
        return self._is_full and max(self._counts) - min(self._counts) <= NOISE_COUNTS

    @property
    def is_moving(self) -> bool:
        """Whether the hub has been seen to move within 50 ms; where nothing is known, neither this nor at rest."""
        return self._is_full and not self.is_at_rest

    @property
    def speed(self) -> float:
        """Mean speed in the last 50 ms [m/s]; 0 while it is not known."""
        if not self._is_full:
            return 0.0
        early, late = np.split(np.array(self._counts, dtype=np.float64), [self._n_ticks // 2])
        counts = float(np.mean(late) - np.mean(early))
        return abs(counts) * self._resolution / (0.5 * self._n_ticks * self._period)

    @property
    def _is_full(self) -> bool:
        return len(self._counts) == self._n_ticks
