"""A motor with a position loop that carries the beam: what stands behind other people's emulated controllers.

Unlike the suite's own virtual axis it does not go exactly where a command says: a position loop with the velocity as
feed-forward sets a velocity, a velocity loop follows it with a lag, and with the motor off the hub coasts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.motion import CarriedHub, HubMotion
from beam_ros.hub.simulated.plant import Plant

TICK_NS = 1_000_000
POSITION_GAIN = 60.0
"""Of the position loop [1/s]."""
VELOCITY_GAIN = 300.0
"""Of the velocity loop [1/s]."""
COASTING = 2.0
"""Deceleration by friction of a hub whose motor is off [m/s^2]."""
STRENGTH = 5.0
"""The motor's greatest acceleration, as a multiple of the rig's limit: it keeps no limit of the rig's."""

Command = Callable[[int], tuple[float, float] | None]
"""From device time [ns] to the commanded position [m] and velocity [m/s]; None: the motor is off."""


def servo_parameters(parameters: AxisParameters) -> AxisParameters:
    """Return the axis as the servo integrates it: with its own tick."""
    return dataclasses.replace(parameters, period_ns=TICK_NS, command_mode="acceleration")


class ServoAxis(CarriedHub):
    """The hub on a servo, with its beam.

    Parameters
    ----------
    parameters : AxisParameters
        The axis, for its encoder and its limits.
    plant : Plant
        What the hub carries, stepped with the servo's tick.
    device : SimulatedDevice
        Where the hub stands at power-on, and what the clock reads then.

    Attributes
    ----------
    speed_limit : float
        What the drive keeps [m/s].
    """

    def __init__(self, parameters: AxisParameters, plant: Plant, device: SimulatedDevice) -> None:
        self._parameters = servo_parameters(parameters)
        super().__init__(HubMotion(self._parameters, plant, device))
        self.speed_limit = math.inf

    @property
    def velocity(self) -> float:
        """How fast it is [m/s]."""
        return self._motion.velocity

    def position_at(self, device_ns: int) -> float:
        """Return where the hub was at an instant that is reached [ns of device time], in whole counts [m]."""
        position = float(self.snapshots([min(device_ns, self.device_ns)]).positions[0])
        position = self._motion.measured(position)
        resolution = self._parameters.encoder_resolution
        return round(position / resolution) * resolution

    def advance(self, to_ns: int, command: Command) -> None:
        """Do every tick that begins before a device time [ns]."""
        motion, period = self._motion, self._parameters.period
        strongest = STRENGTH * self._parameters.max_acceleration
        while motion.device_ns < to_ns:
            wanted = command(motion.device_ns)
            if wanted is None:
                step = COASTING * period
                coasting = motion.velocity
                acceleration = -math.copysign(min(abs(coasting), step), coasting) / period
            else:
                position, velocity = wanted
                aim = velocity + POSITION_GAIN * (position - motion.position)
                aim = min(max(aim, -self.speed_limit), self.speed_limit)
                acceleration = VELOCITY_GAIN * (aim - motion.velocity)
                acceleration = min(max(acceleration, -strongest), strongest)
            motion.lead(motion.velocity + acceleration * period, acceleration)
