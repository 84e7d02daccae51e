"""What the firmware costs its processor: instructions per tick and depth of the stack, counted by an emulator.

The microcontroller's firmware homes, enables, and follows a sequence of some seconds, with telemetry, in QEMU, which
counts time in instructions. What only the plant port does is left out. A tick of 1 ms has 168 000 cycles.

    python -m benchmarks.firmware_load firmware/build/stm32f405-plant.elf
"""

from __future__ import annotations

import argparse
import socket
import struct
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beam_ros.hub.firmware.machine import INSTRUCTION_SHIFT
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import RigidPlant
from benchmarks.paced_firmware import PacedFirmware

SECONDS = 2.0
CYCLES_PER_TICK = 168_000
LINE_BYTES = 92
"""What the line can bring in a tick, at 921 600 baud."""
_PAINT = 0xC5C5C5C5
_LIMITS = protocol.DeviceLimits.of(AxisParameters())


@dataclass(frozen=True)
class FirmwareLoad:
    """What a firmware costs.

    Parameters
    ----------
    in_tick : float
        Instructions of a tick itself, at most since power-on.
    mean, most : float
        Instructions from one tick to the next, telemetry and messages included: on average while a sequence runs, and
        at most since power-on.
    stack_bytes : int
        Deepest use of the stack since power-on.
    """

    in_tick: float
    mean: float
    most: float
    stack_bytes: int


class _Monitor:
    """QEMU's monitor, which reads the processor's memory."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))

    def read(self, address: int, size: int) -> bytes:
        """Return a piece of memory."""
        stored = self._path.with_suffix(".memory")
        stored.unlink(missing_ok=True)
        self._socket.sendall(f'pmemsave {address:#x} {size} "{stored}"\n'.encode())
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            if stored.exists() and stored.stat().st_size == size:
                return stored.read_bytes()
            time.sleep(0.01)
        raise TimeoutError("QEMU's monitor does not answer")


def _symbols(file: Path) -> dict[str, int]:
    listing = subprocess.run(
        ["arm-none-eabi-nm", "-C", str(file)], capture_output=True, text=True, check=True, timeout=30
    )
    rows = (line.split(maxsplit=2) for line in listing.stdout.splitlines())
    return {row[2]: int(row[0], 16) for row in rows if len(row) == 3}


class _Host:
    """The least that leads the firmware through a sequence."""

    def __init__(self, firmware: PacedFirmware) -> None:
        self._firmware = firmware
        self._decoder = FrameDecoder()
        self._waiting = b""
        self.ms = 0
        self.status: protocol.Status | None = None

    def say(self, *messages: protocol.Message, ms: int) -> None:
        """Say something, and let time pass with a heartbeat every 20 ms and a clock query every 200 ms."""
        end = self.ms + ms
        self._waiting += b"".join(map(protocol.encode, messages))
        while self.ms < end:
            self.ms += 1
            if self.ms % 20 == 0:
                self._waiting += protocol.encode(protocol.Heartbeat())
            if self.ms % 200 == 0:
                self._waiting += protocol.encode(protocol.ClockQuery(self.ms & 0xFFFF))
            data, self._waiting = self._waiting[:LINE_BYTES], self._waiting[LINE_BYTES:]
            for payload in self._decoder.feed(self._firmware.exchange(data, self.ms * 1_000_000)):
                message = protocol.decode(payload)
                if isinstance(message, protocol.Status):
                    self.status = message

    def play(self, seconds: float) -> None:
        """Let the firmware follow a slow sine, fed as its room allows."""
        n = round(seconds * 1000)
        values = 0.5 * np.sin(2 * np.pi * 5.0 * np.arange(n) / 1000.0)
        self.say(protocol.Arm(1, (self.ms + 100) * 1_000_000, n), ms=40)
        sent = 0
        while self.status is not None and self.status.sequence_state in ("armed", "running"):
            part = values[sent : sent + min(60, self.status.received + self.status.free - sent)]
            self.say(*([protocol.Samples(1, sent, part)] if len(part) else []), ms=20)
            sent += len(part)
        if self.status is None or self.status.sequence_state != "done":
            raise RuntimeError(f"the sequence did not run: {self.status}")


def measure(file: Path, folder: Path, seconds: float = SECONDS) -> FirmwareLoad:
    """Run a sequence on the emulated processor, and return what it cost.

    Parameters
    ----------
    file : path
        The firmware for the STM32F405 with a plant port.
    folder : path
        For the monitor's socket.
    seconds : float
        Length of the sequence [s].
    """
    symbols = _symbols(file)
    path = folder / "monitor"
    options = ("-monitor", f"unix:{path},server=on,wait=off")
    firmware = PacedFirmware(file, AxisParameters(), RigidPlant(0.8, 1e-3), 0.002, options=options)
    try:
        monitor = _Monitor(path)
        host = _Host(firmware)

        def load() -> tuple[int, int, int, int]:
            ticks, worked, most, in_tick = struct.unpack(
                "<4Q", monitor.read(symbols["beam::stm32::load"], 32)
            )
            return ticks, worked, most, in_tick

        host.say(protocol.Hello(), ms=100)
        host.say(protocol.SetLimits(1, _LIMITS), protocol.Request(1, "home"), ms=2000)
        host.say(protocol.Request(2, "enable"), ms=100)
        before = load()
        host.play(seconds)
        after = load()
        limit, top = symbols["stack_limit"], symbols["stack_top"]
        words = np.frombuffer(monitor.read(limit, (top - limit) // 4 * 4), "<u4")
    finally:
        firmware.close()
    per_ns = 2.0**-INSTRUCTION_SHIFT
    untouched = int(np.argmax(words != _PAINT))
    return FirmwareLoad(
        after[3] * per_ns,
        (after[1] - before[1]) / (after[0] - before[0]) * per_ns,
        after[2] * per_ns,
        top - limit - 4 * untouched,
    )


def main(argv: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        load = measure(options.file, Path(folder), options.seconds)
    print("                 instructions  share of a tick's 168 000 cycles, at one each")
    rows = (("a tick, at most", load.in_tick), ("mean of 1 ms", load.mean), ("most in 1 ms", load.most))
    for what, count in rows:
        print(f"{what:15}  {count:12.0f}  {count / CYCLES_PER_TICK:.3f}")
    print(f"stack: {load.stack_bytes} bytes at the deepest")


if __name__ == "__main__":
    main()
