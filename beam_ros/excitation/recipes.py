"""From the rig's ``excitation`` parameters to a recipe: one small function for each kind of signal.

Which parameters a kind reads stands in its function and in docs/excitation.md; the others are left alone.
"""

from __future__ import annotations

from collections.abc import Callable

from beam_ident.errors import IdentificationError
from beam_ident.excitation import (
    BandLimitedNoise,
    Doublet,
    LinearChirp,
    LogChirp,
    Multisine,
    PointToPoint,
    Prbs,
    Pulse,
    Recipe,
    Sine,
    Step,
    SteppedSine,
)
from beam_ros.errors import UsageError
from beam_ros.rig.rig import Rig

_USUAL_LINE_PERIOD_S = 10.0
_BROADBAND = ("chirp", "linear_chirp", "multisine", "noise")


def recipe_of_rig(rig: Rig) -> Recipe:
    """Build the recipe that the rig's ``excitation`` parameters describe.

    Raises
    ------
    UsageError
        The parameters do not make a signal.
    """
    kind = rig.text("excitation.kind")
    highest, nyquist = rig.number("excitation.end_frequency"), 0.5 / rig.number("hub.period")
    if kind in _BROADBAND and highest > nyquist:
        raise UsageError(
            f"excitation.end_frequency is {highest:g} Hz: expected at most {nyquist:g} Hz, half the rate "
            "of hub.period"
        )
    try:
        return RECIPE_OF_KIND[kind](rig)
    except IdentificationError as err:
        raise UsageError(f"excitation parameters: {err}") from err


def _chirp(rig: Rig, chirp: type[LogChirp] | type[LinearChirp]) -> Recipe:
    duration = rig.number("excitation.duration")
    return chirp(
        start_hz=rig.number("excitation.start_frequency"),
        end_hz=rig.number("excitation.end_frequency"),
        sweep_s=duration,
        acceleration=rig.number("excitation.acceleration"),
        displacement_ceiling=rig.number("excitation.max_displacement"),
        still_s=rig.number("excitation.still"),
        fade_in_s=min(1.0, duration / 4),
        fade_out_s=min(0.25, duration / 4),
        velocity_ceiling=_velocity_ceiling(rig),
    )


def _velocity_ceiling(rig: Rig) -> float | None:
    return rig.number("excitation.max_velocity") or None


def _multisine(rig: Rig) -> Recipe:
    duration, period = rig.number("excitation.duration"), rig.number("excitation.line_period")
    n_periods = max(1, round(duration / (period or _USUAL_LINE_PERIOD_S)))
    lines = rig.text("excitation.lines")
    return Multisine(
        low_hz=rig.number("excitation.start_frequency"),
        high_hz=rig.number("excitation.end_frequency"),
        line_period_s=period or duration / n_periods,
        n_periods=n_periods,
        rms_acceleration=rig.number("excitation.acceleration"),
        displacement_ceiling=rig.number("excitation.max_displacement"),
        odd_only=lines != "full",
        seed=_whole(rig, "excitation.seed"),
        still_s=rig.number("excitation.still"),
        fade_s=min(0.5, duration / 4),
        detection_group=_whole(rig, "excitation.detection_group") if lines == "random_odd" else 0,
        phases=rig.text("excitation.phases"),
        velocity_ceiling=_velocity_ceiling(rig),
    )


def _prbs(rig: Rig) -> Recipe:
    order, clock_s = _whole(rig, "excitation.order"), rig.number("excitation.clock_period")
    is_inverse = bool(rig["excitation.inverse_repeat"])
    period_s = (2.0 if is_inverse else 1.0) * (2**order - 1) * clock_s
    return Prbs(
        drive=rig.text("excitation.drive"),
        amplitude=_level(rig),
        rise_s=rig.number("excitation.edge_time"),
        still_s=rig.number("excitation.still"),
        order=order,
        clock_s=clock_s,
        n_periods=max(1, round(rig.number("excitation.duration") / period_s)),
        inverse_repeat=is_inverse,
        high_pass_hz=rig.number("excitation.high_pass"),
    )


def _level(rig: Rig) -> float:
    """Return the level of pulses, doublets and sequences in the quantity that they are designed in."""
    name = {
        "position": "excitation.step_size",
        "velocity": "excitation.speed",
        "acceleration": "excitation.acceleration",
    }[rig.text("excitation.drive")]
    return rig.number(name)


def _step(rig: Rig) -> Recipe:
    rise = rig.number("excitation.rise_time")
    return Step(
        distance=rig.number("excitation.step_size"),
        rise_s=rise,
        hold_s=max(0.0, rig.number("excitation.duration") - 2 * rise),
        still_s=rig.number("excitation.still"),
    )


def _pulse(rig: Rig, pulse: type[Pulse] | type[Doublet]) -> Recipe:
    return pulse(
        drive=rig.text("excitation.drive"),
        amplitude=_level(rig),
        rise_s=rig.number("excitation.edge_time"),
        still_s=rig.number("excitation.still"),
        width_s=rig.number("excitation.width"),
        gap_s=rig.number("excitation.gap"),
    )


def _sine(rig: Rig) -> Recipe:
    frequency = rig.number("excitation.start_frequency")
    n_cycles = rig.number("excitation.duration") * frequency
    return Sine(
        frequency_hz=frequency,
        acceleration=rig.number("excitation.acceleration"),
        n_cycles=n_cycles,
        fade_cycles=min(4.0, n_cycles / 4),
        still_s=rig.number("excitation.still"),
        displacement_ceiling=rig.number("excitation.max_displacement"),
    )


def _stepped_sine(rig: Rig) -> Recipe:
    return SteppedSine(
        frequencies_hz=rig.numbers("excitation.frequencies"),
        acceleration=rig.number("excitation.acceleration"),
        displacement_ceiling=rig.number("excitation.max_displacement"),
        settle_cycles=rig.number("excitation.settle_cycles"),
        measure_cycles=_whole(rig, "excitation.measure_cycles"),
        still_s=rig.number("excitation.still"),
    )


def _noise(rig: Rig) -> Recipe:
    duration = rig.number("excitation.duration")
    return BandLimitedNoise(
        low_hz=rig.number("excitation.start_frequency"),
        high_hz=rig.number("excitation.end_frequency"),
        length_s=duration,
        rms_acceleration=rig.number("excitation.acceleration"),
        displacement_ceiling=rig.number("excitation.max_displacement"),
        seed=_whole(rig, "excitation.seed"),
        still_s=rig.number("excitation.still"),
        fade_s=min(0.5, duration / 4),
    )


def _moves(rig: Rig) -> Recipe:
    return PointToPoint(
        waypoints=rig.numbers("excitation.waypoints"),
        profile=rig.text("excitation.profile"),
        speed=rig.number("excitation.speed"),
        acceleration=rig.number("excitation.acceleration"),
        jerk=rig.number("excitation.jerk"),
        dwell_s=rig.number("excitation.dwell"),
        still_s=rig.number("excitation.still"),
    )


def _whole(rig: Rig, name: str) -> int:
    return int(rig.number(name))


RECIPE_OF_KIND: dict[str, Callable[[Rig], Recipe]] = {
    "chirp": lambda rig: _chirp(rig, LogChirp),
    "linear_chirp": lambda rig: _chirp(rig, LinearChirp),
    "multisine": _multisine,
    "prbs": _prbs,
    "step": _step,
    "doublet": lambda rig: _pulse(rig, Doublet),
    "pulse": lambda rig: _pulse(rig, Pulse),
    "sine": _sine,
    "stepped_sine": _stepped_sine,
    "noise": _noise,
    "moves": _moves,
}
"""What makes the recipe of each word that ``excitation.kind`` may be."""
