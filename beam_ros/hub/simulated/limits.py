"""The limits that no command may pass, as the device looks at them before every tick."""

from __future__ import annotations

import math

from beam_ros.hub.faults import Fault, fault
from beam_ros.hub.parameters import AxisParameters

_SLACK = 1e-5
"""Relative slack of the device's own limits over the host's, so that a checked sequence never trips them."""
_MIN_JUMP = 0.1
"""The hub's mobility is learned from a change of the force by at least this share of the greatest ..."""
_MIN_COUNTS = 16
"""... which changes the speed by at least so much more than the tick before did [encoder_resolution / period]."""


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
