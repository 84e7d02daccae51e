"""Whether this host may speak: a process whose executor is frozen must fall silent, so that the device stops."""

from __future__ import annotations

HOST_ALIVE_NS = 200_000_000
"""Nothing is said when the last poll is older than this."""
HEARTBEAT_NS = 50_000_000
"""Where nothing else was said for so long, a sign of life is due."""


class HostPulse:
    """The executor's own heartbeat.

    Attributes
    ----------
    talking_since_ns : int or None
        Steady time from which on the host has been speaking [ns]; None while it is silent.
    is_closing : bool
        From now on polls are not needed for the host to speak.
    """

    def __init__(self) -> None:
        self.talking_since_ns: int | None = None
        self.is_closing = False
        self._polled_ns: int | None = None
        self._last_sent_ns = 0

    def beat(self, now_ns: int) -> None:
        """Note that the executor has come round."""
        self._polled_ns = now_ns

    def may_speak(self, now_ns: int, *, is_line_open: bool) -> bool:
        """Say whether the host is alive and there is a line to speak on."""
        is_alive = self.is_closing or (
            self._polled_ns is not None and now_ns - self._polled_ns <= HOST_ALIVE_NS
        )
        if not (is_alive and is_line_open):
            self.talking_since_ns = None
            return False
        if self.talking_since_ns is None:
            self.talking_since_ns = now_ns
        return True

    def is_heartbeat_due(self, now_ns: int) -> bool:
        """Say whether nothing has been sent for so long that a sign of life is due."""
        return now_ns - self._last_sent_ns >= HEARTBEAT_NS

    def note_sent(self, now_ns: int) -> None:
        """Note that something was sent."""
        self._last_sent_ns = now_ns
