"""A sequence, put together from its chunks and kept as it came: ticks are made of it piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import MAX_CHUNK_POINTS, SequenceChunk
from beam_ros.hub.parameters import AxisParameters, Hold

MAX_CHUNKS = 20_000
MAX_TICKS = 3_600_000
"""Longest sequence in device ticks, an hour at 1 kHz: 29 MB of samples, some seconds of checking."""
BLOCK_TICKS = 16_384
"""Ticks that are looked at together: more would only cost memory."""


@dataclass(frozen=True)
class Sequence:
    """A complete sequence, to be applied on the device's own grid.

    Parameters
    ----------
    sequence_id : str
        Its name.
    start_ns : int
        When its first sample is to be applied [ns, UNIX].
    values : ndarray, shape (n_points,)
        Samples in the command mode's unit, ``multiple`` device ticks apart.
    multiple : int
        Device ticks from one sample to the next.
    hold : {"zoh", "linear"}
        How the samples continue in between.
    """

    sequence_id: str
    start_ns: int
    values: FloatArray
    multiple: int = 1
    hold: Hold = "zoh"

    @property
    def n_ticks(self) -> int:
        """Device ticks: each sample's where values are held, up to the last sample where lines join them."""
        if self.hold == "zoh":
            return len(self.values) * self.multiple
        return (len(self.values) - 1) * self.multiple + 1

    def ticks(self, first: int, end: int) -> FloatArray:
        """Return the samples of the ticks from ``first`` to before ``end``, shape (n_ticks,)."""
        end = min(end, self.n_ticks)
        if self.multiple == 1:
            return self.values[first:end]
        k = np.arange(first, end)
        if self.hold == "zoh":
            return self.values[k // self.multiple]
        low = first // self.multiple
        part = self.values[low : end // self.multiple + 2]
        return np.interp(k, (low + np.arange(len(part))) * self.multiple, part)

    def blocks(self) -> Iterator[FloatArray]:
        """Yield all ticks in pieces, each shape (up to ``BLOCK_TICKS``,)."""
        for first in range(0, self.n_ticks, BLOCK_TICKS):
            yield self.ticks(first, first + BLOCK_TICKS)


class SequenceAssembler:
    """Puts the chunks of one sequence together.

    Parameters
    ----------
    first : SequenceChunk
        Whichever chunk came first.
    parameters : AxisParameters
        The axis's limits.
    """

    def __init__(self, first: SequenceChunk, parameters: AxisParameters) -> None:
        self._parameters = parameters
        self._head = first
        self._chunks: dict[int, SequenceChunk] = {}
        self.points = 0

    @property
    def sequence_id(self) -> str:
        """Name of the sequence."""
        return self._head.sequence_id

    @property
    def start_ns(self) -> int:
        """When the first sample is to be applied [ns, UNIX]."""
        return self._head.start_ns

    @property
    def is_complete(self) -> bool:
        """Whether all chunks have come."""
        return len(self._chunks) == self._head.count

    def missing(self) -> str:
        """Say how much has come so far."""
        return f"{len(self._chunks)} of {self._head.count} chunks came"

    def add(self, chunk: SequenceChunk) -> str | None:
        """Take a chunk, or return why it does not belong to this sequence or makes it too long."""
        objection = chunk.fault or self._misfit(chunk)
        if objection:
            return objection
        known = self._chunks.get(chunk.index)
        if known is not None:
            if known.first_tick == chunk.first_tick and np.array_equal(known.values, chunk.values):
                return None
            return f"chunk {chunk.index} came twice with different samples"
        self._chunks[chunk.index] = chunk
        self.points += len(chunk.values)
        return None

    def _misfit(self, chunk: SequenceChunk) -> str | None:
        head, device_ns = self._head, self._parameters.period_ns
        if not 1 <= chunk.index <= chunk.count <= MAX_CHUNKS:
            return f"chunk {chunk.index}/{chunk.count}: expected 1 <= k <= n <= {MAX_CHUNKS}"
        if not 1 <= len(chunk.values) <= MAX_CHUNK_POINTS:
            return f"chunk {chunk.index} has {len(chunk.values)} points: expected 1 to {MAX_CHUNK_POINTS}"
        if chunk.period_ns <= 0 or chunk.period_ns % device_ns:
            return f"period {chunk.period_ns} ns: expected a multiple of the device's {device_ns} ns"
        if chunk.first_tick < 0:
            return f"chunk {chunk.index} begins at sample {chunk.first_tick}: expected 0 or more"
        for name in ("count", "start_ns", "period_ns"):
            if getattr(chunk, name) != getattr(head, name):
                return (
                    f"chunk {chunk.index} has {name} {getattr(chunk, name)}, another chunk has "
                    f"{getattr(head, name)}: expected the same in all chunks"
                )
        # Every chunk still to come holds at least one sample.
        points = max(chunk.first_tick + len(chunk.values), chunk.count)
        n_ticks = points * (chunk.period_ns // device_ns)
        if n_ticks > MAX_TICKS:
            return (
                f"lasts at least {n_ticks * self._parameters.period:g} s, {n_ticks} ticks of the device: at most "
                f"{MAX_TICKS} ticks ({MAX_TICKS * self._parameters.period:g} s) are taken; cut it into several "
                "sequences that each end at rest"
            )
        return None

    def assemble(self) -> Sequence | str:
        """Return the whole sequence, or why the chunks do not make one; the chunks are let go of."""
        expected = 0
        parts = []
        for index in range(1, self._head.count + 1):
            chunk = self._chunks[index]
            if chunk.first_tick != expected:
                return (
                    f"chunk {index} begins at sample {chunk.first_tick}, the chunks before it hold "
                    f"{expected}: expected no gap and no overlap"
                )
            expected += len(chunk.values)
            parts.append(chunk.values)
        values = np.concatenate(parts, dtype=np.float64)
        self._chunks.clear()
        multiple = self._head.period_ns // self._parameters.period_ns
        return Sequence(self.sequence_id, self.start_ns, values, multiple, self._parameters.hold)
