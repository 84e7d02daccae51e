"""How long the other side has said nothing, as far as this process could hear."""

from __future__ import annotations

from beam_ros.hub.host.waking_time import WakingTime


class Silence:
    """The time since the last word; who looks often enough sees it grow with the clock.

    Parameters
    ----------
    patience_ns : int
        The other side is lost after so long a silence [ns].

    Attributes
    ----------
    is_connected : bool
        Whether a word came since the other side was lost.
    """

    def __init__(self, patience_ns: int) -> None:
        self.is_connected = False
        self._patience_ns = patience_ns
        self._waking = WakingTime()
        self._heard_ns = 0

    def end(self) -> None:
        """Note a word."""
        self.is_connected = True
        self._heard_ns = self._waking.ns

    def lose(self) -> None:
        """Note that the other side is lost."""
        self.is_connected = False

    def is_too_long(self, now_ns: int) -> bool:
        """Look, at steady time ``now_ns``, whether the other side has said nothing for too long."""
        silent_ns = self._waking.look(now_ns) - self._heard_ns
        return self.is_connected and silent_ns > self._patience_ns
