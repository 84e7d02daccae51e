"""A record that grows: samples are added as they arrive, and at any time it is a record of what there is."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import RecordError


class GrowingRecord:
    """Samples of the signals of a record, which keep arriving.

    Parameters
    ----------
    begun : TimeRecord -- the first samples of every signal, with name, unit, hold, exposure and so on
    memory_s : float
        Only what came in so long before the newest sample is kept [s]: a bound on the memory, and a way to follow
        what changes slowly. Infinite keeps everything.

    Raises
    ------
    RecordError
        A memory that is not above zero.
    """

    def __init__(self, begun: TimeRecord, memory_s: float = math.inf) -> None:
        if not memory_s > 0.0:
            raise RecordError(f"memory_s is {memory_s!r}; expected a time above 0 s")
        self._begun, self._memory_s = begun, memory_s
        self._pieces: dict[str, deque[tuple[FloatArray, FloatArray]]] = {
            **{own.name: deque([(own.times_s, _as_measured(own))]) for own in begun.inputs},
            **{own.name: deque([(own.times_s, own.values)]) for own in begun.outputs},
        }

    def add(self, name: str, times_s: ArrayLike, values: ArrayLike) -> None:
        """Add samples to a signal.

        Parameters
        ----------
        name : str
        times_s : array_like, shape (n,) -- stamps, all after those that are there [s]
        values : array_like, shape (n,) -- NaN where nothing was seen

        Raises
        ------
        RecordError
            No such signal, unequal lengths, or stamps that do not rise.
        """
        if name not in self._pieces:
            raise RecordError(f"no signal {name!r}; expected one of {', '.join(self._pieces)}")
        times, samples = (np.asarray(own, dtype=np.float64) for own in (times_s, values))
        if times.ndim != 1 or times.shape != samples.shape:
            raise RecordError(f"{name!r}: {times.shape} stamps and {samples.shape} values; expected as many")
        if not len(times):
            return
        last = float(self._pieces[name][-1][0][-1])
        if not np.all(np.diff(times, prepend=last) > 0.0):
            raise RecordError(
                f"{name!r}: stamps from {times[0]:.6g} s on follow {last:.6g} s and do not rise: its clock stepped "
                "back. Begin a record of its own there, and identify both together"
            )
        pieces = self._pieces[name]
        pieces.append((times, samples))
        while pieces[0][0][-1] < times[-1] - self._memory_s:
            pieces.popleft()

    @property
    def heard_s(self) -> float:
        """From the first sample of the input that ever came to the newest one [s], kept or not."""
        drive = self._begun.inputs[0]
        return float(self._pieces[drive.name][-1][0][-1]) - drive.span_s[0]

    def record(self) -> TimeRecord:
        """Return the record as it is now."""
        newest = max(float(pieces[-1][0][-1]) for pieces in self._pieces.values())
        inputs, outputs = [], []
        for drive in self._begun.inputs:
            times, values = self._kept(drive.name, newest)
            known = np.flatnonzero(np.isfinite(values))  # an input begins and ends with a known sample
            there = slice(int(known[0]), int(known[-1]) + 1)
            inputs.append(replace(drive, times_s=times[there], values=values[there], gaps=()))
        for output in self._begun.outputs:
            times, values = self._kept(output.name, newest)
            outputs.append(replace(output, times_s=times, values=values))
        return replace(self._begun, inputs=tuple(inputs), outputs=tuple(outputs))

    def _kept(self, name: str, newest: float) -> tuple[FloatArray, FloatArray]:
        """Return the samples of a signal that are kept, as one piece from now on."""
        times, values = (np.concatenate(part) for part in zip(*self._pieces[name], strict=True))
        first = int(np.searchsorted(times, newest - self._memory_s))
        self._pieces[name] = deque([(times[first:], values[first:])])
        return self._pieces[name][0]


def _as_measured(drive: InputSignal) -> FloatArray:
    """Return the samples of an input, NaN where they were filled in."""
    values = np.array(drive.values)
    for gap in drive.gaps:
        values[(drive.times_s > gap.start_s) & (drive.times_s < gap.end_s)] = np.nan
    return values
