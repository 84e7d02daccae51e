"""How the axis answers a set-point: a few phases, in each of which one drive is held.

A drive is the hub's acceleration, or the force on it where efforts are commanded. Phases last whole ticks; where
a ramp does not, its acceleration is a little lower instead, so that it ends at the right speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from beam_ros.hub.parameters import AxisParameters


class Phase(NamedTuple):
    """Some ticks under one drive [m/s^2], or [N] on a free hub."""

    n_ticks: int
    drive: float


def ramp(velocity: float, goal: float, acceleration: float, period: float) -> Phase:
    """Return the phase from one velocity to another [m/s] at an acceleration [m/s^2]."""
    change = goal - velocity
    n_ticks = math.ceil(abs(change) / (acceleration * period) - 1e-6)
    return Phase(n_ticks, change / (n_ticks * period)) if n_ticks > 0 else Phase(0, 0.0)


def stop(velocity: float, parameters: AxisParameters) -> Phase:
    """Return the phase in which a stop brings a velocity [m/s] to rest."""
    return ramp(velocity, 0.0, parameters.stop_deceleration, parameters.period)


def phases_towards(
    setpoint: float, position: float, velocity: float, parameters: AxisParameters, n_ticks: int
) -> list[Phase]:
    """Return what the axis does in the next ticks that follow a set-point.

    Parameters
    ----------
    setpoint : float
        In the command mode's unit.
    position, velocity : float
        Of the hub now [m], [m/s].
    parameters : AxisParameters
        Command mode, limits of the axis and of its profiled moves.
    n_ticks : int
        So many ticks from now.
    """
    mode = parameters.command_mode
    if mode in ("acceleration", "effort"):
        return [Phase(n_ticks, setpoint)]
    if mode == "velocity":
        way = [ramp(velocity, setpoint, parameters.max_acceleration, parameters.period)]
    else:
        way = _profiled_move(setpoint - position, velocity, parameters)
    phases = []
    for phase in (*way, Phase(n_ticks, 0.0)):
        length = min(phase.n_ticks, n_ticks)
        if length > 0:
            phases.append(Phase(length, phase.drive))
            n_ticks -= length
    return phases


def move_ticks(setpoint: float, position: float, velocity: float, parameters: AxisParameters) -> int:
    """Return how many ticks the profiled move to a position [m] takes."""
    return sum(phase.n_ticks for phase in _profiled_move(setpoint - position, velocity, parameters))


def _profiled_move(distance: float, velocity: float, parameters: AxisParameters) -> list[Phase]:
    """Return speeding up (or turning round, or slowing down), cruising and braking of a time-optimal move."""
    period, acceleration = parameters.period, parameters.move_acceleration
    # The way that braking from now on would take decides in which direction the move goes.
    sign = math.copysign(1.0, distance - velocity * abs(velocity) / (2 * acceleration))
    way, speed = sign * distance, sign * velocity
    # way = (peak^2 - speed^2)/(2 a) + peak^2/(2 a), without a cruise.
    peak = min(math.sqrt(max(0.0, acceleration * way + speed * speed / 2)), parameters.move_speed)
    changing = (peak * peak - speed * speed) / (2 * acceleration) * (1.0 if peak >= speed else -1.0)
    rest = way - changing - peak * peak / (2 * acceleration)
    cruise = Phase(round(max(0.0, rest) / (peak * period)) if peak > 0.0 else 0, 0.0)
    begin, end = ramp(speed, peak, acceleration, period), ramp(peak, 0.0, acceleration, period)
    return [Phase(phase.n_ticks, sign * phase.drive) for phase in (begin, cruise, end)]
