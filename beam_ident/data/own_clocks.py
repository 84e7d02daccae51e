"""Outputs with a clock or a low-pass of their own: a laser beside a camera, late by itself, or slow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import LowPass, TimeRecord


@dataclass(frozen=True)
class OwnClock:
    """The clock of one output against that which the outputs share.

    A sample that the common clock would have stamped ``t`` has the stamp ``m + (t - m) (1 + rate) + delay``, with m
    the middle of all outputs' stamps in the record.

    Attributes
    ----------
    delay : float -- how late its stamps are [s]
    rate : float -- how much faster it runs
    runs : bool -- whether the rate is one of its own
    """

    delay: float = 0.0
    rate: float = 0.0
    runs: bool = False

    def to_common(self, times_s: FloatArray, middle_s: float) -> FloatArray:
        """Return stamps as the common clock gives them [s]."""
        return np.asarray(middle_s + (times_s - self.delay - middle_s) / (1.0 + self.rate))

    def stamped(self, times_s: FloatArray, middle_s: float) -> FloatArray:
        """Return the stamps of samples that the common clock has stamped [s]."""
        return np.asarray(middle_s + (times_s - middle_s) * (1.0 + self.rate) + self.delay)

    def moved(self, delay: float, rate: float) -> OwnClock:
        """Return the clock with more delay [s] and rate."""
        return OwnClock(self.delay + delay, self.rate + rate, self.runs or rate != 0.0)


def middle_of(record: TimeRecord) -> float:
    """Return the middle of all outputs' stamps [s]."""
    first = min(own.times_s[0] for own in record.outputs)
    last = max(own.times_s[-1] for own in record.outputs)
    return float(0.5 * (first + last))


def on_common_clock(record: TimeRecord, clocks: Mapping[str, OwnClock]) -> TimeRecord:
    """Return a record with all stamps as the common clock gives them.

    Parameters
    ----------
    record : TimeRecord
    clocks : mapping -- by the output's name
    """
    if not any(output.name in clocks for output in record.outputs):
        return record
    middle = middle_of(record)
    outputs = [
        replace(own, times_s=clocks[own.name].to_common(own.times_s, middle)) if own.name in clocks else own
        for own in record.outputs
    ]
    return TimeRecord(record.inputs, tuple(outputs), record.start_ns, record.name)


def with_low_passes(records: Sequence[TimeRecord], low_passes: Mapping[str, LowPass]) -> list[TimeRecord]:
    """Return records whose outputs state these low-passes, by name, whatever they stated."""

    def stating(record: TimeRecord) -> TimeRecord:
        outputs = [
            replace(own, low_pass=low_passes[own.name]) if own.name in low_passes else own
            for own in record.outputs
        ]
        return replace(record, outputs=tuple(outputs))

    return [stating(one) if low_passes else one for one in records]
