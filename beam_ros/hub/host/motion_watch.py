"""Whether the hub moves as it was commanded: what was measured against what was applied, batch by batch.

In acceleration, velocity and position mode the applied reference says where the hub must be. Its path is integrated
exactly, as the device does it, and corrected so slowly by what is measured that only a motion which the commands do
not explain leaves it: a jam, a slip, a lying encoder. In effort mode the mass and the friction decide; there only
travel, jumps and speed are certain.

Every bound follows from the limits of the axis, the encoder's step and ``max_following_error``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

OVERSHOOT = 2.0
"""A hub behind the worst of servos is never faster than this times the speed limit."""
NOISE_COUNTS = 16
"""What an encoder may jump at rest [encoder_resolution]."""
SPEED_S = 0.1
"""Mean speeds are taken over this time [s]."""
ANCHOR_TICKS = 8
"""Ticks that it takes to see where the hub is and how it moves."""
SHORTEST_S, LONGEST_S = 0.05, 2.0
"""Time constant with which the path is pulled towards the measured one [s] ..."""
MEMORY = 0.4
"""... which grows with the time for which it has been followed by this share: as a fit of all of it would do."""


@dataclass(frozen=True)
class Measuring:
    """How well positions and their times are known.

    Parameters
    ----------
    jump : float
        What a position may jump at rest [m].
    rest : float
        By how much positions of a hub at rest differ within 50 ms [m].
    jitter : float
        By how much the times of two samples may be wrong [s].
    """

    jump: float
    rest: float
    jitter: float = 0.0

    @classmethod
    def by_encoder(cls, parameters: AxisParameters) -> Measuring:
        """Return how the encoder of an axis measures, at the ticks of its device."""
        noise = NOISE_COUNTS * parameters.encoder_resolution
        return cls(noise, noise)


class CertainMotion:
    """What is certain of an axis whatever it is commanded: it stays in its travel, and moves no faster than it can.

    Parameters
    ----------
    parameters : AxisParameters
        Limits.
    measuring : Measuring
        How well positions are known.
    """

    def __init__(self, parameters: AxisParameters, measuring: Measuring) -> None:
        self._parameters = parameters
        self._tolerance = parameters.max_following_error + 2 * parameters.encoder_resolution
        self._measuring = measuring
        self._least = max(SPEED_S, parameters.period) - 1e-9
        self._past: deque[tuple[float, float]] = deque()

    def forget(self) -> None:
        """Begin anew: where the hub is has another meaning from now on, or it may have been moved."""
        self._past.clear()

    def find(
        self, times: FloatArray, positions: FloatArray, *, is_homed: bool, is_enabled: bool
    ) -> tuple[str, str] | None:
        """Return the fault that samples show and what was seen, or None.

        Parameters
        ----------
        times, positions : ndarray, shape (n_samples,)
            When the hub was measured [s], increasing from call to call, and where it was [m].
        is_homed : bool
            Whether positions count from home.
        is_enabled : bool
            Whether the hub moves as the axis leads it, so that its speed is limited.
        """
        if self._past and times[0] <= self._past[-1][0]:
            self.forget()  # A clock that went back is somebody else's finding.
        self._forget_older_than(float(times[-1]))
        found = self._jump(times, positions)
        if found is None and is_homed:
            found = self._beyond_travel(positions)
        if found is None and is_enabled:
            found = self._too_fast(float(times[-1]), float(positions[-1]))
        self._past.append((float(times[-1]), float(positions[-1])))
        return found

    def _forget_older_than(self, now: float) -> None:
        """Keep of the past what a mean speed needs, and the newest sample."""
        while len(self._past) > 1 and now - self._past[1][0] >= self._least:
            self._past.popleft()

    def _jump(self, times: FloatArray, positions: FloatArray) -> tuple[str, str] | None:
        """Look for a way between two samples that no speed explains."""
        if self._past:
            time, position = self._past[-1]
            times, positions = np.append(time, times), np.append(position, positions)
        if len(times) < 2:
            return None
        speed = OVERSHOOT * self._parameters.max_speed
        most = speed * (np.diff(times) + self._measuring.jitter) + self._measuring.jump
        ways = np.abs(np.diff(positions))
        worst = int(np.argmax(ways - most))
        if ways[worst] <= most[worst]:
            return None
        return (
            "position_jumped",
            f"the position changed by {1e3 * ways[worst]:.3f} mm within {1e3 * np.diff(times)[worst]:.3g} ms: "
            f"expected at most {1e3 * most[worst]:.3f} mm at hub.max_speed {self._parameters.max_speed:g} m/s",
        )

    def _beyond_travel(self, positions: FloatArray) -> tuple[str, str] | None:
        limit = self._parameters.position_limit
        furthest = positions[np.argmax(np.abs(positions))]
        if abs(furthest) <= limit + self._tolerance:
            return None
        return (
            "beyond_travel",
            f"the hub is at {1e3 * furthest:.3f} mm: expected within +-{1e3 * limit:g} mm (hub.travel)",
        )

    def _too_fast(self, now: float, position: float) -> tuple[str, str] | None:
        """Look for a mean speed beyond the limit, which no servo's lag or noise explains."""
        if not self._past or now - self._past[0][0] < self._least:
            return None
        elapsed = now - self._past[0][0] + self._measuring.jitter
        way = abs(position - self._past[0][1])
        if way <= self._parameters.max_speed * elapsed + 2 * self._tolerance:
            return None
        return (
            "motion_unexplained",
            f"the hub moved with {way / elapsed:.3g} m/s for {elapsed:.2f} s: expected at most "
            f"{self._parameters.max_speed:g} m/s (hub.max_speed)",
        )


class MotionWatch:
    """Follows the hub of a device that says what it applied.

    Parameters
    ----------
    parameters : AxisParameters
        Limits, command mode, tick, encoder, and the greatest following error.
    measuring : Measuring
        How well positions are known.

    Attributes
    ----------
    certain : CertainMotion
        What is certain whatever was applied.
    """

    def __init__(self, parameters: AxisParameters, measuring: Measuring) -> None:
        self._parameters = parameters
        self._step = parameters.encoder_resolution
        self._tolerance = parameters.max_following_error + 2 * self._step
        self._path = None if parameters.command_mode == "effort" else _Path(parameters)
        self.certain = CertainMotion(parameters, measuring)

    def forget(self) -> None:
        """Begin anew: where the hub is has another meaning from now on, or it may have been moved."""
        self.certain.forget()
        if self._path is not None:
            self._path.forget()

    def find(
        self, ticks: TickBatch, lost: int, *, is_homed: bool, is_enabled: bool
    ) -> tuple[str, str] | None:
        """Return the fault that a batch shows and what was seen, or None.

        Parameters
        ----------
        ticks : TickBatch
            What was applied and measured.
        lost : int
            Ticks that are missing before these.
        is_homed : bool
            Whether positions count from home.
        is_enabled : bool
            Whether the drive holds the hub to its reference.
        """
        times, positions = ticks.measured(self._parameters.period, self._step)
        found = self.certain.find(times, positions, is_homed=is_homed, is_enabled=is_enabled)
        if self._path is not None:
            error = self._path.error(ticks.applied, positions, has_gap=lost > 0, is_enabled=is_enabled)
            if found is None and is_enabled and error > self._tolerance:
                found = (
                    "motion_unexplained",
                    f"the hub is {1e3 * error:.2f} mm from where its commands lead it: expected at most "
                    f"{1e3 * self._parameters.max_following_error:g} mm (hub.max_following_error)",
                )
        return found


class _Path:
    """Where the applied reference leads the hub.

    Notes
    -----
    Within a batch the path is the exact one of the reference; between batches an observer with the double
    pole -1/tau pulls position (gain 2/tau, or 1/tau where the reference is a velocity) and velocity
    (gain 1/tau^2) towards the measured ones.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self._mode = parameters.command_mode
        self._period = parameters.period
        self._applied: list[FloatArray] = []
        self._measured: list[FloatArray] = []
        self._position: float | None = None
        self._velocity = 0.0
        self._followed = 0.0

    def forget(self) -> None:
        """Take the next ticks for a new beginning."""
        self._position = None
        self._applied.clear()
        self._measured.clear()

    def error(self, applied: FloatArray, measured: FloatArray, *, has_gap: bool, is_enabled: bool) -> float:
        """Return the greatest distance [m] of measured positions from the path; 0 while it is not known."""
        if self._mode == "position":
            return float(np.max(np.abs(measured - applied)))
        if has_gap or not is_enabled:
            self.forget()
        if self._position is None:
            self._anchor(applied, measured)
            return 0.0
        path, velocities = self._lead(applied, self._position, self._velocity)
        errors = measured - path[:-1]
        mean, duration = float(np.mean(errors)), len(applied) * self._period
        share = min(0.4, duration / min(max(MEMORY * self._followed, SHORTEST_S), LONGEST_S))
        self._followed += duration
        self._position = path[-1] + share * mean * (1 if self._mode == "velocity" else 2)
        self._velocity = velocities + share**2 / duration * mean
        return float(np.max(np.abs(errors)))

    def _anchor(self, applied: FloatArray, measured: FloatArray) -> None:
        """See where the hub is and how it moves, as soon as there are ticks enough."""
        self._applied.append(applied)
        self._measured.append(measured)
        if sum(map(len, self._applied)) < ANCHOR_TICKS:
            return
        applied, measured = np.concatenate(self._applied), np.concatenate(self._measured)
        forced, gained = self._lead(applied, 0.0, 0.0)
        times = self._period * np.arange(len(applied) + 1)
        rest = measured - forced[:-1]
        slope = 0.0
        if self._mode == "acceleration":
            centred = times[:-1] - np.mean(times[:-1])
            slope = float(centred @ rest / (centred @ centred))
        start = float(np.mean(rest - slope * times[:-1]))
        self.forget()
        self._position = start + slope * times[-1] + forced[-1]
        self._velocity = slope + gained
        self._followed = 0.0

    def _lead(self, applied: FloatArray, position: float, velocity: float) -> tuple[FloatArray, float]:
        """Return the positions [m] at all ticks and after the last, and the velocity after it [m/s]."""
        period = self._period
        if self._mode == "velocity":
            return position + np.append(0.0, period * np.cumsum(applied)), 0.0
        velocities = velocity + np.append(0.0, period * np.cumsum(applied))
        ways = (velocities[:-1] + velocities[1:]) * (period / 2)
        return position + np.append(0.0, np.cumsum(ways)), float(velocities[-1])
