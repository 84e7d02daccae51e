"""The firmware's programs, built by its own Makefile, and the core as an object that lives in virtual time."""

from __future__ import annotations

import shutil
import struct
import subprocess
from functools import cache
from pathlib import Path

import pytest

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
    """The compiled core with its ideal axis, in a process of its own; time is what the caller says."""

    def __init__(self, mode: int = 0, position: float = 0.01, accident: str = "") -> None:
        words = [str(built("beam-exchange")), str(mode), repr(position), *([accident] if accident else [])]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until ``device_ns``, take the bytes, and return what the core sends."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(struct.pack("<QI", device_ns, len(data)) + data)
        self._process.stdin.flush()
        (size,) = struct.unpack("<I", self._process.stdout.read(4))
        return self._process.stdout.read(size)

    def __enter__(self) -> VirtualCore:
        return self

    def __exit__(self, *_error: object) -> None:
        self._process.stdin.close()  # type: ignore[union-attr]
        self._process.stdout.close()  # type: ignore[union-attr]
        self._process.wait(timeout=10)
