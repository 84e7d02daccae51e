"""An emulated JointTrajectoryController with its drive: what a controller_manager runs, without ros2_control.

Written from the documents of ros2_controllers (Jazzy): a message that is not all right is rejected with a line in the
log alone; a stamp of zero means now; what lies in the past is skipped; before the first point the joint goes there
from where it is; points are joined by straight lines, cubics or quintics, by what both ends carry; after
the last point it is held; nobody checks limits, and nobody minds when the sender dies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.simulated.motion import Snapshots

_AT_REST = 1.2e-7
"""The last point's velocity may be no greater (single precision's epsilon)."""


@dataclass(frozen=True)
class Waypoints:
    """The points of one JointTrajectory message, of one joint.

    Parameters
    ----------
    stamp_ns : int
        Of its header [ns, UNIX]; 0: now.
    times_ns : ndarray of int64, shape (n_points,)
        ``time_from_start`` [ns].
    positions, velocities, accelerations : ndarray, shape (n_points,), or None
        On the joint's own scale.
    """

    stamp_ns: int
    times_ns: StampArray
    positions: FloatArray
    velocities: FloatArray | None = None
    accelerations: FloatArray | None = None


def interpolate(
    tau: float, span: float, start: tuple[float, ...], end: tuple[float, ...]
) -> tuple[float, float]:
    """Return position and velocity between two points.

    Parameters
    ----------
    tau, span : float
        Time since the first point, and between both [s].
    start, end : tuple of float
        Position, and where both have them velocity and acceleration.

    Notes
    -----
    The Hermite polynomial of degree 1, 3 or 5 through what both ends carry.
    """
    order = min(len(start), len(end))
    if order == 1:
        slope = (end[0] - start[0]) / span
        return start[0] + slope * tau, slope
    h = span
    c: tuple[float, ...]
    if order == 2:
        (x0, v0), (x1, v1) = start[:2], end[:2]
        c = (x0, v0, (3 * (x1 - x0) / h - 2 * v0 - v1) / h, (2 * (x0 - x1) / h + v0 + v1) / h**2)
    else:
        (x0, v0, a0), (x1, v1, a1) = start[:3], end[:3]
        d = x1 - x0
        c = (
            x0,
            v0,
            a0 / 2,
            (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3),
            (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4),
            (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h**2) / (2 * h**5),
        )
    position = sum(k * tau**n for n, k in enumerate(c))
    velocity = sum(n * k * tau ** (n - 1) for n, k in enumerate(c) if n)
    return position, velocity


class EmulatedTrajectoryController:
    """The controller, the drive that it commands, and the beam on its hub.

    Parameters
    ----------
    servo : ServoAxis
        The drive, with the hub on it; its clock reads stamps [ns, UNIX].
    metres_per_unit : float, optional
        Travel of the hub for one unit of the joint [m].

    Attributes
    ----------
    rejected : list of str
        What the controller's log would say of messages that it did not take.
    """

    def __init__(self, servo: ServoAxis, *, metres_per_unit: float = 1.0) -> None:
        self._servo = servo
        self._unit = metres_per_unit
        self._way: Waypoints | None = None
        self._begin_ns = 0
        self._before: tuple[int, tuple[float, float]] = (0, (0.0, 0.0))
        hold = self._servo.true_position
        self._held = hold / metres_per_unit
        self._commands = ((servo.device_ns, hold), (servo.device_ns, hold))
        self.rejected: list[str] = []

    @property
    def reached_ns(self) -> int:
        """The newest stamp [ns, UNIX] that ``snapshots`` can show."""
        return self._servo.device_ns

    def snapshots(self, stamps_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants [ns, UNIX] of the last 4 s."""
        return self._servo.snapshots(stamps_ns)

    def receive(self, way: Waypoints, now_ns: int) -> None:
        """Take a trajectory message at a time [ns, UNIX]."""
        reason = _rejection(way, now_ns)
        if reason:
            self.rejected.append(reason)
            return
        # The first segment begins where the joint is when the message comes.
        self._before = now_ns, self._measured()
        self._way = way if len(way.times_ns) else None
        self._begin_ns = way.stamp_ns or now_ns
        self._held = self._before[1][0]

    def update(self, now_ns: int) -> tuple[float, float]:
        """Do one control cycle at a time [ns, UNIX]; return the measured position and velocity of the joint."""
        self._servo.advance(now_ns, self._drive_command)
        self._commands = self._commands[1], (now_ns, self._sample(now_ns) * self._unit)
        return self._measured()

    def _measured(self) -> tuple[float, float]:
        position = self._servo.position_at(self._servo.device_ns)
        return position / self._unit, self._servo.velocity / self._unit

    def _sample(self, now_ns: int) -> float:
        """Return the position that the trajectory has now."""
        way = self._way
        if way is None:
            return self._held
        times_ns = self._begin_ns + way.times_ns
        k = int(np.searchsorted(times_ns, now_ns, side="right")) - 1
        if k >= len(times_ns) - 1:
            return float(way.positions[-1])
        start: tuple[float, ...]
        if k < 0:
            start_ns, start = self._before
        else:
            start_ns, start = int(times_ns[k]), _state(way, k)
        end_ns = int(times_ns[k + 1])
        tau, span = (now_ns - start_ns) * 1e-9, (end_ns - start_ns) * 1e-9
        return interpolate(tau, span, start, _state(way, k + 1))[0]

    def _drive_command(self, device_ns: int) -> tuple[float, float]:
        """Return what the drive makes of the last two cycles' positions: a straight line, one cycle late."""
        (before_ns, before), (last_ns, last) = self._commands
        span_ns = max(last_ns - before_ns, 1)
        share = (device_ns - last_ns) / span_ns
        if share >= 1.0 or last == before:
            return last, 0.0
        return before + (last - before) * share, (last - before) / (span_ns * 1e-9)


def _state(way: Waypoints, k: int) -> tuple[float, ...]:
    """Return what point k carries."""
    values = [float(way.positions[k])]
    if way.velocities is not None:
        values.append(float(way.velocities[k]))
        if way.accelerations is not None:
            values.append(float(way.accelerations[k]))
    return tuple(values)


def _rejection(way: Waypoints, now_ns: int) -> str:
    """Return why the controller does not take a message, empty where it does."""
    if len(way.times_ns) == 0:
        return ""
    if len(way.positions) != len(way.times_ns):
        return "mismatch between points and positions"
    if way.stamp_ns and way.stamp_ns + int(way.times_ns[-1]) < now_ns:
        return "received trajectory with non-zero start time that ends in the past"
    if np.any(np.diff(way.times_ns) <= 0):
        return "time between points is not strictly increasing"
    if way.velocities is not None and abs(float(way.velocities[-1])) > _AT_REST:
        return "velocity of last trajectory point is not zero"
    return ""
