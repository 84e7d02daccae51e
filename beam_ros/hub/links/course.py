"""What the hub is led along: a plan, and when it begins."""

from __future__ import annotations

import numpy as np

from beam_ros.hub.contract import SampleBatch
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.parameters import AxisParameters

SETTLING_NS = 100_000_000
"""So long the motor holds the hub after a plan has come to rest, before it may be switched off [ns]."""
MOST_TICKS = 1000
"""So many ticks of the past at most are shown at once."""


class LedCourse:
    """The plan that is followed now, in steady time.

    Parameters
    ----------
    parameters : AxisParameters
        Command mode and tick.

    Attributes
    ----------
    plan : MotionPlan
        What is being done.
    start_ns : int
        Steady time at which it begins [ns].
    revision : int
        Grows with every new plan.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self.plan = MotionPlan.rest(0.0)
        self.start_ns = 0
        self.revision = 0
        self._period_ns, self._mode = parameters.period_ns, parameters.command_mode
        self._shown_ns = 0

    def follow(self, plan: MotionPlan, start_ns: int) -> None:
        """Follow another plan from a steady time on [ns]."""
        self.plan, self.start_ns = plan, start_ns
        self.revision += 1

    def at(self, now_ns: int) -> tuple[float, float, float]:
        """Return where the hub is to be: position from home [m], velocity [m/s], acceleration [m/s^2]."""
        return self.plan.at((now_ns - self.start_ns) * 1e-9)

    def is_over(self, now_ns: int) -> bool:
        """Whether the plan has come to rest."""
        return now_ns >= self.start_ns + round(self.plan.duration * 1e9)

    def is_settled(self, now_ns: int) -> bool:
        """Whether it has been at rest for ``SETTLING_NS``."""
        return self.is_over(now_ns - SETTLING_NS)

    def take_ticks(self, now_ns: int, clock: HostClock) -> tuple[SampleBatch, SampleBatch] | None:
        """Return what was led at the rig's ticks since the last call: as applied and as measured; or None."""
        period_ns, start_ns = self._period_ns, self.start_ns
        begin_ns = max(self._shown_ns, now_ns - MOST_TICKS * period_ns)
        if start_ns <= now_ns:
            begin_ns = max(begin_ns, start_ns)
        first = -((start_ns - begin_ns) // period_ns)
        last = (now_ns - start_ns) // period_ns
        if last <= first:
            return None
        self._shown_ns = start_ns + last * period_ns
        times = np.arange(first, last) * (period_ns * 1e-9)
        positions, velocities, accelerations = self.plan.sample(np.asarray(times, dtype=np.float64))
        stamp_ns = clock.stamp_ns(start_ns + first * period_ns)
        applied = SampleBatch(
            stamp_ns,
            period_ns,
            1,
            positions=positions,
            velocities=velocities if self._mode == "velocity" else None,
            accelerations=accelerations if self._mode == "acceleration" else None,
        )
        return applied, SampleBatch(stamp_ns, period_ns, 1, positions=positions, velocities=velocities)
