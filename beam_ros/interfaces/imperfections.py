"""Imperfections of the simulated hardware: presets of the group ``simulation``, and where a key does nothing.

A preset gives all of these keys at once, and keys that are given beside it win. A key that would have no effect on
the rig as it is commanded and filmed is refused, so that nobody believes in a friction that is not there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.parameter import Value

if TYPE_CHECKING:
    from beam_ros.interfaces.rig_parameters import RigParameters

PRESETS: dict[str, dict[str, Value]] = {
    "ideal": {
        "drag_coefficient": 0.0,
        "large_deflections": False,
        "friction_coulomb": 0.0,
        "friction_static": 0.0,
        "friction_viscous": 0.0,
        "friction_coulomb_difference": 0.0,
        "friction_viscous_difference": 0.0,
        "servo_frequency": 0.0,
        "servo_damping": 0.7,
        "backlash": 0.0,
        "end_stops": False,
        "stop_restitution": 0.3,
        "ripple": 0.0,
        "ripple_period": 0.005,
        "encoder_noise": 0.0,
        "encoder_at": "hub",
        "hub_clock_ppm": 0.0,
        "camera_clock_ppm": 0.0,
        "stamp_offset": 0.0,
        "stamp_jitter": 0.0,
        "frame_drops": 0.0,
        "full_well": 0.0,
    }
}
"""Values of the keys of the group ``simulation`` by the preset's name; ``ideal`` is what the packaged file holds."""

# A preloaded ball screw on recirculating guides with a servo drive, and an industrial camera on USB 3.
PRESETS["realistic"] = {
    **PRESETS["ideal"],
    "drag_coefficient": 6.0,
    "large_deflections": True,
    "friction_coulomb": 1.5,
    "friction_static": 2.0,
    "friction_viscous": 4.0,
    "servo_frequency": 60.0,
    "backlash": 2e-6,
    "end_stops": True,
    "ripple": 0.3,
    "encoder_noise": 2e-7,
    "hub_clock_ppm": 35.0,
    "camera_clock_ppm": -20.0,
    "stamp_jitter": 5e-5,
    "frame_drops": 0.001,
    "full_well": 10_000.0,
}


def with_preset(changes: Mapping[str, Value]) -> dict[str, Value]:
    """Return dotted names and values with what a preset among them gives beside them."""
    preset = changes.get("simulation.preset")
    if preset is None:
        return dict(changes)
    given = {f"simulation.{leaf}": value for leaf, value in PRESETS[str(preset)].items()}
    return {**given, **changes}


def _is_pushed(rig: RigParameters) -> bool:
    return rig.simulation.servo_frequency > 0.0 or rig.hub.command_mode == "effort"


def _has_driven_servo(rig: RigParameters) -> bool:
    return rig.simulation.servo_frequency > 0.0 and rig.hub.command_mode != "effort"


_EFFECTS: tuple[tuple[tuple[str, ...], Callable[[RigParameters], bool], str], ...] = (
    (
        (
            "friction_coulomb",
            "friction_static",
            "friction_viscous",
            "friction_coulomb_difference",
            "friction_viscous_difference",
            "end_stops",
            "ripple",
        ),
        _is_pushed,
        "a hub that follows its commands exactly feels no force: expected simulation.servo_frequency above 0, or "
        "hub.command_mode effort",
    ),
    (
        ("backlash", "encoder_at"),
        _has_driven_servo,
        "there is no drive that the hub could lag behind: expected simulation.servo_frequency above 0, and another "
        "hub.command_mode than effort",
    ),
    (
        ("servo_damping",),
        lambda rig: rig.simulation.servo_frequency > 0.0,
        "there is no servo: expected simulation.servo_frequency above 0",
    ),
    (
        ("stop_restitution",),
        lambda rig: rig.simulation.end_stops,
        "there are no stops: expected simulation.end_stops true",
    ),
    (
        ("ripple_period",),
        lambda rig: rig.simulation.ripple > 0.0,
        "there is no ripple: expected simulation.ripple above 0",
    ),
    (
        ("full_well",),
        lambda rig: rig.simulation.images,
        "there are no images: expected simulation.images true",
    ),
)


def check_imperfections(rig: RigParameters) -> None:
    """Check that every imperfection is one on this rig.

    Raises
    ------
    ParameterFileError
        A key that the preset does not set so has no effect, the static friction is below Coulomb's, friction
        is below 0 in one direction, or the servo is too fast for the device's tick.
    """
    simulation = rig.simulation
    static, coulomb = simulation.friction_static, simulation.friction_coulomb
    if 0.0 < static < coulomb:
        raise ParameterFileError(
            f"simulation.friction_static is {static:g} N: expected at least simulation.friction_coulomb = "
            f"{coulomb:g} N, or 0 for the same"
        )
    for kind, unit in (("coulomb", "N"), ("viscous", "N s/m")):
        mean = getattr(simulation, f"friction_{kind}")
        apart = getattr(simulation, f"friction_{kind}_difference")
        if abs(apart) > 2.0 * mean:
            raise ParameterFileError(
                f"simulation.friction_{kind}_difference is {apart:g} {unit}: expected at most {2.0 * mean:g} "
                f"{unit} on either side of 0, twice their mean simulation.friction_{kind}; friction never pushes"
            )
    reach = math.tau * simulation.servo_frequency * rig.hub.period
    zeta = simulation.servo_damping
    # The force of a tick is held: a mass on this loop swings up from omega T = min(4 zeta, 1/zeta) on.
    bound = 0.5 * min(4.0 * zeta, 1.0 / max(zeta, 1e-9))
    if reach > bound:
        raise ParameterFileError(
            f"simulation.servo_frequency is {simulation.servo_frequency:g} Hz with servo_damping {zeta:g} and "
            f"hub.period {rig.hub.period:g} s: expected at most "
            f"{bound / (math.tau * rig.hub.period):.3g} Hz, half of where a "
            "servo that acts once per tick becomes unstable; lower it"
        )
    of_presets = (PRESETS["ideal"], PRESETS[simulation.preset])
    for names, has_effect, reason in _EFFECTS:
        for name in names:
            value = getattr(simulation, name)
            if not has_effect(rig) and all(value != preset[name] for preset in of_presets):
                raise ParameterFileError(
                    f"simulation.{name} is {value} and would have no effect, because {reason}; or leave it out"
                )
