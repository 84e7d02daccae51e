"""Was this process frozen, and was a request sent before it woke?

What was asked while the process did not come round (stopped, suspended, or kept busy by something else) lies in a
queue when it does, and would move the axis long after somebody wanted it. The executor's steady timer shows the gap.
It may be called before the requests that waited or after them, and the middleware may deliver them seconds later
still, when it repeats what nobody acknowledged: so the gap is looked for at every beat and at every request, and the
time at which a request was sent decides. Whose clock is not quite ours is covered by a moment after the gap, in which
nothing that moves the axis is taken.
"""

from __future__ import annotations

FROZEN_NS = 1_000_000_000
"""A process that has not come round for so long was frozen; a request that waited less is answered."""
WAKING_NS = 500_000_000
"""What comes so soon after a freeze may have been asked during it."""


class FreezeWatch:
    """Notices that the process was frozen."""

    def __init__(self) -> None:
        self._beat_ns: int | None = None
        self._gap_ns = 0
        self._woke_ns = 0

    def beat(self, now_ns: int) -> None:
        """Note that the executor comes round at steady time ``now_ns``; at least every 50 ms."""
        if self._beat_ns is not None and now_ns - self._beat_ns > FROZEN_NS:
            self._gap_ns, self._woke_ns = now_ns - self._beat_ns, now_ns
        self._beat_ns = now_ns

    def objection(self, now_ns: int, sent_ns: int) -> str | None:
        """Return why a request may be an old one, or None.

        Parameters
        ----------
        now_ns, sent_ns : int
            Steady times at which it is taken up and was sent [ns].
        """
        self.beat(now_ns)
        if self._gap_ns and (sent_ns <= self._woke_ns or now_ns - self._woke_ns <= WAKING_NS):
            return f"was frozen for {self._gap_ns * 1e-9:.1f} s; ask again"
        return None
