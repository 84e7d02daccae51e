"""The firmware's programs, built by its own Makefile, and the core as an object that lives in virtual time."""

from __future__ import annotations

import shutil
import struct
import subprocess
from functools import cache
from pathlib import Path

import pytest

from beam_ros.hub.parameters import AxisParameters

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


@cache
def built(name: str) -> Path:
    """Return a program of ``firmware/build``, made now if it must be; skips the test where nothing can make it."""
    tools = ("make", "arm-none-eabi-gcc", "qemu-system-arm") if name.endswith(".elf") else ("make", "g++")
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool} on this machine: the firmware {name} needs it")
    made = subprocess.run(
        ["make", "-C", str(FIRMWARE), f"build/{name}"],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return FIRMWARE / "build" / name


class VirtualCore:
    """The compiled core with its ideal axis, in a process of its own; time is what the caller says.

    It is also a ``Bench``: what its sensors read can be interfered with.
    """

    _SIGNALS = (
        "is_counter_valid",
        "has_home_counter",
        "is_below_home",
        "is_at_low_end",
        "is_at_high_end",
        "has_drive_alarm",
        "has_lost_steps",
    )
    """In the order of the flags of the plant port."""

    def __init__(self, mode: int = 0, position: float = 0.01, *, program: Path | None = None) -> None:
        words = [str(program or built("beam-exchange")), str(mode), repr(position)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._signals: dict[str, bool] = {}
        self._is_stuck = False
        self._counts = 0
        self.true_position = position
        self.max_following_error = AxisParameters().max_following_error

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until ``device_ns``, take the bytes, and return what the core sends."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        flags = {name: 1 << bit for bit, name in enumerate(self._SIGNALS)}
        on, off = (
            sum(flags[name] for name, held in self._signals.items() if held is side) for side in (True, False)
        )
        head = struct.pack("<QBBBiI", device_ns, on, off, self._is_stuck, self._counts, len(data))
        self._process.stdin.write(head + data)
        self._process.stdin.flush()
        self.true_position, size = struct.unpack("<dI", self._process.stdout.read(12))
        return self._process.stdout.read(size)

    def hold_signals(self, **signals: bool) -> None:
        """Let signals read on or off whatever the hub does, and all others what is true."""
        self._signals = signals

    def lie(self, offset: float, _scale: float) -> None:
        """Let the encoder read ``offset`` more [m]."""
        self._counts = round(offset / AxisParameters().encoder_resolution)

    def stick(self, *, is_stuck: bool) -> None:
        """Let the hub stand still whatever is commanded, or move again."""
        self._is_stuck = is_stuck

    def __enter__(self) -> VirtualCore:
        return self

    def __exit__(self, *_error: object) -> None:
        self._process.stdin.close()  # type: ignore[union-attr]
        self._process.stdout.close()  # type: ignore[union-attr]
        self._process.wait(timeout=10)
