"""The hub's exact motion tick by tick, and what a camera could see of it at any instant of the recent past.

Within a tick either the acceleration is constant (acceleration mode, and effort mode while the axis holds or
brakes), or the velocity is (velocity and position mode), or the force is (effort mode). That is the reference,
which the device knows. Where the plant has a servo, the hub follows it as servo, friction and beam let it: then the
force is constant within every tick, and reference and hub are two things.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.errors import SnapshotError
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.encoder import Encoder
from beam_ros.hub.simulated.plant import Plant, Reference

HISTORY_TICKS = 4096
"""Ticks of the past that ``HubMotion.snapshots`` can look into (4 s at 1 kHz)."""


@dataclass(frozen=True)
class Snapshots:
    """Hub and beam at exact instants, as a camera needs them.

    Parameters
    ----------
    times_ns : ndarray of int64, shape (n_times,)
        Instants asked for [ns of device time].
    positions, accelerations : ndarray, shape (n_times,)
        Of the hub [m], [m/s^2]; the true ones, from home, not what the encoder says. Where the velocity
        jumps from tick to tick, the acceleration is the jump spread over the tick.
    residual_accelerations : ndarray, shape (n_times,)
        The acceleration that the modes left out of q follow [m/s^2]; the hub's, but for internal damping.
    coordinates : ndarray, shape (n_times, n_modes)
        Modal coordinates q [m]: w(z) = shape(z) @ q - residual(z) * residual_acceleration.
    """

    times_ns: StampArray
    positions: FloatArray
    accelerations: FloatArray
    residual_accelerations: FloatArray
    coordinates: FloatArray


class _TickStart(NamedTuple):
    """All that it takes to say where hub and beam are at any instant of one tick."""

    position: float
    velocity: float
    """After any jump at the tick's beginning."""
    elastic: FloatArray
    drive: float
    """Acceleration of a led hub, force on a free one."""
    is_free: bool
    mean_acceleration: float


class CarriedHub:
    """The hub of a device, with the beam on it, as a camera sees it and as a hand disturbs it.

    Parameters
    ----------
    motion : HubMotion
        How it moves.
    """

    def __init__(self, motion: HubMotion) -> None:
        self._motion = motion

    @property
    def device_ns(self) -> int:
        """Device time up to which the hub has moved [ns]."""
        return self._motion.device_ns

    @property
    def true_position(self) -> float:
        """Where the hub really is, seen from home [m]; no device knows that before it has homed."""
        return self._motion.hub_position

    def snapshots(self, times_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants of the recent past; see ``HubMotion.snapshots``."""
        return self._motion.snapshots(times_ns)

    def lie(self, offset: float, scale: float, drift: float = 0.0) -> None:
        """Let the encoder read ``scale`` times the position, and ``offset`` [m] and ever more [m/s] besides."""
        self._motion.lie(offset, scale, drift)

    def stick(self, *, is_stuck: bool) -> None:
        """Let the hub stand still whatever is commanded, or move again."""
        self._motion.stick(is_stuck=is_stuck)


class HubMotion:
    """Hub and beam, integrated one device tick at a time.

    Parameters
    ----------
    parameters : AxisParameters
        Command mode, tick and encoder.
    plant : Plant
        What the hub carries, stepped with the same period.
    device : SimulatedDevice
        Where the hub stands at power-on, what the clock reads then, and how the encoder measures.

    Attributes
    ----------
    tick : int
        The tick that comes next; all before it are done.
    position, velocity : float
        The reference [m], [m/s], seen from home as the device knows it: where the hub is, unless a servo lags behind.
    hub_position, hub_velocity : float
        Where the hub really is [m], seen from home, and how it moves [m/s].
    """

    def __init__(self, parameters: AxisParameters, plant: Plant, device: SimulatedDevice) -> None:
        parameters.check_within_travel("initial_position", device.initial_position)
        self.tick = self._first_tick = -(-device.clock_start_ns // parameters.period_ns)
        self.position = self.hub_position = device.initial_position
        self.velocity = self.hub_velocity = 0.0
        self._zero = device.initial_position
        self._encoder = Encoder(device, parameters)
        self._is_stuck = False
        # By how much the hub lies behind its reference, without a servo that would pull it on.
        self._lost = 0.0
        # By how much the device's home lies beside the true one: what the servo lacked when it was found.
        self._home_error = 0.0
        self._parameters = parameters
        self._plant = plant
        self._history: list[_TickStart | None] = [None] * HISTORY_TICKS

    @property
    def device_ns(self) -> int:
        """Device time up to which the motion is integrated [ns]."""
        return self.tick * self._parameters.period_ns

    @property
    def position_count(self) -> int:
        """What the encoder reads [encoder_resolution]."""
        position = self.position if self._encoder.is_at_drive else self.hub_position - self._home_error
        return self._encoder.count(position - self._zero, self.tick)

    def measured(self, position: float) -> float:
        """Return what the encoder makes of a position [m] now."""
        return self._encoder.measured(position, self.tick)

    @property
    def velocity_count(self) -> int:
        """Measured speed [encoder_resolution / period]."""
        velocity = self.velocity if self._encoder.is_at_drive else self.hub_velocity
        return round(velocity * self._parameters.period / self._parameters.encoder_resolution)

    def lie(self, offset: float, scale: float, drift: float = 0.0) -> None:
        """Let the encoder read ``scale`` times the position, and ``offset`` [m] and ever more [m/s] besides."""
        self._encoder.lie(offset, scale, drift, self.tick)

    def stick(self, *, is_stuck: bool) -> None:
        """Let the hub stand still whatever is commanded, or move again; without a servo it has lost the steps."""
        self._is_stuck = is_stuck

    def set_zero(self) -> None:
        """Take this very place for home."""
        if self._plant.has_servo or self._lost:
            self._home_error, self._lost = self.hub_position, -self.hub_position
        else:
            self.hub_position = 0.0
        self.position = self._zero = 0.0

    def follow(self, command: float) -> tuple[float, float]:
        """Integrate one period under a command of the mode; return the reference applied and the force [N]."""
        mode, period = self._parameters.command_mode, self._parameters.period
        if mode == "effort":
            return self.push(command)
        if mode == "acceleration":
            return self.lead(self.velocity + command * period, command)
        if mode == "velocity":
            return self.lead(command)
        reference = self.position
        _, effort = self.lead((command - self.position) / period)
        self.position = command
        if self._is_stuck:
            self._lost = command - self.hub_position
        elif not self._plant.has_servo:
            self.hub_position = command - self._lost
        return reference, effort

    def lead(self, velocity: float, acceleration: float | None = None) -> tuple[float, float]:
        """Integrate one period that leads the hub to a velocity; return reference and force."""
        before, reference_position = self.velocity, self.position
        if not self._parameters.is_ramped:
            acceleration = 0.0
            effort = self.carry(velocity, acceleration, velocity)
        else:
            if acceleration is None:
                acceleration = (velocity - before) / self._parameters.period
            effort = self.carry(before, acceleration, velocity)
        mode = self._parameters.command_mode
        if mode == "acceleration":
            return acceleration, effort
        if mode == "velocity":
            return velocity, effort
        if mode == "position":
            return reference_position - self._zero, effort
        return effort, effort

    def carry(self, start_velocity: float, acceleration: float, end_velocity: float) -> float:
        """Integrate one period whose reference begins with a velocity, after any jump, and holds an acceleration.

        Parameters
        ----------
        start_velocity, acceleration, end_velocity : float
            Of the reference at the tick's beginning [m/s], over the tick [m/s^2], and at its end [m/s].

        Returns
        -------
        float -- the force at the tick's beginning, any jump spread over the tick [N]
        """
        period = self._parameters.period
        reference_position = self.position
        mean_acceleration = acceleration + (start_velocity - self.velocity) / period
        mean_velocity = start_velocity + acceleration * (period / 2)
        if self._plant.has_servo:
            wanted = Reference(reference_position + self._home_error, start_velocity, mean_acceleration)
            effort = self._plant.servo_force(self.hub_position, self.hub_velocity, wanted)
            self._move(effort)
            self.position += mean_velocity * period
        elif self._is_stuck:
            effort = self._stand_still()
            self.position += mean_velocity * period
            self._lost = self.position - self.hub_position
        else:
            # What was stuck until now is taken along at once.
            if start_velocity != self.hub_velocity:
                self._plant.kick(start_velocity - self.hub_velocity)
            effort = self._plant.force_when_led(mean_acceleration)
            self._history[self.tick % HISTORY_TICKS] = _TickStart(
                reference_position - self._lost,
                start_velocity,
                self._plant.state(),
                acceleration,
                False,
                mean_acceleration,
            )
            self._plant.step_led(acceleration, mean_acceleration)
            self.position += mean_velocity * period
            self.hub_position, self.hub_velocity = self.position - self._lost, end_velocity
            self._count_tick()
        self.velocity = end_velocity
        return effort

    def push(self, force: float) -> tuple[float, float]:
        """Integrate one period of the free hub under a force."""
        self._move(force)
        self.position, self.velocity = self.hub_position - self._home_error, self.hub_velocity
        return force, force

    def _move(self, force: float) -> None:
        """Integrate one period of the hub under a force that is held over it."""
        if self._is_stuck:
            self._stand_still()
            return
        self._history[self.tick % HISTORY_TICKS] = _TickStart(
            self.hub_position, self.hub_velocity, self._plant.state(), force, True, 0.0
        )
        self.hub_position, self.hub_velocity = self._plant.step_free(
            self.hub_position, self.hub_velocity, force
        )
        self._count_tick()

    def _stand_still(self) -> float:
        """Integrate one period of a hub that does not move; return the force that holds it [N]."""
        if self.hub_velocity:
            self._plant.kick(-self.hub_velocity)
            self.hub_velocity = 0.0
        effort = self._plant.force_when_led(0.0)
        self._history[self.tick % HISTORY_TICKS] = _TickStart(
            self.hub_position, 0.0, self._plant.state(), 0.0, False, 0.0
        )
        self._plant.step_led(0.0, 0.0)
        self._count_tick()
        return effort

    def _count_tick(self) -> None:
        self.tick += 1
        self._encoder.turn()

    def snapshots(self, times_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants of the recent past, also inside ticks.

        Parameters
        ----------
        times_ns : sequence of int
            Instants [ns of device time], each within the last ``HISTORY_TICKS`` ticks that are done.

        Raises
        ------
        SnapshotError
            An instant lies ahead, or further back than the axis remembers.
        """
        times = np.asarray(times_ns, dtype=np.int64)
        positions = np.empty(len(times))
        accelerations = np.empty(len(times))
        residuals = np.empty(len(times))
        coordinates = np.empty((len(times), self._plant.n_modes))
        oldest = max(self._first_tick, self.tick - HISTORY_TICKS)
        for i, time_ns in enumerate(times.tolist()):
            tick, rest_ns = divmod(time_ns, self._parameters.period_ns)
            if tick == self.tick and rest_ns == 0 and tick > oldest:
                tick, rest_ns = tick - 1, self._parameters.period_ns
            entry = self._history[tick % HISTORY_TICKS] if oldest <= tick < self.tick else None
            if time_ns == self.device_ns and self.tick == self._first_tick:
                # Nothing has been done since power-on: hub and beam are where they stand.
                entry = _TickStart(self.hub_position, 0.0, self._plant.state(), 0.0, False, 0.0)
            if entry is None:
                raise SnapshotError(
                    f"snapshot at {time_ns} ns of device time: expected from "
                    f"{oldest * self._parameters.period_ns} to {self.device_ns} ns; advance first, ask sooner"
                )
            tau = rest_ns * 1e-9
            if entry.is_free:
                motion = self._plant.free_motion(
                    entry.elastic, entry.position, entry.velocity, tau, entry.drive
                )
                positions[i] = motion.position
                accelerations[i] = residuals[i] = motion.acceleration
                coordinates[i] = motion.coordinates
            else:
                positions[i] = entry.position + entry.velocity * tau + entry.drive * tau * tau / 2
                accelerations[i] = entry.mean_acceleration
                residuals[i] = self._plant.residual_acceleration(entry.elastic, tau, entry.mean_acceleration)
                coordinates[i] = self._plant.coordinates(entry.elastic, tau, entry.drive)
        return Snapshots(times, positions, accelerations, residuals, coordinates)
