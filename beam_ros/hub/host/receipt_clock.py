"""A clock that only its readings' receipt betrays: nobody can be asked, so no round trip bounds the delay.

Every reading comes late, by the time that transport and scheduling take. Of some readings in a row the least delayed
one is kept, and a straight line goes through these (``ClockMapping``). What all readings share, the shortest delay,
stays in the stamps as a constant, and ends in the latency that identification estimates.
"""

from __future__ import annotations

from collections.abc import Callable

from beam_ros.hub.clock_mapping import ClockMapping
from beam_ros.hub.host.stamp_watch import StampWatch

GROUP_NS = 100_000_000
"""Of the readings of so long a time the least delayed one counts [ns of device time]."""
WRAP_NS = 1_000_000_000
"""A counter that has wrapped has gone on by as much as the host's clock and this at most [ns]."""


class ReceiptClock:
    """The map from a device's clock to steady time, regressed from receipt times.

    Parameters
    ----------
    tick_ns : float
        Length of one unit of the counter [ns].
    modulus : int
        Readings at which a counter wraps, 0 where it never does.
    report : callable
        Takes the name of a fault and what was seen: that the counter jumped or ran backwards; a new epoch begins.
    """

    def __init__(self, tick_ns: float, modulus: int, report: Callable[[str, str], None]) -> None:
        self._watch = StampWatch(report)
        self._tick_ns = tick_ns
        self._modulus = modulus
        self._epoch = 1
        self._mapping = ClockMapping(1)
        self._turns = 0
        self._last: tuple[int, int] | None = None
        self._group_ns = 0
        self._least: tuple[int, int] | None = None
        self._least_delay_ns = 0

    @property
    def epoch(self) -> int:
        """Counts the clock's beginnings."""
        return self._epoch

    @property
    def is_usable(self) -> bool:
        """Whether enough readings have come to map anything."""
        return self._mapping.is_usable

    def add(self, reading: int, received_ns: int) -> int | None:
        """Take a reading of the counter with the steady time at which it came [ns].

        Returns
        -------
        int or None
            Device time [ns]; None where the reading cannot be true.
        """
        device_ns, turns = self._unwrapped_ns(reading, received_ns)
        n_jumps = self._watch.n_jumps
        if not self._watch.is_credible(device_ns, received_ns):
            return None
        self._turns = turns
        if self._watch.n_jumps != n_jumps:
            self._epoch += 1
            self._mapping = ClockMapping(self._epoch)
            self._least = None
        self._last = device_ns, received_ns
        delay_ns = received_ns - device_ns
        if self._least is None:
            self._group_ns = device_ns
        if self._least is None or delay_ns < self._least_delay_ns:
            self._least, self._least_delay_ns = (device_ns, received_ns), delay_ns
        if device_ns - self._group_ns >= GROUP_NS:
            self._mapping.add(self._least[1], self._least[1], self._least[0])
            self._least = None
        return device_ns

    def host_ns(self, device_ns: int) -> int:
        """Return the steady time [ns] of a device time [ns]; to be asked in increasing order."""
        return self._mapping.host_ns(device_ns)

    def _unwrapped_ns(self, reading: int, received_ns: int) -> tuple[int, int]:
        """Return what a reading means [ns], and how often the counter has wrapped by then."""
        device_ns = self._ns(reading, self._turns)
        if self._last is not None and self._modulus and device_ns < self._last[0]:
            wrapped_ns = self._ns(reading, self._turns + 1)
            if wrapped_ns - self._last[0] <= received_ns - self._last[1] + WRAP_NS:
                return wrapped_ns, self._turns + 1
        return device_ns, self._turns

    def _ns(self, reading: int, turns: int) -> int:
        return round((reading + turns * self._modulus) * self._tick_ns)
