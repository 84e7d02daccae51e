"""The last seconds of a signal, of which every reader of the page receives what is new to it.

A reader says up to which row it has the trace, and receives those behind it. One that falls so far behind that
these rows are gone receives the whole trace anew: nothing waits for a slow reader.
"""

from __future__ import annotations

from collections import deque
from typing import Any


class Trace:
    """Rows of numbers, the newest at the end.

    Parameters
    ----------
    seconds : float -- so much is kept, by the rows' first number [s]
    epoch : int -- the first one
    min_step_s : float -- a row that comes sooner after the last one is left out [s]

    Attributes
    ----------
    epoch : int -- rises whenever the trace begins anew
    total : int -- rows that there were in this epoch
    """

    def __init__(self, seconds: float, epoch: int = 0, min_step_s: float = 0.0035) -> None:
        self._seconds, self._min_step_s = seconds, min_step_s
        self._times: deque[float] = deque()
        self._rows: deque[tuple[float | None, ...]] = deque()
        self.epoch, self.total = epoch, 0

    def clear(self) -> None:
        """Begin anew."""
        self._times.clear()
        self._rows.clear()
        self.epoch, self.total = self.epoch + 1, 0

    def add(self, at_s: float, *values: float | None) -> None:
        """Add a row, unless it comes too soon after the last one."""
        if self._times and at_s - self._times[-1] < self._min_step_s:
            return
        self._times.append(at_s)
        self._rows.append((at_s, *values))
        self.total += 1
        while self._times[0] < at_s - self._seconds:
            self._times.popleft()
            self._rows.popleft()

    def since(self, epoch: int, total: int) -> dict[str, Any]:
        """Return what somebody lacks who has so many rows of an epoch.

        Returns
        -------
        dict -- ``anew``: forget what you have; ``rows``
        """
        first = self.total - len(self._rows)
        is_anew = epoch != self.epoch or not first <= total <= self.total
        skipped = 0 if is_anew else total - first
        rows = list(self._rows)[skipped:]
        return {"anew": is_anew, "rows": rows}
