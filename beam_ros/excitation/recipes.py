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
    kind = rig.excitation.kind
    highest, nyquist = rig.excitation.end_frequency, 0.5 / rig.hub.period
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
    duration = rig.excitation.duration
    return chirp(
        start_hz=rig.excitation.start_frequency,
        end_hz=rig.excitation.end_frequency,
        sweep_s=duration,
        acceleration=rig.excitation.acceleration,
        displacement_ceiling=rig.excitation.max_displacement,
        still_s=rig.excitation.still,
        fade_in_s=min(1.0, duration / 4),
        fade_out_s=min(0.25, duration / 4),
        velocity_ceiling=_velocity_ceiling(rig),
    )


def _velocity_ceiling(rig: Rig) -> float | None:
    return rig.excitation.max_velocity or None


def _multisine(rig: Rig) -> Recipe:
    duration, period = rig.excitation.duration, rig.excitation.line_period
    n_periods = max(1, round(duration / (period or _USUAL_LINE_PERIOD_S)))
    lines = rig.excitation.lines
    return Multisine(
        low_hz=rig.excitation.start_frequency,
        high_hz=rig.excitation.end_frequency,
        line_period_s=period or duration / n_periods,
        n_periods=n_periods,
        rms_acceleration=rig.excitation.acceleration,
        displacement_ceiling=rig.excitation.max_displacement,
        odd_only=lines != "full",
        seed=rig.excitation.seed,
        still_s=rig.excitation.still,
        fade_s=min(0.5, duration / 4),
        detection_group=rig.excitation.detection_group if lines == "random_odd" else 0,
        phases=rig.excitation.phases,
        velocity_ceiling=_velocity_ceiling(rig),
    )


def _prbs(rig: Rig) -> Recipe:
    order, clock_s = rig.excitation.order, rig.excitation.clock_period
    is_inverse = rig.excitation.inverse_repeat
    period_s = (2.0 if is_inverse else 1.0) * (2**order - 1) * clock_s
    return Prbs(
        drive=rig.excitation.drive,
        amplitude=_level(rig),
        rise_s=rig.excitation.edge_time,
        still_s=rig.excitation.still,
        order=order,
        clock_s=clock_s,
        n_periods=max(1, round(rig.excitation.duration / period_s)),
        inverse_repeat=is_inverse,
        high_pass_hz=rig.excitation.high_pass,
    )


def _level(rig: Rig) -> float:
    """Return the level of pulses, doublets and sequences in the quantity that they are designed in."""
    excitation = rig.excitation
    return {
        "position": excitation.step_size,
        "velocity": excitation.speed,
        "acceleration": excitation.acceleration,
    }[excitation.drive]


def _step(rig: Rig) -> Recipe:
    rise = rig.excitation.rise_time
    return Step(
        distance=rig.excitation.step_size,
        rise_s=rise,
        hold_s=max(0.0, rig.excitation.duration - 2 * rise),
        still_s=rig.excitation.still,
    )


def _pulse(rig: Rig, pulse: type[Pulse] | type[Doublet]) -> Recipe:
    return pulse(
        drive=rig.excitation.drive,
        amplitude=_level(rig),
        rise_s=rig.excitation.edge_time,
        still_s=rig.excitation.still,
        width_s=rig.excitation.width,
        gap_s=rig.excitation.gap,
    )


def _sine(rig: Rig) -> Recipe:
    frequency = rig.excitation.start_frequency
    n_cycles = rig.excitation.duration * frequency
    return Sine(
        frequency_hz=frequency,
        acceleration=rig.excitation.acceleration,
        n_cycles=n_cycles,
        fade_cycles=min(4.0, n_cycles / 4),
        still_s=rig.excitation.still,
        displacement_ceiling=rig.excitation.max_displacement,
    )


def _stepped_sine(rig: Rig) -> Recipe:
    return SteppedSine(
        frequencies_hz=rig.excitation.frequencies,
        acceleration=rig.excitation.acceleration,
        displacement_ceiling=rig.excitation.max_displacement,
        settle_cycles=rig.excitation.settle_cycles,
        measure_cycles=rig.excitation.measure_cycles,
        still_s=rig.excitation.still,
    )


def _noise(rig: Rig) -> Recipe:
    duration = rig.excitation.duration
    return BandLimitedNoise(
        low_hz=rig.excitation.start_frequency,
        high_hz=rig.excitation.end_frequency,
        length_s=duration,
        rms_acceleration=rig.excitation.acceleration,
        displacement_ceiling=rig.excitation.max_displacement,
        seed=rig.excitation.seed,
        still_s=rig.excitation.still,
        fade_s=min(0.5, duration / 4),
    )


def _moves(rig: Rig) -> Recipe:
    return PointToPoint(
        waypoints=rig.excitation.waypoints,
        profile=rig.excitation.profile,
        speed=rig.excitation.speed,
        acceleration=rig.excitation.acceleration,
        jerk=rig.excitation.jerk,
        dwell_s=rig.excitation.dwell,
        still_s=rig.excitation.still,
    )


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
