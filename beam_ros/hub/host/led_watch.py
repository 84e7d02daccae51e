"""Whether a hub that the host leads is where it was led."""

from __future__ import annotations

from collections import deque

LAG_NS = 150_000_000
"""A drive may be this much behind its commands, and a measurement behind the hub [ns]."""


class LedWatch:
    """Compares where the hub is with where it was led within the time by which a drive may lag.

    Parameters
    ----------
    max_following_error : float
        Greatest distance from there [m].
    """

    def __init__(self, max_following_error: float) -> None:
        self._most = max_following_error
        self._led: deque[tuple[int, float]] = deque()

    def forget(self) -> None:
        """Begin anew: the hub is not led, or from elsewhere."""
        self._led.clear()

    def find(self, now_ns: int, led: float, position: float) -> tuple[str, str] | None:
        """Return the fault and what was seen, or None.

        Parameters
        ----------
        now_ns : int
            Steady time [ns].
        led, position : float
            Where the hub is to be now, and where it was measured last [m].
        """
        self._led.append((now_ns, led))
        while now_ns - self._led[0][0] > LAG_NS:
            self._led.popleft()
        ways = [way for _, way in self._led]
        astray = max(min(ways) - position, position - max(ways))
        if astray <= self._most:
            return None
        return (
            "motion_unexplained",
            f"the hub is {astray * 1e3:.2f} mm from where it was led: expected at most {self._most * 1e3:g} mm "
            "(hub.max_following_error)",
        )
