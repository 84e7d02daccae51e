"""Whether two records hold the same samples: a model must not be judged by what it was fitted to.

A copy of a bag, a conversion to another storage and a piece cut out of it all keep stamps and values, so these are
compared, not paths or checksums of files.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident import OutputSignal, TimeRecord
from beam_ros.arrays import StampArray
from beam_ros.errors import UsageError
from beam_ros.process.remote_paths import AnyPath

_SHARE = 0.5  # of the shorter of two signals
_MOVING = 20  # samples among them that differ from the one before
_NEAR_NS = 50  # stamps went through seconds since a record's origin, of which a double knows some nanoseconds

Source = tuple[AnyPath, TimeRecord]


def refuse_shared(fitted: Sequence[Source], unseen: Sequence[Source]) -> None:
    """Refuse a bag that would count twice, or that would judge a model that is fitted to it.

    Parameters
    ----------
    fitted, unseen : sequence of (path, record) -- what a model is fitted to, and what shall judge it

    Raises
    ------
    UsageError
        Two of the first, or one of each, hold the same samples.
    """
    for k, (path, record) in enumerate(fitted):
        for other, seen in fitted[:k]:
            if hold_the_same(record, seen):
                raise UsageError(f"{other} and {path} hold the same samples; give each bag once")
    for path, record in unseen:
        for other, seen in fitted:
            if hold_the_same(record, seen):
                raise UsageError(
                    f"{path} holds the samples of {other}, to which the model is fitted: it cannot judge the model; "
                    "record a second experiment and give that to --validate, or leave --validate out"
                )


def hold_the_same(one: TimeRecord, other: TimeRecord) -> bool:
    """Return whether some output has most of its samples, while it moves, in both records."""
    return any(
        _are_same(ours, _stamps_ns(one, ours), theirs, _stamps_ns(other, theirs))
        for ours in one.outputs
        for theirs in other.outputs
        if ours.name == theirs.name
    )


def _stamps_ns(record: TimeRecord, signal: OutputSignal) -> StampArray:
    return np.asarray(np.rint(signal.times_s * 1e9), dtype=np.int64) + record.start_ns


def _are_same(ours: OutputSignal, stamps: StampArray, theirs: OutputSignal, other: StampArray) -> bool:
    nearest = np.clip(np.searchsorted(other, stamps - _NEAR_NS), 0, len(other) - 1)
    same = (np.abs(other[nearest] - stamps) <= _NEAR_NS) & (theirs.values[nearest] == ours.values)
    moving = np.count_nonzero(np.diff(ours.values[same]))
    return bool(moving >= _MOVING and np.count_nonzero(same) > _SHARE * min(len(stamps), len(other)))
