"""A serial line as it may be: paced to its baud, with a bounded buffer, and with bytes changed, lost or late."""

from __future__ import annotations

import random
from collections import deque

from beam_ros.hub.emulated.injected_faults import InjectedFault

BITS_PER_BYTE = 10
"""Start bit, eight bits, stop bit."""


class UnrulyLine:
    """One direction of a line: bytes go in with the time, and come out when they have arrived.

    Parameters
    ----------
    baud : int
        Bits per second; 0: as fast as bytes come.
    fifo_bytes : int
        Bytes that wait at most; what comes beyond is lost.
    seed : int
        Of what is changed and lost.

    Attributes
    ----------
    n_lost : int
        Bytes that did not find room.
    """

    def __init__(self, baud: int, fifo_bytes: int, seed: int) -> None:
        self.n_lost = 0
        self._byte_ns = BITS_PER_BYTE * 1_000_000_000 // baud if baud else 0
        self._fifo_bytes = fifo_bytes
        self._random = random.Random(seed)
        self._faults: list[InjectedFault] = []
        self._free_ns = 0
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._n_waiting = 0

    @property
    def next_ns(self) -> int | None:
        """When the next byte arrives [ns]; None where none is under way."""
        return self._waiting[0][0] if self._waiting else None

    def begin(self, fault: InjectedFault) -> None:
        """Let a fault begin."""
        self._faults.append(fault)

    def end(self, fault: InjectedFault) -> None:
        """Let it end."""
        self._faults.remove(fault)

    def clear(self) -> None:
        """Lose what is under way."""
        self._waiting.clear()
        self._n_waiting = 0

    def put(self, data: bytes, now_ns: int) -> None:
        """Take bytes that are sent now."""
        delay_ns = 0
        for fault in self._faults:
            if fault.kind == "delay":
                delay_ns += round(fault.amounts["seconds"] * 1e9)
            elif fault.kind == "drop":
                share = fault.amounts["share"]
                data = bytes(byte for byte in data if self._random.random() >= share)
            else:
                data = self._corrupted(data, fault.amounts["share"])
        room = max(0, self._fifo_bytes - self._n_waiting)
        self.n_lost += max(0, len(data) - room)
        data = data[:room]
        self._n_waiting += len(data)
        if not self._byte_ns:
            if data:
                self._waiting.append((now_ns + delay_ns, data))
            return
        for k in range(len(data)):
            self._free_ns = max(self._free_ns, now_ns) + self._byte_ns
            self._waiting.append((self._free_ns + delay_ns, data[k : k + 1]))

    def take(self, now_ns: int) -> bytes:
        """Return the bytes that have arrived by now."""
        arrived = bytearray()
        while self._waiting and self._waiting[0][0] <= now_ns:
            arrived += self._waiting.popleft()[1]
        self._n_waiting -= len(arrived)
        return bytes(arrived)

    def _corrupted(self, data: bytes, share: float) -> bytes:
        return bytes(
            byte ^ 1 << self._random.randrange(8) if self._random.random() < share else byte for byte in data
        )
