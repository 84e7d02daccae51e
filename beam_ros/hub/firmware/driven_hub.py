"""Hub and beam behind a firmware: they move as its drive says, and its sensors read where the hub is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ros.arrays import StampArray
from beam_ros.hub.firmware.plant_port import Drive, Reading
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.motion import CarriedHub, HubMotion, Snapshots
from beam_ros.hub.simulated.plant import Plant

END_SWITCH_MARGIN = 0.01
"""The end switches stand this far beyond the widest travel, as a part of its half."""


class DrivenHub(CarriedHub):
    """A hub that a firmware drives, tick by tick.

    Parameters
    ----------
    parameters : AxisParameters
        The axis, with its widest limits.
    plant : Plant
        What the hub carries, stepped with the same period.
    device : SimulatedDevice, optional
        Where the hub stands at first, and how the encoder measures.

    Notes
    -----
    The hub takes the way that the drive's velocity and acceleration make of a tick. The reference's position is not
    looked at: its zero is where the firmware believes home to be.

    Only the firmware knows its clock. What it says of a tick comes some time after the tick has begun; the least of
    these delays is taken for the difference between its clock and the caller's.
    """

    def __init__(
        self, parameters: AxisParameters, plant: Plant, device: SimulatedDevice | None = None
    ) -> None:
        self._parameters = parameters
        self._plant = plant
        self._device = device or SimulatedDevice()
        self._home_counter: int | None = None
        self._signals: dict[str, bool] = {}
        self._delay_ns: int | None = None
        self._begin(self._device.initial_position, 0)

    @property
    def device_ns(self) -> int:
        """The caller's time up to which the hub has moved [ns]."""
        return super().device_ns + (self._delay_ns or 0)

    @property
    def max_following_error(self) -> float:
        """How far the hub may be from its reference before the firmware stops it [m]."""
        return self._parameters.max_following_error

    @property
    def velocity(self) -> float:
        """How the hub moves [m/s]."""
        return self._motion.hub_velocity

    @property
    def reading(self) -> Reading:
        """What the sensors read at the tick that comes next."""
        return replace(self._reading, **self._signals)

    def snapshots(self, times_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants of the recent past in the caller's time, as ``HubMotion`` does."""
        return super().snapshots(np.asarray(times_ns, dtype=np.int64) - (self._delay_ns or 0))

    def hold_signals(self, **signals: bool) -> None:
        """Let signals of the reading (fields of ``Reading``) be on or off whatever the hub does, all others true."""
        self._signals = signals

    def reset(self) -> None:
        """Let a firmware begin anew: the hub stops where it is, and the encoder counts from there."""
        self._plant.kick(-self._motion.hub_velocity)
        self._begin(self._motion.hub_position, 0)
        self._delay_ns = None

    def move(self, drive: Drive, now_ns: int) -> None:
        """Move through one tick; one that is said again is not done again.

        Parameters
        ----------
        drive : Drive
            What the firmware says of the tick.
        now_ns : int
            When it came, by the caller's clock [ns].
        """
        delay_ns = now_ns - drive.tick * self._parameters.period_ns
        if self._delay_ns is None:
            self._begin(self._motion.hub_position, drive.tick)
            self._delay_ns = delay_ns
        self._delay_ns = min(self._delay_ns, delay_ns)
        motion = self._motion
        if drive.tick != motion.tick:
            return
        was_below = motion.hub_position < 0.0
        if drive.is_free:
            _, effort = motion.push(drive.effort)
        else:
            end_velocity = drive.velocity + drive.acceleration * self._parameters.period
            effort = motion.carry(drive.velocity, drive.acceleration, end_velocity)
        if was_below != (motion.hub_position < 0.0):
            self._home_counter = round(motion.measured(-self._zero) / self._parameters.encoder_resolution)
        self._reading = self._read(motion.tick, effort)

    def _begin(self, position: float, tick: int) -> None:
        start_ns = tick * self._parameters.period_ns
        start = replace(self._device, initial_position=position, clock_start_ns=start_ns)
        self._motion = HubMotion(self._parameters, self._plant, start)
        self._zero = position
        self._home_counter = None
        self._reading = self._read(0, 0.0)

    def _read(self, tick: int, effort: float) -> Reading:
        position = self._motion.hub_position
        end = self._parameters.position_limit * (1.0 + END_SWITCH_MARGIN)
        return Reading(
            tick,
            self._motion.position_count,
            home_counter=self._home_counter or 0,
            effort=effort,
            has_home_counter=self._home_counter is not None,
            is_below_home=position < 0.0,
            is_at_low_end=position < -end,
            is_at_high_end=position > end,
        )
