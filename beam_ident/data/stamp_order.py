"""Stamps as they come: which samples stand in order, which came late, and which say a time that cannot be.

The longest part of the stamps that rises strictly is taken for right. A sample outside of it either came late, which
shows by the hole that its stamp fills, or its stamp is wrong: a step back of the clock, a restart, a stray message.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import IndexArray, StampArray

_FILLS = 0.5  # of a period from the nearest other stamp: the sample of a hole
_NAMED = 3  # events in a sentence


@dataclass(frozen=True)
class StampEvent:
    """Samples in a row whose stamps are not where their place in the bag says.

    Attributes
    ----------
    first : int -- index of the first of them, in the order of the bag
    count : int
    at_ns : int -- stamp of the last good sample before, or of the first one after [ns]
    step_ns : int -- by how much the first stamp lies after that [ns]; negative: it lies back
    """

    first: int
    count: int
    at_ns: int
    step_ns: int


@dataclass(frozen=True)
class StampOrder:
    """Samples in the order of their stamps.

    Attributes
    ----------
    order : ndarray of int, shape (n_kept,) -- samples that are used, by rising stamps
    repeated : int -- samples left out because their stamp was there already
    late : int -- samples that came late and were put where they belong
    misplaced : tuple of StampEvent -- samples left out because their stamps cannot be right
    """

    order: IndexArray
    repeated: int
    late: int
    misplaced: tuple[StampEvent, ...]

    @staticmethod
    def of(stamps_ns: StampArray) -> StampOrder:
        """Judge stamps [ns] in the order of the bag."""
        steps = np.diff(stamps_ns)
        if len(stamps_ns) < 2 or np.all(steps > 0):
            return StampOrder(np.arange(len(stamps_ns)), 0, 0, ())
        rising = _rising(stamps_ns)
        good = stamps_ns[rising]
        is_good = np.zeros(len(stamps_ns), dtype=bool)
        is_good[rising] = True
        odd = np.flatnonzero(~is_good)
        period = float(np.median(np.diff(good))) if len(good) > 1 else 0.0
        after = np.searchsorted(good, stamps_ns[odd])
        apart = np.full(len(odd), np.inf)
        for neighbour in (np.maximum(after - 1, 0), np.minimum(after, len(good) - 1)):
            apart = np.minimum(apart, np.abs(stamps_ns[odd] - good[neighbour]))
        inside = (stamps_ns[odd] > good[0]) & (stamps_ns[odd] < good[-1])
        repeated = apart == 0.0
        _, first_of_stamp = np.unique(stamps_ns[odd], return_index=True)
        is_first = np.zeros(len(odd), dtype=bool)
        is_first[first_of_stamp] = True
        late = inside & is_first & (apart > _FILLS * period) & ~_holes_at(odd, stamps_ns, is_good, period)
        kept = np.sort(np.concatenate([rising, odd[late]]))
        order = kept[np.argsort(stamps_ns[kept], kind="stable")]
        wrong = odd[~late & ~repeated]
        return StampOrder(order, int(np.sum(repeated)), int(np.sum(late)), _events(wrong, stamps_ns, is_good))

    def sentences(self, what: str, start_ns: int) -> list[str]:
        """Say what was found.

        Parameters
        ----------
        what : str -- whose stamps these are
        start_ns : int -- from which instants are counted [ns]
        """
        said = []
        if self.misplaced:
            named = [
                f"{abs(event.step_ns) * 1e-9:.3f} s {'back' if event.step_ns < 0 else 'ahead'} at "
                f"{(event.at_ns - start_ns) * 1e-9:.3f} s"
                + (f" ({event.count} samples)" if event.count > 1 else "")
                for event in self.misplaced[:_NAMED]
            ]
            more = f" and {len(self.misplaced) - _NAMED} more" if len(self.misplaced) > _NAMED else ""
            count = sum(event.count for event in self.misplaced)
            said.append(
                f"{what}: {count} stamp{'s' if count > 1 else ''} cannot be right and "
                f"{'are' if count > 1 else 'is'} left out: {', '.join(named)}{more}"
            )
        if self.late:
            said.append(f"{what}: {self.late} samples came late and were put where their stamps say")
        if self.repeated:
            said.append(f"{what}: {self.repeated} samples repeat a stamp and are left out")
        return said


def _rising(stamps_ns: StampArray) -> IndexArray:
    """Return the longest strictly rising part of stamps: for every length the smallest last stamp is kept."""
    lasts: list[int] = []
    places: list[int] = []
    before = np.full(len(stamps_ns), -1, dtype=np.intp)
    for index, stamp in enumerate(stamps_ns.tolist()):
        length = bisect_left(lasts, stamp)
        if length:
            before[index] = places[length - 1]
        if length == len(lasts):
            lasts.append(stamp)
            places.append(index)
        else:
            lasts[length], places[length] = stamp, index
    found = np.empty(len(lasts), dtype=np.intp)
    index = places[-1]
    for k in range(len(lasts) - 1, -1, -1):
        found[k] = index
        index = int(before[index])
    return found


def _holes_at(odd: IndexArray, stamps_ns: StampArray, is_good: Any, period_ns: float) -> Any:
    """Return which odd samples stand in the bag where the good stamps lack one: there they were measured."""
    good = np.flatnonzero(is_good)
    after = np.searchsorted(good, odd)
    before, behind = good[np.maximum(after - 1, 0)], good[np.minimum(after, len(good) - 1)]
    return (behind > odd) & (before < odd) & (stamps_ns[behind] - stamps_ns[before] > 1.5 * period_ns)


def _events(wrong: IndexArray, stamps_ns: StampArray, is_good: Any) -> tuple[StampEvent, ...]:
    """Group samples that follow each other and jump together."""
    events: list[StampEvent] = []
    good = np.flatnonzero(is_good)
    for group in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1) if len(wrong) else []:
        first = int(group[0])
        place = int(np.searchsorted(good, first))
        beside = int(stamps_ns[good[place - 1 if place else 0]])
        events.append(StampEvent(first, len(group), beside, int(stamps_ns[first]) - beside))
    return tuple(events)
