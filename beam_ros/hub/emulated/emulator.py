"""A motion controller in software: the firmware's behaviour behind a pseudo-terminal.

``EmulatedFirmware`` is the firmware: bytes in, bytes out, device time as an argument. It holds a
``VirtualAxis`` with a small buffer and answers by the line protocol alone. ``EmulatedController`` gives it a
clock that drifts, a thread and a pseudo-terminal, so that the driver meets a serial port; for a simulated
camera it shows its axis with host stamps.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import select
import threading
import time
import tty
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from beam_ros.arrays import StampArray
from beam_ros.hub.contract import HostTime, Outcome
from beam_ros.hub.errors import HubConnectionError, HubParameterError, HubProtocolError
from beam_ros.hub.faults import fault
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.hub.simulated.plant import Plant
from beam_ros.hub.ticks import TickQueue

PUSH_PATIENCE_NS = 1_000_000_000
"""Telemetry is pushed until the host has been silent for this long [ns of device time]."""
IDENTIFY_INTERVAL_NS = 100_000_000
"""How often at most the device identifies itself to a host without a session [ns of device time]."""
REMEMBERED_REQUESTS = 16
MAX_BACKLOG = 65_536
"""Bytes that wait where the line takes no more [2.7 s of telemetry]."""

_SEQUENCE_STATES: dict[str, protocol.DeviceSequenceState] = {
    "sequence_running": "running",
    "sequence_done": "done",
    "sequence_aborted": "aborted",
    "sequence_underrun": "underrun",
}


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
        self._has_limits = False
        self._silences = self._told_silences = 0
        self._replies: OrderedDict[int, protocol.RequestReply] = OrderedDict()
        self._setpoint_number = 0
        self._setpoints_refused = 0
        self._arm_reply: protocol.ArmReply | None = None
        self._sequence_number = 0
        self._sequence_state: protocol.DeviceSequenceState = "none"
        self._sequence_reason = ""
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
        self._has_limits = False
        self._silences = self._told_silences = self.axis.silences
        self._replies.clear()
        self._arm_reply = None
        self._setpoint_number = 0
        self._sequence_number = 0
        self._sequence_state = "none"
        self._sequence_reason = ""
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
                self._has_limits = True
        obeyed = protocol.DeviceLimits.of(axis.parameters) if self._has_limits else protocol.DeviceLimits()
        self._send(protocol.LimitsReply(message.number, obeyed))

    def _on_clock_query(self, query: protocol.ClockQuery) -> None:
        self._send(protocol.ClockReply(query.number, self._now_ns, self._now_ns))

    def _on_request(self, request: protocol.Request) -> None:
        known = self._replies.get(request.number)
        if known is not None:
            self._send(known)
            return
        if request.kind in ("enable", "home") and not self._has_limits:
            text = f"cannot {request.kind}: the axis has no limits; set them first"
            self._remember(protocol.RequestReply(request.number, "failure", text))
            self._send(self._replies[request.number])
            return
        self._remember(protocol.RequestReply(request.number, "pending", ""))
        self.axis.request(request.number, request.kind)
        self._note_changes()
        reply = self._replies[request.number]
        if reply.phase == "pending":
            self._send(reply)

    def _remember(self, reply: protocol.RequestReply) -> None:
        self._replies[reply.number] = reply
        while len(self._replies) > REMEMBERED_REQUESTS:
            self._replies.popitem(last=False)

    def _on_setpoint(self, setpoint: protocol.Setpoint) -> None:
        if setpoint.number == self._setpoint_number:
            return
        self._setpoint_number = setpoint.number
        if not self.axis.setpoint(setpoint.value).success:
            self._setpoints_refused = (self._setpoints_refused + 1) & 0xFFFF
            self._send_status()

    def _on_arm(self, arm: protocol.Arm) -> None:
        if self._arm_reply is None or self._arm_reply.number != arm.number:
            outcome = self.axis.arm(arm.start_ns, arm.n_samples)
            self._arm_reply = protocol.ArmReply(arm.number, outcome.success, outcome.message)
            if outcome.success:
                self._sequence_number = arm.number
                self._sequence_state = "armed"
                self._sequence_reason = ""
        self._send(self._arm_reply)
        self._send_status()

    def _on_samples(self, samples: protocol.Samples) -> None:
        """Take what continues the sequence; the status tells the host what is still missing."""
        if samples.number == self._sequence_number and self.axis.has_sequence:
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
                self._sequence_state = _SEQUENCE_STATES[event.kind]
                self._sequence_reason = event.text
            # One status for each change, so that the host sees them all, in their order.
            self._send_status()
        if self.axis.silences != self._told_silences:
            self._told_silences = self.axis.silences
            self._send_status()
        for number, outcome in self.axis.take_completed():
            if number not in self._replies:
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
            self._send(protocol.Telemetry(ticks))
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
                axis.tick,
                axis.state,
                axis.activity,
                min(max(position, limits.min), limits.max),
                min(max(velocity, limits.min), limits.max),
                axis.fault.number,
                (axis.silences - self._silences) & 0xFFFF,
                axis.silence_tick if axis.silences != self._silences else 0,
                self._setpoint_number,
                self._setpoints_refused,
                self._sequence_number,
                self._sequence_state,
                axis.n_received,
                min(axis.buffer_free, 0xFFFF),
                axis.reason,
                self._sequence_reason,
            )
        )


def _phase(outcome: Outcome) -> protocol.ReplyPhase:
    return "success" if outcome.success else "failure"


class EmulatedController:
    """The emulated firmware at work: in real time, on a pseudo-terminal.

    Parameters
    ----------
    parameters : AxisParameters
        The axis, with the widest limits that it can be given.
    plant : Plant
        What the hub carries.
    device : SimulatedDevice, optional
        The controller's start, buffer and clock.
    link : path, optional
        A symbolic link to keep pointing at the pseudo-terminal, which has another name after every ``plug``.

    Raises
    ------
    HubConnectionError
        There is no pseudo-terminal available, or the link cannot be made.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        plant: Plant,
        device: SimulatedDevice | None = None,
        *,
        link: str | Path | None = None,
    ) -> None:
        self._parameters = parameters
        self._device = device or SimulatedDevice()
        self._plant = plant
        self._link = None if link is None else Path(link)
        self._lock = threading.Lock()
        self._boots = 1
        self._firmware = self._boot(self._device)
        self._rate_ppb = round(self._device.clock_drift_ppm * 1000)
        self._boot_steady_ns = time.monotonic_ns()
        self._boot_device_ns = self._device.clock_start_ns
        self._clock = HostClock(HostTime(self._boot_steady_ns, time.time_ns()))
        self._master: int | None = None
        self._slave: int | None = None
        self._wake_read, self._wake_write = os.pipe()
        self._backlog = bytearray()
        self._is_closing = False
        self._slave_path = ""
        self.plug()
        self._thread = threading.Thread(target=self._run, name="emulated-controller", daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        """Path under which a driver opens it as a serial port."""
        return self._slave_path if self._link is None else str(self._link)

    @property
    def axis(self) -> VirtualAxis:
        """The emulated axis, for tests and displays."""
        return self._firmware.axis

    # The camera's side --------------------------------------------------------------------------------

    @property
    def reached_ns(self) -> int:
        """The newest stamp [ns, UNIX] that ``snapshots`` can show."""
        with self._lock:
            return self._stamp_ns(self._firmware.axis.device_ns)

    def snapshots(self, stamps_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants up to ``reached_ns``, at most 4 s ago.

        Parameters
        ----------
        stamps_ns : sequence of int
            Instants [ns, UNIX], by the true map of the emulated clock, which the driver only estimates.

        Raises
        ------
        SnapshotError
            An instant is not reached yet, too long ago, or before the last restart.
        """
        with self._lock:
            return self._firmware.axis.snapshots([self._device_ns_of(int(stamp)) for stamp in stamps_ns])

    # Accidents ----------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, the device lives on."""
        with self._lock:
            for descriptor in (self._master, self._slave):
                if descriptor is not None:
                    os.close(descriptor)
            self._master = self._slave = None
            self._backlog.clear()
        self._wake()

    def plug(self) -> None:
        """Put the cable in: a new pseudo-terminal, under the same link."""
        try:
            master, slave = os.openpty()
        except OSError as err:
            raise HubConnectionError(
                f"no pseudo-terminal for the emulated controller: {err}; expected a mounted /dev/pts; "
                "close programs that hold many terminals"
            ) from err
        tty.setraw(slave)
        os.set_blocking(master, False)
        with self._lock:
            self._master, self._slave = master, slave
            self._slave_path = os.ttyname(slave)
        if self._link is not None:
            self._point_link()
        self._wake()

    def restart(self) -> None:
        """Cut the power for a moment: the firmware forgets everything, the hub stays where it is."""
        with self._lock:
            where = self._firmware.axis.true_position
            self._boots += 1
            self._firmware = self._boot(dataclasses.replace(self._device, initial_position=where))
            self._boot_steady_ns = time.monotonic_ns()

    def inject(self, data: bytes) -> None:
        """Put bytes on the line towards the host, as a disturbance would."""
        with self._lock:
            self._write(data)

    def close(self) -> None:
        """End the emulation and take the port away."""
        if self._is_closing:
            return
        self._is_closing = True
        self._wake()
        self._thread.join(timeout=2.0)
        self.unplug()
        os.close(self._wake_read)
        os.close(self._wake_write)
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    # Inside -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause_s = min(0.005, self._parameters.batch_ns * 0.25e-9)
        while not self._is_closing:
            master = self._master
            watched = [self._wake_read] if master is None else [self._wake_read, master]
            try:
                ready, _, _ = select.select(watched, [], [], pause_s)
            except (OSError, ValueError):
                # The cable was pulled between the two lines above.
                continue
            if self._wake_read in ready:
                os.read(self._wake_read, 64)
            with self._lock:
                data = b""
                if self._master is not None and self._master in ready:
                    with contextlib.suppress(OSError):
                        data = os.read(self._master, 65536)
                self._write(self._firmware.exchange(data, self._device_ns(time.monotonic_ns())))

    def _write(self, data: bytes) -> None:
        """Write what the line takes, and keep the rest for later; beyond the backlog it is lost."""
        if self._master is None:
            return
        if len(self._backlog) + len(data) <= MAX_BACKLOG:
            self._backlog += data
        if self._backlog:
            with contextlib.suppress(OSError):
                del self._backlog[: os.write(self._master, self._backlog)]

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._wake_write, b"!")

    def _boot(self, device: SimulatedDevice) -> EmulatedFirmware:
        boot_id = (os.getpid() << 12 | self._boots) & 0xFFFFFFFF
        return EmulatedFirmware(self._parameters, self._plant, device, boot_id=boot_id)

    def _device_ns(self, steady_ns: int) -> int:
        elapsed_ns = steady_ns - self._boot_steady_ns
        return self._boot_device_ns + elapsed_ns + elapsed_ns * self._rate_ppb // 1_000_000_000

    def _device_ns_of(self, stamp_ns: int) -> int:
        return self._device_ns(self._clock.steady_ns(stamp_ns))

    def _stamp_ns(self, device_ns: int) -> int:
        elapsed_ns = device_ns - self._boot_device_ns
        steady_ns = self._boot_steady_ns + elapsed_ns * 1_000_000_000 // (1_000_000_000 + self._rate_ppb)
        return self._clock.stamp_ns(steady_ns)

    def _point_link(self) -> None:
        assert self._link is not None
        try:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(self._slave_path)
        except OSError as err:
            raise HubConnectionError(
                f"link {self._link} to the emulated port {self._slave_path}: {err}; expected a writable "
                "folder and no file of that name; choose another emulator.port_link"
            ) from err
