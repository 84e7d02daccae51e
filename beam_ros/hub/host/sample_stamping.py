"""From the device's ticks to stamped batches: the device's clock is asked, mapped, and put on every sample.

What the device says of time is believed where it can be true. One absurd answer or tick is left out and counted;
where several in a row agree with each other and not with what was known, the clock has jumped: that is reported
as a fault, and a new map begins.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from beam_ros.hub.clock_mapping import ClockMapping
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.hub.host.device_counter import WRAPS_NS, DeviceCounter
from beam_ros.hub.host.tick_watch import TickWatch
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch, sample_batches

FAST_CLOCK_NS = 10_000_000
FAST_CLOCK_PHASE_NS = 1_000_000_000
SLOW_CLOCK_NS = 200_000_000
URGENT_CLOCK_NS = 40_000_000
"""Intervals of clock queries: just after connecting, later, and later while the map is not good enough."""
SETTLING_NS = 500_000_000
"""Samples are stamped from this long after connecting on, if the map is then known to half of the gate ..."""
STAMPING_PATIENCE_NS = 2_000_000_000
"""... or from this long after connecting on, if it is not: what is stamped once is only slewed from then on."""
MAX_OPEN_QUERIES = 100
AGREEING = 3
"""So many readings in a row that agree are believed against what was known before."""
DISAGREEING = 20
"""So many strange answers, of which no three agree, come from no clock."""
AHEAD_NS = 20_000_000
"""Ticks cannot lie further ahead of the map than this, which is for resolution [ns], and ..."""
SURE = 2.0
"""... than so many of its standard deviations: a constant within half the round trip is at most 1.73 of its own."""
CONNECTION_NS = 800_000_000
"""The first ticks of a connection are not older than this, and than the connection, when they come [ns] ..."""
LIVE_NS = 100_000_000
"""Where ticks and clock differ by a wrap, the ticks are taken for as old as this at most [ns]."""
LATE_NS = 5_000_000_000
"""... and later ones not older than this, and than what this process slept: buffers hold about 3 s."""

Report = Callable[[str, str], None]
"""Takes the name of a fault and what was seen."""


class DeviceClock:
    """The device's clock, as the host knows it from questions and answers.

    Parameters
    ----------
    max_sd_ns : int
        Standard deviation of the map above which it is not good enough [ns].
    report : callable
        Is told that the clock jumped or ran backwards.

    Attributes
    ----------
    mapping : ClockMapping
        From device time to steady time, for the device's present start.
    ticks : TickWatch
        Whether the ticks keep up with this clock.
    connected_ns : int
        Steady time of the greeting that began the connection [ns], or of the clock's last jump.
    """

    def __init__(self, max_sd_ns: int, report: Report) -> None:
        self.max_sd_ns = max_sd_ns
        self.mapping = ClockMapping(0)
        self.ticks = TickWatch(report)
        self.connected_ns = 0
        self._report = report
        self._counter = DeviceCounter()
        self._n_agreeing = 0
        self._other: ClockMapping | None = None
        """What strange answers agree on, since the last one that was believed."""
        self._n_strange = self._n_strange_ever = 0
        self._sent: dict[int, int] = {}
        self._number = 0
        self._last_query_ns = 0
        self._interval_ns = URGENT_CLOCK_NS
        self._syncs: list[ClockSync] = []

    def connect(self, greeted_ns: int, *, is_new_boot: bool) -> None:
        """Begin a connection with its greeting [ns]; the map goes on where the device has not restarted."""
        self.connected_ns = greeted_ns
        self.ticks.restart()
        self._sent.clear()
        # In a long pause a narrow counter may have wrapped more often than can be told.
        self._n_agreeing = self._n_strange = 0
        self._other = None
        if is_new_boot:
            self.mapping = ClockMapping(self.mapping.epoch + 1)
            self._counter = DeviceCounter()

    def sd_ns(self, now_ns: int) -> float:
        """Return the standard deviation [ns] of the map now."""
        return self.mapping.standard_deviation_ns(self.mapping.device_ns(now_ns))

    def device_says_ns(self, steady_ns: int) -> int:
        """Return what the device's own counter reads [ns] at a steady time [ns]."""
        return self._counter.shown_ns(max(0, self.mapping.device_ns(steady_ns)))

    def is_new(self, now_ns: int) -> bool:
        """Whether the connection is so young that the clock is asked as often as it can be."""
        return now_ns - self.connected_ns < FAST_CLOCK_PHASE_NS

    def is_query_due(self, now_ns: int) -> bool:
        """Whether the clock should be asked now."""
        interval_ns = FAST_CLOCK_NS if self.is_new(now_ns) else self._interval_ns
        return now_ns - self._last_query_ns >= interval_ns

    def _set_interval(self, now_ns: int) -> None:
        """Ask more often while the map is not good enough; only questions and answers change that."""
        is_vague = self._other is not None or self.sd_ns(now_ns) > self.max_sd_ns
        self._interval_ns = URGENT_CLOCK_NS if is_vague else SLOW_CLOCK_NS

    def query(self, now_ns: int) -> int | None:
        """Return the number of a question that is due and leaves now, or None."""
        if not self.is_query_due(now_ns):
            return None
        self._last_query_ns = now_ns
        self._set_interval(now_ns)
        self._number = (self._number + 1) & 0xFFFF
        if len(self._sent) > MAX_OPEN_QUERIES:
            self._sent.clear()
        self._sent[self._number] = now_ns
        return self._number

    def answer(
        self, number: int, came_ns: int, left_ns: int, received_ns: int, clock: HostClock | None
    ) -> None:
        """Take an answer.

        Parameters
        ----------
        number : int
            The question's.
        came_ns, left_ns : int
            The device's clock when the question came and when the answer left [ns].
        received_ns : int
            Steady time at which the answer came [ns].
        clock : HostClock or None
            The host's own clock.
        """
        sent_ns = self._sent.pop(number, None)
        if sent_ns is None or clock is None:
            return
        # The device's own pause is no part of the way, where it can be true.
        pause_ns = left_ns - came_ns
        returned_ns = received_ns - (pause_ns if 0 <= pause_ns <= received_ns - sent_ns else 0)
        device_ns = self._believe(sent_ns, returned_ns, came_ns)
        if device_ns is not None:
            sync = self.mapping.add(sent_ns, returned_ns, device_ns)
            self.ticks.take_trip(returned_ns - sent_ns)
            self._syncs.append(dataclasses.replace(sync, host_ns=clock.stamp_ns(sync.host_ns)))
        self._set_interval(received_ns)

    def take_syncs(self) -> list[ClockSync]:
        """Return the comparisons of the clocks since the last call."""
        syncs, self._syncs = self._syncs, []
        return syncs

    def counters(self, now_ns: int) -> dict[str, int]:
        """Return what is known of the clock, for diagnostics."""
        counters = {"strange_clock_answers": self._n_strange_ever}
        if self.mapping.is_usable:
            stamp_sd_ns = self.mapping.stamp_sd_ns(self.mapping.device_ns(now_ns))
            counters |= {
                "clock_sd_ns": round(self.sd_ns(now_ns)),
                "stamp_sd_ns": round(stamp_sd_ns),
                "clock_rtt_ns": self.mapping.shortest_rtt_ns,
                "clock_drift_ppb": round((1.0 / self.mapping.rate - 1.0) * 1e9),
            }
        return counters

    def _believe(self, sent_ns: int, returned_ns: int, shown_ns: int) -> int | None:
        """Return the extended device time of an answer, or None where it cannot be true."""
        possible = self.mapping.possible_ns(sent_ns, returned_ns)
        if possible is None:
            device_ns: int | None = self._counter.extended_ns(shown_ns)
        else:
            device_ns = self._counter.read(shown_ns, *possible)
        if device_ns is not None:
            self._n_agreeing += 1
            self._n_strange, self._other = 0, None
            return device_ns
        assert possible is not None
        self._n_strange += 1
        self._n_strange_ever += 1
        expected = None if self._other is None else self._other.possible_ns(sent_ns, returned_ns)
        if self._other is None or expected is None or not expected[0] <= shown_ns <= expected[1]:
            self._other = ClockMapping(self.mapping.epoch + 1)
        self._other.add(sent_ns, returned_ns, shown_ns)
        if self._other.n_exchanges >= AGREEING:
            self._jump(self._other, shown_ns, possible, returned_ns)
        elif self._n_strange >= DISAGREEING:
            self._n_strange = 0
            self._report("clock_jumped", f"{DISAGREEING} answers of the clock do not fit together")
        return None

    def _jump(self, other: ClockMapping, shown_ns: int, possible: tuple[int, int], now_ns: int) -> None:
        """Begin again with what the last answers agree on."""
        if self._n_agreeing >= AGREEING:
            name = "clock_backwards" if self._counter.extended_ns(shown_ns) < possible[0] else "clock_jumped"
            wanted_ns = sum(possible) // 2
            self._report(
                name,
                f"the clock shows {shown_ns * 1e-9:.6f} s where {wanted_ns * 1e-9:.6f} s +- "
                f"{(possible[1] - possible[0]) / 2e6:.1f} ms was expected",
            )
        self.mapping, self._other = other, None
        self.ticks.restart()
        self._counter = DeviceCounter()
        self._n_agreeing, self._n_strange = other.n_exchanges, 0
        self.connected_ns = now_ns


class SampleStamping:
    """Makes stamped batches of the device's ticks, once its clock is known well enough.

    Parameters
    ----------
    parameters : AxisParameters
        Command mode, resolution and period.
    device_clock : DeviceClock
        Maps the ticks.
    journal : Journal
        Counts what was lost or could not be stamped.
    report : callable
        Is told that the ticks jumped or ran backwards.
    """

    def __init__(
        self, parameters: AxisParameters, device_clock: DeviceClock, journal: Journal, report: Report
    ) -> None:
        self._parameters = parameters
        self._device_clock = device_clock
        self._journal = journal
        self._report = report
        self._stamping_epoch: int | None = None
        self._counter = self._new_counter()
        self._expected_ns: int | None = None
        self._received_ns = self._fresh_ns = 0
        self._placed_epoch: int | None = None
        self._n_agreeing = 0
        self._other_ns: int | None = None
        self._n_other = 0
        self._last_stamp_ns = 0
        self._batches: list[tuple[SampleBatch, SampleBatch]] = []

    def connect(self, *, is_new_boot: bool) -> None:
        """Begin a connection."""
        self._expected_ns = self._placed_epoch = None
        self._n_agreeing = self._n_other = 0
        if is_new_boot:
            self._counter = self._new_counter()

    def add(self, ticks: TickBatch, received_ns: int, clock: HostClock | None) -> int | None:
        """Take ticks that came at steady time ``received_ns``; old ones are dropped, a gap stays a gap.

        Returns
        -------
        int or None
            Ticks that were lost before these; None where these cannot be true and are left out.
        """
        counters = self._journal.counters
        period_ns = self._parameters.period_ns
        length_ns = len(ticks) * period_ns
        device_ns = self._believe(ticks.first_tick * period_ns, length_ns, received_ns)
        if device_ns is None:
            counters["strange_ticks"] += len(ticks)
            return None
        lost = 0
        if self._expected_ns is not None:
            lost = (device_ns - self._expected_ns) // period_ns
        if lost:
            counters["lost_ticks"] += lost
            self._journal.tell("warning", f"{lost} ticks of the hub's samples were lost on the line")
        self._expected_ns = device_ns + length_ns
        self._received_ns = received_ns
        mapping = self._device_clock.mapping
        if not mapping.is_usable or device_ns > mapping.device_ns(received_ns) - LATE_NS:
            self._fresh_ns = received_ns
        stamp_ns = 0
        if clock is not None and self._may_stamp(device_ns, received_ns):
            stamp_ns = clock.stamp_ns(mapping.host_ns(device_ns))
            if self._device_clock.sd_ns(received_ns) < self._device_clock.max_sd_ns:
                self._device_clock.ticks.take_age(
                    received_ns - mapping.host_ns(device_ns + length_ns), received_ns
                )
        if stamp_ns <= self._last_stamp_ns:
            counters["unstamped_batches"] += 1
            return lost
        self._last_stamp_ns = stamp_ns
        self._batches.append(sample_batches(ticks, stamp_ns, mapping.epoch, self._parameters))
        return lost

    @property
    def has_batches(self) -> bool:
        """Whether ``take_batches`` has something to return."""
        return bool(self._batches)

    def take_batches(self) -> list[tuple[SampleBatch, SampleBatch]]:
        """Return what was applied and measured since the last call, batch by batch."""
        batches, self._batches = self._batches, []
        return batches

    def _new_counter(self) -> DeviceCounter:
        return DeviceCounter((*WRAPS_NS, self._parameters.period_ns << 32))

    def _believe(self, shown_ns: int, length_ns: int, received_ns: int) -> int | None:
        """Return the extended device time of a batch, or None where it cannot be true."""
        mapping = self._device_clock.mapping
        if mapping.is_usable and self._placed_epoch != mapping.epoch:
            # From now on the clock says where ticks can lie.
            self._placed_epoch = mapping.epoch
            self._expected_ns = None
        is_first = self._expected_ns is None
        possible = self._possible_ns(length_ns, received_ns)
        if possible is None:
            device_ns: int | None = self._counter.extended_ns(shown_ns)
        else:
            device_ns = self._counter.read(shown_ns, *possible)
            if device_ns is None and is_first:
                recent_ns = possible[1] - LIVE_NS
                device_ns = self._counter.read(shown_ns, recent_ns, possible[1], may_be_ahead=True)
        if device_ns is not None:
            self._n_agreeing += 1
            self._n_other = 0
            return self._on_grid_ns(device_ns)
        self._n_other = self._n_other + 1 if shown_ns == self._other_ns else 1
        self._other_ns = shown_ns + length_ns
        return self._jumped_ns(shown_ns, length_ns, received_ns) if self._n_other >= AGREEING else None

    def _on_grid_ns(self, device_ns: int) -> int:
        """Put a batch whole ticks after the one before: a clock that wraps within a tick tears its numbers."""
        if self._expected_ns is None:
            return device_ns
        after_ns = (self._expected_ns - device_ns) % self._parameters.period_ns
        self._counter.shift(after_ns)
        return device_ns + after_ns

    def _possible_ns(self, length_ns: int, received_ns: int) -> tuple[int, int] | None:
        """Return between what device times [ns] a batch must begin that came now, None where all is possible."""
        by_clock = self._by_clock_ns(length_ns, received_ns)
        if self._expected_ns is None:
            return by_clock
        least_ns = self._expected_ns - self._parameters.period_ns + 1
        if by_clock is None:
            return least_ns, self._expected_ns + received_ns - self._received_ns + AHEAD_NS
        return max(least_ns, by_clock[0]), by_clock[1]

    def _by_clock_ns(self, length_ns: int, received_ns: int) -> tuple[int, int] | None:
        """Return the same by the map of the clock alone."""
        mapping = self._device_clock.mapping
        if not mapping.is_usable:
            return None
        device_ns = mapping.device_ns(received_ns)
        newest_ns = device_ns + AHEAD_NS + round(SURE * mapping.stamp_sd_ns(device_ns)) - length_ns
        if self._expected_ns is None:
            return newest_ns - CONNECTION_NS - (received_ns - self._device_clock.connected_ns), newest_ns
        return newest_ns - LATE_NS - (received_ns - self._fresh_ns), newest_ns

    def _jumped_ns(self, shown_ns: int, length_ns: int, received_ns: int) -> int | None:
        """Report that the ticks jumped, and go on with them where the clock agrees."""
        device_ns = self._counter.extended_ns(shown_ns)
        by_clock = self._by_clock_ns(length_ns, received_ns)
        is_possible = by_clock is None or by_clock[0] <= device_ns <= by_clock[1]
        if self._n_agreeing >= AGREEING or not is_possible:
            expected_ns = self._expected_ns
            if expected_ns is None:
                expected_ns = self._device_clock.mapping.device_ns(received_ns) - length_ns
            period_ns = self._parameters.period_ns
            self._report(
                "clock_backwards" if device_ns < expected_ns else "clock_jumped",
                f"the samples are of tick {shown_ns // period_ns}: expected about {expected_ns // period_ns}, "
                "tick k at k periods of the clock",
            )
        if not is_possible:
            return None
        self._n_other = 0
        self._expected_ns = None
        return device_ns

    def _may_stamp(self, device_ns: int, received_ns: int) -> bool:
        mapping = self._device_clock.mapping
        if self._stamping_epoch != mapping.epoch:
            sd_ns = mapping.standard_deviation_ns(device_ns)
            age_ns = received_ns - self._device_clock.connected_ns
            is_settled = age_ns > SETTLING_NS and sd_ns < self._device_clock.max_sd_ns / 2
            if not is_settled and not (age_ns > STAMPING_PATIENCE_NS and mapping.is_usable):
                return False
            self._stamping_epoch = mapping.epoch
        return True
