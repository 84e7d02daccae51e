"""Gates of the samples: what is missing and where, what stands at its limits, what is noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.data.argument_checks import require_output
from beam_ident.report.gates import Gate
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.noise_floor import noise_floor
from beam_ident.sensing.quantisation import clipped_warnings
from beam_ros.rig.rig import Rig

_NAMED = 3
_WIDER = 1.1  # times wider intervals are worth a word: a sixth of the samples is missing then
_UNLIKELY = 200.0  # no resonance of a beam in air raises broad motion as much as a wrong unit, 1000, does
_OTHER_MOTION = 0.02  # of the largest residue: what other modes and noise leave in the main motion
_FALSE_ALARM = 1e-4  # how often markers in their places are taken for exchanged
_MOST_PLACES = 6  # markers of which every order is tried
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
        else:
            yield Gate.judged(name, worst <= least_noise, figure, expected, _RECORD_AGAIN)


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
        else:
            yield Gate.judged(name, 1.0 - share >= 1.0 / _WIDER**2, figure, expected, remedy)


def damage_gate(record: TimeRecord) -> Gate:
    """Judge whether channels are clipped, stuck, or one another's copy."""
    found = [*clipped_warnings(record.outputs), *damage_warnings(record.outputs, record.inputs)]
    expected = "no samples at an end of the range, stuck or copied"
    remedy = "take a wider range, or mend the channel"
    return Gate.judged("saturation", not found, " ".join(found) or "none", expected, remedy)


def noise_gates(outputs: Sequence[OutputSignal], noise_sd: dict[str, float]) -> Iterator[Gate]:
    """Judge every output's motion against the floor of its noise."""
    for own in outputs:
        noise = noise_sd[own.name]
        name, expected = f"noise of {own.name}", "motion above the floor of the noise"
        try:
            require_output(own.name, own.values[own.is_valid])
        except EstimationError as err:  # as the fit would refuse it
            yield Gate(
                name, "failed", str(err), expected, "see that the tracker ran and the beam was in view"
            )
            continue
        if math.isnan(noise):
            yield Gate(name, "not judged", f"{len(own.values)} samples", "32 samples without a hole")
            continue
        seen = own.values[own.is_valid]
        moves = math.sqrt(max(float(np.var(seen)) - noise**2, 0.0))
        figure = f"floor {noise:.2g} {own.unit}, motion {moves:.3g} {own.unit}"
        remedy = "more amplitude, a better light or a nearer sensor"
        yield Gate.judged(name, moves > noise, figure, expected, remedy)


def place_gate(record: TimeRecord, rig: Rig | None, structure: str) -> Gate:
    """Judge whether every marker moves as its height says, or as that of another.

    Notes
    -----
    The main motion of the deflections, their first singular vector, is held against every mode shape of the rig at
    the heights of the markers, and at the same heights in every other order. An error of a height goes along the
    shape's slope. The orders are compared by their log-likelihoods.
    """
    expected = "markers that move as the mode shapes do at their heights"
    markers = [] if rig is None else [own for own in record.outputs if own.name in rig.markers.names]
    stamps = {own.times_s[own.is_valid].tobytes() for own in markers}
    if rig is None or structure != "base_motion" or not 2 <= len(markers) <= _MOST_PLACES or len(stamps) != 1:
        return Gate("places", "not judged", f"{len(markers)} markers seen at once on a moved base", expected)
    drive, times = record.inputs[0], markers[0].times_s[markers[0].is_valid]
    base = np.interp(times, drive.times_s, drive.values)
    bent = np.array([own.values[own.is_valid] - base for own in markers])
    main = np.linalg.svd(bent - np.mean(bent, axis=1, keepdims=True), full_matrices=False)[0][:, 0]
    rows = [rig.markers.names.index(own.name) for own in markers]
    heights = np.array(rig.markers.heights)[rows]
    height_sd = np.array(rig.markers.height_uncertainties)[rows]
    model = rig.beam_model()
    shapes = np.asarray(model.motion_residues(heights))
    slopes = np.asarray(model.motion_residues(heights, derivative=1))
    variances = (slopes * height_sd[:, None]) ** 2 + (_OTHER_MOTION * np.max(np.abs(shapes), axis=0)) ** 2

    def misfit(order: tuple[int, ...]) -> float:
        shape, variance = shapes[list(order)], variances[list(order)]
        gains = (shape / variance).T @ main / np.sum(main[:, None] ** 2 / variance, axis=0)
        return float(np.min(np.sum((gains * main[:, None] - shape) ** 2 / variance, axis=0)))

    given = tuple(range(len(markers)))
    best = min(permutations(given), key=misfit)
    if misfit(given) - misfit(best) <= 2.0 * math.log(math.factorial(len(markers)) / _FALSE_ALARM):
        return Gate("places", "passed", "each as at its height", expected)
    said = ", ".join(
        f"{own.name} moves as {markers[k].name} should"
        for own, k in zip(markers, best, strict=True)
        if own is not markers[k]
    )
    remedy = (
        "see which marker is which (markers.heights, tracker), and whether the names of two are exchanged"
    )
    return Gate("places", "doubtful", said, expected, remedy)


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
    figure = "; ".join(doubts) or ", ".join(figures) or "nothing moves"
    remedy = (
        "give the signal its scale (,scale=1e-3 or ,scale=-1), or mend calibration and camera.is_mirrored"
    )
    return Gate.judged("units", not doubts, figure, expected, remedy)


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
    yield Gate.judged(
        "travel",
        reached <= limit - 3.0 * step,
        f"{reached * 1e3:.3g} mm of {limit * 1e3:.3g} mm to either side",
        "the hub away from its stops",
        "lower the amplitude: a stop is a blow that is no part of the input",
    )
    sizes = {}
    for own in record.outputs:
        times = own.times_s[own.is_valid]
        bent = own.values[own.is_valid] - np.interp(times, drive.times_s, drive.values)
        sizes[own.name] = float(np.max(np.abs(bent - np.median(bent))))
    if sizes:
        highest = max(sizes, key=lambda name: sizes[name])
        yield Gate.judged(
            "deflection",
            sizes[highest] <= rig.hub.max_tip_deflection,
            f"{sizes[highest] * 1e3:.3g} mm at {highest}",
            f"below the rig's {rig.hub.max_tip_deflection * 1e3:.3g} mm, where the beam is linear",
            "lower the amplitude, or sweep through the mode faster",
        )


def floors(outputs: Sequence[OutputSignal]) -> dict[str, float]:
    """Return the floor of every output's noise, NaN where it is not known."""
    return {own.name: noise_floor(own.times_s[own.is_valid], own.values[own.is_valid]) for own in outputs}


def _length(drive: InputSignal) -> float:
    first, last = drive.span_s
    return last - first
