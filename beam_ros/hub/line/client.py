"""The host's end of the line protocol: what is said to the device, and what follows from its answers.

``HubClient`` is pure: bytes come in with the steady time at which they came, bytes go out when they are asked
for, and the commands and reports are those of ``Hub``. Port, threads and reconnection are the driver's.

It says nothing at all unless the executor polled within the last 0.2 s, so that a frozen process falls
silent and the device's watchdog stops the axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from beam_ros.hub.clock_mapping import ClockMapping
from beam_ros.hub.contract import (
    ClockSync,
    EventLevel,
    HostTime,
    HubEvent,
    HubReport,
    HubStatus,
    Outcome,
    RequestKind,
    SampleBatch,
    SequenceChunk,
)
from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import HubParameters
from beam_ros.hub.sequences import MAX_AGE_NS, CommandGate, Guard, Sequence
from beam_ros.hub.simulated.axis import sample_batches

Link = Literal["down", "greeting", "up"]

HOST_ALIVE_NS = 200_000_000
HEARTBEAT_NS = 50_000_000
HELLO_NS = 200_000_000
SILENCE_NS = 500_000_000
"""A device that says nothing for this long is lost."""
NO_ANSWER_NS = 3_000_000_000
"""A port where nobody answers the greeting for this long is opened anew."""
RETRY_NS = 100_000_000
ASK_AGAIN_NS = 500_000_000
ANSWER_NS = 1_000_000_000
"""A request that the device has not acknowledged by then has failed."""
LAST_ARM_NS = 80_000_000
"""A complete sequence waits for the clock map to be good enough until this long before its start."""
RESEND_NS = 60_000_000
FAST_CLOCK_NS = 10_000_000
FAST_CLOCK_PHASE_NS = 1_000_000_000
SLOW_CLOCK_NS = 200_000_000
URGENT_CLOCK_NS = 40_000_000
"""Intervals of clock queries: just after connecting, later, and later while the map is not good enough."""
SETTLING_NS = 500_000_000
"""Samples are stamped from this long after connecting on, if the map is then known to half of the gate ..."""
STAMPING_PATIENCE_NS = 2_000_000_000
"""... or from this long after connecting on, if it is not: what is stamped once is only slewed from then on."""
SAMPLES_PER_FRAME = 50
FRAMES_PER_TURN = 4


@dataclass
class _PendingRequest:
    request_id: int
    kind: RequestKind
    first_sent_ns: int | None = None
    last_sent_ns: int = 0
    is_acknowledged: bool = False


@dataclass
class _Setpoint:
    number: int
    value: float
    made_ns: int
    sent_ns: int | None = None


@dataclass
class _Stream:
    """A sequence on its way to the device."""

    sequence: Sequence
    number: int
    start_steady_ns: int
    start_device_ns: int | None = None
    last_arm_ns: int = 0
    is_accepted: bool = False
    is_running: bool = False
    sent: int = 0
    received: int = 0
    edge: int = 0
    progress_ns: int = 0


class HubClient:
    """The host's end of the line.

    Parameters
    ----------
    parameters : HubParameters
        What the rig file says of the axis; the device must agree.
    guard : callable, optional
        A further check of complete sequences, for limits that need a model of the beam.
    """

    def __init__(self, parameters: HubParameters, guard: Guard | None = None) -> None:
        self._parameters = parameters
        self._gate = CommandGate(parameters, guard)
        self._decoder = FrameDecoder()
        self._clock: HostClock | None = None
        self._polled_ns: int | None = None
        self._is_closing = False

        self._link: Link = "down"
        self._link_reason = "not connected yet"
        self._link_since_ns = 0
        self._heard_ns = 0
        self._talking_since_ns: int | None = None
        self._last_sent_ns = 0
        self._last_hello_ns: int | None = None
        self._has_complained = False

        self._boot_id: int | None = None
        self._epoch = 0
        self._mapping = ClockMapping(0)
        self._queries: dict[int, int] = {}
        self._query_number = 0
        self._last_query_ns = 0
        self._is_stamping = False
        self._expected_tick: int | None = None
        self._last_stamp_ns = 0

        self._device: protocol.Status | None = None
        self._next_request = 1
        self._requests: dict[int, _PendingRequest] = {}
        self._closing_request: int | None = None
        self._setpoint: _Setpoint | None = None
        self._setpoint_number = 0
        self._stream: _Stream | None = None
        self._stream_number = 0

        self._applied: list[SampleBatch] = []
        self._measured: list[SampleBatch] = []
        self._syncs: list[ClockSync] = []
        self._completed: list[tuple[int, Outcome]] = []
        self._events: list[HubEvent] = []
        self._counters = {
            "bad_frames": 0,
            "unknown_messages": 0,
            "lost_ticks": 0,
            "unstamped_batches": 0,
            "connections": 0,
            "resent_samples": 0,
            "setpoints_refused": 0,
            "real_time_jumps": 0,
        }
        self._handlers: dict[type, Callable[..., None]] = {
            protocol.Identity: self._on_identity,
            protocol.ClockReply: self._on_clock_reply,
            protocol.RequestReply: self._on_request_reply,
            protocol.ArmReply: self._on_arm_reply,
            protocol.Telemetry: self._on_telemetry,
            protocol.Status: self._on_status,
        }

    # The Hub protocol ---------------------------------------------------------------------------------

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        request_id = self._next_request
        self._next_request += 1
        if kind in ("stop", "disable"):
            self._setpoint = None
            self._gate.abort_loading(f"{kind} was asked for")
            if self._stream is not None and self._stream.start_device_ns is None:
                # The device does not know of it yet.
                self._stream = None
                self._gate.finish("aborted", f"{kind} was asked for")
        if self._link == "up":
            self._requests[request_id & 0xFFFF] = _PendingRequest(request_id, kind)
        else:
            message = f"cannot {kind.replace('_', ' ')}: the controller is disconnected: {self._link_reason}"
            self._completed.append((request_id, Outcome(False, message)))
        return request_id

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        now_ns = self._host_clock(now).stamp_ns(now.steady_ns)
        outcome = self._gate.check_setpoint(stamp_ns, value, now_ns, self._status().state)
        if outcome.success:
            self._setpoint_number = self._setpoint_number % 0xFFFF + 1
            self._setpoint = _Setpoint(self._setpoint_number, value, now.steady_ns)
        else:
            self._counters["setpoints_refused"] += 1
        return outcome

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        clock = self._host_clock(now)
        status = self._status()
        sequence = self._gate.add(
            chunk,
            clock.stamp_ns(now.steady_ns),
            status.state,
            status.position,
            status.velocity,
        )
        if sequence is not None:
            self._stream_number = self._stream_number % 0xFFFF + 1
            self._stream = _Stream(sequence, self._stream_number, clock.steady_ns(sequence.start_ns))

    def poll(self, now: HostTime) -> HubReport:
        """Say that the host is alive, and collect what happened."""
        clock = self._host_clock(now)
        self._polled_ns = now.steady_ns
        jump_ns = clock.jump_ns(now)
        if jump_ns is not None:
            self._counters["real_time_jumps"] += 1
            self._tell(
                "error",
                f"the computer's real-time clock jumped by {jump_ns * 1e-9:.3f} s; stamps keep the old time: "
                "discard this recording and start the rig anew",
            )
        self._gate.expire(clock.stamp_ns(now.steady_ns))
        report = HubReport(
            applied=self._applied,
            measured=self._measured,
            sequences=self._gate.take_reports(),
            clock=self._syncs,
            completed=self._completed,
            status=self._status(now.steady_ns),
            events=self._events,
        )
        self._applied, self._measured, self._syncs = [], [], []
        self._completed, self._events = [], []
        return report

    def begin_close(self) -> None:
        """Ask the device to stop; from now on polls are not needed for the line to live."""
        self._is_closing = True
        if self._link == "up":
            self._closing_request = self.request("stop")

    @property
    def is_closed(self) -> bool:
        """Whether the axis is known to have stopped, or there is nobody to ask."""
        return self._link != "up" or (self._closing_request or 0) & 0xFFFF not in self._requests

    # The line -----------------------------------------------------------------------------------------

    def line_opened(self, now_ns: int) -> None:
        """Begin to greet the device on the port that was just opened."""
        self._link = "greeting"
        self._link_reason = "the controller has not answered yet"
        self._link_since_ns = self._heard_ns = now_ns
        self._last_hello_ns = None
        self._decoder.reset()

    def line_lost(self, reason: str) -> None:
        """Take note that the port is closed."""
        was_up = self._link == "up"
        self._forget_session(reason)
        self._link = "down"
        if was_up:
            self._tell("error", reason)

    def is_silent(self, now_ns: int) -> bool:
        """Whether the device has said nothing for so long that the port should be opened anew."""
        if self._talking_since_ns is None:
            return False
        patience_ns = SILENCE_NS if self._link == "up" else NO_ANSWER_NS
        return now_ns - max(self._heard_ns, self._talking_since_ns) > patience_ns

    def receive(self, data: bytes, received_ns: int) -> None:
        """Take bytes from the line, with the steady time [ns] at which they came."""
        payloads = self._decoder.feed(data)
        self._counters["bad_frames"] = self._decoder.n_bad
        for payload in payloads:
            try:
                message = protocol.decode(payload)
            except HubProtocolError as err:
                self._counters["unknown_messages"] += 1
                if self._counters["unknown_messages"] == 1:
                    self._tell("warning", str(err))
                continue
            handler = self._handlers.get(type(message))
            if handler is not None and (self._link == "up" or isinstance(message, protocol.Identity)):
                self._heard_ns = received_ns
                handler(message, received_ns)

    def transmit(self, now_ns: int) -> bytes:
        """Return what is to be sent now, at steady time ``now_ns``; nothing where the host is not alive."""
        is_alive = self._is_closing or (
            self._polled_ns is not None and now_ns - self._polled_ns <= HOST_ALIVE_NS
        )
        if not is_alive or self._link == "down":
            self._talking_since_ns = None
            # A set-point that waited for a frozen host is too old to be sent when it thaws.
            self._setpoint = None
            return b""
        if self._talking_since_ns is None:
            self._talking_since_ns = now_ns
        messages: list[protocol.Message] = []
        if self._link == "greeting":
            self._greet(messages, now_ns)
        else:
            self._command(messages, now_ns)
            self._arm(messages, now_ns)
            self._ask(messages, now_ns)
            self._stream_samples(messages, now_ns)
            if not messages and now_ns - self._last_sent_ns >= HEARTBEAT_NS:
                messages.append(protocol.Heartbeat())
        if messages:
            self._last_sent_ns = now_ns
        return b"".join(map(protocol.encode, messages))

    def clock_query(self, now_ns: int) -> bytes:
        """Return a question for the device's clock, if one is due, to be sent at once."""
        if self._link != "up" or self._talking_since_ns is None:
            return b""
        interval_ns = SLOW_CLOCK_NS
        if now_ns - self._link_since_ns < FAST_CLOCK_PHASE_NS:
            interval_ns = FAST_CLOCK_NS
        elif self._map_sd_ns(now_ns) > self._parameters.max_clock_sd_ns:
            interval_ns = URGENT_CLOCK_NS
        if now_ns - self._last_query_ns < interval_ns:
            return b""
        self._last_query_ns = now_ns
        self._query_number = (self._query_number + 1) & 0xFFFF
        if len(self._queries) > 100:
            self._queries.clear()
        self._queries[self._query_number] = now_ns
        return protocol.encode(protocol.ClockQuery(self._query_number))

    def goodbye(self) -> bytes:
        """Return the last words to the device."""
        return protocol.encode(protocol.Goodbye()) if self._link == "up" else b""

    # What is said -------------------------------------------------------------------------------------

    def _greet(self, messages: list[protocol.Message], now_ns: int) -> None:
        if self._last_hello_ns is None or now_ns - self._last_hello_ns >= HELLO_NS:
            self._last_hello_ns = now_ns
            messages.append(protocol.Hello())
        if now_ns - self._link_since_ns > 2 * ANSWER_NS:
            self._complain(
                f"nobody answers on {self._parameters.serial_port} at {self._parameters.serial_baud} baud: "
                f"expected a controller that speaks protocol version {protocol.VERSION}; check serial.port, "
                "serial.baud, and that the controller has power and the firmware"
            )

    def _command(self, messages: list[protocol.Message], now_ns: int) -> None:
        """Send the newest set-point, and send it again until it has come or is too old."""
        setpoint = self._setpoint
        if setpoint is None:
            return
        has_come = self._device is not None and self._device.setpoint_number == setpoint.number
        if has_come or now_ns - setpoint.made_ns > MAX_AGE_NS:
            self._setpoint = None
        elif setpoint.sent_ns is None or now_ns - setpoint.sent_ns >= RESEND_NS:
            setpoint.sent_ns = now_ns
            messages.append(protocol.Setpoint(setpoint.number, setpoint.value))

    def _ask(self, messages: list[protocol.Message], now_ns: int) -> None:
        for number, pending in list(self._requests.items()):
            if pending.first_sent_ns is None:
                pending.first_sent_ns = now_ns
            elif not pending.is_acknowledged and now_ns - pending.first_sent_ns > ANSWER_NS:
                del self._requests[number]
                message = f"{pending.kind}: the controller did not answer within {ANSWER_NS * 1e-9:g} s"
                self._completed.append((pending.request_id, Outcome(False, message)))
                continue
            elif now_ns - pending.last_sent_ns < (ASK_AGAIN_NS if pending.is_acknowledged else RETRY_NS):
                continue
            pending.last_sent_ns = now_ns
            messages.append(protocol.Request(number, pending.kind))

    def _arm(self, messages: list[protocol.Message], now_ns: int) -> None:
        stream = self._stream
        if stream is None or stream.is_accepted:
            return
        if stream.start_device_ns is None:
            sd_ns, limit_ns = self._map_sd_ns(now_ns), self._parameters.max_clock_sd_ns
            if sd_ns < limit_ns:
                stream.start_device_ns = max(0, self._mapping.device_ns(stream.start_steady_ns))
            elif now_ns > stream.start_steady_ns - LAST_ARM_NS:
                self._stream = None
                self._gate.finish(
                    "refused",
                    f"the clock map's standard deviation is {sd_ns / 1000:.0f} us: expected below "
                    f"{limit_ns / 1000:g} us; look for a slow USB hub or a busy computer",
                )
        if stream.start_device_ns is not None and now_ns - stream.last_arm_ns >= RETRY_NS:
            stream.last_arm_ns = now_ns
            messages.append(protocol.Arm(stream.number, stream.start_device_ns, len(stream.sequence.values)))

    def _stream_samples(self, messages: list[protocol.Message], now_ns: int) -> None:
        stream = self._stream
        if stream is None or not stream.is_accepted:
            return
        if stream.sent > stream.received and now_ns - stream.progress_ns > RESEND_NS:
            self._counters["resent_samples"] += stream.sent - stream.received
            stream.sent = stream.received
            stream.progress_ns = now_ns
        values = stream.sequence.values
        for _ in range(FRAMES_PER_TURN):
            end = min(stream.sent + SAMPLES_PER_FRAME, stream.edge, len(values))
            # Whole frames, unless it is the end: a sample at a time would cost a frame each.
            if end <= stream.sent or (end < stream.sent + SAMPLES_PER_FRAME and end < len(values)):
                break
            if stream.sent == stream.received:
                stream.progress_ns = now_ns
            messages.append(protocol.Samples(stream.number, stream.sent, values[stream.sent : end]))
            stream.sent = end

    # What is heard ------------------------------------------------------------------------------------

    def _on_identity(self, identity: protocol.Identity, received_ns: int) -> None:
        if self._link == "up":
            reason = (
                "the controller restarted" if identity.boot_id != self._boot_id else "the session was lost"
            )
            self._forget_session(reason)
            self.line_opened(received_ns)
            self._tell("error", reason)
            return
        objection = self._objection(identity)
        if objection:
            self._link_reason = objection
            self._complain(objection)
            return
        if identity.boot_id != self._boot_id:
            self._boot_id = identity.boot_id
            self._epoch += 1
            self._mapping = ClockMapping(self._epoch)
            self._is_stamping = False
        self._expected_tick = None
        self._queries.clear()
        self._link = "up"
        self._has_complained = False
        self._link_reason = ""
        self._link_since_ns = received_ns
        self._counters["connections"] += 1
        self._tell("info", f"connected: {identity.name} on {self._parameters.serial_port}")

    def _objection(self, identity: protocol.Identity) -> str | None:
        """Return why this device cannot be the axis of the rig file."""
        if identity.version != protocol.VERSION:
            return (
                f"the controller speaks protocol versions {identity.lowest_version} to "
                f"{identity.highest_version}: expected {protocol.VERSION}; update the firmware or this suite"
            )
        parameters = self._parameters
        for name, value, wanted in (
            ("period_ns", identity.period_ns, parameters.period_ns),
            ("command mode", identity.command_mode, parameters.command_mode),
            ("encoder resolution", identity.encoder_resolution, parameters.encoder_resolution),
        ):
            if value != wanted:
                return f"the controller's {name} is {value}, the rig file's {wanted}: make them the same"
        for name, limit, allowed in (
            ("travel", identity.travel, parameters.travel),
            ("max_speed", identity.max_speed, parameters.max_speed),
            ("max_acceleration", identity.max_acceleration, parameters.max_acceleration),
            ("max_effort", identity.max_effort, parameters.max_effort),
        ):
            if limit < allowed * (1 - 1e-9):
                return f"the controller allows {name} {limit:g}, the rig file {allowed:g}: lower hub.{name}"
        return None

    def _on_clock_reply(self, reply: protocol.ClockReply, received_ns: int) -> None:
        sent_ns = self._queries.pop(reply.number, None)
        if sent_ns is None or self._clock is None:
            return
        answering_ns = min(max(0, reply.sent_ns - reply.received_ns), received_ns - sent_ns)
        # The device's own pause is no part of the way.
        sync = self._mapping.add(sent_ns, received_ns - answering_ns, reply.received_ns)
        self._syncs.append(dataclasses.replace(sync, host_ns=self._clock.stamp_ns(sync.host_ns)))

    def _on_request_reply(self, reply: protocol.RequestReply, _received_ns: int) -> None:
        pending = self._requests.get(reply.number)
        if pending is None:
            return
        if reply.phase == "pending":
            pending.is_acknowledged = True
            return
        del self._requests[reply.number]
        if pending.request_id != self._closing_request:
            self._completed.append((pending.request_id, Outcome(reply.phase == "success", reply.text)))

    def _on_arm_reply(self, reply: protocol.ArmReply, received_ns: int) -> None:
        stream = self._stream
        if stream is None or reply.number != stream.number or stream.is_accepted:
            return
        if reply.is_accepted:
            stream.is_accepted = True
            stream.progress_ns = received_ns
        else:
            self._stream = None
            self._gate.finish("refused", reply.text)

    def _on_telemetry(self, telemetry: protocol.Telemetry, received_ns: int) -> None:
        ticks = telemetry.ticks
        if self._expected_tick is not None:
            lost = ticks.first_tick - self._expected_tick
            if lost < 0:
                return
            if lost:
                self._counters["lost_ticks"] += lost
                self._tell("warning", f"{lost} ticks of the hub's samples were lost on the line")
        self._expected_tick = ticks.first_tick + len(ticks)
        device_ns = ticks.first_tick * self._parameters.period_ns
        if not self._is_stamping:
            sd_ns = self._mapping.standard_deviation_ns(device_ns)
            age_ns = received_ns - self._link_since_ns
            self._is_stamping = (age_ns > SETTLING_NS and sd_ns < self._parameters.max_clock_sd_ns / 2) or (
                age_ns > STAMPING_PATIENCE_NS and self._mapping.is_usable
            )
        if not self._is_stamping or self._clock is None:
            self._counters["unstamped_batches"] += 1
            return
        stamp_ns = self._clock.stamp_ns(self._mapping.host_ns(device_ns))
        if stamp_ns <= self._last_stamp_ns:
            self._counters["unstamped_batches"] += 1
            return
        self._last_stamp_ns = stamp_ns
        applied, measured = sample_batches(ticks, stamp_ns, self._epoch, self._parameters)
        self._applied.append(applied)
        self._measured.append(measured)

    def _on_status(self, status: protocol.Status, received_ns: int) -> None:
        before, self._device = self._device, status
        if before is not None:
            refused = (status.setpoints_refused - before.setpoints_refused) & 0xFFFF
            self._counters["setpoints_refused"] += refused
        stream = self._stream
        if stream is not None and status.sequence_number == stream.number:
            self._follow(stream, status, received_ns)
        if before is None or status.state != before.state:
            line = self._gate.note(
                "state", f"{status.state}: {status.reason}" if status.reason else status.state
            )
            if line is not None:
                self._events.append(line)

    def _follow(self, stream: _Stream, status: protocol.Status, received_ns: int) -> None:
        if status.received > stream.received:
            stream.received = status.received
            stream.progress_ns = received_ns
        stream.edge = max(stream.edge, status.received + status.free)
        state = status.sequence_state
        if state in ("running", "done", "underrun") and not stream.is_running:
            stream.is_running = True
            self._gate.note("sequence_running", "")
        if state == "done":
            self._gate.note("sequence_done", status.sequence_reason)
        elif state == "aborted":
            self._gate.note("sequence_aborted", status.sequence_reason)
        elif state == "underrun":
            self._gate.note("sequence_underrun", status.sequence_reason)
        else:
            return
        self._stream = None

    # Inside -------------------------------------------------------------------------------------------

    def _host_clock(self, now: HostTime) -> HostClock:
        if self._clock is None:
            self._clock = HostClock(now)
        return self._clock

    def _forget_session(self, reason: str) -> None:
        """End all that was going on with the device, because it cannot be reached any more."""
        self._link_reason = reason
        for pending in self._requests.values():
            if pending.request_id != self._closing_request:
                message = f"{pending.kind}: the controller is disconnected: {reason}"
                self._completed.append((pending.request_id, Outcome(False, message)))
        self._requests.clear()
        self._setpoint = None
        self._stream = None
        self._gate.finish("aborted", reason)
        self._device = None

    def _map_sd_ns(self, now_ns: int) -> float:
        return self._mapping.standard_deviation_ns(self._mapping.device_ns(now_ns))

    def _status(self, now_ns: int | None = None) -> HubStatus:
        counters = dict(self._counters)
        if now_ns is not None and self._mapping.is_usable:
            counters["clock_sd_ns"] = round(self._map_sd_ns(now_ns))
            counters["clock_rtt_ns"] = self._mapping.shortest_rtt_ns
            counters["clock_drift_ppb"] = round((1.0 / self._mapping.rate - 1.0) * 1e9)
        device = self._device
        if self._link != "up" or device is None:
            return HubStatus(fault=self._link_reason, counters=counters)
        resolution = self._parameters.encoder_resolution
        return HubStatus(
            device.state,
            device.position_count * resolution,
            device.velocity_count * resolution / self._parameters.period,
            device.reason,
            counters,
        )

    def _tell(self, level: EventLevel, text: str) -> None:
        self._events.append(HubEvent(level, text))

    def _complain(self, text: str) -> None:
        """Say once what is wrong with the connection."""
        self._link_reason = text
        if not self._has_complained:
            self._has_complained = True
            self._tell("error", text)
