"""A clock that only its readings' receipt betrays: nobody can be asked, so no round trip bounds the delay.

Every reading comes late, by the time that transport and scheduling take. Of some readings in a row the least delayed
one is kept, and a straight line goes through these (``ClockMapping``). What all readings share, the shortest delay,
stays in the stamps as a constant, and ends in the latency that identification estimates.
"""

from __future__ import annotations

from beam_ros.hub.clock_mapping import ClockMapping

GROUP_NS = 100_000_000
"""Of the readings of so long a time the least delayed one counts [ns of device time]."""
RESTART_NS = 1_000_000_000
"""A clock that steps back or ahead by more than this against the host's has begun anew [ns]."""


class ReceiptClock:
    """The map from a device's clock to steady time, regressed from receipt times.

    Parameters
    ----------
    modulus : int
        Readings at which a counter wraps, 0 where it never does.
    tick_ns : float
        Length of one unit of the counter [ns].
    """

    def __init__(self, tick_ns: float, modulus: int = 0) -> None:
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

    def add(self, reading: int, received_ns: int) -> int:
        """Take a reading of the counter with the steady time at which it came [ns]; return device time [ns]."""
        device_ns = self._unwrapped_ns(reading, received_ns)
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

    def _unwrapped_ns(self, reading: int, received_ns: int) -> int:
        device_ns = self._ns(reading)
        if self._last is None:
            return device_ns
        last_ns, last_received_ns = self._last
        if self._modulus and device_ns < last_ns:
            wrapped_ns = self._ns(reading + self._modulus)
            if abs((wrapped_ns - last_ns) - (received_ns - last_received_ns)) < RESTART_NS:
                self._turns += 1
                return wrapped_ns
        if abs((device_ns - last_ns) - (received_ns - last_received_ns)) > RESTART_NS:
            self._epoch += 1
            self._mapping = ClockMapping(self._epoch)
            self._turns = 0
            self._least = None
            return self._ns(reading)
        return device_ns

    def _ns(self, reading: int) -> int:
        return round((reading + self._turns * self._modulus) * self._tick_ns)
