"""The time in which this process was awake: who was put aside heard nothing, and waited for nothing."""

from __future__ import annotations

MOST_NS = 50_000_000
"""So much of the time between two looks counts at the most [ns]: several turns of every loop here."""


class WakingTime:
    """Steady time without the time in which nobody looked.

    Attributes
    ----------
    ns : int
        How long this process has been awake [ns].
    """

    def __init__(self) -> None:
        self.ns = 0
        self._looked_ns: int | None = None

    def look(self, now_ns: int) -> int:
        """Take the steady time [ns]; return how long this process has been awake [ns]."""
        if self._looked_ns is not None:
            self.ns += min(max(0, now_ns - self._looked_ns), MOST_NS)
        self._looked_ns = now_ns
        return self.ns
