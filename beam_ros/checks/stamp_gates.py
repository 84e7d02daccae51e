"""Gates of time: whether stamps say when something was measured, on one clock, one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from beam_ident import OutputSignal, TimeRecord
from beam_ident.data.stamp_jumps import possible_jumps
from beam_ident.report.gates import Gate
from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise_clocks
from beam_ros.rig.rig import Rig
from beam_ros.signals.fields import message_stamps

_OFF_RATE = 0.01
"""Cameras keep their frame rate to a part in a thousand; ten times that is another setting."""


class TimingCosts:
    """What an error of a stamp does to the outputs: it moves them by their speed.

    Parameters
    ----------
    outputs : sequence of OutputSignal
    noise_sd : mapping -- of every output, by name

    Attributes
    ----------
    allowed_s : float -- error of stamps that adds as much as the noise of the output that it hurts most [s]
    """

    def __init__(self, outputs: Sequence[OutputSignal], noise_sd: dict[str, float]) -> None:
        allowed = []
        for own in outputs:
            seen = own.is_valid
            steps = np.diff(own.times_s[seen])
            noise = noise_sd[own.name]
            if not len(steps) or math.isnan(noise):
                continue
            step = float(np.median(steps))
            # Differences of noise are no speed: their variance is taken out.
            change = float(np.mean(np.square(np.diff(own.values[seen])))) - 2.0 * noise**2
            if change > 0.0:
                allowed.append(noise * step / math.sqrt(change))
        self.allowed_s = min(allowed, default=math.inf)


def clock_gates(bag: Bag, costs: TimingCosts) -> Iterator[Gate]:
    """Judge the device's clock by its comparisons with the host's."""
    clocks = summarise_clocks(bag.clock_syncs()) if bag.count("hub/clock_sync") else ()
    if not clocks:
        yield Gate(
            "device clock",
            "not judged",
            "no comparisons with the host's clock",
            "hub/clock_sync, so that the device's ticks can be mapped",
        )
        return
    longest = max(clocks, key=lambda own: own.points)
    scatter_s = 0.0 if math.isnan(longest.residual_ns) else longest.residual_ns * 1e-9
    figure = (
        f"{longest.points} comparisons, {longest.rate_ppm:+.1f} ppm, residual {scatter_s * 1e6:.1f} us, median round "
        f"trip {longest.median_rtt_ns * 1e-3:.0f} us"
    )
    expected = (
        f"a residual below {costs.allowed_s * 1e6:.3g} us, where it costs as much as the outputs' noise"
    )
    if longest.points < 3 or math.isnan(longest.rate_ppm):
        remedy = "record longer, or with the driver's clock exchange at its usual rate"
        yield Gate("device clock", "doubtful", f"{longest.points} comparisons", "three or more", remedy)
    else:
        remedy = "take load off the host, shorten the line to the device, or raise its rate"
        yield Gate.judged("device clock", scatter_s <= costs.allowed_s, figure, expected, remedy)
    if len(clocks) > 1:
        yield Gate(
            "device restarts",
            "doubtful",
            f"{len(clocks) - 1} restarts, each of which begins a clock and a zero of its own",
            "none",
            "find what restarts the device (supply, watchdog, cable); every part is used by itself at best",
        )


def order_gates(bag: Bag, topics: Sequence[str], origin_ns: int) -> Iterator[Gate]:
    """Judge whether the stamps of every topic that is used rise, message by message."""
    found, total = [], 0
    for topic in topics:
        stamps, order = message_stamps(bag, topic)
        total += len(stamps)
        found += order.sentences(topic, origin_ns)
    expected = "every stamp later than the one before, and none far off"
    remedy = "they are left out; find what publishes them (two publishers on a topic, a clock that is set)"
    figure = "; ".join(found) or f"all {total} messages"
    yield Gate.judged("stamps in order", not found, figure, expected, remedy)


def jump_gate(records: Sequence[TimeRecord]) -> Gate:
    """Judge whether a steady clock may have jumped in the middle of a record."""
    found = [
        jump
        for number, record in enumerate(records)
        for jumps in possible_jumps(record, number, [drive.name for drive in record.inputs], at_gaps=False)
        for jump in jumps[:1]
    ]
    named = ", ".join(
        f"{', '.join(jump.signals)} by {jump.size_s * 1e3:.3g} ms at {jump.at_s:.3f} s" for jump in found[:3]
    )
    return Gate.judged(
        "clock jumps",
        not found,
        f"possible: {named}" if found else "none",
        "a steady rate, but for whole samples that are lost",
        "the estimator modal decides from the data and takes a jump out; keep clocks from being set while recording",
    )


def rate_gates(outputs: Sequence[OutputSignal], rig: Rig | None, has_markers: bool) -> Iterator[Gate]:
    """Judge the outputs' rate against what the rig's camera is set to, and say how evenly they come."""
    for times, names in _clocks(outputs):
        steps = np.diff(times)
        if not len(steps):
            continue
        period = float(np.median(steps))
        usual = steps[np.abs(steps - period) < 0.5 * period]
        jitter = float(np.std(usual)) if len(usual) else math.nan
        # Stamps are whole nanoseconds.
        scatter = f"{jitter * 1e3:.3g} ms" if jitter > 1e-9 else "less than 1 ns"
        figure = f"{1.0 / period:.4g} samples a second, intervals scatter by {scatter}"
        name = f"rate of {names}"
        if rig is None or not has_markers:
            yield Gate(name, "passed", figure, "any: samples are used at their own stamps")
            continue
        expected = f"{rig.camera.rate:g} frames a second, as the rig says"
        is_same = abs(period * rig.camera.rate - 1.0) <= _OFF_RATE
        remedy = (
            "give the rig file of this experiment, or mend the camera's settings: exposure goes with them"
        )
        yield Gate.judged(name, is_same, figure, expected, remedy)


def _clocks(outputs: Sequence[OutputSignal]) -> Iterator[tuple[np.ndarray, str]]:
    """Yield the stamps of outputs with the names of those that share their first and last ones."""
    groups: dict[tuple[float, float], list[OutputSignal]] = {}
    for own in outputs:
        groups.setdefault((float(own.times_s[0]), float(own.times_s[-1])), []).append(own)
    for group in groups.values():
        longest = max(group, key=lambda own: len(own.times_s))
        yield longest.times_s, ", ".join(own.name for own in group)
