"""What the device lets the hub do: profiled moves, braking, and the limits that no command may pass."""

from __future__ import annotations

import math

from beam_ros.hub.faults import Fault, fault
from beam_ros.hub.parameters import AxisParameters

ARRIVED = 1e-12
"""A profiled move ends this close to its target [m]; what rounding leaves is smaller."""
_SLACK = 1e-5
"""Relative slack of the device's own limits over the host's, so that a checked sequence never trips them."""
_MIN_JUMP = 0.1
"""The hub's mobility is learned from a change of the force by at least this share of the greatest ..."""
_MIN_COUNTS = 16
"""... which changes the speed by at least so much more than the tick before did [encoder_resolution / period]."""


def profile_velocity(
    distance: float, velocity: float, speed: float, acceleration: float, period: float, *, is_ramped: bool
) -> float:
    """Return the velocity for the end of the next tick of a time-optimal move that ends at rest on target.

    Parameters
    ----------
    distance, velocity : float
        Way still to go [m] and present velocity [m/s], both signed.
    speed, acceleration : float
        Limits of the move [m/s], [m/s^2].
    period : float
        The device's tick [s].
    is_ramped : bool
        Whether the velocity runs linearly through a tick, or jumps at its beginning and stays.

    Notes
    -----
    With u = v/(aT) and D = d/(a T^2), braking from u' by one unit a tick covers
    u' + (u' - 1) + ... = (n + 1) u' - n (n + 1)/2 with n = floor(u'), where the velocity jumps. Where it is
    ramped, the way of the coming tick, u/2, and half of each later one give the same sum for D - u/2. So
    u' = E/(n + 1) + n/2 with n = floor((sqrt(1 + 8 E) - 1)/2) lands on the target exactly.
    """
    unit = acceleration * period
    way = distance / (unit * period) - (velocity / (2 * unit) if is_ramped else 0.0)
    size = abs(way)
    n = math.floor((math.sqrt(1.0 + 8.0 * size) - 1.0) / 2.0)
    wanted = math.copysign(size / (n + 1) + n / 2, way) * unit
    wanted = min(max(wanted, -speed), speed)
    return min(max(wanted, velocity - unit), velocity + unit)


def braked_velocity(velocity: float, parameters: AxisParameters) -> float:
    """Return the velocity [m/s] for the end of a tick of the stop ramp, from ``velocity``."""
    step = parameters.stop_deceleration * parameters.period
    return 0.0 if abs(velocity) <= step else velocity - math.copysign(step, velocity)


def command_towards(setpoint: float, position: float, velocity: float, parameters: AxisParameters) -> float:
    """Return a tick's command on the way to a set-point, in the command mode's unit.

    Parameters
    ----------
    setpoint : float
        In the command mode's unit.
    position, velocity : float
        Where the hub is [m] and how it moves [m/s].
    parameters : AxisParameters
        Command mode, limits and tick.
    """
    mode, period = parameters.command_mode, parameters.period
    if mode == "velocity":
        step = parameters.max_acceleration * period
        return min(max(setpoint, velocity - step), velocity + step)
    if mode != "position":
        return setpoint
    # Position commands name the end of the tick, as the samples of a sequence do.
    distance = setpoint - position
    velocity = profile_velocity(
        distance, velocity, parameters.move_speed, parameters.move_acceleration, period, is_ramped=False
    )
    if abs(distance - velocity * period) < ARRIVED:
        return setpoint
    return position + velocity * period


class SpeedForecast:
    """By how much a force will change the hub's speed within a tick, from what the last ones did.

    A device does not know the mass that it moves. The speed goes on changing as it did in the last tick; where the
    force itself jumps, the jump's share is what earlier jumps taught.

    Parameters
    ----------
    parameters : AxisParameters
        Greatest effort, encoder and tick.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self._least_jump = _MIN_JUMP * parameters.max_effort
        self._least_change = _MIN_COUNTS * parameters.encoder_resolution / parameters.period
        self._mobility = 0.0
        self.forget()

    def forget(self) -> None:
        """Begin anew: no force led the hub to where it is."""
        self._begun: float | None = None
        self._changed = 0.0
        self._efforts = (0.0, 0.0)

    def change(self, effort: float, velocity: float) -> float:
        """Return the change [m/s] of the coming tick, at whose beginning the hub has ``velocity`` [m/s]."""
        before, last = self._efforts
        if self._begun is not None:
            changed = velocity - self._begun
            jump, answer = abs(last - before), abs(changed - self._changed)
            if jump >= self._least_jump and answer >= self._least_change:
                self._mobility = max(self._mobility, answer / jump)
            self._changed = changed
        self._begun, self._efforts = velocity, (last, effort)
        return self._changed + self._mobility * (effort - last)


def limit_reason(
    command: float, position: float, velocity: float, parameters: AxisParameters, *, change: float = 0.0
) -> tuple[Fault, str] | None:
    """Return why the axis must stop instead of following a command: the fault and its numbers; or None.

    Parameters
    ----------
    command : float
        In the command mode's unit.
    position, velocity : float
        Where the hub is [m] and how it moves [m/s] at the tick's beginning.
    parameters : AxisParameters
        Command mode, limits and tick.
    change : float, optional
        By how much a force will change the speed within the tick [m/s]; see ``SpeedForecast``.
    """
    period, mode = parameters.period, parameters.command_mode
    if not math.isfinite(command):
        return fault("command_not_finite"), f"limit: command {command}"
    acceleration = 0.0
    if mode == "acceleration":
        acceleration = command
        begun, velocity = velocity, velocity + command * period
        position += (begun + velocity) * (period / 2)
    elif mode == "velocity":
        acceleration = (command - velocity) / period
        velocity = command
        position += velocity * period
    elif mode == "position":
        begun, velocity = velocity, (command - position) / period
        acceleration = (velocity - begun) / period
        position = command
    else:
        if abs(command) > parameters.max_effort * (1 + _SLACK):
            return fault("effort_limit"), f"limit: effort {command:.6g} N beyond {parameters.max_effort:g} N"
        begun, velocity = velocity, velocity + change
        position += (begun + velocity) * (period / 2)
    if abs(acceleration) > parameters.max_acceleration * (1 + _SLACK):
        limit = f"{parameters.max_acceleration:g} m/s^2"
        return fault("acceleration_limit"), f"limit: acceleration {acceleration:.6g} m/s^2 beyond {limit}"
    if abs(velocity) > parameters.max_speed * (1 + _SLACK):
        return fault("speed_limit"), f"limit: speed {velocity:.6g} m/s beyond {parameters.max_speed:g} m/s"
    braking = velocity * abs(velocity) / (2 * parameters.stop_deceleration)
    slack = parameters.stop_deceleration * period * period + _SLACK * parameters.travel
    if max(abs(position), abs(position + braking)) > parameters.position_limit + slack:
        return fault("travel_limit"), (
            f"limit: at {position:.6f} m with {velocity:.3g} m/s the hub can just be stopped within "
            f"+-{parameters.position_limit:g} m"
        )
    return None
