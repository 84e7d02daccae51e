"""Blows of a hammer: when it was in contact, and its sensor's noise while it was not.

A hammer pushes, briefly, and then it is elsewhere: between the contacts the force is zero, whatever its sensor says.
That noise goes on for the whole record and none of it reaches the structure. Taken for a force it answers nothing,
and a fit bends its modes to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from beam_ident.data.records import InputSignal, TimeRecord

_BY_CHANCE = 1e-6  # chance that noise alone makes a contact anywhere in a record
_MIN_CONTACT = 0.01  # of the highest blow: a sensor's own ringing may be as large
_DOUBLE = 0.3  # of the longest time between contacts: what follows sooner is no blow of its own
_MOST = 0.2  # of the samples: a hammer is in contact for less
_ROUNDING = 1e-12  # of the highest blow
_QUIET = (
    0.02  # of the highest blow: a force sensor's noise is less, what a structure does to a shaker is more
)


@dataclass(frozen=True)
class Blow:
    """One blow: its first contact and its last [s], and in how many contacts it came."""

    start_s: float
    end_s: float
    n_contacts: int


def find_blows(drive: InputSignal) -> list[Blow]:
    """Return the blows of a force, each with the contacts that follow it too soon to be blows of their own.

    Parameters
    ----------
    drive : InputSignal

    Notes
    -----
    A contact is a run of samples beyond what noise reaches once in a million records (by the input's ``sigma``, or
    the median absolute deviation), and beyond 1 % of the highest. Runs closer than they are long are one.
    """
    contacts = _contacts(drive)[0]
    if not contacts:
        return []
    starts = np.array([start for start, _ in contacts])
    soon = _DOUBLE * float(np.max(np.diff(np.append(starts, drive.times_s[-1]))))
    blows: list[Blow] = []
    for start, end in contacts:
        if blows and start - blows[-1].start_s < soon:
            blows[-1] = Blow(blows[-1].start_s, end, blows[-1].n_contacts + 1)
        else:
            blows.append(Blow(start, end, 1))
    return blows


def without_noise_between_blows(
    records: Sequence[TimeRecord], input_names: Sequence[str]
) -> tuple[list[TimeRecord], str]:
    """Return records whose hammer is silent while it touches nothing, and what must be said of it.

    Parameters
    ----------
    records : sequence of TimeRecord
    input_names : sequence of str -- which inputs are used

    Notes
    -----
    A measured force is a hammer's where it only pushes, in contacts that take a small part of the record, and where
    nothing else in it stands above small noise. A shaker pulls as well, and a command has no noise.
    """
    result, loudest, doubt = [], "", 0.0
    for record in records:
        inputs = list(record.inputs)
        for place, drive in enumerate(inputs):
            silent = _silent(drive) if drive.name in input_names else None
            if silent is None:
                continue
            inputs[place], sd, own = silent
            if own > doubt:
                loudest, doubt = f"{drive.name}: {sd:.2g} {drive.unit}", own
        result.append(replace(record, inputs=tuple(inputs)))
    if not loudest:
        return list(records), ""
    return result, (
        f"Noise between the blows of {loudest}. A hammer that touches nothing exerts no force: it was taken for zero "
        f"there. While it touches, this noise leaves the impulse of a blow uncertain by {doubt:.1g} of itself, which "
        "standard deviations do not count."
    )


def _silent(drive: InputSignal) -> tuple[InputSignal, float, float] | None:
    """Return a hammer without noise between its blows, that noise, and how uncertain it leaves a blow's impulse."""
    if drive.hold == "zoh" or drive.gaps:
        return None
    contacts, rest, limit = _contacts(drive)
    touches = np.zeros(len(drive.values), dtype=bool)
    for start, end in contacts:
        # What lies below the limit after a contact is a part of it, as what lies before it is.
        touches |= (drive.times_s >= start) & (drive.times_s <= end + 0.5 * (end - start))
    between = drive.values[~touches] - rest
    if not contacts or np.mean(touches) > _MOST or np.max(np.abs(between), initial=0.0) > limit:
        return None
    sd, highest = float(np.std(between)), float(np.max(np.abs(drive.values - rest)))
    if not _ROUNDING * highest < sd < _QUIET * highest:
        return None
    force = np.where(touches, drive.values - rest, 0.0)
    begins = np.flatnonzero(np.diff(touches, prepend=False) & touches)
    least = float(np.min(np.abs(np.add.reduceat(force, begins))))
    doubt = sd * math.sqrt(float(np.sum(touches)) / len(contacts)) / least
    return replace(drive, values=force, sigma=0.0), sd, doubt


def _contacts(drive: InputSignal) -> tuple[list[tuple[float, float]], float, float]:
    """Return begin and end of every contact [s], the level of no force, and what noise does not reach above it."""
    rest = float(np.median(drive.values))
    values = drive.values - rest
    values = values * np.sign(values[int(np.argmax(np.abs(values)))])
    spread = drive.sigma or 1.4826 * float(np.median(np.abs(values)))
    limit = max(spread * float(-ndtri(_BY_CHANCE / len(values))), _MIN_CONTACT * float(np.max(values)))
    above = np.concatenate([[False], values > limit, [False]]).astype(np.int8)
    edges = np.diff(above)
    last = len(values) - 1
    runs: list[tuple[float, float]] = []
    for rise, fall in zip(
        np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True
    ):
        # What lies below the limit before a contact is a part of it: without, the blow would be seen late.
        lead = max(rise - max((fall - rise) // 4, 1), 0)
        runs.append((float(drive.times_s[lead]), float(drive.times_s[min(fall, last)])))
    contacts: list[tuple[float, float]] = []
    for start, end in runs:
        if contacts and start - contacts[-1][1] < contacts[-1][1] - contacts[-1][0]:
            contacts[-1] = (contacts[-1][0], end)
        else:
            contacts.append((start, end))
    return contacts, rest, limit
