"""Whether the stamps of somebody else's samples can be true: they increase, and none comes before its time.

A sample may come late, by whatever line and computer take. A stamp that is behind the one before it, or that is less
old than any clock's drift explains, is left out. Where several in a row agree with each other and not with what was
known, the clock has jumped: that is a fault, and the stamps count from there on.
"""

from __future__ import annotations

from collections.abc import Callable

from beam_ros.hub.host.sample_stamping import AGREEING

EARLY_NS = 500_000_000
"""A sample that is less old by this than the least old of late is ahead of its time [ns]."""
DRIFT = 1e-3
"""The least age grows by this share of the time that passes: no clock drifts more."""


class StampWatch:
    """Follows the stamps of one source.

    Parameters
    ----------
    report : callable
        Takes the name of a fault and what was seen: that the stamps jumped or ran backwards.

    Attributes
    ----------
    n_jumps : int
        How often the stamps began to count from elsewhere.
    """

    def __init__(self, report: Callable[[str, str], None]) -> None:
        self._report = report
        self.n_jumps = 0
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._last_ns: int | None = None
        self._came_ns = self._age_ns = 0
        self._n_agreeing = 0
        self._other_ns = self._n_other = 0

    def is_credible(self, stamp_ns: int, came_ns: int) -> bool:
        """Say whether a sample can have been taken then.

        Parameters
        ----------
        stamp_ns, came_ns : int
            What it says, by its own clock, and when it came, by the host's [ns].
        """
        age_ns, last_ns = came_ns - stamp_ns, self._last_ns
        least_ns = self._age_ns + round(DRIFT * max(0, came_ns - self._came_ns))
        if last_ns is None:
            least_ns = age_ns
        elif stamp_ns == last_ns:
            return False  # The same sample again.
        elif stamp_ns < last_ns or age_ns < least_ns - EARLY_NS:
            is_next = self._n_other > 0 and 0 < stamp_ns - self._other_ns < EARLY_NS
            self._n_other = self._n_other + 1 if is_next else 1
            self._other_ns = stamp_ns
            if self._n_other < AGREEING:
                return False
            if self._n_agreeing >= AGREEING:
                self._report(
                    "clock_backwards" if stamp_ns < last_ns else "clock_jumped",
                    f"the stamps are {age_ns * 1e-9:.3f} s old where about {least_ns * 1e-9:.3f} s were expected",
                )
            least_ns = age_ns
            self._n_agreeing = self._n_other
            self.n_jumps += 1
        self._last_ns, self._came_ns, self._age_ns = stamp_ns, came_ns, min(age_ns, least_ns)
        self._n_agreeing += 1
        self._n_other = 0
        return True
