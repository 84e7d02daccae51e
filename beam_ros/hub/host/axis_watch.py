"""Whether the axis moves as it was commanded, and rests where it is held: all watches over its motion."""

from __future__ import annotations

import numpy as np

from beam_ros.hub.contract import Activity, AxisState
from beam_ros.hub.host.hold_watch import HoldWatch
from beam_ros.hub.host.led_watch import LedWatch
from beam_ros.hub.host.motion_watch import Measuring, MotionWatch
from beam_ros.hub.host.rest_watch import RestWatch
from beam_ros.hub.host.stop_promise import GONE_NS
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

UNSETTLED_BATCHES = 10
"""The ticks of a change come within so many batches after it was reported."""

Found = tuple[str, str] | None
"""A fault by its name, and what was seen; None while all is well."""


class AxisWatch:
    """Holds what is measured against what the axis says that it does, or against where the host leads it.

    Parameters
    ----------
    parameters : AxisParameters
        Limits, command mode, tick and encoder.
    measuring : Measuring
        How well positions are known.

    Attributes
    ----------
    state : str
        Where the controller says that it stands.
    is_led : bool
        Whether it says that something moves or holds the axis.
    is_homing : bool
        Whether it says that it looks for home.
    """

    def __init__(self, parameters: AxisParameters, measuring: Measuring) -> None:
        self._parameters = parameters
        self._motion = MotionWatch(parameters, measuring)
        self._hold = HoldWatch(parameters)
        self._led = LedWatch(parameters.max_following_error)
        self._rest = RestWatch(measuring.rest)
        self.state: AxisState = "disconnected"
        self.is_led = self.is_homing = False
        self._tick = 0
        self._unsettled: tuple[int, int] | None = None
        self._measured_ns = 0

    def connect(self) -> None:
        """Begin a connection."""
        self.state, self.is_led, self.is_homing = "disconnected", False, False
        self._unsettled = None
        self.forget()

    def forget(self) -> None:
        """Begin anew: where the hub is has another meaning from now on."""
        for watch in (self._motion, self._hold, self._led, self._rest):
            watch.forget()

    def forget_commands(self) -> None:
        """Begin anew with where the commands lead the hub."""
        self._motion.forget()

    # What is measured ---------------------------------------------------------------------------------

    def note_measured(
        self, now_ns: int, time: float, position: float, *, is_led: bool, has_home: bool
    ) -> Found:
        """Take one measurement of a hub without ticks: when [s] and where [m]; ``is_led``: its speed is limited."""
        times, positions = np.array([time]), np.array([position])
        self._rest.add(times, positions)
        self._measured_ns = now_ns
        is_homed = has_home and self._counts_from_home
        return self._motion.certain.find(times, positions, is_homed=is_homed, is_enabled=is_led)

    def note_led(self, now_ns: int, led: float, position: float, *, is_held_to_it: bool) -> Found:
        """Take where the host leads the hub and where it was measured last [m]; steady time [ns]."""
        if self.is_led and is_held_to_it:
            return self._led.find(now_ns, led, position)
        self._led.forget()
        return None

    def note_ticks(
        self, now_ns: int, ticks: TickBatch, lost: int, *, is_homing: bool, has_home: bool
    ) -> Found:
        """Take ticks, and how many were lost before them; while it homes, positions lose their meaning."""
        self._rest.add(*ticks.measured(self._parameters.period, self._parameters.encoder_resolution))
        self._measured_ns = now_ns
        if self.is_homing or is_homing:
            self._motion.forget()
            return None
        if self._unsettled is not None:
            tick, patience = self._unsettled
            n_old = tick - ticks.first_tick
            if patience > 0 and n_old >= len(ticks):
                self._unsettled = tick, patience - 1
                return None
            self._unsettled = None
            if 0 < n_old < len(ticks):
                ticks, lost = ticks[n_old:], 0
        self._hold.add(ticks, lost)
        return self._motion.find(
            ticks,
            lost,
            is_homed=has_home and self._counts_from_home,
            is_enabled=self.state == "enabled",
        )

    # What the controller says --------------------------------------------------------------------------

    def note_status(self, state: AxisState, activity: Activity, tick: int) -> Found:
        """Take where the controller says that it stands, and the tick that comes next [device ticks]."""
        is_homing = activity == "homing"
        self._tick = tick
        is_first = self.state == "disconnected"
        if is_first or is_homing != self.is_homing or (state == "enabled") > (self.state == "enabled"):
            self.unsettle()
        self.state, self.is_homing = state, is_homing
        self.is_led = state == "enabled" or activity != "idle"
        if state == "enabled" and activity == "hold":
            return self._hold.find(tick)
        self._hold.forget()
        return None

    def unsettle(self) -> None:
        """Take no notice of the motion before the newest status: positions or commands meant something else."""
        self._unsettled = self._tick, UNSETTLED_BATCHES
        self._motion.forget()
        self._hold.forget()

    # What follows -------------------------------------------------------------------------------------

    @property
    def speed(self) -> float:
        """Mean speed in the last 50 ms [m/s]; 0 while it is not known."""
        return self._rest.speed

    @property
    def ramp_s(self) -> float:
        """How long a stop takes from the present speed [s]."""
        return self._rest.speed / self._parameters.stop_deceleration

    def is_seen_moving(self, now_ns: int) -> bool:
        """Whether what was measured shows a motion, and is not too old to say so; waking time [ns]."""
        return self._rest.is_moving and now_ns - self._measured_ns < GONE_NS

    @property
    def _counts_from_home(self) -> bool:
        return self.state in ("homed", "enabled", "fault")
