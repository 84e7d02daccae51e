"""What the rig file says of other people's controllers: one class for each kind of link."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveParameters:
    """How a drive that the host paces moves the hub.

    Parameters
    ----------
    metres_per_turn : float
        Travel of the hub for one turn; negative where they run against each other [m].
    rate : float
        Writes and measurements a second [1/s].
    homes_here : bool
        Whether hub/home takes the present place; else the encoder's own zero is home.
    """

    metres_per_turn: float = 1.0
    rate: float = 200.0
    homes_here: bool = True


@dataclass(frozen=True)
class OdriveParameters(DriveParameters):
    """How one axis of an ODrive moves the hub.

    Parameters
    ----------
    axis : int
        Number of the axis, 0 or 1.
    """

    axis: int = 0


@dataclass(frozen=True)
class DynamixelParameters(DriveParameters):
    """How one servo on a bus of Dynamixels moves the hub.

    Parameters
    ----------
    servo_id : int
        Its number on the bus, 0 to 252.
    """

    servo_id: int = 1


@dataclass(frozen=True)
class TrajectoryParameters:
    """How a JointTrajectoryController moves the hub.

    Parameters
    ----------
    metres_per_unit : float
        Travel of the hub for one unit of the joint; negative where they run against each other [m].
    max_knots : int
        Most knots in one trajectory.
    homes_here : bool
        Whether hub/home takes the present place; else the joint's own zero is home.
    drive_watchdog_s : float
        After so long a silence of its master the drive stops by itself, as somebody states; 0: it does not [s].
    """

    metres_per_unit: float = 1.0
    max_knots: int = 200_000
    homes_here: bool = True
    drive_watchdog_s: float = 0.0


@dataclass(frozen=True)
class CsvColumns:
    """Which columns mean what, counted from 1; 0 where there is none.

    Parameters
    ----------
    position, velocity, effort, clock : int
        Columns.
    position_scale : float
        Metres in one unit of position; of velocity too, per second.
    effort_scale : float
        Newtons in one unit of effort.
    clock_tick : float
        Seconds in one unit of the clock.
    clock_bits : int
        Bits of the clock's counter, after which it wraps; 0: never.
    """

    position: int = 1
    velocity: int = 0
    effort: int = 0
    clock: int = 0
    position_scale: float = 1.0
    effort_scale: float = 1.0
    clock_tick: float = 1e-6
    clock_bits: int = 32

    @property
    def last(self) -> int:
        """The last column that is needed."""
        return max(self.position, self.velocity, self.effort, self.clock)
