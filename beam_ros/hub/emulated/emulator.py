"""A motion controller's firmware in software: bytes in, bytes out, device time as an argument.

It holds a ``VirtualAxis`` with a small buffer and answers by the line protocol alone.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from beam_ros.hub.contract import Outcome
from beam_ros.hub.emulated.injected_faults import InjectedFault
from beam_ros.hub.emulated.lies import Lies
from beam_ros.hub.errors import HubParameterError, HubProtocolError
from beam_ros.hub.faults import fault, fault_of
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import Plant
from beam_ros.hub.ticks import TickQueue

PUSH_PATIENCE_NS = 1_000_000_000
"""Telemetry is pushed until the host has been silent for this long [ns of device time]."""
IDENTIFY_INTERVAL_NS = 100_000_000
"""How often at most the device identifies itself to a host without a session [ns of device time]."""
REMEMBERED_REQUESTS = 16

_SEQUENCE_STATES: dict[str, protocol.DeviceSequenceState] = {
    "sequence_running": "running",
    "sequence_done": "done",
    "sequence_aborted": "aborted",
    "sequence_underrun": "underrun",
}


@dataclass
class _Session:
    """What a session leaves behind; the next one begins with none of it.

    Attributes
    ----------
    silences, told_silences : int
        Of the axis when it began, and those that the host has heard of.
    has_limits : bool
        Whether the host has set what the axis obeys.
    replies : mapping of int to RequestReply
        To the newest requests, so that one that comes again is answered again.
    setpoint_number : int
        Of the newest set-point.
    arm_reply : ArmReply or None
        To the newest announcement of a sequence.
    sequence_number, sequence_state, sequence_reason
        Of the newest sequence.
    """

    silences: int = 0
    told_silences: int = 0
    has_limits: bool = False
    replies: OrderedDict[int, protocol.RequestReply] = field(default_factory=OrderedDict)
    setpoint_number: int = 0
    arm_reply: protocol.ArmReply | None = None
    sequence_number: int = 0
    sequence_state: protocol.DeviceSequenceState = "none"
    sequence_reason: str = ""


class EmulatedFirmware:
    """The firmware of a motion controller that speaks the line protocol.

    Parameters
    ----------
    parameters : AxisParameters
        The axis, with the widest limits that it can be given.
    plant : Plant
        What the hub carries.
    device : SimulatedDevice
        Where the hub stands at boot, the room for a sequence, what the clock reads at boot.
    boot_id : int
        Another one for every start.
    name : str
        What it calls itself.

    Attributes
    ----------
    lies : Lies
        What it says and is not so; the axis itself goes on undisturbed.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        plant: Plant,
        device: SimulatedDevice,
        *,
        boot_id: int,
        name: str = "firmware emulator",
    ) -> None:
        self.axis = VirtualAxis(parameters, plant, device, buffer_samples=device.buffer_samples)
        self._parameters = parameters
        self._boot_id = boot_id
        self._name = name
        self._decoder = FrameDecoder()
        self._output = bytearray()
        self._is_in_session = False
        self._heard_ns = device.clock_start_ns
        self._now_ns = device.clock_start_ns
        self._identified_ns = -IDENTIFY_INTERVAL_NS
        self._ticks = TickQueue(parameters.batch_ticks)
        self._session = _Session()
        self._setpoints_refused = 0
        self.lies = Lies()
        self._handlers: dict[type, Callable[..., None]] = {
            protocol.Hello: self._on_hello,
            protocol.Heartbeat: lambda _: None,
            protocol.ClockQuery: self._on_clock_query,
            protocol.Request: self._on_request,
            protocol.Setpoint: self._on_setpoint,
            protocol.Arm: self._on_arm,
            protocol.Samples: self._on_samples,
            protocol.Goodbye: self._on_goodbye,
            protocol.SetLimits: self._on_limits,
        }

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until ``device_ns``, take what the line brought by then, and return what to send.

        Parameters
        ----------
        data : bytes
            Received; any bytes at all.
        device_ns : int
            The device's clock now [ns], never earlier than before.
        """
        self._now_ns = max(self._now_ns, device_ns)
        self._ticks.add(self.axis.advance(self._now_ns))
        self._note_changes()
        for payload in self._decoder.feed(data):
            # A frame that is whole but not ours changes nothing; the host finds out by the missing answer.
            with contextlib.suppress(HubProtocolError):
                self._take(protocol.decode(payload))
        self._note_changes()
        self._push()
        output = bytes(self._output)
        self._output.clear()
        return output

    def disturb(self, injected: InjectedFault, *, begins: bool) -> None:
        """Let a fault of the clock or the firmware begin or end."""
        if injected.kind != "trip":
            self.lies.change(injected, begins=begins)
            return
        cause = fault_of(round(injected.amounts["number"]))
        self.axis.trip(cause, cause.sentence)

    # Messages -----------------------------------------------------------------------------------------

    def _take(self, message: protocol.Message) -> None:
        handler = self._handlers.get(type(message))
        if handler is None:
            return
        if not (self._is_in_session or isinstance(message, protocol.Hello)):
            # The host believes in a session that this device has forgotten: tell it.
            if self._now_ns - self._identified_ns > IDENTIFY_INTERVAL_NS:
                self._send(self._identity(protocol.VERSION))
            return
        self._heard_ns = self._now_ns
        self.axis.feed()
        handler(message)

    def _send(self, message: protocol.Message) -> None:
        self._output += protocol.encode(message)

    def _on_hello(self, hello: protocol.Hello) -> None:
        speaks = hello.lowest_version <= protocol.VERSION <= hello.highest_version
        self.axis.emergency_stop(fault("session_opened"), "a host opened a new session")
        self.axis.take_events()  # What became of an earlier session's sequence is nobody's news.
        self._session = _Session(silences=self.axis.silences, told_silences=self.axis.silences)
        self._ticks.clear()
        self._is_in_session = speaks
        self._send(self._identity(protocol.VERSION if speaks else 0))
        self._send_status()

    def _identity(self, version: int) -> protocol.Identity:
        parameters = self._parameters
        self._identified_ns = self._now_ns
        return protocol.Identity(
            version=version,
            lowest_version=protocol.VERSION,
            highest_version=protocol.VERSION,
            boot_id=self._boot_id,
            period_ns=parameters.period_ns,
            batch_ticks=parameters.batch_ticks,
            buffer_samples=self.axis.device.buffer_samples,
            command_mode=parameters.command_mode,
            encoder_resolution=parameters.encoder_resolution,
            widest=protocol.DeviceLimits.of(parameters),
            name=self._name,
        )

    def _on_limits(self, message: protocol.SetLimits) -> None:
        axis = self.axis
        if axis.activity == "idle":
            # What no axis can have changes nothing; the host reads it from the answer.
            with contextlib.suppress(HubParameterError):
                axis.obey(message.limits.narrowed(self._parameters))
                self._session.has_limits = True
        obeyed = (
            protocol.DeviceLimits.of(axis.parameters) if self._session.has_limits else protocol.DeviceLimits()
        )
        self._send(protocol.LimitsReply(message.number, obeyed))

    def _on_clock_query(self, query: protocol.ClockQuery) -> None:
        told_ns = self.lies.told_ns(self._now_ns)
        self._send(protocol.ClockReply(query.number, told_ns, told_ns))

    def _told_tick(self, tick: int) -> int:
        return self.lies.told_tick(tick, self._parameters.period_ns)

    def _on_request(self, request: protocol.Request) -> None:
        if self.lies.ignores_stops and request.kind in ("stop", "disable"):
            if self.lies.stop_answer is not None:
                self._send(protocol.RequestReply(request.number, self.lies.stop_answer, ""))
            return
        known = self._session.replies.get(request.number)
        if known is not None:
            self._send(known)
            return
        if request.kind in ("enable", "home") and not self._session.has_limits:
            text = f"cannot {request.kind}: the axis has no limits; set them first"
            self._remember(protocol.RequestReply(request.number, "failure", text))
            self._send(self._session.replies[request.number])
            return
        self._remember(protocol.RequestReply(request.number, "pending", ""))
        self.axis.request(request.number, request.kind)
        self._note_changes()
        reply = self._session.replies[request.number]
        if reply.phase == "pending":
            self._send(reply)

    def _remember(self, reply: protocol.RequestReply) -> None:
        self._session.replies[reply.number] = reply
        while len(self._session.replies) > REMEMBERED_REQUESTS:
            self._session.replies.popitem(last=False)

    def _on_setpoint(self, setpoint: protocol.Setpoint) -> None:
        if setpoint.number == self._session.setpoint_number:
            return
        self._session.setpoint_number = setpoint.number
        if not self.axis.setpoint(setpoint.value).success:
            self._setpoints_refused = (self._setpoints_refused + 1) & 0xFFFF
            self._send_status()

    def _on_arm(self, arm: protocol.Arm) -> None:
        if self._session.arm_reply is None or self._session.arm_reply.number != arm.number:
            ahead_ns = self.lies.ahead_ns(arm.start_ns, self._now_ns)
            outcome = self.axis.arm(self._now_ns + ahead_ns, arm.n_samples)
            self._session.arm_reply = protocol.ArmReply(arm.number, outcome.success, outcome.message)
            if outcome.success:
                self._session.sequence_number = arm.number
                self._session.sequence_state = "armed"
                self._session.sequence_reason = ""
        self._send(self._session.arm_reply)
        self._send_status()

    def _on_samples(self, samples: protocol.Samples) -> None:
        """Take what continues the sequence; the status tells the host what is still missing."""
        if samples.number == self._session.sequence_number and self.axis.has_sequence:
            known = self.axis.n_received - samples.first
            if 0 <= known < len(samples.values):
                room = samples.values[known : known + self.axis.buffer_free]
                self.axis.append(self.axis.n_received, room.tolist())
        self._send_status()

    def _on_goodbye(self, _goodbye: protocol.Goodbye) -> None:
        self.axis.emergency_stop(fault("session_closed"), "the host closed the session")
        self._send_status()
        self._is_in_session = False

    # Pushing ------------------------------------------------------------------------------------------

    def _note_changes(self) -> None:
        events = self.axis.take_events()
        for event in events:
            if event.kind in _SEQUENCE_STATES:
                self._session.sequence_state = _SEQUENCE_STATES[event.kind]
                self._session.sequence_reason = event.text
            # One status for each change, so that the host sees them all, in their order.
            self._send_status()
        if self.axis.silences != self._session.told_silences:
            self._session.told_silences = self.axis.silences
            self._send_status()
        for number, outcome in self.axis.take_completed():
            if number not in self._session.replies:
                continue  # asked for in an earlier session
            reply = protocol.RequestReply(number, _phase(outcome), outcome.message)
            self._remember(reply)
            self._send(reply)

    def _push(self) -> None:
        is_heard = self._now_ns - self._heard_ns <= PUSH_PATIENCE_NS
        if not (self._is_in_session and is_heard):
            self._ticks.clear()
            return
        batches = self._ticks.take_full()
        for ticks in batches:
            self._send(protocol.Telemetry(self.lies.told(ticks, self._parameters.period_ns)))
        if batches:
            self._send_status()

    def _send_status(self) -> None:
        if not self._is_in_session:
            return
        axis = self.axis
        limits = np.iinfo(np.int32)
        resolution = self._parameters.encoder_resolution
        position = round(axis.position / resolution)
        velocity = round(axis.velocity * self._parameters.period / resolution)
        self._send(
            protocol.Status(
                self._boot_id,
                self._told_tick(axis.tick),
                axis.state,
                axis.activity,
                min(max(position, limits.min), limits.max),
                min(max(velocity, limits.min), limits.max),
                axis.fault.number,
                (axis.silences - self._session.silences) & 0xFFFF,
                self._told_tick(axis.silence_tick) if axis.silences != self._session.silences else 0,
                self._session.setpoint_number,
                self._setpoints_refused,
                self._session.sequence_number,
                self._session.sequence_state,
                axis.n_received,
                min(axis.buffer_free, 0xFFFF),
                axis.reason,
                self._session.sequence_reason,
            )
        )


def _phase(outcome: Outcome) -> protocol.ReplyPhase:
    return "success" if outcome.success else "failure"
