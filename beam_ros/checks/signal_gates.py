"""Gates of the samples: what is missing and where, what stands at its limits, what is noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from beam_ident import InputSignal, OutputSignal, TimeRecord
from beam_ident.report.gates import Gate
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.noise_floor import noise_floor
from beam_ident.sensing.quantisation import clipped_warnings
from beam_ros.rig.rig import Rig

_NAMED = 3
_WIDER = 1.1  # times wider intervals are worth a word: a sixth of the samples is missing then
_UNLIKELY = 200.0  # no resonance of a beam in air raises broad motion as much as a wrong unit, 1000, does
_SIDE = 0.9  # correlation that has a sign


def input_gates(record: TimeRecord, least_noise: float) -> Iterator[Gate]:
    """Judge the input's gaps by how well they can be bridged; ``least_noise`` is infinite where none is known."""
    for drive in record.inputs:
        name = f"gaps of {drive.name}"
        expected = f"bridges known better than the outputs' noise of {least_noise:.2g} {drive.unit}"
        if not drive.gaps:
            yield Gate(name, "passed", f"none in {_length(drive):.3f} s", expected)
            continue
        where = ", ".join(
            f"{gap.start_s:.3f} s ({(gap.end_s - gap.start_s) * 1e3:.3g} ms)" for gap in drive.gaps[:_NAMED]
        )
        more = f" and {len(drive.gaps) - _NAMED} more" if len(drive.gaps) > _NAMED else ""
        worst = max(gap.sigma for gap in drive.gaps)
        missing = sum(gap.missing for gap in drive.gaps)
        figure = f"{len(drive.gaps)}, {missing} samples: at {where}{more}; bridges known to {worst:.2g} {drive.unit}"
        if missing > 0.5 * len(drive.values):
            yield Gate(name, "failed", figure, "less than half missing", _RECORD_AGAIN)
        elif math.isinf(least_noise):
            # Nobody knows what the bridges must be held against: what a fit makes of them it says.
            yield Gate(name, "not judged", figure, "bridges known better than the outputs' noise")
        elif worst > least_noise:
            yield Gate(name, "doubtful", figure, expected, _RECORD_AGAIN)
        else:
            yield Gate(name, "passed", figure, expected)


_RECORD_AGAIN = (
    "record again with less load on the host; both sides of a gap are used, each with its own motion"
)


def loss_gates(outputs: Sequence[OutputSignal]) -> Iterator[Gate]:
    """Judge the samples that every output lacks: frames that are lost and markers that are not seen."""
    for own in outputs:
        times = own.times_s[own.is_valid]
        steps = np.diff(times)
        name, expected = f"samples of {own.name}", "so few missing that no interval is a tenth wider"
        if len(steps) < 2:
            yield Gate(name, "failed", f"{len(times)} samples", "a record", "record longer")
            continue
        period = float(np.median(steps))
        lost = np.maximum(np.rint(steps / period) - 1.0, 0.0)
        share = float(np.sum(lost)) / (len(times) + float(np.sum(lost)))
        longest = int(np.argmax(steps))
        figure = f"{len(times)}, {int(np.sum(lost))} missing ({100.0 * share:.2g} %)"
        if np.any(lost):
            figure += f", longest {(steps[longest]) * 1e3:.3g} ms at {times[longest]:.3f} s"
        remedy = "see why frames or markers are lost: light, focus, load, distance to the image's border"
        if share > 0.5 or steps[longest] > 0.5 * (times[-1] - times[0]):
            yield Gate(name, "failed", figure, "at least half of the samples", remedy)
        elif 1.0 - share < 1.0 / _WIDER**2:
            yield Gate(name, "doubtful", figure, expected, remedy)
        else:
            yield Gate(name, "passed", figure, expected)


def damage_gate(record: TimeRecord) -> Gate:
    """Judge whether channels are clipped, stuck, or one another's copy."""
    found = [*clipped_warnings(record.outputs), *damage_warnings(record.outputs, record.inputs)]
    expected = "no samples at an end of the range, stuck or copied"
    if found:
        return Gate(
            "saturation", "doubtful", " ".join(found), expected, "take a wider range, or mend the channel"
        )
    return Gate("saturation", "passed", "none", expected)


def noise_gates(outputs: Sequence[OutputSignal], noise_sd: dict[str, float]) -> Iterator[Gate]:
    """Judge every output's motion against the floor of its noise."""
    for own in outputs:
        noise = noise_sd[own.name]
        name, expected = f"noise of {own.name}", "motion above the floor of the noise"
        if math.isnan(noise):
            yield Gate(name, "not judged", f"{len(own.values)} samples", "32 samples without a hole")
            continue
        seen = own.values[own.is_valid]
        moves = math.sqrt(max(float(np.var(seen)) - noise**2, 0.0))
        figure = f"floor {noise:.2g} {own.unit}, motion {moves:.3g} {own.unit}"
        remedy = "more amplitude, a better light or a nearer sensor"
        is_seen = moves > noise
        yield Gate(name, "passed" if is_seen else "doubtful", figure, expected, "" if is_seen else remedy)


def unit_gate(record: TimeRecord, structure: str) -> Gate:
    """Judge whether outputs and input can be in the units that they claim."""
    drive = record.inputs[0]
    expected = "outputs that follow the base, between a two-hundredth and 200 times its motion"
    if structure != "base_motion":
        return Gate("units", "not judged", f"{drive.name} in {drive.unit}", expected)
    doubts, figures = [], []
    for own in record.outputs:
        times, values = own.times_s[own.is_valid], own.values[own.is_valid]
        base = np.interp(times, drive.times_s, drive.values)
        if not (np.std(base) > 0.0 and np.std(values) > 0.0):
            continue
        ratio = float(np.std(values) / np.std(base))
        figures.append(f"{own.name} {ratio:.3g} times")
        if not 1.0 / _UNLIKELY < ratio < _UNLIKELY:
            doubts.append(f"{own.name} moves {ratio:.3g} times as much as {drive.name}: millimetres?")
        elif float(np.corrcoef(base, values)[0, 1]) < -_SIDE:
            doubts.append(f"{own.name} moves against {drive.name}: sign?")
    if doubts:
        remedy = (
            "give the signal its scale (,scale=1e-3 or ,scale=-1), or mend calibration and camera.is_mirrored"
        )
        return Gate("units", "doubtful", "; ".join(doubts), expected, remedy)
    return Gate("units", "passed", ", ".join(figures) or "nothing moves", expected)


def limit_gates(record: TimeRecord, rig: Rig | None) -> Iterator[Gate]:
    """Judge how near hub and beam came to the limits of the rig."""
    if rig is None:
        return
    drive = record.inputs[0]
    if drive.name != "hub" or drive.unit != "m":
        return
    reached = float(np.max(np.abs(drive.values)))
    limit = 0.5 * rig.hub.travel
    step = max(rig.hub.encoder_resolution, drive.sigma)
    is_at_end = reached > limit - 3.0 * step
    yield Gate(
        "travel",
        "doubtful" if is_at_end else "passed",
        f"{reached * 1e3:.3g} mm of {limit * 1e3:.3g} mm to either side",
        "the hub away from its stops",
        "lower the amplitude: a stop is a blow that is no part of the input" if is_at_end else "",
    )
    highest = None
    for own in record.outputs:
        times = own.times_s[own.is_valid]
        bent = own.values[own.is_valid] - np.interp(times, drive.times_s, drive.values)
        size = float(np.max(np.abs(bent - np.median(bent))))
        if highest is None or size > highest[1]:
            highest = own.name, size
    if highest is not None:
        is_beyond = highest[1] > rig.hub.max_tip_deflection
        yield Gate(
            "deflection",
            "doubtful" if is_beyond else "passed",
            f"{highest[1] * 1e3:.3g} mm at {highest[0]}",
            f"below the rig's {rig.hub.max_tip_deflection * 1e3:.3g} mm, where the beam is linear",
            "lower the amplitude, or sweep through the mode faster" if is_beyond else "",
        )


def floors(outputs: Sequence[OutputSignal]) -> dict[str, float]:
    """Return the floor of every output's noise, NaN where it is not known."""
    return {own.name: noise_floor(own.times_s[own.is_valid], own.values[own.is_valid]) for own in outputs}


def _length(drive: InputSignal) -> float:
    first, last = drive.span_s
    return last - first
