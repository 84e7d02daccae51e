"""The host's clocks: the steady one that times everything, and the real-time offset that names instants.

Stamps are steady time plus an offset that is taken once and then kept, so that they never step. If the
computer's real-time clock jumps while the rig runs, stamps of other programs no longer agree with ours:
that is reported, never followed.
"""

from __future__ import annotations

from beam_ros.hub.contract import HostTime

JUMP_NS = 10_000_000
"""A change of the real-time offset beyond this is a jump; reading two clocks costs far less."""


class HostClock:
    """Turns readings of the host's clocks into stamps.

    Parameters
    ----------
    start : HostTime
        The reading that fixes the offset.
    real_time_factor : float
        Seconds of stamps per second of steady time, for a simulator that runs slower or faster.
    """

    def __init__(self, start: HostTime, real_time_factor: float = 1.0) -> None:
        self._start = start
        self._factor = real_time_factor
        self._offset_ns = start.unix_ns - start.steady_ns
        self._suspect_ns: int | None = None

    def stamp_ns(self, steady_ns: int) -> int:
        """Return the stamp [ns, UNIX] of an instant of steady time."""
        elapsed_ns = steady_ns - self._start.steady_ns
        if self._factor != 1.0:
            elapsed_ns = round(elapsed_ns * self._factor)
        return self._start.unix_ns + elapsed_ns

    def steady_ns(self, stamp_ns: int) -> int:
        """Return the steady time [ns] that a stamp names."""
        elapsed_ns = stamp_ns - self._start.unix_ns
        if self._factor != 1.0:
            elapsed_ns = round(elapsed_ns / self._factor)
        return self._start.steady_ns + elapsed_ns

    def jump_ns(self, now: HostTime) -> int | None:
        """Return by how much the real-time clock has jumped, once for each jump, or None.

        Two readings in a row must agree on it: between the two clocks of one reading the process may have
        been put aside for a while.
        """
        offset_ns = now.unix_ns - now.steady_ns
        jump_ns = offset_ns - self._offset_ns
        if abs(jump_ns) <= JUMP_NS:
            self._suspect_ns = None
            return None
        if self._suspect_ns is None or abs(offset_ns - self._suspect_ns) > JUMP_NS:
            self._suspect_ns = offset_ns
            return None
        self._suspect_ns = None
        self._offset_ns = offset_ns
        return jump_ns
