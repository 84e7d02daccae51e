"""What the axis carries: the beam on its hub, as the virtual axis drives it tick by tick.

Within one tick the hub is either led (its acceleration is prescribed, after an optional jump of its
velocity) or free under a force, which friction, stops and ripple join; a servo moves it by forces alone. A plant
keeps only the elastic state; where the hub is, the axis knows.
Evaluations inside a tick take a state that ``Plant.state`` returned earlier, so that a camera can ask for
instants of the recent past.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from beam_model import (
    AxisStepper,
    BeamModel,
    ForceStepper,
    MotionStepper,
    NonlinearMotionStepper,
    NonlinearTerms,
)
from beam_ros.arrays import FloatArray
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.mechanism import Mechanism


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


@dataclass(frozen=True)
class Reference:
    """Where a servo shall have the hub at a tick.

    Parameters
    ----------
    position, velocity, acceleration : float
        [m], [m/s], [m/s^2]; the acceleration over the coming tick.
    """

    position: float
    velocity: float
    acceleration: float


class Plant(Protocol):
    """A load on the hub that is stepped exactly with the device's period."""

    n_modes: int
    has_servo: bool
    """Whether a servo moves the hub towards its reference; else it follows exactly."""

    def state(self) -> FloatArray:
        """Return a copy of the elastic state at the present tick."""

    def kick(self, delta_velocity: float) -> None:
        """Let the hub's velocity jump by ``delta_velocity`` [m/s]."""

    def step_led(self, acceleration: float, mean_acceleration: float) -> None:
        """Advance one period under a constant hub acceleration [m/s^2].

        The mean one also counts the jump at the beginning, spread over the period.
        """

    def step_free(self, position: float, velocity: float, force: float) -> tuple[float, float]:
        """Advance one period under a constant force [N]; return the hub's new position and velocity."""

    def force_when_led(self, acceleration: float) -> float:
        """Return the force [N] that gives the hub this acceleration in the present state."""

    def servo_force(self, position: float, velocity: float, reference: Reference) -> float:
        """Let the servo see the hub, once per tick, and return the force [N] that it holds over it."""

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return q, shape (n_modes,), ``tau`` seconds into a tick that began in ``state``, the hub led."""

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the acceleration that the modes left out of q follow then [m/s^2], the hub led."""

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return hub and beam ``tau`` seconds into a tick that began in ``state``, the hub free."""


class RigidPlant:
    """A hub without a beam: a mass and nothing else.

    Parameters
    ----------
    mass : float
        Moving mass [kg].
    period : float
        The device's tick [s].
    """

    n_modes = 0
    has_servo = False

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

    def servo_force(self, position: float, velocity: float, reference: Reference) -> float:
        """Return mass times acceleration [N]: there is no servo."""
        return self._mass * reference.acceleration

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return the empty array: there are no modes."""
        return self._empty

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the hub's acceleration [m/s^2]."""
        return mean_acceleration

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return the hub ``tau`` seconds into a tick under a constant force."""
        a = force / self._mass
        return FreeMotion(position + velocity * tau + a * tau * tau / 2, velocity + a * tau, a, self._empty)


class BeamPlant:
    """A flexible beam on the hub, stepped exactly; implements ``Plant``.

    Parameters
    ----------
    model : BeamModel
        Beam and hub.
    period : float
        The device's tick [s].
    terms : NonlinearTerms, optional
        Air drag and large deflections.
    mechanism : Mechanism, optional
        Friction, stops, servo and ripple of the axis.

    Notes
    -----
    Its state is [q, q', alpha', a_R]: the hub's velocity matters to a beam in air, and a_R is the
    acceleration that the modes left out follow, delayed by eta where there is internal damping.
    """

    def __init__(
        self,
        model: BeamModel,
        period: float,
        terms: NonlinearTerms | None = None,
        mechanism: Mechanism | None = None,
    ) -> None:
        self.n_modes = model.n_modes
        self._mechanism = mechanism = mechanism or Mechanism()
        self.has_servo = mechanism.servo is not None
        self._period = period

        def stepper() -> MotionStepper | NonlinearMotionStepper:
            return (
                model.motion_stepper(period)
                if terms is None
                else NonlinearMotionStepper(model, period, terms)
            )

        self._led, self._probe = stepper(), stepper()
        self._free: AxisStepper | ForceStepper = model.force_stepper(period)
        self._servo: AxisStepper | None = None
        if terms is not None or mechanism.resists or self.has_servo:
            self._free = self._servo = AxisStepper(
                model, period, mechanism.friction, mechanism.stops, mechanism.servo, terms
            )
        self._mass = model.parameters.total_mass
        self._hub_velocity = 0.0
        self._residual = 0.0
        self._delay = model.parameters.damping.internal
        # f = row 0 of M x'' + C x' + K x with q'' from the other rows: linear in [q, q'], alpha' and alpha''.
        M, C, K = model.matrices.M, model.matrices.C, model.matrices.K
        coupling = np.linalg.solve(M[1:, 1:], M[1:, 0])
        self._force_per_state = np.concatenate(
            [K[0, 1:] - coupling @ K[1:, 1:], C[0, 1:] - coupling @ C[1:, 1:]]
        )
        self._force_per_velocity = float(C[0, 0] - coupling @ C[1:, 0])
        self._force_per_acceleration = float(M[0, 0] - coupling @ M[1:, 0])

    def state(self) -> FloatArray:
        """Return a copy of [q, q', alpha', a_R], shape (2 n_modes + 2,)."""
        result = np.empty(2 * self.n_modes + 2)
        result[:-2] = self._led.state
        result[-2] = self._hub_velocity
        result[-1] = self._residual
        return result

    def kick(self, delta_velocity: float) -> None:
        """Let the hub's velocity jump by ``delta_velocity`` [m/s]."""
        self._led.kick(delta_velocity)
        self._hub_velocity += delta_velocity

    def step_led(self, acceleration: float, mean_acceleration: float) -> None:
        """Advance one period under a constant hub acceleration [m/s^2]."""
        self._led.step(acceleration)
        self._hub_velocity += acceleration * self._period
        self._residual = self._lagged(self._residual, self._period, mean_acceleration)

    def step_free(self, position: float, velocity: float, force: float) -> tuple[float, float]:
        """Advance one period under a constant force [N]; return the hub's new position and velocity."""
        n = self.n_modes
        free = self._free
        self._place_free(self._led.state, position, velocity)
        force += self._mechanism.ripple_at(position)
        free.step(force)
        state = free.state
        position, velocity = float(state[0]), float(state[n + 1])
        self._led.reset()
        self._led.kick(velocity)
        self._led.state = np.concatenate([state[1 : n + 1], state[n + 2 :]])
        self._hub_velocity = velocity
        if self._delay:
            self._residual = float(free.motion(0.0, force).acceleration)
        return position, velocity

    def force_when_led(self, acceleration: float) -> float:
        """Return the force [N] that gives the hub this acceleration in the present state."""
        return (
            float(self._force_per_state @ self._led.state)
            + self._force_per_velocity * self._hub_velocity
            + self._force_per_acceleration * acceleration
        )

    def servo_force(self, position: float, velocity: float, reference: Reference) -> float:
        """Let the servo see the hub, once per tick, and return the force [N] that it holds over it."""
        assert self._servo is not None
        self._place_free(self._led.state, position, velocity)
        feedforward = self._mass * reference.acceleration
        return self._servo.servo_force(reference.position, reference.velocity, feedforward)

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return q, shape (n_modes,), ``tau`` seconds into a tick that began in ``state``, the hub led."""
        self._probe.reset()
        self._probe.kick(float(state[-2]))
        self._probe.state = state[:-2]
        return self._probe.coordinates(tau, acceleration)

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the acceleration that the modes left out of q follow then [m/s^2], the hub led."""
        return self._lagged(float(state[-1]), tau, mean_acceleration)

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return hub and beam ``tau`` seconds into a tick that began in ``state``, the hub free."""
        self._place_free(state[:-2], position, velocity)
        motion = self._free.motion(tau, force + self._mechanism.ripple_at(position))
        return FreeMotion(
            float(motion.position), float(motion.velocity), float(motion.acceleration), motion.coordinates
        )

    def _place_free(self, elastic: FloatArray, position: float, velocity: float) -> None:
        n = self.n_modes
        state = self._free.state
        state[0] = position
        state[1 : n + 1] = elastic[:n]
        state[n + 1] = velocity
        state[n + 2 :] = elastic[n:]

    def _lagged(self, residual: float, tau: float, acceleration: float) -> float:
        if self._delay == 0.0:
            return acceleration
        return acceleration + (residual - acceleration) * math.exp(-tau / self._delay)


class PlantOnDeviceClock:
    """A plant that lives in true time under a device whose clock does not; implements ``Plant``.

    Physics does not follow a crystal: what the device holds for a second of its own acts for
    ``seconds_per_device_second``, and its velocities and accelerations are other ones in true time.

    Parameters
    ----------
    plant : Plant
        Stepped with the true length of the device's tick.
    seconds_per_device_second : float
        True seconds that pass in one second of the device.
    """

    def __init__(self, plant: Plant, seconds_per_device_second: float) -> None:
        self.n_modes = plant.n_modes
        self.has_servo = plant.has_servo
        self._plant = plant
        self._second = seconds_per_device_second

    def state(self) -> FloatArray:
        """Return a copy of the elastic state at the present tick."""
        return self._plant.state()

    def kick(self, delta_velocity: float) -> None:
        """Let the hub's velocity jump by ``delta_velocity`` [m per device second]."""
        self._plant.kick(delta_velocity / self._second)

    def step_led(self, acceleration: float, mean_acceleration: float) -> None:
        """Advance one period under a constant hub acceleration [m per device second squared]."""
        self._plant.step_led(self._true(acceleration), self._true(mean_acceleration))

    def step_free(self, position: float, velocity: float, force: float) -> tuple[float, float]:
        """Advance one period under a constant force [N]; return position and velocity as the device sees them."""
        position, velocity = self._plant.step_free(position, velocity / self._second, force)
        return position, velocity * self._second

    def force_when_led(self, acceleration: float) -> float:
        """Return the force [N] that gives the hub this acceleration in the present state."""
        return self._plant.force_when_led(self._true(acceleration))

    def servo_force(self, position: float, velocity: float, reference: Reference) -> float:
        """Let the servo see the hub, once per tick, and return the force [N] that it holds over it."""
        true = Reference(
            reference.position, reference.velocity / self._second, self._true(reference.acceleration)
        )
        return self._plant.servo_force(position, velocity / self._second, true)

    def coordinates(self, state: FloatArray, tau: float, acceleration: float) -> FloatArray:
        """Return q, shape (n_modes,), ``tau`` device seconds into a tick that began in ``state``, the hub led."""
        return self._plant.coordinates(state, tau * self._second, self._true(acceleration))

    def residual_acceleration(self, state: FloatArray, tau: float, mean_acceleration: float) -> float:
        """Return the true acceleration that the modes left out of q follow then [m/s^2], the hub led."""
        return self._plant.residual_acceleration(state, tau * self._second, self._true(mean_acceleration))

    def free_motion(
        self, state: FloatArray, position: float, velocity: float, tau: float, force: float
    ) -> FreeMotion:
        """Return hub and beam ``tau`` device seconds into a tick that began in ``state``; accelerations are true."""
        motion = self._plant.free_motion(state, position, velocity / self._second, tau * self._second, force)
        return replace(motion, velocity=motion.velocity * self._second)

    def _true(self, acceleration: float) -> float:
        return acceleration / self._second**2


def beam_on_axis(
    model: BeamModel,
    parameters: AxisParameters,
    terms: NonlinearTerms | None = None,
    mechanism: Mechanism | None = None,
    *,
    clock_drift_ppm: float = 0.0,
) -> Plant:
    """Put a beam on the axis of a device, whose clock may drift.

    Parameters
    ----------
    model : BeamModel
        Beam and hub.
    parameters : AxisParameters
        The device's tick.
    terms : NonlinearTerms, optional
        Air drag and large deflections.
    mechanism : Mechanism, optional
        Friction, stops, servo and ripple of the axis.
    clock_drift_ppm : float, optional
        By how much the device's clock runs fast [1e-6].
    """
    second = 1.0 / (1.0 + clock_drift_ppm * 1e-6)
    plant = BeamPlant(model, parameters.period * second, terms, mechanism)
    return plant if second == 1.0 else PlantOnDeviceClock(plant, second)
