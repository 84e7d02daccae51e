"""What lies between the simulated drive's command and the hub: guide, stops, servo and the actuator's ripple."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from beam_model import EndStops, HubFriction, PositionServo


@dataclass(frozen=True)
class Mechanism:
    """The real axis around the hub; by default a hub that nothing resists and that follows exactly.

    Parameters
    ----------
    friction : HubFriction
        Of the guide.
    stops : EndStops, optional
        At the ends of the travel, seen from home.
    servo : PositionServo, optional
        What moves the hub towards its reference; without one it follows exactly.
    ripple : float
        Amplitude of a force that the actuator adds [N]: ripple sin(2 pi x / ripple_period), with the position x
        at the tick's beginning, where the actuator commutates.
    ripple_period : float
        [m].
    """

    friction: HubFriction = field(default_factory=HubFriction)
    stops: EndStops | None = None
    servo: PositionServo | None = None
    ripple: float = 0.0
    ripple_period: float = 1.0

    @property
    def resists(self) -> bool:
        """Whether a hub under a force moves otherwise than freely."""
        return self.friction != HubFriction() or self.stops is not None

    def ripple_at(self, position: float) -> float:
        """Return the ripple's force [N] at a position of the hub [m]."""
        if self.ripple == 0.0:
            return 0.0
        return self.ripple * math.sin(2.0 * math.pi * position / self.ripple_period)


def servo_on(
    mass: float, *, frequency_hz: float, damping_ratio: float, max_force: float, backlash: float
) -> PositionServo:
    """Return the servo that gives a mass this natural frequency and damping ratio.

    Parameters
    ----------
    mass : float
        All that moves [kg].
    frequency_hz, damping_ratio : float
        Of the mass on the servo: stiffness M omega^2, damping 2 zeta M omega.
    max_force : float
        Saturation [N].
    backlash : float
        Play between drive and hub [m].
    """
    omega = 2.0 * math.pi * frequency_hz
    return PositionServo(
        proportional=mass * omega**2,
        derivative=2.0 * damping_ratio * mass * omega,
        max_force=max_force,
        backlash=backlash,
    )
