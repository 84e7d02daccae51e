"""Any axis of ros2_control, by the plain topics of its JointTrajectoryController: whole motions in one message.

What the host plans goes over as knots that the controller's own interpolation joins to the very same motion: its
cubics through positions and velocities give back pieces of constant acceleration, its straight lines through
positions give back pieces of constant velocity. A dead host stops no trajectory, so that every set-point is handed
over together with the ramp that ends it; only a sequence runs to its own end.

Facts of the controller: the documents ``userdoc.rst`` and ``trajectory.rst`` of ros2_controllers.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.contract import HostTime, HubCapabilities
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.host.stamp_watch import StampWatch
from beam_ros.hub.link_parameters import TrajectoryParameters
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.query_line import SteadyTime
from beam_ros.hub.parameters import AxisParameters

HOLD_NS = 1_000_000_000
"""Every trajectory ends with a rest of this length: one that is over when it comes would be ignored, not obeyed."""
TURN_S = 0.005
SILENCE_NS = 500_000_000
"""Joint states that do not come for this long are a lost controller [ns]."""
MAX_AGE_NS = 100_000_000
"""Stamps of joint states that are older, or ahead, come from another clock [ns]."""
AGES = 50

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


CONTROLLER_SETTINGS = (
    "joints",
    "allow_partial_joints_goal",
    "interpolation_method",
    "positions_upsampling.enable",
)
"""Parameters of a JointTrajectoryController that decide what becomes of the knots; Jazzy has all but the last, which
later releases have."""


def settings_objection(settings: Mapping[str, object], joint: str, *, has_velocities: bool) -> str:
    """Return why a controller would not follow the knots as they are meant; empty where it does.

    Parameters
    ----------
    settings : mapping
        Those of ``CONTROLLER_SETTINGS`` that it has.
    joint : str
        The joint that carries the hub.
    has_velocities : bool
        Whether knots carry velocities; else positions alone, to be joined by straight lines.
    """
    joints = settings.get("joints")
    if isinstance(joints, list) and joints:
        if joint not in joints:
            return (
                f"the controller leads {', '.join(joints)}: expected {joint!r} among them; correct "
                "trajectory.joint"
            )
        if len(joints) > 1 and settings.get("allow_partial_joints_goal") is False:
            return (
                f"the controller leads {len(joints)} joints and rejects trajectories of {joint!r} alone: expected "
                "allow_partial_joints_goal: true among its parameters"
            )
    method = settings.get("interpolation_method", "splines")
    if method != "splines":
        return (
            f"the controller's interpolation_method is {method}, so that it jumps from knot to knot: expected "
            "splines, its default"
        )
    if settings.get("positions_upsampling.enable") and not has_velocities:
        return (
            "the controller's positions_upsampling.enable is true, so that it bends straight lines into splines: "
            "expected false, or hub.command_mode acceleration"
        )
    return ""


def _silence(drive_watchdog_s: float) -> str:
    """Return what becomes of the hub when the drive's master, controller_manager, falls silent."""
    if not drive_watchdog_s:
        return "silence stops nothing: the drive is not stated to stop without its master (axis.drive_watchdog is 0)"
    return (
        f"that the drive stops {drive_watchdog_s:g} s after its master falls silent is stated, not proved "
        "(axis.drive_watchdog); a controller that goes on without this program is not silent"
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
    steady : SteadyTime, optional
        A clock of the caller's, who then calls ``turn`` again and again; else threads do that, and check sequences.

    Attributes
    ----------
    awaits_check : bool
        Whether the controller's settings are still being asked for: the motor stays off until then.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        trajectory: TrajectoryParameters,
        send: Callable[[Knots], None],
        guard: BeamGuard | None = None,
        *,
        steady: SteadyTime | None = None,
    ) -> None:
        counters = ("trajectories", "unstamped_states")
        axis = HostAxis(
            parameters,
            guard,
            homes_here=trajectory.homes_here,
            counters=counters,
            objection=self._sequence_objection,
            reports_course=True,
            patience_ns=SILENCE_NS,
            checks_in_background=steady is None,
        )
        silence = _silence(trajectory.drive_watchdog_s)
        promised = dataclasses.replace(CAPABILITIES, shortcomings=(*CAPABILITIES.shortcomings, silence))
        super().__init__(axis, promised, steady)
        axis.contact.await_answer()
        self._settings = trajectory
        self._send = send
        self._sent_revision = 0
        self._last: tuple[int, float] | None = None
        self._stamps = StampWatch(self._blame_clock)
        self._ages_ns: deque[int] = deque(maxlen=AGES)
        self.awaits_check = False
        self._refusal = ""
        self._begin(steady)

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
            self.axis.measure(metres, speed, stamp_ns, None if effort is None else effort / unit)
            if self._refusal:
                return
            if not self.axis.contact.is_made:
                self.axis.connect("joint states come")
            self.axis.contact.hear()

    @property
    def is_connected(self) -> bool:
        """Whether joint states come, of a controller that is not refused."""
        return self.axis.contact.is_made

    def judge(self, objection: str) -> None:
        """Take what there is to say against the controller's settings, empty where nothing is.

        A hub that is held or moved is stopped first.
        """
        with self.lock:
            self.awaits_check = False
            self._refusal = objection
            if objection:
                self._refuse(self.steady.now_ns())

    def leave_off(self, reason: str) -> None:
        """Refuse what waits for the motor."""
        with self.lock:
            self.axis.deny(reason)

    def no_state(self, reason: str) -> None:
        """Take note of joint states that do not say where the joint is."""
        with self.lock:
            if not self.axis.contact.is_made:
                self.axis.disconnect("status_unreadable", reason)

    def _refuse(self, now_ns: int) -> None:
        if self.axis.is_powered:
            self.axis.fail("wrong_axis", self._refusal, now_ns)
        else:
            self.axis.disconnect("wrong_axis", self._refusal)

    def _blame_clock(self, name: str, reason: str) -> None:
        self._ages_ns.clear()
        self.axis.fail(name, reason, self.steady.now_ns())

    # Turns ---------------------------------------------------------------------------------------------

    def turn(self) -> None:
        """Let time do its work, and publish what the controller is to follow from now on."""
        with self.lock:
            knots = self._news(self.steady.now_ns())
        if knots is not None:
            self._send(knots)
        self.steady.wait(TURN_S)

    def _let_go(self) -> None:
        """Leave the joint to the controller, which goes on holding it."""

    def _news(self, now_ns: int) -> Knots | None:
        """Return a trajectory that is to be published."""
        axis = self.axis
        if axis.contact.is_silent(now_ns):
            reason = "no joint states came for 0.5 s: is the broadcaster active?"
            if axis.is_powered:
                # The controller may be alive, and follow a sequence that nobody sees any more.
                axis.fail("telemetry_stopped", reason, now_ns)
            else:
                self._last = None
                self._ages_ns.clear()
                self._stamps.forget()
                axis.disconnect("controller_silent", reason)
                return None
        elif self._refusal and axis.contact.is_made:
            self._refuse(now_ns)
        if axis.powering and not self.awaits_check:
            if axis.is_moving:
                axis.deny("the hub moves: expected it at rest")
            else:
                axis.grant(now_ns)
        axis.step(now_ns)
        clock, course = axis.stamps, axis.course
        if clock is None or course.revision == self._sent_revision:
            return None
        # Also a ramp that is over by now: the controller follows the trajectory before it until it hears of this.
        self._sent_revision = course.revision
        axis.journal.counters["trajectories"] += 1
        start_ns = clock.stamp_ns(course.start_ns)
        return Knots.of(course.plan, start_ns, axis.place.zero, self._settings.metres_per_unit)

    def _sequence_objection(self, plan: MotionPlan) -> str:
        """Return why a sequence cannot be handed over."""
        knots = len(plan.times) + 1
        most = self._settings.max_knots
        if knots > most:
            return f"it needs {knots} knots: expected at most trajectory.max_knots = {most}; make it shorter"
        # What is least late shows the clocks; the others waited for one of the two computers.
        age_ns = min(self._ages_ns, default=0)
        if abs(age_ns) > MAX_AGE_NS:
            return (
                f"the joint states' stamps are {age_ns * 1e-9:.3f} s behind this host's clock: expected within "
                f"{MAX_AGE_NS * 1e-9:g} s; synchronise the two computers' clocks (chrony)"
            )
        return ""
