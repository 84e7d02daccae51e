"""A built firmware in virtual time: it goes on only when its caller lets it, by so many ticks as are asked for.

So its answers do not depend on how busy this computer is, and its work is counted in instructions.
"""

from __future__ import annotations

import fcntl
import select
import struct
import termios
import time
from collections.abc import Sequence
from pathlib import Path

from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.firmware.driven_hub import DrivenHub
from beam_ros.hub.firmware.machine import START_S, FirmwareMachine
from beam_ros.hub.firmware.plant_port import Drive, decode, encode_reading, encode_setup
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import Plant

_CHUNK = 65_536
_NUDGE_S = 0.1
_PIECE = 1024
"""Bytes that the firmware's buffer surely holds in one tick."""


class PacedFirmware:
    """A built firmware for the STM32F405, in an emulator that counts time in instructions.

    Parameters
    ----------
    file : path
        The built firmware with a plant port, an ELF file.
    parameters : AxisParameters
        The axis, with the widest limits that the firmware can be given.
    plant : Plant
        What the hub carries.
    initial_position : float
        Where the hub stands at power-on, seen from home [m].
    n_starts : int
        Another one for every start.
    options : sequence of str
        More arguments for QEMU.

    Attributes
    ----------
    axis : DrivenHub
        The hub.

    Raises
    ------
    HubParameterError
        There is no such file, or it is for another computer.
    HubConnectionError
        QEMU is missing, or the firmware does not start.
    """

    def __init__(
        self,
        file: str | Path,
        parameters: AxisParameters,
        plant: Plant,
        initial_position: float = 0.0,
        *,
        n_starts: int = 0,
        options: Sequence[str] = (),
    ) -> None:
        self.axis = DrivenHub(parameters, plant, SimulatedDevice(initial_position))
        self._period_ns = parameters.period_ns
        self._frames = FrameDecoder()
        self._machine = FirmwareMachine(file, n_starts, options, is_paced=True)
        self._said = bytearray()
        self._tick = 0
        try:
            self._answer(encode_setup(parameters, parameters.max_following_error))
        except BaseException:
            self._machine.close()
            raise

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until ``device_ns``, take what the line brought by then, and return what to send.

        Parameters
        ----------
        data : bytes
            Received; any bytes at all. They are heard in the last tick, long ones in several; if none is due, more
            ticks are done.
        device_ns : int
            Until which time of the firmware's clock it lives [ns]; it is at 0 when it starts.

        Raises
        ------
        HubConnectionError
            The firmware has come to its end.
        """
        pieces = [data[k : k + _PIECE] for k in range(0, len(data), _PIECE)]
        due = max(-(-device_ns // self._period_ns) - self._tick, len(pieces))
        for left in range(due, 0, -1):
            if left <= len(pieces):
                self._hand_over(pieces[-left])
            self._answer()
        said, self._said = bytes(self._said), bytearray()
        return said

    def close(self) -> None:
        """Switch it off; the hub stops where it is."""
        self._machine.close()
        self.axis.reset()

    def _answer(self, setup: bytes = b"") -> None:
        """Give the reading that the firmware waits for, and wait until it waits for the next one."""
        machine = self._machine
        assert machine.bell is not None
        deadline = time.monotonic() + START_S
        is_told = not setup
        if is_told:
            self._tell()
        while time.monotonic() < deadline and machine.is_running:
            ready = select.select([machine.plant, machine.line, machine.bell], [], [], _NUDGE_S)[0]
            if machine.plant in ready:
                for message in map(decode, self._frames.feed(machine.plant.recv(_CHUNK))):
                    if isinstance(message, Drive):
                        self.axis.move(message, message.tick * self._period_ns)
                        self._tick = message.tick + 1
                    elif not is_told:
                        is_told = True
                        self._tell(setup)
            self._listen()
            if machine.bell in ready and machine.bell.recv(_CHUNK) and self._tick:
                return
            if not ready:
                # Rarely an emulated processor sleeps through an interrupt. The end of no frame wakes it.
                machine.line.sendall(b"\0")
        raise self._end()

    def _tell(self, setup: bytes = b"") -> None:
        self._machine.plant.sendall(setup + encode_reading(self.axis.reading))
        self._machine.ring()

    def _hand_over(self, data: bytes) -> None:
        """Send bytes, and wait until the serial port has taken them; the firmware takes them and waits meanwhile."""
        line = self._machine.line
        deadline = time.monotonic() + START_S
        line.sendall(data)
        while struct.unpack("i", fcntl.ioctl(line, termios.TIOCOUTQ, bytes(4)))[0]:
            if time.monotonic() > deadline or not self._machine.is_running:
                raise self._end()
            self._listen()
            time.sleep(5e-5)

    def _listen(self) -> None:
        while select.select([self._machine.line], [], [], 0.0)[0] and self._machine.is_running:
            self._said += self._machine.line.recv(_CHUNK)

    def _end(self) -> HubConnectionError:
        return HubConnectionError(
            f"the firmware has ended or hangs ({self._machine.last_words}); expected it to go on; "
            "build it again with `make firmware`"
        )
