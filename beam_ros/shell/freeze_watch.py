"""Was this process frozen, and was a request sent before it woke?

What was asked while the process did not come round (stopped, suspended, or kept busy by something else) lies in a
queue when it does, and would move the axis long after somebody wanted it. The executor's steady timer shows the gap.
It may be called before the requests that waited or after them, and the middleware may deliver them seconds later
still, when it repeats what nobody acknowledged: so the gap is looked for at every beat and at every request, and the
time at which a request was sent decides: one that waited longer than the limit of a freeze is stale. Clocks that are
not quite ours are covered by a moment after the gap, in which nothing that moves the axis is taken.
"""

from __future__ import annotations

from beam_ros.hub.contract import ASK_AGAIN

BEAT_NS = 50_000_000
"""The executor comes round at least so often while nothing keeps it [ns]."""
WAKING_NS = 500_000_000
"""What comes so soon after a freeze may have been asked during it, by a clock ahead of ours; at most as long after it
as it outlasted the limit, for what is hidden so is no older."""


class FreezeWatch:
    """Notices that the process was frozen.

    Parameters
    ----------
    frozen_ns : int
        A process that has not come round for so long was frozen [ns]. For a hub that is its watchdog's time: the axis
        has stopped meanwhile, and what was asked before was for a motion that is over. At least two beats: one may
        be late by another.
    """

    def __init__(self, frozen_ns: int) -> None:
        self._frozen_ns = max(frozen_ns, 2 * BEAT_NS)
        self._beat_ns: int | None = None
        self._gap_ns = 0
        self._woke_ns = 0

    def beat(self, now_ns: int) -> None:
        """Note that the executor comes round at steady time ``now_ns``; at least every ``BEAT_NS``."""
        if self._beat_ns is not None and now_ns - self._beat_ns > self._frozen_ns:
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
        if not self._gap_ns:
            return None
        if sent_ns <= self._woke_ns:
            is_old = now_ns - sent_ns > self._frozen_ns
        else:
            is_old = now_ns - self._woke_ns <= min(WAKING_NS, self._gap_ns - self._frozen_ns)
        return f"was frozen for {self._gap_ns * 1e-9:.2f} s; {ASK_AGAIN}" if is_old else None
