"""From the device's ticks to stamped batches: the device's clock is asked, mapped, and put on every sample."""

from __future__ import annotations

import dataclasses

from beam_ros.hub.clock_mapping import ClockMapping
from beam_ros.hub.contract import ClockSync, SampleBatch
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


class DeviceClock:
    """The device's clock, as the host knows it from questions and answers.

    Parameters
    ----------
    max_sd_ns : int
        Standard deviation of the map above which it is not good enough [ns].

    Attributes
    ----------
    mapping : ClockMapping
        From device time to steady time, for the device's present start.
    connected_ns : int
        Steady time of the connection [ns].
    """

    def __init__(self, max_sd_ns: int) -> None:
        self.max_sd_ns = max_sd_ns
        self.mapping = ClockMapping(0)
        self.connected_ns = 0
        self._sent: dict[int, int] = {}
        self._number = 0
        self._last_query_ns = 0
        self._syncs: list[ClockSync] = []

    def connect(self, now_ns: int, *, is_new_boot: bool) -> None:
        """Begin a connection; the map goes on where the device has not restarted."""
        self.connected_ns = now_ns
        self._sent.clear()
        if is_new_boot:
            self.mapping = ClockMapping(self.mapping.epoch + 1)

    def sd_ns(self, now_ns: int) -> float:
        """Return the standard deviation [ns] of the map now."""
        return self.mapping.standard_deviation_ns(self.mapping.device_ns(now_ns))

    def query(self, now_ns: int) -> int | None:
        """Return the number of a question that is due and leaves now, or None."""
        interval_ns = SLOW_CLOCK_NS
        if now_ns - self.connected_ns < FAST_CLOCK_PHASE_NS:
            interval_ns = FAST_CLOCK_NS
        elif self.sd_ns(now_ns) > self.max_sd_ns:
            interval_ns = URGENT_CLOCK_NS
        if now_ns - self._last_query_ns < interval_ns:
            return None
        self._last_query_ns = now_ns
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
        # The device's own pause is no part of the way.
        answering_ns = min(max(0, left_ns - came_ns), received_ns - sent_ns)
        sync = self.mapping.add(sent_ns, received_ns - answering_ns, came_ns)
        self._syncs.append(dataclasses.replace(sync, host_ns=clock.stamp_ns(sync.host_ns)))

    def take_syncs(self) -> list[ClockSync]:
        """Return the comparisons of the clocks since the last call."""
        syncs, self._syncs = self._syncs, []
        return syncs

    def counters(self, now_ns: int) -> dict[str, int]:
        """Return what is known of the clock, for diagnostics."""
        if not self.mapping.is_usable:
            return {}
        return {
            "clock_sd_ns": round(self.sd_ns(now_ns)),
            "clock_rtt_ns": self.mapping.shortest_rtt_ns,
            "clock_drift_ppb": round((1.0 / self.mapping.rate - 1.0) * 1e9),
        }


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
    """

    def __init__(self, parameters: AxisParameters, device_clock: DeviceClock, journal: Journal) -> None:
        self._parameters = parameters
        self._device_clock = device_clock
        self._journal = journal
        self._is_stamping = False
        self._expected_tick: int | None = None
        self._last_stamp_ns = 0
        self._batches: list[tuple[SampleBatch, SampleBatch]] = []

    def connect(self, *, is_new_boot: bool) -> None:
        """Begin a connection."""
        self._expected_tick = None
        if is_new_boot:
            self._is_stamping = False

    def add(self, ticks: TickBatch, received_ns: int, clock: HostClock | None) -> None:
        """Take ticks that came at steady time ``received_ns``; old ones are dropped, a gap stays a gap."""
        counters = self._journal.counters
        if self._expected_tick is not None:
            lost = ticks.first_tick - self._expected_tick
            if lost < 0:
                return
            if lost:
                counters["lost_ticks"] += lost
                self._journal.tell("warning", f"{lost} ticks of the hub's samples were lost on the line")
        self._expected_tick = ticks.first_tick + len(ticks)
        device_ns = ticks.first_tick * self._parameters.period_ns
        stamp_ns = 0
        if clock is not None and self._may_stamp(device_ns, received_ns):
            stamp_ns = clock.stamp_ns(self._device_clock.mapping.host_ns(device_ns))
        if stamp_ns <= self._last_stamp_ns:
            counters["unstamped_batches"] += 1
            return
        self._last_stamp_ns = stamp_ns
        epoch = self._device_clock.mapping.epoch
        self._batches.append(sample_batches(ticks, stamp_ns, epoch, self._parameters))

    def take_batches(self) -> list[tuple[SampleBatch, SampleBatch]]:
        """Return what was applied and measured since the last call, batch by batch."""
        batches, self._batches = self._batches, []
        return batches

    def _may_stamp(self, device_ns: int, received_ns: int) -> bool:
        if not self._is_stamping:
            mapping = self._device_clock.mapping
            sd_ns = mapping.standard_deviation_ns(device_ns)
            age_ns = received_ns - self._device_clock.connected_ns
            self._is_stamping = (age_ns > SETTLING_NS and sd_ns < self._device_clock.max_sd_ns / 2) or (
                age_ns > STAMPING_PATIENCE_NS and mapping.is_usable
            )
        return self._is_stamping
