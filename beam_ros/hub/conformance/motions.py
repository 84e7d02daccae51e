"""Small motions for the checks: sequences and set-points of a few millimetres, in every command mode."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.line import protocol

SHARE_OF_TRAVEL = 0.02
"""How far the small motions go, as a share of the travel."""
SHARE_OF_LIMITS = 0.2
"""How much of speed and acceleration they use at most."""
CRUISE_RATE = 0.4
"""Speed of a motion that is to be stopped [travel/s]: rise, 80 ms and ramp take 5 % of the travel."""
RISE_S = 0.05
"""The time in which it gets there [s]."""
_GENTLE_FORCE = 0.01
"""Force of an axis in effort mode, as a share of the greatest: its mass is not known."""


def bump(identity: protocol.Identity, n_samples: int, position: float) -> FloatArray:
    """Return a sequence that goes away and comes back to rest, shape (n_samples,), in the mode's unit.

    Parameters
    ----------
    identity : Identity
        Mode, tick and widest limits.
    n_samples : int
        Its length [ticks].
    position : float
        Where the hub stands [m].
    """
    return _sequence(identity, np.sin(np.pi * np.linspace(0.0, 1.0, n_samples + 2)) ** 4, position)


def shift(identity: protocol.Identity, n_samples: int, position: float) -> FloatArray:
    """Return a sequence that ends at rest elsewhere, towards home or beyond it, shape (n_samples,)."""
    s = np.linspace(0.0, 1.0, n_samples + 2)
    path = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return _sequence(identity, -path if position > 0.0 else path, position)


def cruise(identity: protocol.Identity, seconds: float, position: float) -> FloatArray:
    """Return a sequence that gets up to a steady speed and keeps it for a time: it is to be stopped on its way.

    Parameters
    ----------
    identity : Identity
        Mode, tick and widest limits.
    seconds : float
        How long the speed is kept [s].
    position : float
        Where the hub stands [m].
    """
    period = identity.period_ns * 1e-9
    speed = min(CRUISE_RATE * identity.widest.travel, SHARE_OF_LIMITS * identity.widest.max_speed)
    return led(identity, trapezoid(period, speed, speed / RISE_S, seconds), position)


def trapezoid(period: float, speed: float, acceleration: float, seconds: float) -> FloatArray:
    """Return the accelerations [m/s^2] of the ticks in which a speed [m/s] is reached and kept for a time [s]."""
    n_rise = max(math.ceil(speed / acceleration / period - 1e-9), 1)
    n_kept = math.ceil(seconds / period)
    return np.concatenate([np.full(n_rise, speed / (n_rise * period)), np.zeros(n_kept)])


def led(identity: protocol.Identity, accelerations: FloatArray, position: float) -> FloatArray:
    """Return the samples of a motion from rest, towards home or beyond it, in the mode's unit.

    A mode that is no motion gets a gentle force in the place of every acceleration.

    Parameters
    ----------
    identity : Identity
        Mode and tick.
    accelerations : ndarray, shape (n_ticks,)
        Of each tick, as if home lay ahead [m/s^2].
    position : float
        Where the hub stands [m].

    Returns
    -------
    ndarray, shape (n_ticks,); in position mode (n_ticks + 1,)
    """
    period = identity.period_ns * 1e-9
    accelerations = -accelerations if position > 0.0 else accelerations
    speeds = np.cumsum(accelerations) * period
    if identity.command_mode == "position":
        return np.concatenate([[position], position + np.cumsum(speeds) * period])
    if identity.command_mode == "velocity":
        return np.asarray(speeds)
    if identity.command_mode == "acceleration":
        return np.asarray(accelerations)
    return np.asarray(_GENTLE_FORCE * identity.widest.max_effort * np.sign(accelerations))


def setpoint(identity: protocol.Identity, position: float) -> float:
    """Return a set-point, in the mode's unit, that moves the hub a little way towards home or beyond it."""
    widest = identity.widest
    value = {
        # Held for 0.4 s, this acceleration leads 4 % of the travel away.
        "acceleration": min(0.5 * widest.travel, SHARE_OF_LIMITS * widest.max_acceleration),
        "velocity": min(0.1 * widest.travel, SHARE_OF_LIMITS * widest.max_speed),
        "position": 2 * SHARE_OF_TRAVEL * widest.travel,
        "effort": _GENTLE_FORCE * widest.max_effort,
    }[identity.command_mode]
    return -value if position > 0.0 else value


def narrowed(limits: protocol.DeviceLimits, **narrower: float) -> protocol.DeviceLimits:
    """Return limits of which some are narrower, and no move or way home beyond the greatest ones."""
    limits = replace(limits, **narrower)  # type: ignore[arg-type]
    return replace(
        limits,
        move_speed=min(limits.move_speed, limits.max_speed),
        move_acceleration=min(limits.move_acceleration, limits.max_acceleration),
        homing_speed=min(limits.homing_speed, limits.max_speed),
        homing_acceleration=min(limits.homing_acceleration, limits.max_acceleration),
    )


def with_command_limit(
    identity: protocol.Identity, limits: protocol.DeviceLimits, limit: float
) -> protocol.DeviceLimits:
    """Return limits with which a set-point may have this magnitude at most, in the mode's unit."""
    return {
        "acceleration": narrowed(limits, max_acceleration=limit),
        "velocity": narrowed(limits, max_speed=limit),
        "position": narrowed(limits, travel=2 * limit),
        "effort": narrowed(limits, max_effort=limit),
    }[identity.command_mode]


def _sequence(identity: protocol.Identity, shape: FloatArray, position: float) -> FloatArray:
    """Return the samples of a path of this shape (n_samples + 2 points, its greatest value 1)."""
    widest = identity.widest
    period = identity.period_ns * 1e-9
    speeds = np.diff(shape) / period
    accelerations = np.diff(shape, n=2) / period**2
    way = min(
        SHARE_OF_TRAVEL * widest.travel,
        SHARE_OF_LIMITS * widest.max_speed / np.abs(speeds).max(),
        SHARE_OF_LIMITS * widest.max_acceleration / np.abs(accelerations).max(),
    )
    if identity.command_mode == "position":
        return np.asarray(position + way * shape[:-2])
    if identity.command_mode == "velocity":
        return np.asarray(way * speeds[:-1])
    if identity.command_mode == "acceleration":
        return np.asarray(way * accelerations)
    return np.asarray(_GENTLE_FORCE * widest.max_effort * accelerations / np.abs(accelerations).max())
