"""Small motions for the checks: sequences and set-points of a few millimetres, in every command mode."""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.line import protocol

SHARE_OF_TRAVEL = 0.02
"""How far the small motions go, as a share of the travel."""
SHARE_OF_LIMITS = 0.2
"""How much of speed and acceleration they use at most."""
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


def command_limit(identity: protocol.Identity, limits: protocol.DeviceLimits) -> float:
    """Return the greatest magnitude of a set-point, in the mode's unit."""
    limit: dict[str, float] = {
        "acceleration": limits.max_acceleration,
        "velocity": limits.max_speed,
        "position": limits.travel / 2,
        "effort": limits.max_effort,
    }
    return limit[identity.command_mode]


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
