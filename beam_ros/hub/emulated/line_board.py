"""An emulated board that prints where the hub is, and moves it by a program of its own: it takes no orders."""

from __future__ import annotations

import math

from beam_ros.hub.emulated.injected_faults import InjectedFault
from beam_ros.hub.emulated.lies import Lies
from beam_ros.hub.emulated.servo import TICK_NS, servo_parameters
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.motion import CarriedHub, HubMotion
from beam_ros.hub.simulated.plant import Plant

LINE_NS = 5_000_000
"""A line for every 5 ms of the board's clock [ns]."""
MICROSECONDS_WRAP_NS = (1 << 32) * 1000
"""The counter of microseconds has 32 bits [ns]."""
COUNT = 1e-6
"""What one unit of the printed position is [m]."""
_TONES = ((0.9, 0.002), (6.5, 0.0001))
"""Frequencies [Hz] and amplitudes [m] of the hub's motion."""


class LineBoard:
    """A board that prints ``microseconds,position`` lines, with a 32 bit counter of microseconds.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    plant : Plant
        What the hub carries, stepped with the servo's tick.
    device : SimulatedDevice
        What the clock reads at power-on.

    Attributes
    ----------
    lies : Lies
        Of its printed clock.
    """

    def __init__(self, parameters: AxisParameters, plant: Plant, device: SimulatedDevice) -> None:
        self.axis = _SelfMoved(HubMotion(servo_parameters(parameters), plant, device))
        self.lies = Lies(clock_wrap_ns=MICROSECONDS_WRAP_NS)
        self._next_ns = -(-device.clock_start_ns // LINE_NS) * LINE_NS

    def disturb(self, injected: InjectedFault, *, begins: bool) -> None:
        """Let a fault of the clock begin or end."""
        self.lies.change(injected, begins=begins)
        self.lies.clock_wrap_ns = self.lies.clock_wrap_ns or MICROSECONDS_WRAP_NS

    def exchange(self, _data: bytes, device_ns: int) -> bytes:
        """Advance to a device time [ns] and return the lines that are due."""
        lines = []
        while self._next_ns <= device_ns:
            self.axis.advance(self._next_ns)
            micros = self.lies.told_ns(self._next_ns) // 1000
            lines.append(f"{micros},{round(self.axis.measured_position / COUNT)}\r\n")
            self._next_ns += LINE_NS
        self.axis.advance(device_ns)
        return "".join(lines).encode()


class _SelfMoved(CarriedHub):
    """A hub that swings by itself."""

    def __init__(self, motion: HubMotion) -> None:
        super().__init__(motion)
        self._start_ns = motion.device_ns

    @property
    def measured_position(self) -> float:
        return self._motion.measured(self._motion.hub_position)

    def advance(self, to_ns: int) -> None:
        while self._motion.device_ns < to_ns:
            t = (self._motion.device_ns - self._start_ns + TICK_NS / 2) * 1e-9
            # From rest: x = sum of a (1 - cos(w t)).
            acceleration = sum(a * (2 * math.pi * f) ** 2 * math.cos(2 * math.pi * f * t) for f, a in _TONES)
            self._motion.lead(self._motion.velocity + acceleration * TICK_NS * 1e-9, acceleration)
