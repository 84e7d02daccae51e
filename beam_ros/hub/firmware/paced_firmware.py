"""A built firmware in virtual time: it goes on only when its caller lets it, by so many ticks as are asked for.

So its answers do not depend on how busy this computer is, and its work is counted in instructions.
"""

from __future__ import annotations

import fcntl
import select
import struct
import termios
import time
from pathlib import Path

from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.firmware.driven_hub import DrivenHub
from beam_ros.hub.firmware.machine import START_S, FirmwareMachine
from beam_ros.hub.firmware.plant_port import Boot, Drive, decode, encode_reading, encode_setup
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import Plant

_CHUNK = 65_536


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
    ) -> None:
        self.axis = DrivenHub(parameters, plant, initial_position)
        self._period_ns = parameters.period_ns
        self._frames = FrameDecoder()
        self._machine = FirmwareMachine(file, n_starts, is_paced=True)
        self._said = bytearray()
        self._tick = 0
        try:
            while not isinstance(self._hear(), Boot):
                pass
            self._answer(encode_setup(parameters))
            self._note(self._hear())
        except BaseException:
            self._machine.close()
            raise

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until ``device_ns``, take what the line brought by then, and return what to send.

        Parameters
        ----------
        data : bytes
            Received; any bytes at all. They are heard after the last tick; without one, one more is done.
        device_ns : int
            Until which time of the firmware's clock it lives [ns]; it is at 0 when it starts.

        Raises
        ------
        HubConnectionError
            The firmware has come to its end.
        """
        due = max(-(-device_ns // self._period_ns) - self._tick, 1 if data else 0)
        for left in range(due, 0, -1):
            if left == 1:
                self._hand_over(data)
            self._answer()
            self._note(self._hear())
        # All that a tick has said was written before the next one began.
        self._listen()
        said, self._said = bytes(self._said), bytearray()
        return said

    def close(self) -> None:
        """Switch it off; the hub stops where it is."""
        self._machine.close()
        self.axis.reset()

    def _answer(self, setup: bytes = b"") -> None:
        self._machine.plant.sendall(setup + encode_reading(self.axis.reading))
        self._machine.ring()

    def _note(self, message: Boot | Drive) -> None:
        """Move through the tick that has begun; the firmware now waits for the reading of the next one."""
        if isinstance(message, Drive):
            self.axis.move(message, message.tick * self._period_ns)
            self._tick = message.tick + 1

    def _hand_over(self, data: bytes) -> None:
        """Send bytes, and wait until the serial port has taken them; the firmware takes them and waits meanwhile."""
        if not data:
            return
        line = self._machine.line
        deadline = time.monotonic() + START_S
        line.sendall(data)
        while struct.unpack("i", fcntl.ioctl(line, termios.TIOCOUTQ, bytes(4)))[0]:
            if time.monotonic() > deadline or not self._machine.is_running:
                raise self._end()
            self._listen()
            time.sleep(5e-5)

    def _hear(self) -> Boot | Drive:
        while True:
            ready = select.select([self._machine.plant, self._machine.line], [], [], START_S)[0]
            if self._machine.line in ready:
                self._listen()
            if self._machine.plant in ready:
                heard = self._machine.plant.recv(_CHUNK)
                payloads = self._frames.feed(heard)
                if payloads:
                    return decode(payloads[-1])
                if not heard:
                    raise self._end()
            elif not ready:
                raise self._end()

    def _listen(self) -> None:
        while select.select([self._machine.line], [], [], 0.0)[0] and self._machine.is_running:
            self._said += self._machine.line.recv(_CHUNK)

    def _end(self) -> HubConnectionError:
        return HubConnectionError(
            f"the firmware has ended or hangs ({self._machine.last_words}); expected it to go on; "
            "build it again with `make firmware`"
        )
