"""How a hub gets somewhere: moves, ramps and answers to set-points, as pieces of constant acceleration.

A host that plans ahead, and the check that foresees what an axis will do, take the pieces as they are; a device that
decides tick by tick takes the same law from ``profile_velocity``, whose last tick lands on the target.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from beam_ros.hub.parameters import AxisParameters

ARRIVED = 1e-12
"""A profiled move ends this close to its target [m]; what rounding leaves is smaller."""
_WHOLE = 1e-6
"""A ramp that is longer than whole ticks by less than this share of one takes just these: rounding."""


class MotionPiece(NamedTuple):
    """Some time [s] under one drive: an acceleration [m/s^2], or a force [N] on a free hub."""

    duration: float
    drive: float


class Phase(NamedTuple):
    """Some ticks under one drive [m/s^2], or [N] on a free hub."""

    n_ticks: int
    drive: float


def ramp(velocity: float, goal: float, acceleration: float) -> MotionPiece:
    """Return the piece from one velocity to another [m/s] at an acceleration [m/s^2]."""
    change = goal - velocity
    return MotionPiece(abs(change) / acceleration, math.copysign(acceleration, change))


def move(distance: float, velocity: float, speed: float, acceleration: float) -> list[MotionPiece]:
    """Return the move over a distance [m] from a velocity [m/s] to rest, in the shortest time.

    Parameters
    ----------
    distance, velocity : float
        Way to go [m] and present velocity [m/s], both signed.
    speed, acceleration : float
        Limits [m/s], [m/s^2].

    Returns
    -------
    list of MotionPiece
        Speeding up (or turning round, or slowing down), cruising, braking.
    """
    # The way that braking from now on would take decides in which direction the move goes.
    sign = math.copysign(1.0, distance - velocity * abs(velocity) / (2 * acceleration))
    # distance = (2 peak^2 - velocity^2) / (2 a), without a cruise.
    peak = min(speed, math.sqrt(max(0.0, acceleration * sign * distance + velocity**2 / 2)))
    begin, end = ramp(velocity, sign * peak, acceleration), ramp(sign * peak, 0.0, acceleration)
    ramps = (velocity + sign * peak) / 2 * begin.duration + sign * peak / 2 * end.duration
    cruise = max(0.0, sign * (distance - ramps) / peak) if peak > 0.0 else 0.0
    return [begin, MotionPiece(cruise, 0.0), end]


def answer(
    setpoint: float, position: float, velocity: float, parameters: AxisParameters
) -> list[MotionPiece]:
    """Return what an axis does of a set-point that is always refreshed; the last piece may never end.

    Parameters
    ----------
    setpoint : float
        In the command mode's unit.
    position, velocity : float
        Of the hub now [m], [m/s].
    parameters : AxisParameters
        Command mode, limits of the axis and of its profiled moves.
    """
    if parameters.command_mode == "velocity":
        return [ramp(velocity, setpoint, parameters.max_acceleration), MotionPiece(math.inf, 0.0)]
    if parameters.command_mode == "position":
        return move(setpoint - position, velocity, parameters.move_speed, parameters.move_acceleration)
    return [MotionPiece(math.inf, setpoint)]


def cut(pieces: Iterable[MotionPiece], duration: float) -> list[MotionPiece]:
    """Return the pieces of a time [s] from the beginning."""
    kept = []
    for piece in pieces:
        kept.append(MotionPiece(min(piece.duration, duration), piece.drive))
        duration -= kept[-1].duration
    return kept


def in_ticks(pieces: Iterable[MotionPiece], period: float, n_ticks: int | None = None) -> list[Phase]:
    """Return pieces in whole ticks of a period [s]: all of them, or what they come to in ``n_ticks``.

    A ramp that does not last whole ticks has a little less acceleration instead, so that it ends at its speed.
    """
    phases = []
    left = math.inf if n_ticks is None else n_ticks
    for duration, drive in (*pieces, MotionPiece(math.inf if n_ticks is not None else 0.0, 0.0)):
        whole = duration / period
        if math.isfinite(whole):
            length = round(whole) if drive == 0.0 else math.ceil(whole - _WHOLE)
            drive *= whole / length if length else 0.0
            whole = length
        length = int(min(whole, left))
        if length:
            phases.append(Phase(length, drive))
            left -= length
    return phases


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
