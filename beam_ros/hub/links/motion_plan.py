"""A motion known beforehand, piece by piece: what a host-paced axis follows, and what a trajectory is made of.

Within a piece the acceleration is constant, so that positions are quadratic in time: that is what samples held
between ticks mean in acceleration mode, and what ramps and profiled moves are made of. In velocity and position mode
the acceleration of every piece is zero and the velocity jumps between pieces. Neighbouring ticks with the very same
command are one piece: nothing is lost by that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.kinematics import answer, cut, move, ramp
from beam_ros.hub.parameters import AxisParameters

_SLACK = 1e-5
"""Relative slack on limits that were checked before, for rounding."""


@dataclass(frozen=True)
class MotionPlan:
    """Where the hub is to be at any time from the plan's start; before it and after it, the hub rests.

    Parameters
    ----------
    times : ndarray, shape (n_pieces + 1,)
        Where the pieces begin, and where the last one ends [s from the start].
    positions : ndarray, shape (n_pieces + 1,)
        There [m].
    velocities : ndarray, shape (n_pieces,)
        At the beginning of each piece, after any jump [m/s].
    accelerations : ndarray, shape (n_pieces,)
        Throughout each piece [m/s^2].
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    @classmethod
    def rest(cls, position: float) -> MotionPlan:
        """Stay at a position [m]."""
        return cls.ramps(position, 0.0, [])

    @classmethod
    def ramps(cls, position: float, velocity: float, pieces: Sequence[tuple[float, float]]) -> MotionPlan:
        """Start with a position [m] and a velocity [m/s], then hold accelerations.

        Parameters
        ----------
        position, velocity : float
            At the start.
        pieces : list of (duration, acceleration)
            One after the other [s], [m/s^2]; pieces without duration are left out.
        """
        columns = np.array([piece for piece in pieces if piece[0] > 0.0]).reshape(-1, 2)
        times = np.concatenate(([0.0], np.cumsum(columns[:, 0])))
        return cls._integrated(position, velocity, times, columns[:, 1])

    @classmethod
    def brake(cls, position: float, velocity: float, deceleration: float) -> MotionPlan:
        """Decelerate [m/s^2] to rest."""
        return cls.ramps(position, velocity, [ramp(velocity, 0.0, deceleration)])

    @classmethod
    def move(
        cls, position: float, velocity: float, target: float, speed: float, acceleration: float
    ) -> MotionPlan:
        """Go to a target [m] in the shortest time that speed [m/s] and acceleration [m/s^2] allow, to rest there."""
        return cls.ramps(position, velocity, move(target - position, velocity, speed, acceleration))

    @classmethod
    def towards(
        cls, position: float, velocity: float, setpoint: float, parameters: AxisParameters
    ) -> MotionPlan:
        """Follow a set-point for the watchdog's time, then stop, as silence would; one of a position to its end."""
        pieces = answer(setpoint, position, velocity, parameters)
        if parameters.command_mode != "position":
            pieces = cut(pieces, parameters.watchdog_s)
            end = velocity + sum(duration * drive for duration, drive in pieces)
            pieces.append(ramp(end, 0.0, parameters.stop_deceleration))
        return cls.ramps(position, velocity, pieces)

    @classmethod
    def sequence(cls, values: FloatArray, parameters: AxisParameters, position: float) -> MotionPlan:
        """Run the samples of a checked sequence from rest at a position [m].

        Parameters
        ----------
        values : ndarray, shape (n_ticks,)
            Samples at device ticks, in the command mode's unit.
        parameters : AxisParameters
            Command mode and tick.
        position : float
            Where the hub rests [m]; not used in position mode, whose samples say it.
        """
        period = parameters.period
        if parameters.command_mode == "position":
            slopes = np.diff(values)
            begins = np.flatnonzero(np.concatenate(([True], slopes[1:] != slopes[:-1])))
            knots = np.append(begins, len(slopes))
            return cls._joined(knots * period, np.asarray(values)[knots])
        begins = np.flatnonzero(np.concatenate(([True], values[1:] != values[:-1])))
        times = np.append(begins, len(values)) * period
        if parameters.command_mode == "velocity":
            way = np.concatenate(([0.0], np.cumsum(values[begins] * np.diff(times))))
            return cls._joined(times, position + way)
        return cls._integrated(position, 0.0, times, values[begins])

    @classmethod
    def _joined(cls, times: FloatArray, positions: FloatArray) -> MotionPlan:
        """Join positions by straight lines."""
        velocities = np.diff(positions) / np.diff(times)
        return cls(times, positions, velocities, np.zeros(len(velocities)))

    @classmethod
    def _integrated(
        cls, position: float, velocity: float, times: FloatArray, accelerations: FloatArray
    ) -> MotionPlan:
        durations = np.diff(times)
        velocities = velocity + np.concatenate(([0.0], np.cumsum(accelerations * durations)))
        ways = (velocities[:-1] + accelerations * durations / 2) * durations
        positions = position + np.concatenate(([0.0], np.cumsum(ways)))
        return cls(times, positions, velocities[:-1], accelerations)

    @property
    def duration(self) -> float:
        """From the start to rest [s]."""
        return float(self.times[-1])

    def sample(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position [m], velocity [m/s] and acceleration [m/s^2] at times from the start [s]."""
        times = np.asarray(times, dtype=np.float64)
        rests = (times < 0.0) | (times >= self.duration)
        if len(self.accelerations) == 0:
            zero = np.zeros(times.shape)
            return zero + self.positions[0], zero, zero
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.accelerations) - 1)
        tau = np.clip(times - self.times[piece], 0.0, None)
        acceleration = self.accelerations[piece]
        velocity = self.velocities[piece] + acceleration * tau
        position = self.positions[piece] + self.velocities[piece] * tau + acceleration * tau**2 / 2
        at_rest = np.where(times < 0.0, self.positions[0], self.positions[-1])
        return (
            np.where(rests, at_rest, position),
            np.where(rests, 0.0, velocity),
            np.where(rests, 0.0, acceleration),
        )

    def at(self, time: float) -> tuple[float, float, float]:
        """Return position [m], velocity [m/s] and acceleration [m/s^2] at one time from the start [s]."""
        position, velocity, acceleration = self.sample(np.array([time]))
        return float(position[0]), float(velocity[0]), float(acceleration[0])

    @cached_property
    def is_smooth(self) -> bool:
        """Whether the velocity never jumps, so that positions with velocities say all."""
        return bool(np.any(self.accelerations != 0.0)) or not np.any(self.velocities != 0.0)

    def objection(self, parameters: AxisParameters) -> str:
        """Return why the axis must not follow this plan: speed, acceleration or travel; empty where it may."""
        if len(self.accelerations) == 0:
            return ""
        durations = np.diff(self.times)
        ends = self.velocities + self.accelerations * durations
        speed = float(np.max(np.abs(np.concatenate((self.velocities, ends)))))
        if speed > parameters.max_speed * (1 + _SLACK):
            return f"would reach {speed:.3g} m/s: the limit is {parameters.max_speed:g} m/s"
        acceleration = float(np.max(np.abs(self.accelerations)))
        limit = max(parameters.max_acceleration, parameters.stop_deceleration)
        if acceleration > limit * (1 + _SLACK):
            return f"needs {acceleration:.3g} m/s^2: the limit is {limit:g} m/s^2"
        # Between two knots the position is extreme where the velocity passes through zero.
        turning = self.velocities * ends < 0.0
        turns = self.positions[:-1][turning] - self.velocities[turning] ** 2 / (
            2 * self.accelerations[turning]
        )
        reach = float(np.max(np.abs(np.concatenate((self.positions, turns)))))
        if reach > parameters.position_limit * (1 + _SLACK):
            return (
                f"would take the hub to {reach:.6f} m before it rests: the travel ends at "
                f"+-{parameters.position_limit:g} m"
            )
        return ""
