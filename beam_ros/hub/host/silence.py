"""How long the other side has said nothing, as far as this process could hear."""

from __future__ import annotations

MOST_NS = 50_000_000
"""So much of the time between two looks counts at the most [ns]: who was frozen in it heard nothing."""


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
        self._silent_ns = 0
        self._looked_ns: int | None = None

    def end(self) -> None:
        """Note a word."""
        self.is_connected = True
        self._silent_ns = 0

    def lose(self) -> None:
        """Note that the other side is lost."""
        self.is_connected = False

    def is_too_long(self, now_ns: int) -> bool:
        """Look, at steady time ``now_ns``, whether the other side has said nothing for too long."""
        if self._looked_ns is not None:
            self._silent_ns += min(now_ns - self._looked_ns, MOST_NS)
        self._looked_ns = now_ns
        return self.is_connected and self._silent_ns > self._patience_ns
