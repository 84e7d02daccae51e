"""When a device is greeted: again and again until it answers, and after a pause where it has another host."""

from __future__ import annotations

HELLO_NS = 200_000_000
"""A greeting that was not answered is said again after this time."""
COMPLAINT_NS = 2_000_000_000
"""A greeting that nobody answers for this long is reported."""


class Greeting:
    """The greetings of one line.

    Attributes
    ----------
    next_ns : int
        Before this steady time nothing is said [ns].
    n_unanswered : int
        Greetings without an answer.
    pause_ns : int
        How long the newest lost session was left to another host; 0 without one [ns].
    """

    def __init__(self) -> None:
        self.next_ns = 0
        self.n_unanswered = 0
        self.pause_ns = 0
        self._begun_ns = 0
        self._said_ns: int | None = None

    def begin(self, now_ns: int, wait_ns: int = 0) -> None:
        """Greet from now on, or once a time is over [ns]."""
        self._begun_ns, self.next_ns = now_ns, now_ns + wait_ns
        self._said_ns = None

    @property
    def newest_ns(self) -> int:
        """When the newest one left, or before the first, when greeting began [ns]."""
        return self._begun_ns if self._said_ns is None else self._said_ns

    def leave_to_another(self, longest_ns: int) -> int:
        """Return for how long a device is left to another host [ns]: twice as long as before, up to a bound."""
        self.pause_ns = min(max(HELLO_NS, 2 * self.pause_ns), longest_ns)
        return self.pause_ns

    def is_in_vain(self, now_ns: int) -> bool:
        """Whether nobody has answered for so long that it is to be said."""
        return now_ns - max(self._begun_ns, self.next_ns) > COMPLAINT_NS

    def is_due(self, now_ns: int) -> bool:
        """Return whether the device is to be greeted now; then it counts as greeted."""
        if now_ns < self.next_ns or (self._said_ns is not None and now_ns - self._said_ns < HELLO_NS):
            return False
        self._said_ns = now_ns
        self.n_unanswered += 1
        return True
