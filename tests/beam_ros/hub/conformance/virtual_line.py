"""A line on which no time passes but what a test lets pass."""

from __future__ import annotations

from typing import Protocol


class Firmware(Protocol):
    """Bytes in, bytes out, device time as an argument."""

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Live until then, take what came, and return what is sent."""


class VirtualLine:
    """A firmware in virtual time."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._now_ns = 0
        self._output = b""

    def send(self, data: bytes) -> None:
        self._output += self._firmware.exchange(data, self._now_ns)

    def receive(self, timeout_s: float) -> bytes:
        end_ns = self._now_ns + max(round(timeout_s * 1e9), 1000)
        while not self._output and self._now_ns < end_ns:
            self._now_ns = min(self._now_ns + 2_000_000, end_ns)
            self._output += self._firmware.exchange(b"", self._now_ns)
        output, self._output = self._output, b""
        return output

    def now_ns(self) -> int:
        return self._now_ns
