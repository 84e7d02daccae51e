"""A built firmware in the place of the suite's own emulator of one: bytes in, bytes out, and a hub behind it."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

from beam_ros.hub.firmware.driven_hub import DrivenHub
from beam_ros.hub.firmware.machine import FirmwareMachine
from beam_ros.hub.firmware.plant_port import Boot, decode, encode_reading, encode_setup
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import Plant

_CHUNK = 65_536
_MARGIN_NS = 300_000
"""A reading that comes less than this before its tick may be late, and is announced."""


class BuiltFirmware:
    """A built firmware at work, with a plant behind it. It runs by itself, in real time.

    Parameters
    ----------
    file : path
        The built firmware with a plant port, an ELF file for the STM32F405 or for this computer.
    parameters : AxisParameters
        The axis, with the widest limits that the firmware can be given.
    plant : Plant
        What the hub carries.
    device : SimulatedDevice, optional
        Where the hub stands at power-on, and how the encoder measures; buffer and clock are the firmware's own.
    n_starts : int
        Another one for every start.

    Attributes
    ----------
    axis : DrivenHub
        The hub.

    Raises
    ------
    HubParameterError
        There is no such file, or it is no ELF.
    HubConnectionError
        The firmware does not start.
    """

    def __init__(
        self,
        file: str | Path,
        parameters: AxisParameters,
        plant: Plant,
        device: SimulatedDevice | None = None,
        *,
        n_starts: int = 0,
    ) -> None:
        self.axis = DrivenHub(parameters, plant, device)
        self._parameters = parameters
        self._frames = FrameDecoder()
        self._to_firmware = bytearray()
        self._machine = FirmwareMachine(file, n_starts)
        for end in (self._machine.line, self._machine.plant):
            end.setblocking(False)

    @property
    def sources(self) -> tuple[socket.socket, ...]:
        """What to wait for: where one of these can be read, ``exchange`` has something to do."""
        return (self._machine.line, self._machine.plant) if self._machine.is_running else ()

    @property
    def trouble(self) -> str:
        """Why it goes on no more; empty while it does."""
        machine = self._machine
        return (
            "" if machine.is_running else f"the firmware (process {machine.pid}) ended: {machine.last_words}"
        )

    @property
    def pid(self) -> int:
        """Number of its process."""
        return self._machine.pid

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Let the plant answer the firmware, hand over what the line brought, and return what to send.

        Parameters
        ----------
        data : bytes
            Received; any bytes at all.
        device_ns : int
            The clock that ``axis`` is asked by, now [ns].
        """
        if not self._machine.is_running:
            return b""
        for payload in self._frames.feed(_available(self._machine.plant)):
            message = decode(payload)
            if isinstance(message, Boot):
                self.axis.reset()
                self._answer(encode_setup(self._parameters), is_awaited=True)
            else:
                self.axis.move(message, device_ns)
                self._answer(b"", is_awaited=device_ns > self.axis.device_ns - _MARGIN_NS)
        self._to_firmware += data
        if self._to_firmware:
            try:
                del self._to_firmware[: self._machine.line.send(self._to_firmware)]
            except OSError:
                # Nobody takes it: what a line carries then is lost.
                self._to_firmware.clear()
        return _available(self._machine.line)

    def _answer(self, setup: bytes, *, is_awaited: bool) -> None:
        with contextlib.suppress(OSError):
            self._machine.plant.sendall(setup + encode_reading(self.axis.reading))
        if is_awaited:
            self._machine.ring()

    def close(self) -> None:
        """Switch it off; the hub stops where it is."""
        self._machine.close()
        self.axis.reset()


def _available(end: socket.socket) -> bytes:
    try:
        return end.recv(_CHUNK)
    except OSError:
        return b""
