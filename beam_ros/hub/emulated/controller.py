"""The emulated firmware at work: with a clock that drifts, a thread, a pseudo-terminal, and faults on request.

The driver meets a serial port. For a simulated camera the controller shows its axis with host stamps.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from beam_ros.arrays import StampArray
from beam_ros.hub.contract import HostTime
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.emulated.injected_faults import (
    KINDS,
    FaultSchedule,
    InjectedFault,
    disturb,
)
from beam_ros.hub.emulated.pseudo_terminal import MAX_BACKLOG, PseudoTerminal
from beam_ros.hub.emulated.unruly_line import UnrulyLine
from beam_ros.hub.errors import HubParameterError
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.drifting_clock import DriftingClock
from beam_ros.hub.simulated.motion import CarriedHub, Snapshots
from beam_ros.hub.simulated.plant import Plant


class Firmware(Protocol):
    """A device on a serial line, as ``EmulatedController`` runs it: the suite's own, or somebody else's."""

    @property
    def axis(self) -> CarriedHub:
        """Hub and beam."""

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Take bytes from the line and advance to a device time [ns]; return the bytes for the host."""


@runtime_checkable
class LyingFirmware(Protocol):
    """A firmware whose clock, at least, can be wrong on request."""

    def disturb(self, injected: InjectedFault, *, begins: bool) -> None:
        """Let a fault of the clock or the firmware begin or end."""


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


@runtime_checkable
class DelayingFirmware(Protocol):
    """A firmware that answers after a while of its own."""

    @property
    def due_ns(self) -> int | None:
        """Device time at which the next answer leaves [ns]."""


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
        self._longest_pause_s = min(0.005, parameters.batch_ns * 0.25e-9)
        self._faults = FaultSchedule()
        self._lines = {
            "to_host": UnrulyLine(line_baud, fifo_bytes, seed=1),
            "to_device": UnrulyLine(line_baud, fifo_bytes, seed=2),
        }
        self._is_stalled = False
        self._device = device or SimulatedDevice()
        make = boot or (lambda device, boot_id: EmulatedFirmware(parameters, plant, device, boot_id=boot_id))
        boot_ids = itertools.count(os.getpid() << 12 | 1)
        self._boot: Callable[[SimulatedDevice], Firmware] = lambda device: make(
            device, next(boot_ids) & 0xFFFFFFFF
        )
        self._lock = threading.Lock()
        self._firmware = self._boot(self._device)
        self._start_ns = time.monotonic_ns()
        self._time = DriftingClock(self._start_ns, self._device.clock_start_ns, self._device.clock_drift_ppm)
        self._clock = HostClock(HostTime(self._start_ns, time.time_ns()))
        self._terminal = PseudoTerminal(None if link is None else Path(link))
        self._wakers = os.pipe()
        self._is_closing = False
        self.plug()
        self._thread = threading.Thread(target=self._run, name="emulated-controller", daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        """Path under which a driver opens it as a serial port."""
        return self._terminal.port

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
            return self._clock.stamp_ns(self._time.host_ns(self._firmware.axis.device_ns))

    def snapshots(self, stamps_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants up to ``reached_ns``, at most 4 s ago.

        Parameters
        ----------
        stamps_ns : sequence of int
            Instants [ns, UNIX], by the true map of the emulated clock.

        Raises
        ------
        SnapshotError
            An instant is not reached yet, too long ago, or before the last restart.
        """
        with self._lock:
            return self._firmware.axis.snapshots([self.device_ns(int(stamp)) for stamp in stamps_ns])

    def device_ns(self, stamp_ns: int) -> int:
        """Return what the emulated clock truly reads at a stamp [ns, UNIX]; the driver only estimates it."""
        return self._time.device_ns(self._clock.steady_ns(stamp_ns))

    # Accidents ----------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, the device lives on."""
        with self._lock:
            self._terminal.unplug()
            for line in self._lines.values():
                line.clear()
        self._wake()

    def plug(self) -> None:
        """Put the cable in: a new pseudo-terminal, under the same link."""
        with self._lock:
            self._terminal.plug()
        self._wake()

    def restart(self) -> None:
        """Cut the power for a moment: the firmware forgets everything, the hub stays where it is."""
        with self._lock:
            where = self._firmware.axis.true_position
            self._switch_off()
            self._firmware = self._boot(dataclasses.replace(self._device, initial_position=where))
            self._time.set(time.monotonic_ns(), self._device.clock_start_ns)

    def inject(self, data: bytes) -> None:
        """Put bytes on the line towards the host, as a disturbance would."""
        with self._lock:
            self._terminal.write(data)

    def check_faults(self, faults: Sequence[InjectedFault]) -> None:
        """Raise ``HubParameterError`` where these faults cannot happen to this device."""
        for fault in faults:
            place = KINDS[fault.kind].place
            if place == "firmware" and not isinstance(self._firmware, EmulatedFirmware):
                raise HubParameterError(
                    f"fault {fault.kind}: only the suite's own emulated firmware lies; leave the fault out, or set "
                    "axis.kind to beam and emulator.firmware to python"
                )
            if place == "clock" and not isinstance(self._firmware, LyingFirmware):
                raise HubParameterError(
                    f"fault {fault.kind}: nobody can disturb the clock of this device; leave the fault out, or "
                    "set axis.kind to beam and emulator.firmware to python"
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
            return self._faults.take_notes()

    def close(self) -> None:
        """End the emulation and take the port away."""
        if self._is_closing:
            return
        self._is_closing = True
        self._wake()
        self._thread.join(timeout=2.0)
        self._switch_off()
        self.unplug()
        for end in self._wakers:
            os.close(end)

    # Inside -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._is_closing:
            pause_s = self._pause_s()
            master = self._terminal.descriptor
            watched: list[int | socket.socket] = [self._wakers[0]]
            if master is not None:
                watched.append(master)
            if isinstance(self._firmware, RunningFirmware) and not self._is_stalled:
                watched += self._firmware.sources
            try:
                ready, _, _ = select.select(watched, [], [], pause_s)
            except (OSError, ValueError):
                # The cable was pulled between the two lines above.
                continue
            if self._wakers[0] in ready:
                os.read(self._wakers[0], 64)
            self._let_faults_happen()
            with self._lock:
                data = self._terminal.read() if self._terminal.descriptor in ready else b""
                now_ns = time.monotonic_ns()
                to_device, to_host = self._lines["to_device"], self._lines["to_host"]
                to_device.put(data, now_ns)
                if not self._is_stalled:
                    heard = to_device.take(now_ns)
                    to_host.put(self._firmware.exchange(heard, self._time.device_ns(now_ns)), now_ns)
                self._terminal.write(to_host.take(now_ns))

    def _pause_s(self) -> float:
        """Return how long nothing is due, if nothing comes [s]."""
        pause_s = self._longest_pause_s
        with self._lock:
            arrivals = [line.next_ns for line in self._lines.values()]
            if isinstance(self._firmware, DelayingFirmware) and self._firmware.due_ns is not None:
                arrivals.append(self._time.host_ns(self._firmware.due_ns))
        due = [ns for ns in arrivals if ns is not None]
        if due and not self._is_stalled:
            pause_s = min(pause_s, max(0.0, (min(due) - time.monotonic_ns()) * 1e-9))
        return pause_s

    def _let_faults_happen(self) -> None:
        with self._lock:
            changes = list(self._faults.changes(self.elapsed))
        for fault, begins in changes:
            _HAPPENINGS[fault.kind](self, fault, begins)

    def _disturb_axis(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            disturb(self._firmware.axis, fault, begins=begins)

    def _disturb_line(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            for direction, line in self._lines.items():
                if fault.direction in (direction, "both"):
                    (line.begin if begins else line.end)(fault)

    def _pull_cable(self, _fault: InjectedFault, begins: bool) -> None:
        if begins:
            self.unplug()
        elif self._terminal.descriptor is None:
            self.plug()

    def _cut_power(self, _fault: InjectedFault, _begins: bool) -> None:
        self.restart()

    def _stall(self, _fault: InjectedFault, begins: bool) -> None:
        self._is_stalled = begins

    def _let_clock_drift(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            self._time.change_rate(time.monotonic_ns(), (1 if begins else -1) * fault.amounts["ppm"])

    def _let_firmware_lie(self, fault: InjectedFault, begins: bool) -> None:
        with self._lock:
            assert isinstance(self._firmware, LyingFirmware)
            self._firmware.disturb(fault, begins=begins)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._wakers[1], b"!")

    def _switch_off(self) -> None:
        if isinstance(self._firmware, RunningFirmware):
            self._firmware.close()


_HAPPENINGS: dict[str, Callable[[EmulatedController, InjectedFault, bool], None]] = {
    "corrupt": EmulatedController._disturb_line,
    "drop": EmulatedController._disturb_line,
    "delay": EmulatedController._disturb_line,
    "drift": EmulatedController._let_clock_drift,
    "step": EmulatedController._let_firmware_lie,
    "wrap": EmulatedController._let_firmware_lie,
    "ignored_stop": EmulatedController._let_firmware_lie,
    "no_number": EmulatedController._let_firmware_lie,
    "missed_ticks": EmulatedController._let_firmware_lie,
    "trip": EmulatedController._let_firmware_lie,
    "reset": EmulatedController._cut_power,
    "unplug": EmulatedController._pull_cable,
    "stall": EmulatedController._stall,
    "lying_encoder": EmulatedController._disturb_axis,
    "sticking_axis": EmulatedController._disturb_axis,
}
