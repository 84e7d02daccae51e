"""Whether a device's ticks keep up with its clock: a tick that was missed and not counted makes later stamps late."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

WINDOW_NS = 1_000_000_000
"""The least age of samples is taken over so long: a busy computer lets some wait, never all."""
LATE_NS = 1_000_000
"""What ticks may be late beyond what the line explains [ns]: stamps that are wrong by more spoil an experiment."""
_WINDOWS = 2
"""So many windows in a row are believed."""
_TRIPS = 64
"""Round trips that say what the line can explain: of the last 13 s."""


class TickWatch:
    """Compares how old samples are when they come with what round trips on the same line take.

    A line that lets samples wait (a full buffer, a port that is polled) lets the answers of the clock wait, too. So
    an age that has grown by more than round trips differ is no line's: the ticks have another rate than their clock.

    Parameters
    ----------
    report : callable
        Takes the name of a fault and what was seen.
    """

    def __init__(self, report: Callable[[str, str], None]) -> None:
        self._report = report
        self.restart()

    def restart(self) -> None:
        """Begin anew: with a connection, or with another clock."""
        self._trips_ns: deque[int] = deque(maxlen=_TRIPS)
        self._least_trip_ns: int | None = None
        self._least_age_ns: int | None = None
        self._age_ns: int | None = None
        self._since_ns: int | None = None
        self._n_wrong = 0

    def take_trip(self, round_trip_ns: int) -> None:
        """Take how long a question and its answer were on the line [ns]."""
        self._trips_ns.append(round_trip_ns)
        least_ns = self._least_trip_ns
        self._least_trip_ns = round_trip_ns if least_ns is None else min(least_ns, round_trip_ns)

    def take_age(self, age_ns: int, now_ns: int) -> None:
        """Take how long before now the newest tick ended, by a clock that is known well enough [ns]."""
        if self._since_ns is None:
            self._since_ns = now_ns
        self._age_ns = age_ns if self._age_ns is None else min(self._age_ns, age_ns)
        if now_ns - self._since_ns < WINDOW_NS or self._least_trip_ns is None:
            return
        age_ns, self._age_ns, self._since_ns = self._age_ns, None, now_ns
        self._least_age_ns = age_ns if self._least_age_ns is None else min(self._least_age_ns, age_ns)
        explained_ns = max(self._trips_ns) - self._least_trip_ns
        late_ns = age_ns - self._least_age_ns - explained_ns
        early_ns = -age_ns - self._least_trip_ns - explained_ns
        self._n_wrong = self._n_wrong + 1 if max(late_ns, early_ns) > LATE_NS else 0
        if self._n_wrong >= _WINDOWS:
            where = "behind" if late_ns > early_ns else "ahead of"
            self._report(
                "clock_jumped",
                f"the ticks are {max(late_ns, early_ns) * 1e-6:.1f} ms {where} the controller's clock, beyond the "
                f"{explained_ns * 1e-6:.1f} ms that the line explains: expected at most {LATE_NS * 1e-6:g} ms; ticks "
                "are missed, or counted wrong",
            )
