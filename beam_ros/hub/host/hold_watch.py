"""Whether a hub that is held stays where it is, however slowly it leaves."""

from __future__ import annotations

from collections import deque

import numpy as np

from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

_REMEMBERED = 64
"""Batches that wait for a status, at most."""


class HoldWatch:
    """Compares where the hub is with where its hold began.

    A batch counts as held when a status that is not older says so, and nothing was applied: on a line that loses
    messages, the word of a motion may be lost.

    Parameters
    ----------
    parameters : AxisParameters
        Command mode, encoder, and the greatest following error.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self._is_watched = parameters.command_mode in ("acceleration", "velocity")
        self._resolution = parameters.encoder_resolution
        self._most = parameters.max_following_error
        self._waiting: deque[tuple[int, int, int]] = deque(maxlen=_REMEMBERED)
        self._held: int | None = None

    def forget(self) -> None:
        """Take the next ticks for the beginning of a hold."""
        self._waiting.clear()
        self._held = None

    def add(self, ticks: TickBatch, lost: int) -> None:
        """Take ticks, and how many were lost before them."""
        if lost or not self._is_watched or np.any(ticks.applied != 0.0):
            self.forget()
            return
        counts = ticks.position_counts
        self._waiting.append((ticks.end_tick, int(np.min(counts)), int(np.max(counts))))

    def find(self, tick: int) -> tuple[str, str] | None:
        """Return the fault of ticks before one at which the device says that it holds the hub, and what was seen."""
        while self._waiting and self._waiting[0][0] <= tick:
            _, least, most = self._waiting.popleft()
            if self._held is None:
                self._held = (least + most) // 2
            way = self._resolution * max(most - self._held, self._held - least)
            if way > self._most + 2 * self._resolution:
                return (
                    "motion_unexplained",
                    f"the hub is {1e3 * way:.2f} mm from where it is held: expected at most {1e3 * self._most:g} mm "
                    "(hub.max_following_error)",
                )
        return None
