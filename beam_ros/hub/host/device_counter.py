"""A counter of device time that may be narrow: its wraps are taken out, so that it goes on for ever.

Many microcontrollers count nanoseconds, microseconds or ticks in 32 bits. Such a counter starts again at 0 after
4.3 s, 72 minutes or 50 days. That is told from a restart and from a jump by what the counter must show about now:
a wrap is off by exactly its width.
"""

from __future__ import annotations

from collections.abc import Sequence

WRAPS_NS = ((1 << 32) * 1_000_000, (1 << 32) * 1_000, 1 << 32)
"""Widths of 32-bit counters of milliseconds, microseconds and nanoseconds [ns]; of two that fit, the first counts."""
CERTAIN = 32
"""A wrap is believed where what is possible is narrower than its width by this factor."""


class DeviceCounter:
    """One counter of the device, extended.

    Parameters
    ----------
    wraps_ns : sequence of int
        Widths that it may have [ns]; which one it has shows at the first wrap.

    Attributes
    ----------
    width_ns : int or None
        Its width [ns], None while it has not wrapped.
    """

    def __init__(self, wraps_ns: Sequence[int] = WRAPS_NS) -> None:
        self.width_ns: int | None = None
        self._wraps_ns = tuple(wraps_ns)
        self._offset_ns = 0

    def extended_ns(self, shown_ns: int) -> int:
        """Return what a reading [ns] means if the counter has not wrapped since the last one."""
        return shown_ns + self._offset_ns

    def shown_ns(self, extended_ns: int) -> int:
        """Return what the device itself calls an extended time [ns]."""
        return extended_ns if self.width_ns is None else extended_ns % self.width_ns

    def read(
        self, shown_ns: int, least_ns: int, greatest_ns: int, *, may_be_ahead: bool = False
    ) -> int | None:
        """Extend a reading.

        Parameters
        ----------
        shown_ns : int
            What the counter shows [ns].
        least_ns, greatest_ns : int
            Between what the extended time must lie [ns].
        may_be_ahead : bool, optional
            Whether it is the other counter, by which it is judged, that may have wrapped.

        Returns
        -------
        int or None
            The extended time [ns]; None where no number of wraps makes it possible.
        """
        plain_ns = self.extended_ns(shown_ns)
        if least_ns <= plain_ns <= greatest_ns:
            return plain_ns
        for width_ns in self._wraps_ns if self.width_ns is None else (self.width_ns,):
            n_wraps = (greatest_ns - plain_ns) // width_ns
            is_certain = (greatest_ns - least_ns) * CERTAIN < width_ns
            is_wrap = n_wraps > 0 and shown_ns < width_ns
            if is_certain and (is_wrap or may_be_ahead) and plain_ns + n_wraps * width_ns >= least_ns:
                if is_wrap:
                    self.width_ns = width_ns
                self._offset_ns += n_wraps * width_ns
                return self.extended_ns(shown_ns)
        return None

    def shift(self, by_ns: int) -> None:
        """Let all readings from the last one on mean a time that is later by so much [ns]."""
        self._offset_ns += by_ns
