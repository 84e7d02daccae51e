"""How late a camera's stamps are, found while it runs: the low marker beside the hub, over the last seconds."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.synchronisation import Synchronisation, synchronise

WINDOW_S = 10.0
"""So much of both records is looked at."""
ENOUGH_S = 0.5e-3
"""Standard deviation from which on nothing more is asked [s]."""
_EXPECTED_S = 0.1
_FRAMES = 1000
"""At most so many frames of a window are compared: the estimate must not hold up those that come meanwhile."""


class LatenessWatch:
    """Gathers what hub and low marker do, and says how late the frames' stamps are.

    Parameters
    ----------
    rate_hz : float -- frames a second that the camera should give

    Attributes
    ----------
    late_s, late_sd_s : float -- how late stamps are, and its standard deviation [s]; NaN until the hub has moved
    """

    def __init__(self, rate_hz: float) -> None:
        self._step = max(1, math.ceil(rate_hz * WINDOW_S / _FRAMES))
        self.restart()

    def restart(self) -> None:
        """Forget everything: another camera, or the same one started anew."""
        self.late_s = self.late_sd_s = math.nan
        self._count = 0
        self._hub: deque[tuple[int, float]] = deque()
        self._frames: deque[tuple[int, float]] = deque()

    def add_hub(self, stamp_ns: int, position_m: float) -> None:
        """Take note of where the hub was."""
        self._append(self._hub, stamp_ns, position_m)

    def add_frame(self, stamp_ns: int, low_marker_m: float) -> None:
        """Take note of a frame: middle of the low marker's exposure, and where the marker was; NaN: not seen.

        A frame from before the last one is by another clock: the camera's was set back.
        """
        if self._frames and stamp_ns < self._frames[-1][0]:
            self.restart()
        self._count += 1
        if self._count % self._step == 0:
            self._append(self._frames, stamp_ns, low_marker_m)

    def _append(self, record: deque[tuple[int, float]], stamp_ns: int, value: float) -> None:
        if not math.isfinite(value) or (record and stamp_ns <= record[-1][0]):
            return
        record.append((stamp_ns, value))
        while stamp_ns - record[0][0] > WINDOW_S * 1e9:
            record.popleft()

    def look(self) -> None:
        """Estimate anew, until it is known well enough."""
        if self.late_sd_s <= ENOUGH_S or not self._hub or not self._frames:
            return
        origin_ns = self._hub[0][0]
        (hub_t, hub_x), (t, x) = (
            (np.array([(stamp - origin_ns) * 1e-9 for stamp, _ in record]), np.array([v for _, v in record]))
            for record in (self._hub, self._frames)
        )
        try:
            found = synchronise(hub_t, hub_x, t, x, expected_s=_EXPECTED_S)
        except SynchronisationError:
            return  # the hub rests, or the record is short: the next look sees more
        self._take(found)

    def _take(self, found: Synchronisation) -> None:
        if not found.offset_sd_s >= self.late_sd_s:
            self.late_s, self.late_sd_s = -found.offset_s, found.offset_sd_s
