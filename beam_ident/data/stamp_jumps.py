"""Clocks that jump in the middle of a record: from some instant on all stamps of a signal are late by the same.

A camera or a device that takes its samples at a steady rate shows a jump in its stamps: the interval there is not the
period.  But samples may be lost there as well, or instead: by how much the clock jumped, and whether it did at all,
is for the data to say.  Where an input's clock jumps by whole periods, the hole looks like lost samples and is filled
in (``data.gaps``): that nothing was lost there is possible, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal, TimeRecord

_MIN_STAMPS = 60  # stamps that show whether a rate is steady
_STANDS_OUT = 8.0  # deviations of the intervals from their period
_WHOLE = 0.02  # of a period: rounded and mapped stamps differ by less
_MOST = (
    8  # suspicious intervals of a signal: where there are more, samples are lost, or it has no steady rate
)
_MAX_JUMP_S = 0.2


@dataclass(frozen=True)
class ClockJump:
    """A step of a clock.

    Attributes
    ----------
    record : int -- in which of the records
    signals : tuple of str -- whose stamps step: outputs that share a clock, or an input
    at_s : float -- the first stamp after it, as it was measured [s]
    size_s : float -- by how much later the stamps are from there on [s]
    size_sd : float -- its standard deviation [s]
    """

    record: int
    signals: tuple[str, ...]
    at_s: float
    size_s: float
    size_sd: float = 0.0

    @property
    def sentence(self) -> str:
        """What must be known of it."""
        deviation = f" +- {1e3 * self.size_sd:.2g}" if self.size_sd else ""
        return (
            f"The clock of {', '.join(self.signals)} jumps by {1e3 * self.size_s:.4g}{deviation} ms at "
            f"{self.at_s:.4f} s: the stamps on both sides were taken with a latency each."
        )


def possible_jumps(
    record: TimeRecord, number: int, input_names: Sequence[str], at_gaps: bool = True
) -> list[list[ClockJump]]:
    """Return for every interval at which a steady clock may have jumped by how much that may have been.

    Parameters
    ----------
    record : TimeRecord
    number : int -- of the record
    input_names : sequence of str -- inputs whose clock is looked at beside the outputs'
    at_gaps : bool -- whether gaps of these inputs, of whole periods, may be jumps as well
    """
    clocks: dict[bytes, tuple[FloatArray, list[str]]] = {}
    stamps = [(name, record.input(name).times_s) for name in input_names]
    stamps += [(seen.name, seen.times_s) for seen in record.outputs]
    for name, own in stamps:
        clocks.setdefault(own.tobytes(), (own, []))[1].append(name)
    found = [
        [ClockJump(number, tuple(names), at_s, size) for size in sizes]
        for times, names in clocks.values()
        for at_s, sizes in _suspicious(times)
    ]
    for drive in map(record.input, input_names if at_gaps else ()):
        period = float(np.median(np.diff(drive.times_s)))
        gaps = drive.gaps if len(drive.gaps) <= _MOST else ()
        sizes = [(gap.end_s, gap.end_s - gap.start_s - period) for gap in gaps]
        found += [
            [ClockJump(number, (drive.name,), at_s, size)] for at_s, size in sizes if 0.0 < size < _MAX_JUMP_S
        ]
    return found


def _suspicious(times_s: FloatArray) -> list[tuple[float, list[float]]]:
    """Return the stamps behind intervals that are not the period, and by how much their clock may have jumped [s]."""
    if len(times_s) < _MIN_STAMPS:
        return []
    intervals = np.diff(times_s)
    period = float(np.median(intervals))
    scatter = 1.4826 * float(np.median(np.abs(intervals - period)))
    least = max(_STANDS_OUT * scatter, _WHOLE * period)
    places = np.flatnonzero(np.abs(intervals - period) > least)
    if len(places) > _MOST:
        return []
    found = []
    for place in places:
        # Each sample that was lost there takes a period.
        passed = period * np.arange(1, int(intervals[place] / period + 0.5) + 2)
        sizes = [float(size) for size in intervals[place] - passed if least < abs(size) < _MAX_JUMP_S]
        found.append((float(times_s[place + 1]), sizes))
    return [(at_s, sizes) for at_s, sizes in found if sizes]


def without_jumps(record: TimeRecord, number: int, jumps: Sequence[ClockJump]) -> TimeRecord:
    """Return a record whose stamps do not jump.

    Parameters
    ----------
    record : TimeRecord
    number : int -- of the record
    jumps : sequence of ClockJump
    """
    own = [jump for jump in jumps if jump.record == number]
    if not own:
        return record

    def steady(name: str, times_s: FloatArray) -> FloatArray:
        late = [jump.size_s * (times_s >= jump.at_s) for jump in own if name in jump.signals]
        return np.asarray(times_s - np.sum(late, axis=0)) if late else times_s

    def driven(drive: InputSignal) -> InputSignal:
        # Where a clock has jumped, nothing was lost: what fills the gap there was never sampled.
        at = {jump.at_s for jump in own if drive.name in jump.signals}
        is_filling = np.zeros(len(drive.times_s), dtype=bool)
        gaps = []
        for gap in drive.gaps:
            if gap.end_s in at:
                is_filling |= (drive.times_s > gap.start_s) & (drive.times_s < gap.end_s)
            else:
                start_s, end_s = steady(drive.name, np.array([gap.start_s, gap.end_s])).tolist()
                gaps.append(replace(gap, start_s=start_s, end_s=end_s))
        times_s = steady(drive.name, drive.times_s)[~is_filling]
        return replace(drive, times_s=times_s, values=drive.values[~is_filling], gaps=tuple(gaps))

    outputs = tuple(replace(seen, times_s=steady(seen.name, seen.times_s)) for seen in record.outputs)
    return TimeRecord(tuple(map(driven, record.inputs)), outputs, record.start_ns, record.name)


def is_after(jump: ClockJump, jumps: Sequence[ClockJump], times_s: FloatArray) -> FloatArray:
    """Return 1 for corrected stamps of a jump's clock after it, else 0, shape as the stamps.

    Parameters
    ----------
    jump : ClockJump
    jumps : sequence of ClockJump -- all that were corrected, this one among them
    times_s : ndarray -- corrected stamps [s]
    """
    late = math.fsum(
        own.size_s
        for own in jumps
        if own.record == jump.record and own.signals == jump.signals and own.at_s <= jump.at_s
    )
    return np.asarray(times_s >= jump.at_s - late - 1e-9, dtype=np.float64)
