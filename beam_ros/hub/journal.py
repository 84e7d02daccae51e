"""What a hub has to say for the log, and its counters for the diagnostics."""

from __future__ import annotations

from collections.abc import Iterable

from beam_ros.hub.contract import EventLevel, HostTime, HubEvent
from beam_ros.hub.host_clock import HostClock


class Journal:
    """Lines for the log since the last poll, and counters since the start.

    Parameters
    ----------
    counters : iterable of str
        Names of the counters, which begin at 0.

    Attributes
    ----------
    counters : dict of str to int
        What was lost, refused, retried.
    """

    def __init__(self, counters: Iterable[str]) -> None:
        self.counters = dict.fromkeys((*counters, "setpoints_refused", "real_time_jumps"), 0)
        self._events: list[HubEvent] = []

    def tell(self, level: EventLevel, text: str) -> None:
        """Add a line."""
        self._events.append(HubEvent(level, text))

    def add(self, event: HubEvent | None) -> None:
        """Add a line, if it is one."""
        if event is not None:
            self._events.append(event)

    def watch_clock(self, clock: HostClock, now: HostTime) -> None:
        """Report a jump of the computer's real-time clock."""
        jump_ns = clock.jump_ns(now)
        if jump_ns is not None:
            self.counters["real_time_jumps"] += 1
            self.tell(
                "error",
                f"the computer's real-time clock jumped by {jump_ns * 1e-9:.3f} s; stamps keep the old time: "
                "discard this recording and start the rig anew",
            )

    def take_events(self) -> list[HubEvent]:
        """Return the lines since the last call."""
        events, self._events = self._events, []
        return events
