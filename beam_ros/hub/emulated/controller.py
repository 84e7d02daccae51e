"""The emulated firmware at work: with a clock that drifts, a thread, a pseudo-terminal, and faults on request.

The driver meets a serial port. For a simulated camera the controller shows its axis with host stamps.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from beam_ros.arrays import StampArray
from beam_ros.hub.contract import HostTime
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.emulated.injected_faults import (
    KINDS,
    DisturbedAxis,
    FaultSchedule,
    InjectedFault,
    disturb,
    note,
)
from beam_ros.hub.emulated.unruly_line import UnrulyLine
from beam_ros.hub.errors import HubConnectionError, HubParameterError
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.hub.simulated.plant import Plant

MAX_BACKLOG = 65_536
"""Bytes that wait where the line takes no more [2.7 s of telemetry]."""


class CarriedBeam(DisturbedAxis, Protocol):
    """The hub of an emulated device, and the beam on it, as a camera needs them."""

    @property
    def device_ns(self) -> int:
        """Device time up to which the hub has moved [ns]."""

    @property
    def true_position(self) -> float:
        """Where the hub really is, seen from home [m]."""

    def snapshots(self, times_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants of the recent past."""


class Firmware(Protocol):
    """A device on a serial line, as ``EmulatedController`` runs it: the suite's own, or somebody else's.

    Attributes
    ----------
    clock_step_ns : int
        By how much the clock that the host sees was set forward [ns].
    clock_wrap_ns : int
        Where that clock begins at zero again [ns]; 0: never.
    """

    clock_step_ns: int
    clock_wrap_ns: int

    @property
    def axis(self) -> CarriedBeam:
        """Hub and beam."""

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Take bytes from the line and advance to a device time [ns]; return the bytes for the host."""


@runtime_checkable
class RunningFirmware(Protocol):
    """A firmware that is a program of its own, with a clock that nobody can disturb."""

    @property
    def sources(self) -> tuple[socket.socket, ...]:
        """What to wait for: where one of these can be read, ``exchange`` has something to do."""

    @property
    def trouble(self) -> str:
        """Why it goes on no more; empty while it does."""

    def close(self) -> None:
        """Switch it off."""


FirmwareMaker = Callable[[SimulatedDevice, int], Firmware]
"""Boots a firmware: on a device, with a boot id."""


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
    line_baud : int, optional
        Bits per second at which bytes travel; 0: as fast as USB.
    fifo_bytes : int, optional
        Bytes that wait in each direction; what comes beyond is lost.
    boot : callable, optional
        Boots somebody else's firmware in place of the suite's own.

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
        line_baud: int = 0,
        fifo_bytes: int = MAX_BACKLOG,
        boot: FirmwareMaker | None = None,
    ) -> None:
        self._parameters = parameters
        self._faults = FaultSchedule()
        self._to_host = UnrulyLine(line_baud, fifo_bytes, seed=1)
        self._to_device = UnrulyLine(line_baud, fifo_bytes, seed=2)
        self._is_stalled = False
        self._notes: list[str] = []
        self._device = device or SimulatedDevice()
        self._maker = boot or (
            lambda device, boot_id: EmulatedFirmware(parameters, plant, device, boot_id=boot_id)
        )
        self._link = None if link is None else Path(link)
        self._lock = threading.Lock()
        self._boots = 1
        self._firmware = self._boot(self._device)
        self._rate_ppb = round(self._device.clock_drift_ppm * 1000)
        self._start_ns = self._boot_steady_ns = time.monotonic_ns()
        self._boot_device_ns = self._device.clock_start_ns
        self._clock = HostClock(HostTime(self._start_ns, time.time_ns()))
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
        """The emulated axis of the suite's own firmware, for tests and displays."""
        axis = self._firmware.axis
        assert isinstance(axis, VirtualAxis)
        return axis

    @property
    def trouble(self) -> str:
        """Why the firmware goes on no more; empty while it does."""
        return self._firmware.trouble if isinstance(self._firmware, RunningFirmware) else ""

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
        # The terminal's number may be somebody else's at once, and the link another emulator's already.
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self._slave_path:
            self._link.unlink()
        with self._lock:
            for descriptor in (self._master, self._slave):
                if descriptor is not None:
                    os.close(descriptor)
            self._master = self._slave = None
            self._backlog.clear()
            self._to_host.clear()
            self._to_device.clear()
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
            self._switch_off()
            self._firmware = self._boot(dataclasses.replace(self._device, initial_position=where))
            self._boot_steady_ns, self._boot_device_ns = time.monotonic_ns(), self._device.clock_start_ns

    def inject(self, data: bytes) -> None:
        """Put bytes on the line towards the host, as a disturbance would."""
        with self._lock:
            self._write(data)

    def check_faults(self, faults: Sequence[InjectedFault]) -> None:
        """Raise ``HubParameterError`` where these faults cannot happen here: a built firmware's clock is its own."""
        of_clock = [fault.kind for fault in faults if KINDS[fault.kind].place == "clock"]
        if of_clock and isinstance(self._firmware, RunningFirmware):
            raise HubParameterError(
                f"fault {of_clock[0]}: nobody can disturb the clock of a built firmware; leave the fault out, or "
                "set emulator.firmware to python"
            )

    def bring_about(self, faults: Sequence[InjectedFault]) -> None:
        """Let faults happen, their times counted from the start."""
        with self._lock:
            self._faults.add(faults)
        self._wake()

    @property
    def elapsed(self) -> float:
        """Time since the start [s], from which the times of faults count."""
        return (time.monotonic_ns() - self._start_ns) * 1e-9

    def take_notes(self) -> list[str]:
        """Return what went wrong on request since the last call, for the log."""
        with self._lock:
            notes, self._notes = self._notes, []
        return notes

    def close(self) -> None:
        """End the emulation and take the port away."""
        if self._is_closing:
            return
        self._is_closing = True
        self._wake()
        self._thread.join(timeout=2.0)
        self._switch_off()
        self.unplug()
        os.close(self._wake_read)
        os.close(self._wake_write)

    # Inside -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._is_closing:
            pause_s = self._pause_s()
            master = self._master
            watched: list[int | socket.socket] = [self._wake_read]
            if master is not None:
                watched.append(master)
            if isinstance(self._firmware, RunningFirmware) and not self._is_stalled:
                watched += self._firmware.sources
            try:
                ready, _, _ = select.select(watched, [], [], pause_s)
            except (OSError, ValueError):
                # The cable was pulled between the two lines above.
                continue
            if self._wake_read in ready:
                os.read(self._wake_read, 64)
            self._let_faults_happen()
            with self._lock:
                data = b""
                if self._master is not None and self._master in ready:
                    with contextlib.suppress(OSError):
                        data = os.read(self._master, 65536)
                now_ns = time.monotonic_ns()
                self._to_device.put(data, now_ns)
                if not self._is_stalled:
                    heard = self._to_device.take(now_ns)
                    self._to_host.put(self._firmware.exchange(heard, self._device_ns(now_ns)), now_ns)
                self._write(self._to_host.take(now_ns))

    def _pause_s(self) -> float:
        """Return how long nothing is due, if nothing comes [s]."""
        pause_s = min(0.005, self._parameters.batch_ns * 0.25e-9)
        with self._lock:
            arrivals = [line.next_ns for line in (self._to_host, self._to_device)]
        due = [ns for ns in arrivals if ns is not None]
        if due and not self._is_stalled:
            pause_s = min(pause_s, max(0.0, (min(due) - time.monotonic_ns()) * 1e-9))
        return pause_s

    def _let_faults_happen(self) -> None:
        with self._lock:
            changes = list(self._faults.changes(self.elapsed))
            self._notes += [note(fault, begins=begins) for fault, begins in changes]
        for fault, begins in changes:
            _HAPPENINGS[fault.kind](self, fault, begins)

    def _disturb_axis(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            disturb(self._firmware.axis, fault, begins=begins)

    def _disturb_line(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            for line, direction in ((self._to_host, "to_host"), (self._to_device, "to_device")):
                if fault.direction in (direction, "both"):
                    (line.begin if begins else line.end)(fault)

    def _pull_cable(self, _fault: InjectedFault, begins: bool) -> None:
        if begins:
            self.unplug()
        elif self._master is None:
            self.plug()

    def _cut_power(self, _fault: InjectedFault, _begins: bool) -> None:
        self.restart()

    def _stall(self, _fault: InjectedFault, begins: bool) -> None:
        self._is_stalled = begins

    def _let_clock_drift(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            now_ns = time.monotonic_ns()
            self._boot_device_ns, self._boot_steady_ns = self._device_ns(now_ns), now_ns
            self._rate_ppb += round((1 if begins else -1) * fault.amounts["ppm"] * 1000)

    def _step_clock(self, fault: InjectedFault, _begins: bool) -> None:
        self._firmware.clock_step_ns += round(fault.amounts["seconds"] * 1e9)

    def _wrap_clock(self, fault: InjectedFault, begins: bool) -> None:
        self._firmware.clock_wrap_ns = 2 ** round(fault.amounts["bits"]) if begins else 0

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

    def _boot(self, device: SimulatedDevice) -> Firmware:
        return self._maker(device, (os.getpid() << 12 | self._boots) & 0xFFFFFFFF)

    def _switch_off(self) -> None:
        if isinstance(self._firmware, RunningFirmware):
            self._firmware.close()

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


_HAPPENINGS: dict[str, Callable[[EmulatedController, InjectedFault, bool], None]] = {
    "corrupt": EmulatedController._disturb_line,
    "drop": EmulatedController._disturb_line,
    "delay": EmulatedController._disturb_line,
    "drift": EmulatedController._let_clock_drift,
    "step": EmulatedController._step_clock,
    "wrap": EmulatedController._wrap_clock,
    "reset": EmulatedController._cut_power,
    "unplug": EmulatedController._pull_cable,
    "stall": EmulatedController._stall,
    "lying_encoder": EmulatedController._disturb_axis,
    "sticking_axis": EmulatedController._disturb_axis,
}
