"""The host's end of the line protocol: what is said to the device, and what follows from its answers.

``HubClient`` is pure: bytes come in with the steady time at which they came, bytes go out when they are asked
for, and the commands and reports are those of ``Hub``. Port, threads and reconnection are the driver's. The
client only translates: ``Connection`` knows the session, and the objects of ``beam_ros.hub.host``, which know
nothing of this protocol, keep the requests, the sequence, the clock and the samples.

It says nothing at all unless the executor polled within the last 0.2 s, so that a frozen process falls
silent and the device's watchdog stops the axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

from beam_ros.hub.contract import (
    AxisState,
    HostTime,
    HubCapabilities,
    HubReport,
    HubStatus,
    Outcome,
    RequestKind,
    SequenceChunk,
)
from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.faults import Fault, fault_of
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.host.pulse import HostPulse
from beam_ros.hub.host.requests import STOPS, Requests, SetpointRepeater
from beam_ros.hub.host.sample_stamping import DeviceClock, SampleStamping
from beam_ros.hub.host.sequence_stream import SequenceStream
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.line import protocol
from beam_ros.hub.line.connection import Connection
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, LinkParameters

COUNTERS = (
    "bad_frames",
    "unknown_messages",
    "lost_ticks",
    "strange_ticks",
    "unstamped_batches",
    "connections",
    "watchdog_proved",
    "resent_samples",
)


@dataclasses.dataclass
class _Seen:
    """What the device said last.

    Attributes
    ----------
    status : Status or None
        The newest.
    told_state : str or None
        The newest state that is in the log.
    changed_tick : int
        Since when it is in its state [device ticks].
    held_at : float or None
        The position that it applied last in this state, in position mode [m].
    """

    status: protocol.Status | None = None
    told_state: AxisState | None = None
    changed_tick: int = 0
    held_at: float | None = None


class HubClient:
    """The host's end of the line.

    Parameters
    ----------
    parameters : AxisParameters
        What the rig file says of the axis; the device must agree.
    link : LinkParameters
        The port, for messages, and how well the device's clock must be known.
    guard : BeamGuard, optional
        The beam on the axis, and how far it may be loaded.
    checks_in_background : bool, optional
        Complete sequences are checked in a thread; else within ``load``, for a caller whose time is not real.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        link: LinkParameters,
        guard: BeamGuard | None = None,
        *,
        checks_in_background: bool = False,
    ) -> None:
        self._parameters = parameters
        self._link = link
        self._gate = CommandGate(parameters, guard, in_background=checks_in_background)
        self._decoder = FrameDecoder()
        self._journal = Journal(COUNTERS)
        self._pulse = HostPulse()
        self._connection = Connection(parameters, link, self._journal)
        self._supervisor = Supervisor(parameters, self._journal)
        self._requests = Requests(parameters, self._supervisor.report)
        self._setpoints = SetpointRepeater()
        self._device_clock = DeviceClock(link.max_clock_sd_ns, self._supervisor.report)
        self._stream = SequenceStream(self._gate, self._device_clock, self._journal, parameters.period_ns)
        self._stamping = SampleStamping(
            parameters, self._device_clock, self._journal, self._supervisor.report
        )
        self._clock: HostClock | None = None
        self._seen = _Seen()

    # The Hub protocol ---------------------------------------------------------------------------------

    @property
    def capabilities(self) -> HubCapabilities:
        """What the protocol promises, and what goes without the proof of the watchdog."""
        return HubCapabilities(
            "beam",
            (self._parameters.command_mode,),
            rate=1.0 / self._parameters.period,
            shortcomings=self._link.shortcomings,
        )

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        if not self._connection.is_in_session:
            reason = f"the controller is disconnected: {self._connection.contact.reason}"
            return self._requests.answers.give(Outcome(False, f"cannot {kind.replace('_', ' ')}: {reason}"))
        if kind in STOPS:
            return self._stop(kind, f"{kind} was asked for")
        answer = self._supervisor.answer(
            kind, self._seen.status.state if self._seen.status else "disconnected"
        )
        # What is asked while the connection comes up waits for it; that takes a second.
        return self._requests.begin(kind) if answer is None else self._requests.answers.give(answer)

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        now_ns = self._host_clock(now).stamp_ns(now.steady_ns)
        status = self._status()
        if self._supervisor.is_stopping:
            outcome = Outcome(False, "refused: the axis was asked to stop and is not yet seen at rest")
        else:
            outcome = self._gate.check_setpoint(
                stamp_ns, value, now_ns, status.state, status.position, status.velocity
            )
        if outcome.success:
            self._setpoints.take(value, now.steady_ns)
        else:
            self._journal.counters["setpoints_refused"] += 1
        return outcome

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        status = self._status()
        now_ns = self._host_clock(now).stamp_ns(now.steady_ns)
        self._gate.add(chunk, now_ns, status.state, self._held_position(status), status.velocity)

    def poll(self, now: HostTime) -> HubReport:
        """Say that the host is alive, and collect what happened."""
        clock = self._host_clock(now)
        self._pulse.beat(now.steady_ns)
        self._journal.watch_clock(clock, now)
        batches = self._stamping.take_batches()
        self._gate.follow(batches)
        status = self._status(now.steady_ns)
        now_ns = clock.stamp_ns(now.steady_ns)
        sequence = self._gate.poll(now_ns, status.state, self._held_position(status), status.velocity)
        if sequence is not None:
            self._stream.begin(sequence, clock.steady_ns(sequence.start_ns))
        return HubReport(
            applied=[applied for applied, _ in batches],
            measured=[measured for _, measured in batches],
            sequences=self._gate.take_reports(),
            clock=self._device_clock.take_syncs(),
            completed=self._requests.answers.take(),
            status=status,
            events=self._journal.take_events(),
        )

    @property
    def has_news(self) -> bool:
        """Whether samples or answers wait for the next poll."""
        return self._stamping.has_batches or self._requests.answers.are_there

    def is_calm(self, now_ns: int) -> bool:
        """Whether nothing is under way that a turn every few milliseconds would be worth."""
        # Samples follow the device's word of its room, which ends a wait by itself.
        is_loading = self._gate.sequence_id is not None and not self._stream.is_accepted
        is_busy = self._requests.are_pending or is_loading
        return self._connection.is_up and not is_busy and not self._device_clock.is_new(now_ns)

    def begin_close(self) -> None:
        """Ask the device to stop; from now on polls are not needed for the line to live."""
        self._pulse.is_closing = True
        if self._connection.is_up:
            self._requests.closing_id = self._stop("stop", "stop was asked for")

    @property
    def is_closed(self) -> bool:
        """Whether the axis is known to have stopped, or there is nobody to ask."""
        return not self._connection.is_up or self._requests.is_closed

    # The line -----------------------------------------------------------------------------------------

    def line_opened(self, now_ns: int) -> None:
        """Begin to greet the device on the port that was just opened."""
        self._connection.open(now_ns)
        self._decoder.reset()

    def line_lost(self, cause: Fault, reason: str) -> None:
        """Take note that the port is closed."""
        self._forget_session(reason)
        self._connection.lose(cause, reason)

    def is_silent(self, now_ns: int) -> bool:
        """Whether the device has said nothing for so long that the port should be opened anew."""
        return self._connection.is_silent(now_ns, self._pulse.talking_since_ns)

    def receive(self, data: bytes, received_ns: int) -> None:
        """Take bytes from the line, with the steady time [ns] at which they came."""
        payloads = self._decoder.feed(data)
        counters = self._journal.counters
        counters["bad_frames"] = self._decoder.n_bad
        for payload in payloads:
            try:
                message = protocol.decode(payload)
            except HubProtocolError as err:
                counters["unknown_messages"] += 1
                if counters["unknown_messages"] == 1:
                    self._journal.tell("warning", str(err))
                if payload[:1] == bytes((protocol.STATUS,)) and self._connection.is_in_session:
                    self._supervisor.report("status_unreadable", str(err))
                continue
            handler = _HANDLERS.get(type(message))
            if handler is not None and (
                self._connection.is_in_session or isinstance(message, protocol.Identity)
            ):
                self._connection.hear(received_ns)
                handler(self, message, received_ns)
                # While the watchdog is proved, a device holds its samples back from a host that is silent.
                if self._connection.is_up:
                    self._supervisor.hear(_WATCHED.get(type(message), "other"))

    def transmit(self, now_ns: int) -> bytes:
        """Return what is to be sent now, at steady time ``now_ns``; nothing where the host is not alive."""
        if not self._pulse.may_speak(now_ns, is_line_open=self._is_line_open(now_ns)):
            # What waited for a frozen host is too old to be sent when it thaws.
            self._setpoints.drop()
            self._requests.drop_stale()
            return b""
        was_in_session = self._connection.is_in_session
        messages = list(self._connection.words(now_ns))
        if was_in_session and not self._connection.is_in_session:
            self._forget_session(self._connection.contact.reason)
        elif self._connection.is_in_session and not self._connection.must_be_silent:
            messages += self._words(now_ns)
        if messages:
            self._pulse.note_sent(now_ns)
        return b"".join(map(protocol.encode, messages))

    def clock_query(self, now_ns: int) -> bytes:
        """Return a question for the device's clock, if one is due and the line is free, to be sent at once."""
        connection = self._connection
        if not connection.is_in_session or connection.must_be_silent or self._pulse.talking_since_ns is None:
            return b""
        if self._supervisor.is_stopping:
            return b""
        number = None if self._stream.is_line_taken(now_ns) else self._device_clock.query(now_ns)
        return b"" if number is None else protocol.encode(protocol.ClockQuery(number))

    def goodbye(self) -> bytes:
        """Return the last words to the device."""
        return protocol.encode(protocol.Goodbye()) if self._connection.is_in_session else b""

    # What is said -------------------------------------------------------------------------------------

    def _words(self, now_ns: int) -> Iterator[protocol.Message]:
        is_quiet = True
        for message in self._commands(now_ns):
            is_quiet = False
            yield message
        if is_quiet and not self._supervisor.is_stopping and self._pulse.is_heartbeat_due(now_ns):
            yield protocol.Heartbeat()

    def _commands(self, now_ns: int) -> Iterator[protocol.Message]:
        if not self._connection.is_up:
            return
        if self._supervisor.is_stopping:
            self._supervisor.note_stop_said()
            for request in self._requests.due(now_ns, stops_alone=True):
                yield protocol.Request(*request)
            return
        status = self._seen.status
        setpoint = self._setpoints.due(now_ns, status.setpoint_number if status else None)
        if setpoint is not None:
            yield protocol.Setpoint(*setpoint)
        announcement = self._stream.announcement(now_ns)
        if announcement is not None:
            yield protocol.Arm(*announcement)
        for request in self._requests.due(now_ns):
            yield protocol.Request(*request)
        if self._stream.is_line_taken(now_ns) or not self._device_clock.is_query_due(now_ns):
            # Else they let the question go first: behind samples it would wait, and its answer be worth little.
            for samples in self._stream.samples(now_ns):
                yield protocol.Samples(*samples)

    def _is_line_open(self, now_ns: int) -> bool:
        """Say whether there is a line to speak on; see to it first that an axis with a fault stops."""
        supervisor = self._supervisor
        supervisor.look(now_ns)
        if broken := supervisor.take_broken():
            self._requests.end_stops(broken)
        if not self._connection.is_up:
            return self._connection.state != "down"
        if supervisor.is_stop_due:
            self._requests.withdraw(("enable", "home"), supervisor.reason)
            self._stop("stop", supervisor.reason)
        return not supervisor.must_be_silent(now_ns)

    # What is heard ------------------------------------------------------------------------------------

    def _on_identity(self, identity: protocol.Identity, received_ns: int) -> None:
        is_new_boot = not self._connection.is_same_boot(identity)
        news = self._connection.note_identity(identity, received_ns)
        if news in ("lost", "restarted"):
            self._forget_session(self._connection.contact.reason)
        elif news == "new":
            # A process that was put aside reads the answer late, and with it the samples of all that time.
            self._device_clock.connect(self._connection.greeted_ns, is_new_boot=is_new_boot)
            self._stamping.connect(is_new_boot=is_new_boot)
            self._supervisor.connect()
        elif self._connection.is_in_session:
            # A greeting that was repeated in vain: the device began its samples anew.
            self._stamping.connect(is_new_boot=False)

    def _on_limits_reply(self, reply: protocol.LimitsReply, received_ns: int) -> None:
        self._connection.note_limits(reply.limits, received_ns)
        if not self._connection.is_in_session:
            self._forget_session(self._connection.contact.reason)

    def _on_clock_reply(self, reply: protocol.ClockReply, received_ns: int) -> None:
        self._device_clock.answer(reply.number, reply.received_ns, reply.sent_ns, received_ns, self._clock)
        self._connection.round_trip_ns = self._device_clock.mapping.shortest_rtt_ns

    def _on_request_reply(self, reply: protocol.RequestReply, _received_ns: int) -> None:
        if reply.phase == "pending":
            self._requests.acknowledge(reply.number)
        else:
            kind = self._requests.finish(reply.number, Outcome(reply.phase == "success", reply.text))
            if reply.phase == "success" and kind in STOPS:
                self._supervisor.note_stop_answered()
                self._end_stops()
            elif reply.phase == "success":
                self._supervisor.note_done(kind)

    def _on_arm_reply(self, reply: protocol.ArmReply, received_ns: int) -> None:
        self._stream.note_answer(reply.number, reply.is_accepted, reply.text, received_ns)

    def _on_telemetry(self, telemetry: protocol.Telemetry, received_ns: int) -> None:
        self._supervisor.note_applied(telemetry.ticks.applied)
        for ticks in telemetry.ticks.finite_parts():
            lost = self._stamping.add(ticks, received_ns, self._clock)
            self._supervisor.note_ticks(ticks, lost, is_homing=self._requests.has("home"))
            if self._parameters.command_mode == "position" and ticks.end_tick > self._seen.changed_tick:
                self._seen.held_at = float(ticks.applied[-1])
        self._end_stops()

    def _on_status(self, status: protocol.Status, received_ns: int) -> None:
        seen, before = self._seen, self._seen.status
        seen.status = status
        if before is None or status.state != before.state:
            # What was applied until now counts from elsewhere, or was followed by nothing.
            seen.changed_tick, seen.held_at = status.tick, None
        if before is None or status.fault_number != before.fault_number:
            self._supervisor.note_fault(fault_of(status.fault_number))
        self._supervisor.note_status(status.state, status.activity, status.tick)
        self._end_stops()
        was_up = self._connection.is_up
        self._connection.note_status(status, received_ns)
        if self._connection.is_up and not was_up:
            # In a silence of more than a second the device held its samples back.
            self._stamping.connect(is_new_boot=False)
        if not self._connection.is_in_session:
            self._forget_session(self._connection.contact.reason)
            return
        if before is not None:
            refused = (status.setpoints_refused - before.setpoints_refused) & 0xFFFF
            self._journal.counters["setpoints_refused"] += refused
        self._stream.follow(
            status.sequence_number,
            status.sequence_state,
            status.received,
            status.free,
            status.sequence_reason,
            received_ns,
        )
        if self._connection.is_up and status.state != seen.told_state:
            seen.told_state = status.state
            text = f"{status.state}: {status.reason}" if status.reason else status.state
            self._journal.add(self._gate.note("state", text))

    # Inside -------------------------------------------------------------------------------------------

    def _stop(self, kind: RequestKind, reason: str) -> int:
        """Drop all that is under way; tell the device to stop, and nothing else, until the axis is seen at rest."""
        self._setpoints.drop()
        self._stream.lose(reason)
        self._supervisor.order_stop()
        return self._requests.begin(kind)

    def _end_stops(self) -> None:
        if self._supervisor.end_stop():
            self._requests.end_stops()

    def _host_clock(self, now: HostTime) -> HostClock:
        if self._clock is None:
            self._clock = HostClock(now)
        return self._clock

    def _held_position(self, status: HubStatus) -> float:
        """Return where the device holds the hub [m]: what it applied, where it says so; a servo lags behind it."""
        held_at = self._seen.held_at
        return status.position if held_at is None else held_at

    def _forget_session(self, reason: str) -> None:
        """End all that was going on with the device, because it cannot be reached any more."""
        self._requests.fail_all(reason)
        self._setpoints.drop()
        self._stream.lose(reason)
        self._seen = _Seen()

    def _status(self, now_ns: int | None = None) -> HubStatus:
        status, device = self._connection.contact.status, self._seen.status
        counters = {**status.counters, **({} if now_ns is None else self._device_clock.counters(now_ns))}
        if not self._connection.is_up or device is None:
            return dataclasses.replace(status, counters=counters)
        resolution = self._parameters.encoder_resolution
        status = HubStatus(
            device.state,
            device.position_count * resolution,
            device.velocity_count * resolution / self._parameters.period,
            device.activity,
            fault_of(device.fault_number),
            device.reason,
            counters,
        )
        return self._supervisor.seen(status)


_HANDLERS: dict[type, Callable[..., None]] = {
    protocol.Identity: HubClient._on_identity,
    protocol.ClockReply: HubClient._on_clock_reply,
    protocol.RequestReply: HubClient._on_request_reply,
    protocol.ArmReply: HubClient._on_arm_reply,
    protocol.Telemetry: HubClient._on_telemetry,
    protocol.Status: HubClient._on_status,
    protocol.LimitsReply: HubClient._on_limits_reply,
}
_WATCHED = {protocol.Telemetry: "telemetry", protocol.Status: "status"}
"""Messages without which nobody knows how the axis is."""
