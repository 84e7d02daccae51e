"""Any axis of ros2_control, by the plain topics of its JointTrajectoryController: whole motions in one message.

What the host plans goes over as knots that the controller's own interpolation joins to the very same motion: its
cubics through positions and velocities give back pieces of constant acceleration, its straight lines through
positions give back pieces of constant velocity. A dead host stops no trajectory, so that every set-point is handed
over together with the ramp that ends it; only a sequence runs to its own end.

Facts of the controller: the documents ``userdoc.rst`` and ``trajectory.rst`` of ros2_controllers.
"""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.contract import HostTime, HubCapabilities, SampleBatch
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.host.silence import Silence
from beam_ros.hub.host.stamp_watch import StampWatch
from beam_ros.hub.link_parameters import TrajectoryParameters
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.parameters import AxisParameters

HOLD_NS = 1_000_000_000
"""Every trajectory ends with a rest of this length: one that is over when it comes would be ignored, not obeyed."""
TURN_S = 0.005
SILENCE_NS = 500_000_000
"""Joint states that do not come for this long are a lost controller [ns]."""
MAX_AGE_NS = 100_000_000
"""Stamps of joint states that are older, or ahead, come from another clock [ns]."""
AGES = 50
BATCH_POINTS = 20

CAPABILITIES = HubCapabilities(
    name="trajectory_controller",
    modes=("acceleration", "velocity", "position"),
    is_buffered=True,
    has_device_clock=True,
    has_watchdog=False,
    keeps_limits=False,
    telemetry="push",
    rate=100.0,
    shortcomings=(
        "a sequence that was handed over runs to its end when this host dies: the controller has no watchdog",
        "nobody is known to keep the limits: controller_manager keeps none by default (enforce_command_limits)",
        "the motor is never switched off from here: disabled means held",
        "the controller samples the motion at its own rate: identify with the measured position",
        "a trajectory that the controller rejects is rejected with a line in its log alone",
    ),
)


@dataclass(frozen=True)
class Knots:
    """One trajectory, as the controller takes it.

    Parameters
    ----------
    start_ns : int
        When it begins [ns, UNIX].
    times_ns : ndarray of int64, shape (n_knots,)
        From its start, strictly increasing [ns].
    positions : ndarray, shape (n_knots,)
        On the joint's own scale.
    velocities : ndarray, shape (n_knots,), or None
        There; None where positions alone are joined by straight lines.
    """

    start_ns: int
    times_ns: StampArray
    positions: FloatArray
    velocities: FloatArray | None

    @classmethod
    def of(cls, plan: MotionPlan, start_ns: int, zero: float, metres_per_unit: float) -> Knots:
        """Return the knots that are joined to this very plan, and to a rest after it.

        Parameters
        ----------
        plan : MotionPlan
            From home [m].
        start_ns : int
            When it begins [ns, UNIX].
        zero : float
            Where home is on the joint's scale [m].
        metres_per_unit : float
            Of the joint.

        Notes
        -----
        The cubic through (x0, v0) and (x1, v1) that the controller takes is the parabola x0 + v0 t + a t^2/2 where
        x1 and v1 lie on it: x1 = x0 + (v0 + v1) h / 2. So a knot is needed only where the acceleration changes. A
        quintic through accelerations as well would need two of them at every knot, before and after the change.
        """
        times_ns = np.rint(np.append(plan.times, plan.times[-1]) * 1e9).astype(np.int64)
        times_ns[-1] += HOLD_NS
        positions = (np.append(plan.positions, plan.positions[-1]) + zero) / metres_per_unit
        velocities = np.concatenate((plan.velocities, np.zeros(len(times_ns) - len(plan.velocities))))
        keep = np.append(np.diff(times_ns) > 0, True)
        return cls(
            start_ns,
            times_ns[keep],
            positions[keep],
            (velocities / metres_per_unit)[keep] if plan.is_smooth else None,
        )


class TrajectoryHub(HostPacedHub):
    """A hub behind a JointTrajectoryController; implements ``Hub``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    trajectory : TrajectoryParameters
        How the controller moves it.
    send : callable
        Publishes a trajectory.
    guard : BeamGuard, optional
        A further check of complete sequences, for limits that need a model of the beam.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        trajectory: TrajectoryParameters,
        send: Callable[[Knots], None],
        guard: BeamGuard | None = None,
    ) -> None:
        counters = ("connections", "trajectories", "unstamped_states")
        axis = HostAxis(
            parameters,
            guard,
            homes_here=trajectory.homes_here,
            counters=counters,
            objection=self._sequence_objection,
        )
        super().__init__(axis, CAPABILITIES)
        self._parameters = parameters
        self._settings = trajectory
        self._send = send
        self._sent_revision = 0
        self._silence = Silence(SILENCE_NS)
        self._last: tuple[int, float] | None = None
        self._stamps = StampWatch(self._blame_clock)
        self._ages_ns: deque[int] = deque(maxlen=AGES)
        self._told_ns = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="trajectories", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the axis; the controller goes on holding it."""
        if not self._ending.is_set():
            super().close()
            self._ending.set()
            self._thread.join(timeout=2.0)

    # What the controller says --------------------------------------------------------------------------

    def joint_state(
        self, stamp_ns: int, position: float, velocity: float | None, effort: float | None, now: HostTime
    ) -> None:
        """Take one joint state.

        Parameters
        ----------
        stamp_ns : int
            Its header's stamp [ns, UNIX].
        position, velocity : float
            On the joint's own scale; None where there is none.
        effort : float or None
            Of the joint.
        now : HostTime
            When it came.
        """
        unit = self._settings.metres_per_unit
        with self.lock:
            if stamp_ns <= 0 or not self._stamps.is_credible(stamp_ns, now.unix_ns):
                self.axis.journal.counters["unstamped_states"] += 1
                return
            metres = position * unit
            speed = 0.0
            if velocity is not None:
                speed = velocity * unit
            elif self._last is not None and stamp_ns > self._last[0]:
                speed = (metres - self._last[1]) / ((stamp_ns - self._last[0]) * 1e-9)
            self._last = stamp_ns, metres
            self._ages_ns.append(now.unix_ns - stamp_ns)
            self.axis.observe(metres, speed)
            force = None if effort is None else effort / unit
            self.axis.add_measured(stamp_ns, metres, speed, force)
            if not self._silence.is_connected:
                self.axis.connect()
                self.axis.journal.counters["connections"] += 1
                self.axis.journal.tell("info", "connected: joint states come")
            self._silence.end()

    def _blame_clock(self, name: str, reason: str) -> None:
        self._ages_ns.clear()
        self.axis.fail(name, reason, time.monotonic_ns())

    # The thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._ending.wait(TURN_S):
            with self.lock:
                knots = self._turn(time.monotonic_ns())
            if knots is not None:
                self._send(knots)

    def _turn(self, now_ns: int) -> Knots | None:
        """Let time do its work; return a trajectory that is to be published."""
        axis = self.axis
        if self._silence.is_too_long(now_ns):
            reason = "no joint states came for 0.5 s: is the broadcaster active?"
            if axis.is_powered:
                # The controller may be alive, and follow a sequence that nobody sees any more.
                axis.fail("telemetry_stopped", reason, now_ns)
            else:
                self._silence.lose()
                self._last = None
                self._ages_ns.clear()
                self._stamps.forget()
                axis.disconnect("controller_silent", reason)
                return None
        if axis.powering:
            if axis.is_moving:
                axis.deny("the hub moves: expected it at rest")
            else:
                axis.grant(now_ns)
        axis.step(now_ns)
        clock = axis.stamps
        if clock is None:
            return None
        self._report_applied(now_ns)
        if axis.revision == self._sent_revision:
            return None
        # Also a ramp that is over by now: the controller follows the trajectory before it until it hears of this.
        self._sent_revision = axis.revision
        self._told_ns = axis.plan_ns - 1
        axis.journal.counters["trajectories"] += 1
        return Knots.of(axis.plan, clock.stamp_ns(axis.plan_ns), axis.zero, self._settings.metres_per_unit)

    def _report_applied(self, now_ns: int) -> None:
        """Report what of the trajectory that was handed over is due by now, at the rig's own ticks."""
        axis, clock = self.axis, self.axis.stamps
        assert clock is not None
        if not axis.is_powered or axis.revision != self._sent_revision:
            return
        period_ns = self._parameters.period_ns
        first = (self._told_ns - axis.plan_ns) // period_ns + 1
        last = (now_ns - axis.plan_ns) // period_ns
        if last - first < BATCH_POINTS:
            return
        ticks = np.arange(first, last + 1)
        self._told_ns = axis.plan_ns + last * period_ns
        positions, velocities, accelerations = axis.plan.sample(
            np.asarray(ticks * (period_ns * 1e-9), dtype=np.float64)
        )
        mode = self._parameters.command_mode
        axis.add_applied(
            SampleBatch(
                clock.stamp_ns(axis.plan_ns + int(first) * period_ns),
                period_ns,
                1,
                positions=positions,
                velocities=velocities if mode == "velocity" else None,
                accelerations=accelerations if mode == "acceleration" else None,
            )
        )

    def _sequence_objection(self, plan: MotionPlan) -> str:
        """Return why a sequence cannot be handed over."""
        knots = len(plan.times) + 1
        most = self._settings.max_knots
        if knots > most:
            return f"it needs {knots} knots: expected at most trajectory.max_knots = {most}; make it shorter"
        age_ns = statistics.median(self._ages_ns) if self._ages_ns else 0.0
        if abs(age_ns) > MAX_AGE_NS:
            return (
                f"the joint states' stamps are {age_ns * 1e-9:.3f} s behind this host's clock: expected within "
                f"{MAX_AGE_NS * 1e-9:g} s; synchronise the two computers' clocks (chrony)"
            )
        return ""
