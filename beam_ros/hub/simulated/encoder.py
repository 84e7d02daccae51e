"""What the encoder makes of a position: steps, noise, and lies on request."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from beam_ros.hub.parameters import AxisParameters, SimulatedDevice


class _Lie(NamedTuple):
    offset: float = 0.0
    scale: float = 1.0
    drift: float = 0.0
    since_tick: int = 0


class Encoder:
    """The encoder of a simulated axis.

    Parameters
    ----------
    device : SimulatedDevice
        Where it sits, and its noise.
    parameters : AxisParameters
        Its step, and the tick.

    Attributes
    ----------
    is_at_drive : bool
        Whether it measures the drive, which play or friction may part from the hub.
    """

    def __init__(self, device: SimulatedDevice, parameters: AxisParameters) -> None:
        self.is_at_drive = device.encoder_at == "drive"
        self._resolution, self._period = parameters.encoder_resolution, parameters.period
        self._noise_sd = device.encoder_noise
        self._rng = np.random.default_rng(device.seed)
        self._lie = _Lie()
        self._noise = 0.0
        self.turn()

    def turn(self) -> None:
        """Go on to the next tick, which has another noise."""
        if self._noise_sd:
            self._noise = self._noise_sd * float(self._rng.standard_normal())

    def lie(self, offset: float, scale: float, drift: float, tick: int) -> None:
        """Read ``scale`` times the position, ``offset`` [m] besides, and ever more [m/s] from a tick on."""
        self._lie = _Lie(offset, scale, drift, tick)

    def measured(self, position: float, tick: int) -> float:
        """Return what is read of a position at a tick, but for steps and noise [m]."""
        lie = self._lie
        return position * lie.scale + lie.offset + lie.drift * (tick - lie.since_tick) * self._period

    def count(self, position: float, tick: int) -> int:
        """Return what is read of a position [m] at a tick [encoder_resolution]."""
        return round(self.measured(position + self._noise, tick) / self._resolution)
