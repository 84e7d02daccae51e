"""Channels that cannot be what they seem, by their samples alone: stuck, repeated, wrapped, one another's copy.

An exposure longer than the time between samples is named as well: a shutter opens once for every frame; and an input
that never changes.

None of these needs a model, and each biases one in silence.  A signal that is measured never has the same value twice
while it moves, but for rounding: so a value that stays where its neighbours differ by many steps is no measurement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray, IndexArray
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.noise.rounding import quantum
from beam_ident.sensing.quantisation import clipped_input_warnings

_STUCK = 20  # samples in a row
_BY_CHANCE = 1e-6  # that rounding alone keeps a value for so long
_BEFORE = 5  # samples before a channel is stuck, which show that it was moving
_EXPOSED = 1.01  # of the time between samples
_STEPS = 5.0  # of rounding, which a moving signal makes between samples
_MOVES = 0.1  # of the usual difference between samples, the same
_FEW, _SHARE = 5, 0.02  # repeated samples that are told from chance, and of all that move
_MAX_REPEATED = 5  # repeated samples in a row that tell: more may be a dead band
_LEAP, _MOST_LEAPS = (
    0.6,
    0.2,
)  # of a range, and of all steps: a step that is a leap, and how many there may be
_STEP = 0.4  # of a range: no other step is larger
_ONWARD, _MUCH_LESS = 0.7, 0.3  # of leaps go on the way it went; of a step, by which their sizes scatter
_LATEST = 8  # samples by which a logger may echo an input
_REPEATED = (
    "{} samples repeat the one before, in the middle of a motion, too, as of a camera that shows a frame twice, or "
    "of a sensor that is slower than its stamps"
)


def damage_warnings(outputs: Sequence[OutputSignal], drives: Sequence[InputSignal] = ()) -> tuple[str, ...]:
    """Return what must be known of outputs stuck, repeated, copied, wrapped or exposed too long, and of inputs.

    Parameters
    ----------
    outputs : sequence of OutputSignal -- of one record
    drives : sequence of InputSignal -- of which an output may be a copy
    """
    said = [
        f"Input {own.name} is constant ({own.values[0]:.4g}): it excites nothing, but for a step where the record "
        "begins if it was zero before. Else gains mean nothing. Check the channel, or record the switch-on."
        for own in drives
        if own.values[0] != 0.0 and np.ptp(own.values) == 0.0
    ]
    said += clipped_input_warnings(drives)
    said += [text for own in drives if (text := _wrapped(f"Input {own.name}", own.values))]
    seen = [(own.times_s[own.is_valid], own.values[own.is_valid]) for own in outputs]
    for k, output in enumerate(outputs):
        said += _of_channel(output.name, *seen[k])
        others = [(f"Outputs {own.name}", seen[j], 0) for j, own in enumerate(outputs[:k])]
        times = seen[k][0]
        period = float(np.median(np.diff(times))) if len(times) > 1 else math.inf
        if output.exposure_s > _EXPOSED * period:
            said.append(
                f"Output {output.name}: its exposure is stated as {output.exposure_s * 1e3:.4g} ms, longer than the "
                f"{period * 1e3:.4g} ms between its samples. Give it in seconds, as the shutter has it."
            )
        others += [
            (f"Input {own.name}", samples, late)
            for own in drives
            for samples in [(times, np.interp(times, own.times_s, own.values))]
            for late in range(_LATEST + 1)
        ]
        said += [
            f"{other} and {output.name} hold the same samples"
            + f", these {late} sample{'s' if late > 1 else ''} later" * (late > 0)
            + ": one is the other's copy. Check the channels."
            for other, samples, late in others
            if _are_same(samples, seen[k], late)
        ]
    return tuple(said)


def _are_same(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray], late: int = 0
) -> bool:
    """Return whether two channels hold the same moving values at the same stamps, the second some samples later."""
    n = len(one[1])
    return bool(
        np.array_equal(one[0], other[0])
        and np.array_equal(one[1][: n - late], other[1][late:])
        and len(np.unique(one[1][: n - late])) > _STUCK
    )


def _of_channel(name: str, times: FloatArray, values: FloatArray) -> list[str]:
    """Return what is wrong with one channel."""
    n = len(values)
    if said := _wrapped(f"Output {name}", values):
        return [said]
    if not _may_be_damaged(values):
        return []
    starts, ends, moves = _still_runs(values)
    lengths = ends - starts
    is_at_limit = np.isin(values[starts], [np.min(values), np.max(values)])
    was_moving = np.array([np.any(moves[max(start - _BEFORE, 0) : start]) for start in starts])
    is_held = was_moving & ((lengths >= _STUCK) | ((lengths >= _MAX_REPEATED) & ~is_at_limit))
    others = (np.sum(lengths[~is_held]) + 1.0) / (n - np.sum(lengths[is_held]))
    is_held &= lengths * math.log(min(others, 1.0)) < math.log(_BY_CHANCE)
    if np.any(is_held):
        longest = int(np.argmax(np.where(is_held, lengths, 0)))
        start, end = int(starts[longest]), int(ends[longest])
        more = int(np.count_nonzero(is_held)) - 1
        return [
            f"Output {name} is stuck at {values[start]:.4g} from {times[start]:.4g} s to {times[end]:.4g} s "
            f"({end - start + 1} samples), in the middle of a motion"
            + f", and {more} times more, as of a line that drops out or of play" * (more > 0)
            + ": set them to NaN (not seen), and check the sensor."
        ]
    if len(places := _repeated(values)):
        said = _REPEATED.format(len(places))
        return [f"Output {name}: {said}. Leave repeated samples out, or set them to NaN (not seen)."]
    return []


def _wrapped(name: str, values: FloatArray) -> str:
    """Return that a counter or a converter overflows, or an empty string.

    Notes
    -----
    It leaps from one end of its range to the other and goes on the way it went; leap and motion together are the
    range, always the same. A signal that is switched to and fro rests before and after.
    """
    if len(values) < 2 * _STUCK:
        return ""
    steps = np.diff(values)
    is_leap = np.abs(steps) > _LEAP * np.ptp(values)
    if np.any(np.abs(steps[~is_leap]) > _STEP * np.ptp(values)):  # leaps are steps among others
        return ""
    places = np.flatnonzero(is_leap)
    places = places[(places > 0) & (places < len(steps) - 1)]
    if not _FEW <= len(places) < _MOST_LEAPS * len(steps):
        return ""
    leaps, around = steps[places], 0.5 * (steps[places - 1] + steps[places + 1])
    is_onward = np.sign(steps[places - 1]) * np.sign(leaps) < 0.0
    is_onward &= np.sign(steps[places + 1]) * np.sign(leaps) < 0.0
    ranges = np.abs(leaps) + np.abs(around)
    period = float(np.median(ranges))
    is_both_ways = np.any(leaps > 0.0) and np.any(leaps < 0.0)  # else it may be a saw
    is_range = np.median(np.abs(ranges - period)) < _MUCH_LESS * np.median(np.abs(around))
    if np.mean(is_onward) < _ONWARD or not is_both_ways or not is_range:
        return ""
    return (
        f"{name} wraps round: {len(places)} times it leaps from one end of its range to the other and goes on the "
        f"way it went, as of a counter that overflows. Unwrap it: numpy.unwrap(values, period={period:.6g})."
    )


def without_repeated(
    records: Sequence[TimeRecord], names: Sequence[str]
) -> tuple[list[TimeRecord], tuple[str, ...]]:
    """Return records without the samples of some outputs that repeat the one before, and what is to be said of them.

    Parameters
    ----------
    records : sequence of TimeRecord
    names : sequence of str -- of outputs
    """
    result, said = [], []
    for record in records:
        outputs = []
        for output in record.outputs:
            values = np.array(output.values)
            seen = np.flatnonzero(output.is_valid)
            if output.name in names and len(places := _repeated(values[seen])):
                values[seen[places]] = np.nan
                said.append(f"Output {output.name}: {_REPEATED.format(len(places))}. They are left out.")
            outputs.append(replace(output, values=values))
        result.append(replace(record, outputs=tuple(outputs)))
    return (result, tuple(said)) if said else (list(records), ())


def _repeated(values: FloatArray) -> IndexArray:
    """Return which samples repeat the one before; none where that is chance, as of values that are rounded.

    Notes
    -----
    In the middle of a motion it is told from chance. Of values that are not rounded it is none elsewhere, either.
    """
    none = np.empty(0, dtype=np.intp)
    if not _may_be_damaged(values):
        return none
    starts, ends, moves = _still_runs(values)
    is_repeated = ends - starts < _STUCK
    for limit in (np.min(values), np.max(values)):
        at_limit = values[starts] == limit
        is_repeated &= ~at_limit | (np.count_nonzero(at_limit) == 1)  # else clipped
    starts, ends = starts[is_repeated], ends[is_repeated]
    is_telling = (starts > 0) & (ends < len(moves)) & (ends - starts < _MAX_REPEATED)
    at_speed = is_telling & moves[starts - 1] & moves[np.minimum(ends, len(moves) - 1)]
    n_at_speed = int(np.sum((ends - starts)[at_speed]))
    if n_at_speed < _FEW or not n_at_speed > _SHARE * np.count_nonzero(moves):
        return none
    which = at_speed if quantum(values) else np.ones(len(starts), dtype=bool)
    return np.concatenate(
        [np.arange(start, end) + 1 for start, end in zip(starts[which], ends[which], strict=True)]
    )


def _may_be_damaged(values: FloatArray) -> bool:
    """Return whether some samples of a channel that moves, but not all, are as the one before."""
    n_still = int(np.count_nonzero(values[1:] == values[:-1]))
    return len(values) >= 2 * _STUCK and 0 < n_still < len(values) - 1


def _still_runs(values: FloatArray) -> tuple[IndexArray, IndexArray, BoolArray]:
    """Return where runs of equal samples begin and end, and which differences are those of a motion."""
    steps = np.abs(np.diff(values))
    usual = float(np.sqrt(np.mean(np.square(steps))))
    edges = np.diff(np.concatenate([[False], steps == 0.0, [False]]).astype(np.int8))
    moves = steps > max(_STEPS * quantum(values), _MOVES * usual)
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), moves
