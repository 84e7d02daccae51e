"""How the hub moved, by the device's telemetry: accelerations and speeds, and how well they are known.

Where the mode is a motion, ``applied`` names the reference tick by tick and to the last bit. That the hub has
followed it shows where it rests: there a servo's lag has ended, and the way between two rests is the reference's.
Under a force nothing but the encoder tells. One of its steps q makes a position uncertain by q/2 on
either side, so over n ticks of T a speed by q/(n T), and the difference of two such speeds by 2 q/(n T)^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.conformance.check import require
from beam_ros.hub.conformance.dialogue import Dialogue
from beam_ros.hub.host.motion_watch import NOISE_COUNTS

SLACK = 1e-3
"""Relative slack of measured speeds and accelerations."""
NOTICED_TICKS = 1
"""By how many ticks a ramp may begin later than what it answers."""


@dataclass(frozen=True)
class MeasuredMotion:
    """A stretch of the hub's motion in steps of one or more ticks.

    Parameters
    ----------
    first_tick : int
        Where it begins.
    speeds : ndarray, shape (n_steps + 1,)
        Before each step and after the last one [m/s].
    accelerations : ndarray, shape (n_steps,)
        Of each step [m/s^2].
    speed_error, acceleration_error : float
        What the encoder's resolution leaves open of each [m/s], [m/s^2].
    """

    first_tick: int
    speeds: FloatArray
    accelerations: FloatArray
    speed_error: float = 0.0
    acceleration_error: float = 0.0

    def way(self, period: float, *, is_ramped: bool) -> FloatArray:
        """Return how far the hub has come by each of its ticks, shape (n_steps + 1,) [m].

        Parameters
        ----------
        period : float
            Of a tick, which is a step here [s].
        is_ramped : bool
            Whether the speed runs linearly through a tick; else it jumps at its beginning and stays.
        """
        means = (self.speeds[:-1] + self.speeds[1:]) / 2 if is_ramped else self.speeds[1:]
        return np.concatenate([[0.0], np.cumsum(means) * period])


def motion(host: Dialogue, first: int, last: int, *, rests_at: Literal["first", "last"]) -> MeasuredMotion:
    """Return the reference's motion from tick ``first`` to tick ``last``; at one of them the axis rests."""
    identity, period = host.identity, host.period_s()
    n = last - first
    # The last batch may still be on its way; it comes as long as a silence is young.
    if identity.command_mode == "acceleration":
        accelerations = host.ticks(first, n, alive=False).applied
        gained = np.concatenate([[0.0], np.cumsum(accelerations)]) * period
        return MeasuredMotion(first, gained - (gained[-1] if rests_at == "last" else 0.0), accelerations)
    if identity.command_mode == "velocity":
        speeds = host.ticks(first - 1, n + 1, alive=False).applied
    else:
        speeds = np.diff(host.ticks(first - 1, n + 2, alive=False).applied) / period
    return MeasuredMotion(first, speeds, np.diff(speeds) / period)


def encoder_motion(host: Dialogue, first: int, last: int, *, ticks_per_step: int) -> MeasuredMotion:
    """Return the measured motion from tick ``first`` to tick ``last``, in mean speeds of some ticks each."""
    identity = host.identity
    step_s = ticks_per_step * host.period_s()
    counts = host.ticks(first, last - first, alive=False).position_counts[::ticks_per_step]
    speeds = np.diff(counts) * identity.encoder_resolution / step_s
    speed_error = identity.encoder_resolution / step_s
    return MeasuredMotion(first, speeds, np.diff(speeds) / step_s, speed_error, 2 * speed_error / step_s)


def profile_motion(host: Dialogue, first: int, last: int, acceleration: float) -> MeasuredMotion:
    """Return a motion from rest, by the reference or, under a force, in steps that know its acceleration to 1 %."""
    identity = host.identity
    if identity.command_mode != "effort":
        return motion(host, first, last, rests_at="first")
    step_s = math.sqrt(2 * identity.encoder_resolution / (0.01 * acceleration))
    return encoder_motion(host, first, last, ticks_per_step=math.ceil(step_s / host.period_s()))


def require_profile(moved: MeasuredMotion, speed: float, acceleration: float, what: str) -> None:
    """Require that a move got to this speed and this acceleration, and beyond neither."""
    for name, values, declared, error in (
        ("m/s", moved.speeds, speed, moved.speed_error),
        ("m/s^2", moved.accelerations, acceleration, moved.acceleration_error),
    ):
        greatest = float(np.abs(values).max())
        allowed = SLACK * declared + error
        require(
            abs(greatest - declared) <= allowed,
            f"{what} with at most {greatest:.6g} {name}: expected {declared:.6g} +- {allowed:.2g}",
        )


def require_ramp(host: Dialogue, first: int, last: int, *, is_begun: bool = True) -> int:
    """Require that the axis kept its stop deceleration, neither more nor less, until it rested at tick ``last``.

    Parameters
    ----------
    host : Dialogue
        With the limits that the axis obeys.
    first : int
        Where the ramp begins, or where to look for its beginning.
    last : int
        A tick at which the axis rests.
    is_begun : bool
        Whether it begins at ``first``; else later, from a motion that does not slow down by itself.

    Returns
    -------
    int
        The tick at which the ramp began; ``first`` under a force.
    """
    identity = host.identity
    declared = host.limits.stop_deceleration
    if identity.command_mode == "effort":
        _require_measured_ramp(host, first, last)
        return first
    moved = motion(host, first, max(last, first + 1), rests_at="last")
    before = moved.speeds[:-1]
    ramp = -np.sign(before) * np.minimum(declared, np.abs(before) / host.period_s())
    # What the last tick of a ramp may leave undone is rest.
    is_moving = np.abs(before) > SLACK * declared * host.period_s()
    if not is_moving.any():
        return first
    is_braking = is_moving & (moved.accelerations * ramp > 0.5 * ramp**2)
    require(bool(is_braking.any()), "the axis rests, but its reference shows no ramp")
    start = int(np.argmax(is_braking))
    require(
        not is_begun or start <= NOTICED_TICKS,
        f"the stop ramp begins {start} ticks after its cause: expected at most {NOTICED_TICKS}",
    )
    errors = np.abs(moved.accelerations - ramp)[start:]
    worst = start + int(np.argmax(errors))
    require(
        errors.max() <= SLACK * declared,
        f"{moved.accelerations[worst]:.6g} m/s^2 at {before[worst]:.6g} m/s while stopping: expected "
        f"{ramp[worst]:.6g}",
    )
    return first + start


def _require_measured_ramp(host: Dialogue, first: int, last: int) -> None:
    """The same by the encoder: from the mean speeds of two stretches before the rest, well within the ramp."""
    identity, period = host.identity, host.period_s()
    declared = host.limits.stop_deceleration
    counts = host.ticks(first, last - first, alive=False).position_counts
    resolution = identity.encoder_resolution
    moving = np.flatnonzero(np.diff(counts))
    # A ramp from speed v lasts v/(a T) ticks; the last of them may be a part of one.
    speed = float(np.abs(np.diff(counts[:3])).max(initial=0)) * resolution / period
    n = int(0.4 * speed / (declared * period))
    if n < 2 or not len(moving) or moving[-1] < 2 * n:
        return
    end = int(moving[-1])
    ways = np.diff(counts[[end - 2 * n, end - n, end]]) * resolution
    measured = abs(float(ways[1] - ways[0])) / (n * period) ** 2
    allowed = SLACK * declared + 2 * resolution / (n * period) ** 2
    require(
        abs(measured - declared) <= allowed,
        f"{measured:.6g} m/s^2 by the encoder while stopping: expected {declared:.6g} +- {allowed:.2g}",
    )


def require_followed(host: Dialogue, first: int, last: int) -> None:
    """Require that the encoder shows the way that ``applied`` names, between two ticks at which the axis rests."""
    identity = host.identity
    if identity.command_mode == "effort":
        return  # A force names no way.
    counts = host.ticks(first, last - first + 1, alive=False).position_counts
    moved = motion(host, first, last, rests_at="first")
    path = moved.way(host.period_s(), is_ramped=identity.command_mode == "acceleration")
    expected = float(path[-1]) / identity.encoder_resolution
    require(
        abs(float(counts[-1] - counts[0]) - expected) <= NOISE_COUNTS,
        f"the encoder moved by {counts[-1] - counts[0]} counts while applied names {expected:.1f}: expected the same "
        f"to {NOISE_COUNTS}, from rest to rest",
    )
