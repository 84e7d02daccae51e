"""What the lines of a board say: where the hub was, and when, by the board's clock or by the time of receipt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from beam_ros.hub.host.receipt_clock import ReceiptClock
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_lines import CsvReader


@dataclass(frozen=True)
class CsvMeasurement:
    """One line.

    Parameters
    ----------
    n_numbers : int
        How many it had.
    position : float
        [m].
    velocity, effort : float or None
        [m/s], [N]; None where the board prints none.
    steady_ns : int or None
        When, by the host's steady time [ns]; None where the line has no time that can be believed.
    epoch : int
        Counts the beginnings of the board's clock.
    """

    n_numbers: int
    position: float
    velocity: float | None
    effort: float | None
    steady_ns: int | None
    epoch: int


class CsvMeasurements:
    """Lines in, measurements with times out.

    Parameters
    ----------
    columns : CsvColumns
        What the lines mean.
    report : callable
        Takes the name of a fault of the board's clock, and what was seen.

    Attributes
    ----------
    n_unstamped : int
        Lines without a time that can be believed.
    """

    def __init__(self, columns: CsvColumns, report: Callable[[str, str], None]) -> None:
        self.n_unstamped = 0
        self._columns = columns
        self._report = report
        self._reader = CsvReader()
        self._device_clock = self._new_clock()
        self._last_ns = 0
        self._n_bad_before = 0

    @property
    def has_clock(self) -> bool:
        """Whether the board prints a clock."""
        return bool(self._columns.clock)

    @property
    def n_columns(self) -> int:
        """How many numbers a line must have."""
        return self._columns.last

    @property
    def n_bad(self) -> int:
        """Lines that were no rows."""
        return self._reader.n_bad

    @property
    def n_bad_in_a_row(self) -> int:
        """Those since the last one that was."""
        return self._reader.n_bad - self._n_bad_before

    @property
    def bad_line(self) -> bytes:
        """The newest of them."""
        return self._reader.bad_line

    def reset(self) -> None:
        """Forget what came before: the port was opened anew."""
        self._reader.reset()
        self._n_bad_before = self._reader.n_bad
        self._device_clock = self._new_clock()

    def feed(self, data: bytes, came_ns: int) -> Iterator[CsvMeasurement]:
        """Take bytes that came at a steady time [ns]; yield the measurements that they complete."""
        for row in self._reader.feed(data):
            if len(row) < self._columns.last:
                self._reader.reject(",".join(f"{number:g}" for number in row).encode())
                continue
            self._n_bad_before = self._reader.n_bad
            yield self._measurement(row, came_ns)

    def _measurement(self, row: tuple[float, ...], came_ns: int) -> CsvMeasurement:
        columns = self._columns
        position = row[columns.position - 1] * columns.position_scale
        velocity = row[columns.velocity - 1] * columns.position_scale if columns.velocity else None
        effort = row[columns.effort - 1] * columns.effort_scale if columns.effort else None
        steady_ns = self._steady_ns(row, came_ns)
        if steady_ns is None or steady_ns <= self._last_ns:
            self.n_unstamped += 1
            steady_ns = None
        else:
            self._last_ns = steady_ns
        return CsvMeasurement(len(row), position, velocity, effort, steady_ns, self._device_clock.epoch)

    def _new_clock(self) -> ReceiptClock:
        columns = self._columns
        modulus = 1 << columns.clock_bits if columns.clock_bits else 0
        return ReceiptClock(columns.clock_tick * 1e9, modulus, self._report)

    def _steady_ns(self, row: tuple[float, ...], came_ns: int) -> int | None:
        if not self.has_clock:
            return came_ns
        device_ns = self._device_clock.add(round(row[self._columns.clock - 1]), came_ns)
        if device_ns is None or not self._device_clock.is_usable:
            return None
        return self._device_clock.host_ns(device_ns)
