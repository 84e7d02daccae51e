"""What the axis carries: the beam on its hub, as the virtual axis drives it tick by tick.

Within one tick the hub is either led (its acceleration is prescribed, after an optional jump of its
velocity) or free under a force. A plant keeps only the elastic state; where the hub is, the axis knows.
Evaluations inside a tick take a state that `Plant.state` returned earlier, so that a camera can ask for
instants of the recent past.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beam_ros.hub.contract import FloatArray


@dataclass(frozen=True)
class FreeMotion:
    """Where a free hub and its beam are at one instant.

    Parameters
    ----------
    position, velocity, acceleration : float
        Of the hub [m], [m/s], [m/s^2].
    coordinates : ndarray, shape (n_modes,)
        Modal coordinates q [m].
    """

    position: float
    velocity: float
    acceleration: float
    coordinates: FloatArray


class Plant(Protocol):
    """A load on the hub that is stepped exactly with the device's period."""

    n_modes: int

    def state(self) -> FloatArray:
        """Return a copy of the elastic state at the present tick."""

    def kick(self, delta_velocity: float) -> None:
        """Let the hub's velocity jump by `delta_velocity` [m/s]."""

    def step_led(self, acceleration: float, mean_acceleration: float) -> None:
        """Advance one period under a constant hub acceleration [m/s^2].

        The mean one also counts the jump at the beginning, spread over the period.
        """

    def step_free(self, position: float, velocity: float, force: float) -> tuple[float, float]:
        """Advance one period under a constant force [N]; return the hub's new position and velocity."""

    def force_when_led(self, acceleration: float) -> float:
        """Return the force [N] that gives the hub this acceleration in the present state."""

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return q, shape (n_modes,), `tau` seconds into a tick that began in `state`, the hub led."""

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the acceleration that the modes left out of q follow then [m/s^2], the hub led."""

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return hub and beam `tau` seconds into a tick that began in `state`, the hub free."""


class RigidLoad:
    """A hub without a beam: a mass and nothing else.

    Parameters
    ----------
    mass : float
        Moving mass [kg].
    period : float
        The device's tick [s].
    """

    n_modes = 0

    def __init__(self, mass: float, period: float) -> None:
        self._mass = mass
        self._period = period
        self._empty = np.zeros(0)

    def state(self) -> FloatArray:
        """Return the empty elastic state."""
        return self._empty

    def kick(self, delta_velocity: float) -> None:
        """Leave the rigid load as it is."""

    def step_led(self, acceleration: float, mean_acceleration: float) -> None:
        """Leave the rigid load as it is."""

    def step_free(self, position: float, velocity: float, force: float) -> tuple[float, float]:
        """Advance one period under a constant force [N]; return the hub's new position and velocity."""
        motion = self.free_motion(self._empty, position, velocity, self._period, force)
        return motion.position, motion.velocity

    def force_when_led(self, acceleration: float) -> float:
        """Return mass times acceleration [N]."""
        return self._mass * acceleration

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return the empty array: there are no modes."""
        return self._empty

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the hub's acceleration [m/s^2]."""
        return mean_acceleration

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return the hub `tau` seconds into a tick under a constant force."""
        a = force / self._mass
        return FreeMotion(position + velocity * tau + a * tau * tau / 2, velocity + a * tau, a, self._empty)
