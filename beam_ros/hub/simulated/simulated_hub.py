"""The hub without hardware: a virtual axis in this process, advanced by the time that passes.

``SimulatedHub`` behaves as the driver does with the real axis behind it: the device has a clock of its own
with a start and a drift, set-points age, samples come in batches whose stamps are mapped from device time.
Two things differ: the map is known exactly here, and since device and host are one process, a stall of the
computer is not a silence of the host until it lasts for seconds.
"""

from __future__ import annotations

from collections.abc import Sequence as Listed

from beam_ros.arrays import StampArray
from beam_ros.hub.contract import (
    ClockSync,
    HostTime,
    HubCapabilities,
    HubReport,
    HubStatus,
    Outcome,
    RequestKind,
    SampleBatch,
    SequenceChunk,
)
from beam_ros.hub.errors import SnapshotError
from beam_ros.hub.faults import fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.gate.sequence_assembly import BLOCK_TICKS, Sequence
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.drifting_clock import DriftingClock
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.hub.ticks import TickQueue, sample_batches

CLOCK_SYNC_NS = 200_000_000
"""Interval of the clock comparisons that are reported [ns]."""
MAX_STALL_NS = 2_000_000_000
"""A busy computer may keep this process waiting so long; device and host stood still together then."""
MAX_CATCH_UP_NS = 10_000_000_000
"""After a longer pause (a suspended computer) the simulated device starts a new clock epoch instead."""


class SimulatedHub:
    """A hub that lives in this process; implements ``Hub``, and shows itself to a simulated camera.

    Parameters
    ----------
    axis : VirtualAxis
        The device, without a limit on its buffer.
    real_time_factor : float
        Simulated seconds per second of the host's steady clock.
    guard : BeamGuard, optional
        The beam on the axis, and how far it may be loaded.
    checks_in_background : bool, optional
        Complete sequences are checked in a thread; else within ``load``, for a caller whose time is not real.
    """

    def __init__(
        self,
        axis: VirtualAxis,
        *,
        real_time_factor: float = 1.0,
        guard: BeamGuard | None = None,
        checks_in_background: bool = False,
    ) -> None:
        self.axis = axis
        self._parameters = axis.parameters
        self._factor = real_time_factor
        self._gate = CommandGate(axis.parameters, guard, in_background=checks_in_background)
        self._sequence: Sequence | None = None
        self._clock: HostClock | None = None
        self._device_clock = DriftingClock(0, axis.device_ns, axis.device.clock_drift_ppm)
        self._epoch = 1
        self._last_steady_ns = 0
        self._next_sync_ns = 0
        self._ticks = TickQueue(axis.parameters.batch_ticks)
        self._next_request = 1
        self._journal = Journal(["pauses"])

    # The Hub protocol ---------------------------------------------------------------------------------

    @property
    def capabilities(self) -> HubCapabilities:
        """All that a hub can promise."""
        mode = self._parameters.command_mode
        return HubCapabilities("simulated", (mode,), rate=1.0 / self._parameters.period)

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        request_id = self._next_request
        self._next_request += 1
        self.axis.request(request_id, kind)
        if kind in ("stop", "disable"):
            self._gate.abort_loading(f"{kind} was asked for")
        return request_id

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        now_ns = self._host_clock(now).stamp_ns(now.steady_ns)
        axis = self.axis
        outcome = self._gate.check_setpoint(stamp_ns, value, now_ns, axis.state, axis.position, axis.velocity)
        if outcome.success:
            outcome = axis.setpoint(value)
        if not outcome.success:
            self._journal.counters["setpoints_refused"] += 1
        return outcome

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        now_ns = self._host_clock(now).stamp_ns(now.steady_ns)
        axis = self.axis
        self._gate.add(chunk, now_ns, axis.state, axis.reference_position, axis.velocity)

    def poll(self, now: HostTime) -> HubReport:
        """Advance by the time that has passed, and collect what happened."""
        clock = self._host_clock(now)
        pause_ns = now.steady_ns - self._last_steady_ns
        batches = self._catch_up_or_pause(now, clock)
        self._last_steady_ns = now.steady_ns
        now_ns = clock.stamp_ns(now.steady_ns)
        self._advance(self.device_ns(now_ns), is_stall=pause_ns <= MAX_STALL_NS)
        batches += self._full_batches()
        self._gate.follow(batches)

        self._journal.watch_clock(clock, now)
        for event in self.axis.take_events():
            self._journal.add(self._gate.note(event.kind, event.text))
        self._arm_checked(now_ns)
        clock_syncs = []
        if now.steady_ns >= self._next_sync_ns:
            self._next_sync_ns = now.steady_ns + CLOCK_SYNC_NS
            device_ns = self.axis.device_ns
            clock_syncs.append(ClockSync(self.stamp_ns(device_ns), device_ns, self._epoch, 0))
        return HubReport(
            applied=[applied for applied, _ in batches],
            measured=[measured for _, measured in batches],
            sequences=self._gate.take_reports(),
            clock=clock_syncs,
            completed=self.axis.take_completed(),
            status=self._status(),
            events=self._journal.take_events(),
        )

    def close(self) -> None:
        """Bring the axis to rest and disable it."""
        self._gate.abort_loading("the hub was closed")
        self.axis.emergency_stop(fault("session_closed"), "the hub was closed")
        while self.axis.activity != "idle":
            self.axis.advance(self.axis.device_ns + self._parameters.batch_ns)

    # Time, and the camera -----------------------------------------------------------------------------

    def device_ns(self, stamp_ns: int) -> int:
        """Return the device time [ns] of a stamp [ns, UNIX]."""
        return self._device_clock.device_ns(stamp_ns)

    def stamp_ns(self, device_ns: int) -> int:
        """Return the stamp [ns, UNIX] of a device time [ns]."""
        return self._device_clock.host_ns(device_ns)

    @property
    def reached_ns(self) -> int:
        """The newest stamp [ns, UNIX] that ``snapshots`` can show."""
        return self.stamp_ns(self.axis.device_ns)

    def lag_s(self, now: HostTime) -> float:
        """Return by how much the axis is behind the time that it should have reached [s of simulated time]."""
        return (self._host_clock(now).stamp_ns(now.steady_ns) - self.reached_ns) * 1e-9

    def snapshots(self, stamps_ns: Listed[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants, from the first poll to ``reached_ns``, up to 4 s ago.

        Parameters
        ----------
        stamps_ns : sequence of int
            Instants [ns, UNIX], for instance several within one exposure.

        Raises
        ------
        SnapshotError
            An instant is not reached yet, or too long ago.
        """
        if self._clock is None:
            raise SnapshotError(
                "snapshot before the first poll: the simulated hub has no time yet; poll first"
            )
        times = [self.device_ns(int(stamp)) for stamp in stamps_ns]
        return self.axis.snapshots(times)

    # Inside -------------------------------------------------------------------------------------------

    def _host_clock(self, now: HostTime) -> HostClock:
        if self._clock is None:
            self._clock = HostClock(now, self._factor)
            self._device_clock.set(now.unix_ns, self.axis.device_ns)
            self._last_steady_ns = self._next_sync_ns = now.steady_ns
        return self._clock

    def _arm_checked(self, now_ns: int) -> None:
        axis = self.axis
        sequence = self._gate.poll(now_ns, axis.state, axis.reference_position, axis.velocity)
        if sequence is None:
            return
        outcome = axis.arm(self.device_ns(sequence.start_ns), sequence.n_ticks)
        if outcome.success:
            self._sequence = sequence
        else:
            self._gate.finish("refused", outcome.message)

    def _hand_over(self, to_device_ns: int) -> None:
        """Give the axis the samples that it needs until a device time [ns], and some more."""
        axis, sequence = self.axis, self._sequence
        if sequence is None or not axis.has_sequence:
            self._sequence = None
            return
        elapsed_ns = to_device_ns - self.device_ns(sequence.start_ns)
        wanted = min(elapsed_ns // self._parameters.period_ns + BLOCK_TICKS, sequence.n_ticks)
        while axis.n_received < wanted:
            first = axis.n_received
            axis.append(first, sequence.ticks(first, first + BLOCK_TICKS).tolist())

    def _advance(self, device_ns: int, *, is_stall: bool) -> None:
        """Advance the axis; after a mere stall it was one process with its host all along, never without it."""
        step_ns = self._parameters.batch_ns
        while True:
            until_ns = min(device_ns, self.axis.device_ns + step_ns) if is_stall else device_ns
            self._hand_over(until_ns)
            self._ticks.add(self.axis.advance(until_ns))
            self.axis.feed()
            if until_ns >= device_ns:
                return

    def _catch_up_or_pause(self, now: HostTime, clock: HostClock) -> list[tuple[SampleBatch, SampleBatch]]:
        """After a long pause, let the axis come to rest in its own time and begin a new clock epoch."""
        pause_ns = now.steady_ns - self._last_steady_ns
        if pause_ns <= MAX_CATCH_UP_NS:
            return []
        patience_ns = MAX_CATCH_UP_NS // 10
        self._ticks.add(self.axis.advance(self.axis.device_ns + patience_ns))
        batches = self._full_batches()
        self._ticks.clear()
        self._device_clock.set(clock.stamp_ns(now.steady_ns), self.axis.device_ns)
        self._epoch += 1
        self._journal.counters["pauses"] += 1
        self._journal.tell("error", f"the host paused for {pause_ns * 1e-9:.1f} s; new clock epoch")
        return batches

    def _full_batches(self) -> list[tuple[SampleBatch, SampleBatch]]:
        batches = []
        for ticks in self._ticks.take_full():
            stamp_ns = self.stamp_ns(ticks.first_tick * self._parameters.period_ns)
            batches.append(sample_batches(ticks, stamp_ns, self._epoch, self._parameters))
        return batches

    def _status(self) -> HubStatus:
        axis = self.axis
        counters = dict(self._journal.counters)
        return HubStatus(
            axis.state, axis.position, axis.velocity, axis.activity, axis.fault, axis.reason, counters
        )
