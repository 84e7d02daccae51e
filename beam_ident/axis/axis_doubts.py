"""What speaks against an identified axis: methods or halves that disagree, a force at its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.axis.axis_record import AxisRecord
from beam_ident.axis.axis_result import AxisTerm
from beam_ident.axis.inverse_dynamics import NAMES, InverseDynamicsFit, fit_inverse_dynamics
from beam_ident.errors import EstimationError

_APART, _DIFFERENT = 4.0, 0.01  # standard deviations between two estimates, and share of them
_AT_LIMIT = (0.005, 0.95)
"""Shares of a force's samples at its limits that speak of limits: what is switched stands there always."""
_JUMP, _FASTEST = 5.0, 0.99
"""How many times a step between samples must exceed this quantile of all steps in motion, to be no motion."""
_UNMEASURED = (
    "forces that nobody measured outweigh the noise of the position: the estimates are those of inverse dynamics, "
    "with standard deviations that the colour of these forces gives"
)
_NOT_LED = (
    "; if a servo answered them, the estimates follow them too, and no deviation counts that: name with reference= "
    "the input that the servo was to follow"
)


def negative_friction(estimates: FloatArray, covariance: FloatArray) -> list[str]:
    """Return a warning where dry friction drives the axis."""
    if estimates[2] < -_APART * np.sqrt(covariance[2, 2]):
        return ["the dry friction comes out negative: check the signs of force and position"]
    return []


def of_terms(terms: Sequence[AxisTerm]) -> list[str]:
    """Return a warning where the record shows forces that the model lacks."""
    if not terms:
        return []
    named = " and ".join(term.name for term in terms)
    return [
        f"forces that the model lacks go with {named}: mass and friction take up what of them goes with the motion, "
        "and may err by many of their deviations. Look for a spring, a cable, a slope or a gearing beside the axis; "
        "shorter and faster moves show less of what goes with the position"
    ]


def of_jumps(records: Sequence[AxisRecord]) -> list[str]:
    """Return a warning for every record whose position jumps from one sample to the next as no motion does."""
    found = []
    for record in records:
        speeds = np.abs(np.diff(record.positions) / np.diff(record.times_s))
        moving = speeds[~record.is_slow[1:]]
        fastest = float(np.quantile(moving, _FASTEST)) if len(moving) else np.inf
        places = np.flatnonzero(speeds > _JUMP * fastest)
        if len(places):
            k = int(places[0])
            size = abs(float(record.positions[k + 1] - record.positions[k]))
            at = f"{record.times_s[k + 1]:.6g} s from where the force begins"
            found.append(
                f"the position {record.output.name!r} jumps by {size:.3g} m at {at}, {speeds[k] / fastest:.0f} times "
                f"as fast as it moves ({len(places)} such jumps): wild or lost samples, a counter that wraps, an "
                "encoder that slips; set such samples to NaN, unwrap the counter, or identify the stretches between "
                "as records of their own"
            )
    return found


def of_methods(
    estimates: FloatArray, covariance: FloatArray, other: FloatArray, other_covariance: FloatArray
) -> list[str]:
    """Return a warning where the two methods are further apart than either says."""
    worst, apart = _furthest(estimates, covariance, other, other_covariance)
    if not apart:
        return []
    return [
        f"output error and inverse dynamics disagree by {apart:.1f} standard deviations on the {NAMES[worst]} "
        f"({estimates[worst]:.4g} and {other[worst]:.4g}): the axis does something that the model lacks, or its "
        "noise is unlike what either expects; the difference is an honest uncertainty"
    ]


def of_unmeasured_forces(
    records: Sequence[AxisRecord], fit: InverseDynamicsFit, motions: Sequence[FloatArray] | None
) -> list[str]:
    """Return warnings where forces outweigh the sensor's noise, and what may have made them.

    Parameters
    ----------
    records : sequence of AxisRecord
    fit : InverseDynamicsFit -- of them
    motions : sequence of ndarray, optional -- that its instruments were made of
    """
    is_led = records[0].reference is not None
    found = [_UNMEASURED + ("" if is_led else _NOT_LED)]
    for record in records:
        if share := _at_limit(record.drive.values):
            found.append(
                f"the force {record.drive.name!r} stands at its largest or smallest value in {share:.1%} of its "
                "samples: if the sensor or the amplifier ends there, these estimates are wrong; record smaller "
                "moves, or with a wider range"
            )
    return found if len(found) > 1 else found + _of_halves(records, fit, motions)


def _at_limit(values: FloatArray) -> float:
    """Return the share of samples at the ends of a force's range, 0 where it only passes them."""
    share = float(np.mean((values == np.max(values)) | (values == np.min(values))))
    return share if _AT_LIMIT[0] < share < _AT_LIMIT[1] else 0.0


def _of_halves(
    records: Sequence[AxisRecord], fit: InverseDynamicsFit, motions: Sequence[FloatArray] | None
) -> list[str]:
    """Return a warning where the first and the second halves of records have other masses or frictions."""
    names = tuple(name for name in fit.names if name != "delay")
    halves = []
    for is_second in (False, True):
        masked = [_half(record, is_second) for record in records]
        own = None
        if motions is not None:
            kept = [_is_kept(record, is_second) for record in records]
            own = [motion[keep] for motion, keep in zip(motions, kept, strict=True)]
        try:
            halves.append(fit_inverse_dynamics(masked, fit.parameters.delay, names, own))
        except EstimationError:
            return []
    (first, before), (second, after) = (
        (np.array([half.parameters.value(name) for name in NAMES]), half.covariance[:4, :4])
        for half in halves
    )
    worst, apart = _furthest(first, before, second, after)
    if not apart:
        return []
    return [
        f"the halves of the record disagree by {apart:.1f} standard deviations on the {NAMES[worst]} "
        f"({first[worst]:.4g}, then {second[worst]:.4g}): the gain of the force, a clock or the friction changed in "
        "between; identify shorter records"
    ]


def _is_kept(record: AxisRecord, is_second: bool) -> np.ndarray:
    t = record.times_s
    return np.asarray((t > 0.5 * (t[0] + t[-1])) == is_second)


def _half(record: AxisRecord, is_second: bool) -> AxisRecord:
    """Return a record that knows the positions of one half only."""
    keep = _is_kept(record, is_second)
    output = replace(record.output, times_s=record.times_s[keep], values=record.positions[keep])
    return replace(record, output=output)


def _furthest(
    estimates: FloatArray, covariance: FloatArray, other: FloatArray, other_covariance: FloatArray
) -> tuple[int, float]:
    """Return on which parameter two estimates are furthest apart, and by how many deviations; 0 if by chance."""
    apart = np.abs(estimates - other) / np.sqrt(np.diag(covariance) + np.diag(other_covariance))
    worst = int(np.argmax(apart))
    is_much = abs(estimates[worst] - other[worst]) > _DIFFERENT * abs(estimates[worst])
    return worst, float(apart[worst]) if apart[worst] > _APART and is_much else 0.0
