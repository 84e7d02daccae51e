"""A motion controller that lives in the host: for axes whose own controller knows no states and no limits of ours.

``HostAxis`` keeps what the suite's firmware keeps for itself elsewhere: the states of the table in
``beam_ros.hub.simulated.transitions``, the ageing of set-points, stop ramps, limits. What is to be done is a
``LedCourse``: a plan and the steady time at which it begins; a link writes it to its controller sample by sample, or
hands it over whole. What every order promises, the ``Supervisor`` compares with what is measured, as on every link.
The axis reads no clock: every call says what time it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from beam_ros.hub.answers import Answers
from beam_ros.hub.contract import (
    Activity,
    AxisState,
    HostTime,
    HubReport,
    HubStatus,
    Outcome,
    RequestKind,
    SampleBatch,
    SequenceChunk,
)
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.host.contact import Contact
from beam_ros.hub.host.motion_watch import Measuring
from beam_ros.hub.host.rest_watch import REST_S
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.links.course import LedCourse
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.place import HubPlace
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.state_machine import AxisStateMachine
from beam_ros.hub.simulated.transitions import ARMED, FOLLOWING, HOMING, RUNNING, Cause

AT_REST = 0.002
"""A slower measured hub is taken for one at rest [m/s]: what a drive's speed estimate shows of a standing motor."""
MAX_LATENESS = 0.5
"""A command that is later than this share of the watchdog's time while the hub is to move has lost the pace ..."""
MAX_JUMP = 0.005
"""... and so has one that is further than this from where the last one was due [m]."""
STAMP_JITTER_S = 0.005
"""A measurement's stamp may be wrong by so much [s]."""
HELD = 0.001
"""A hub that is further than this from where it is held does not follow [m]."""


@dataclass
class PollSamples:
    """What is reported with the next poll."""

    applied: list[SampleBatch] = field(default_factory=list)
    measured: list[SampleBatch] = field(default_factory=list)


class HostAxis:
    """States, plan and reports of an axis that the host itself leads.

    Parameters
    ----------
    parameters : AxisParameters
        Command mode and limits.
    guard : BeamGuard, optional
        The beam on the axis, and how far it may be loaded.
    homes_here : bool
        Whether hub/home takes the present place for home; else the controller's own zero is home, and homing
        goes there.
    counters : tuple of str
        Names of the link's own counters.
    objection : callable, optional
        Why the link cannot hand a sequence's plan over; empty where it can.
    reports_course : bool
        Whether what is led is what is applied; else the link says what it wrote, by ``add_applied``.
    measuring : Measuring, optional
        How well positions are measured.
    patience_ns : int
        After so long a silence the controller is lost, where it speaks by itself [ns].
    checks_in_background : bool
        Whether sequences are checked in a thread; else at once.

    Attributes
    ----------
    course : LedCourse
        What is being done.
    place : HubPlace
        Where the hub was measured last.
    journal : Journal
        Events and counters.
    contact : Contact
        Whether the controller answers.
    powering : list of (int, str)
        Requests that wait for the link to switch the motor on: ``grant`` or ``deny`` answers them.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        guard: BeamGuard | None = None,
        *,
        homes_here: bool = True,
        counters: tuple[str, ...] = (),
        objection: Callable[[MotionPlan], str] = lambda plan: "",
        reports_course: bool = False,
        measuring: Measuring | None = None,
        patience_ns: int = 0,
        checks_in_background: bool = True,
    ) -> None:
        self.parameters = parameters
        self.course = LedCourse(parameters)
        self.place = HubPlace(homes_here=homes_here)
        self.powering: list[tuple[int, RequestKind]] = []
        self.journal = Journal(("connections", *counters))
        self.contact = Contact(self.journal, patience_ns)
        self._gate = CommandGate(parameters, guard, in_background=checks_in_background)
        self._objection = objection
        self._reports_course = reports_course
        self._answers = Answers()
        self._machine = self._new_machine()
        self._clock: HostClock | None = None
        self._polled_ns = 0
        self._samples = PollSamples()
        # What the encoder's step is on somebody else's axis, the rig file need not know.
        somehow = Measuring(parameters.max_following_error, AT_REST * REST_S, STAMP_JITTER_S)
        self._supervisor = Supervisor(parameters, self.journal, measuring or somehow)

    # What it is like -----------------------------------------------------------------------------------

    @property
    def state(self) -> AxisState:
        """Disconnected, identified, homed, enabled or fault."""
        if not self.contact.is_made:
            return "disconnected"
        return "fault" if self.is_broken else self._machine.condition.state

    @property
    def activity(self) -> Activity:
        """What the axis is doing now."""
        return self._machine.condition.activity

    @property
    def is_powered(self) -> bool:
        """Whether the motor is to hold or to move; else it is to be off."""
        return self.activity != "idle"

    @property
    def is_broken(self) -> bool:
        """Whether a fault waits to be cleared."""
        return self._supervisor.fault is not NO_FAULT

    @property
    def is_moving(self) -> bool:
        """Whether the measured hub moves."""
        return abs(self.place.velocity) > AT_REST

    def must_be_silent(self, now_ns: int) -> bool:
        """Whether nothing may be written now: the axis did not stop, and its own watchdog is to act."""
        return self._supervisor.must_be_silent(now_ns)

    def clock(self, now: HostTime) -> HostClock:
        """Return the host's clock, which the first call starts."""
        if self._clock is None:
            self._clock = HostClock(now)
        return self._clock

    @property
    def stamps(self) -> HostClock | None:
        """The host's clock; None before the first poll."""
        return self._clock

    # What people ask for -------------------------------------------------------------------------------

    def request(self, kind: RequestKind, now_ns: int) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        if not self.contact.is_made:
            return self.refuse(kind, f"the controller is disconnected: {self.contact.reason}")
        if (answer := self._supervisor.answer(kind, self._machine.condition.state)) is not None:
            if kind == "clear_fault" and answer.success and self._supervisor.has_lost_home:
                self._machine = self._new_machine()
            return self._answers.give(answer)
        number = self._answers.begin()
        if kind in ("enable", "home") and not self.is_powered:
            self.powering.append((number, kind))
        else:
            if kind in ("stop", "disable"):
                self._gate.abort_loading(f"{kind} was asked for")
            was_stopping = self.activity == "stopping"
            self._machine.ask(0, number, kind)
            self._follow_condition(was_stopping, now_ns)
        return number

    def refuse(self, kind: RequestKind, reason: str) -> int:
        """Refuse a request; its number appears in ``HubReport.completed``."""
        return self._answers.give(Outcome(False, f"cannot {kind.replace('_', ' ')}: {reason}"))

    def grant(self, now_ns: int) -> None:
        """Do what waits for the motor, which now holds the hub where it stands."""
        waiting, self.powering = self.powering, []
        p, place = self.parameters, self.place
        for number, kind in waiting:
            if kind == "home":
                place.take_home()
            if abs(place.position) > p.position_limit:
                reason = (
                    f"cannot {kind}: the hub stands at {place.position:.6f} m, expected within "
                    f"+-{p.position_limit:g} m; move it by hand, and home it"
                )
                self._answers.add(number, Outcome(False, reason))
                continue
            self._supervisor.forget_motion()
            self.course.follow(MotionPlan.rest(place.position), now_ns)
            self._machine.ask(0, number, kind)
            self._follow_condition(False, now_ns)
            if self._machine.condition is HOMING:
                way = MotionPlan.move(place.position, 0.0, 0.0, p.homing_speed, p.homing_acceleration)
                self.course.follow(way, now_ns)

    def deny(self, reason: str) -> None:
        """Refuse what waits for the motor."""
        waiting, self.powering = self.powering, []
        for number, kind in waiting:
            self._answers.add(number, Outcome(False, f"cannot {kind}: {reason}"))

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Take one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        now_ns = self.clock(now).stamp_ns(now.steady_ns)
        position, velocity, _ = self.course.at(now.steady_ns)
        outcome = self._gate.check_setpoint(stamp_ns, value, now_ns, self.state, position, velocity)
        if outcome.success:
            plan = MotionPlan.towards(position, velocity, value, self.parameters)
            outcome = self._react("set-point", now.steady_ns, objection=plan.objection(self.parameters))
            if outcome.success:
                self.course.follow(plan, now.steady_ns)
        if not outcome.success:
            self.journal.counters["setpoints_refused"] += 1
        return outcome

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Take one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        clock = self.clock(now)
        position, velocity, _ = self.course.at(now.steady_ns)
        self._gate.add(chunk, clock.stamp_ns(now.steady_ns), self.state, position, velocity)

    def _take_checked(self, now: HostTime) -> None:
        """Make a plan of the sequence that has passed its check, if one has."""
        clock = self.clock(now)
        position, velocity, _ = self.course.at(now.steady_ns)
        sequence = self._gate.poll(clock.stamp_ns(now.steady_ns), self.state, position, velocity)
        if sequence is None:
            return
        plan = MotionPlan.sequence(sequence.ticks(0, sequence.n_ticks), self.parameters, position)
        astray = abs(self.place.position - position)
        objection = self._objection(plan)
        if astray > HELD:
            objection = f"the hub stands {astray * 1e3:.2f} mm from where it is held: expected at most 1 mm"
        outcome = self._react("arm", now.steady_ns, objection=objection)
        if outcome.success:
            self.course.follow(plan, clock.steady_ns(sequence.start_ns))
        else:
            self._gate.finish("refused", outcome.message)

    # What the link sees --------------------------------------------------------------------------------

    def connect(self, what: str) -> None:
        """Note that the controller answers; ``what`` it is goes into the log."""
        self.contact.make(what)
        self._supervisor.connect()

    def disconnect(self, name: str, reason: str) -> None:
        """Note that the controller cannot be reached: nothing is known of the hub any more."""
        self.contact.lose(fault(name), reason)
        self.deny(reason)
        if self.is_powered:
            self._machine.react("emergency stop", 0, reason, fault=fault(name))
        self._gate.finish("aborted", reason)
        self._give_up(f"the controller is disconnected: {reason}")
        self._machine = self._new_machine()

    def fail(self, name: str, reason: str, now_ns: int, *, is_limp: bool = False) -> None:
        """Stop because of something that the host noticed, which stays until it is cleared.

        Parameters
        ----------
        name : str
            In the table of faults.
        reason : str
            What was seen.
        now_ns : int
            Steady time [ns].
        is_limp : bool, optional
            Whether the motor is off already, so that nothing can be led to rest.
        """
        was_broken = self.is_broken
        self._supervisor.report(name, reason)
        if is_limp and self.is_powered and not was_broken:
            self._machine.react("emergency stop", 0, reason, fault=fault(name))
            self._machine.react("rest", 0)
            self.course.follow(MotionPlan.rest(self.place.position), now_ns)
            self._follow_condition(True, now_ns)
        self._stop_if_due(now_ns)

    def note_late(self, late_ns: int, now_ns: int) -> None:
        """Stop if the host was so late with a command that the pace is lost; of a sequence, the rest is lost.

        The stop begins where the hub was just measured: the plan has gone on without it.
        """
        before, after = self.course.at(now_ns - late_ns), self.course.at(now_ns)
        is_still = before[1:] == after[1:] == (0.0, 0.0) and before[0] == after[0]
        is_far = (
            abs(after[0] - before[0]) > MAX_JUMP or late_ns * 1e-9 > MAX_LATENESS * self.parameters.watchdog_s
        )
        if is_far and not is_still and self.is_powered:
            is_running = self._machine.condition is RUNNING
            reason = f"the host was {late_ns * 1e-9:.3f} s late with a position"
            self._react("underrun" if is_running else "emergency stop", now_ns, reason, fault("underrun"))
            self._brake_where_it_is(now_ns)

    def measure(
        self,
        raw: float,
        velocity: float | None,
        stamp_ns: int | None = None,
        effort: float | None = None,
        *,
        epoch: int = 1,
        is_led: bool = False,
    ) -> None:
        """Take what was measured.

        Parameters
        ----------
        raw : float
            Position on the controller's own scale [m].
        velocity : float or None
            [m/s].
        stamp_ns : int, optional
            When [ns, UNIX]; what has no time is not reported.
        effort : float, optional
            Force on the hub [N].
        epoch : int, optional
            Counts the beginnings of the clock that the stamp comes from.
        is_led : bool, optional
            Whether somebody else leads the hub within its limits; else this axis does while it is powered.
        """
        place = self.place
        place.raw, place.velocity = raw, velocity or 0.0
        if stamp_ns is None:
            return
        self._samples.measured.append(
            SampleBatch(
                stamp_ns,
                0,
                epoch,
                positions=np.array([place.position]),
                velocities=None if velocity is None else np.array([velocity]),
                efforts=None if effort is None else np.array([effort]),
            )
        )
        self._supervisor.note_measured(stamp_ns * 1e-9, place.position, is_led=is_led or self.is_powered)

    def add_applied(self, batch: SampleBatch) -> None:
        """Report what was written."""
        self._samples.applied.append(batch)

    # Time ----------------------------------------------------------------------------------------------

    def step(self, now_ns: int) -> None:
        """Do what time alone brings about: starts, ends, silence, set-points that were not refreshed."""
        supervisor, course = self._supervisor, self.course
        supervisor.look(now_ns)
        supervisor.note_led(now_ns, course.at(now_ns)[0], self.place.position)
        self._stop_if_due(now_ns)
        self._end_stop(now_ns)
        condition = self._machine.condition
        watchdog_ns = round(self.parameters.watchdog_s * 1e9)
        patience = f"{self.parameters.watchdog_s:g} s"
        if self.activity not in ("idle", "stopping") and now_ns - self._polled_ns > watchdog_ns:
            reason = f"the host's program stood still for {patience}"
            self._react("silence", now_ns, reason, fault("host_silent"))
        elif condition is ARMED and now_ns >= course.start_ns:
            self._react("start", now_ns)
        elif condition is RUNNING and course.is_over(now_ns):
            self._react("end", now_ns)
        elif condition is FOLLOWING and self._is_aged(now_ns - watchdog_ns):
            self._react(
                "old set-point", now_ns, f"set-point not refreshed for {patience}", fault("setpoint_old")
            )
        elif condition is HOMING and course.is_settled(now_ns):
            self._react("home reached", now_ns)
        supervisor.note_status(self._machine.condition.state, self.activity, 0)

    def _is_aged(self, oldest_ns: int) -> bool:
        """Whether the set-point that is followed is older than that; one of a position does not age."""
        return self.parameters.command_mode != "position" and self.course.start_ns < oldest_ns

    def poll(self, now: HostTime) -> HubReport:
        """Note that the host is alive, and collect what happened."""
        clock = self.clock(now)
        self._polled_ns = now.steady_ns
        if (led := self.course.take_ticks(now.steady_ns, clock)) is not None:
            self._gate.follow([led])
            if self._reports_course and self.is_powered:
                self.add_applied(led[0])
        self.journal.watch_clock(clock, now)
        self._take_checked(now)
        for event in self._machine.take_events():
            self.journal.add(self._gate.note(event.kind, event.text))
        samples, self._samples = self._samples, PollSamples()
        return HubReport(
            applied=samples.applied,
            measured=samples.measured,
            sequences=self._gate.take_reports(),
            clock=[],
            completed=self._answers.take(),
            status=self._status(),
            events=self.journal.take_events(),
        )

    # Stops ---------------------------------------------------------------------------------------------

    def _stop_if_due(self, now_ns: int) -> None:
        """Stop a hub whose motion nobody can answer for: from where it is, so that it is not pulled back."""
        supervisor = self._supervisor
        if self.is_broken:
            self.deny(supervisor.reason)
        if supervisor.is_stop_due and self.activity not in ("idle", "stopping"):
            self._react("emergency stop", now_ns, supervisor.reason, supervisor.fault)
            if supervisor.fault.name in ("motion_unexplained", "beyond_travel"):
                self._brake_where_it_is(now_ns)

    def _end_stop(self, now_ns: int) -> None:
        """End a stop where the hub is seen at rest; where it did something else instead, let go of it."""
        supervisor = self._supervisor
        if broken := supervisor.take_broken():
            self._give_up(broken)
            self._follow_condition(True, now_ns)
        elif supervisor.is_stopping and self.course.is_settled(now_ns):
            supervisor.note_stop_answered(is_over=True)
            if supervisor.end_stop() and self.activity == "stopping":
                self._react("rest", now_ns)

    def _give_up(self, reason: str) -> None:
        """Lead the hub no more; what waits for its rest is answered with the reason why it will not be seen."""
        if self.activity == "stopping":
            self._machine.react("rest", 0, reason)

    def _brake_where_it_is(self, now_ns: int) -> None:
        """Stop from the measured motion."""
        self._brake(self.place.position, self.place.velocity, now_ns)

    def _brake(self, position: float, velocity: float, now_ns: int) -> None:
        brake = MotionPlan.brake(position, velocity, self.parameters.stop_deceleration)
        self.course.follow(brake, now_ns)

    # Inside --------------------------------------------------------------------------------------------

    def _status(self) -> HubStatus:
        if not self.contact.is_made:
            return self.contact.status
        status = HubStatus(
            self._machine.condition.state,
            self.place.position,
            self.place.velocity,
            self.activity,
            self._machine.fault,
            self._machine.reason,
            dict(self.journal.counters),
        )
        return self._supervisor.seen(status)

    def _react(
        self, cause: Cause, now_ns: int, reason: str = "", why: Fault = NO_FAULT, *, objection: str = ""
    ) -> Outcome:
        was_stopping = self.activity == "stopping"
        outcome = self._machine.react(cause, 0, reason, fault=why, objection=objection)
        self._follow_condition(was_stopping, now_ns)
        return outcome

    def _follow_condition(self, was_stopping: bool, now_ns: int) -> None:
        """Begin the ramp of a stop, which is a promise from now on; tell the supervisor where the axis stands."""
        supervisor = self._supervisor
        if self.activity == "stopping" and not was_stopping:
            position, velocity, _ = self.course.at(now_ns)
            self._brake(position, velocity, now_ns)
            supervisor.order_stop()
            supervisor.note_stop_said(self.course.plan.duration)
        supervisor.note_status(self._machine.condition.state, self.activity, 0)

    def _new_machine(self) -> AxisStateMachine:
        """Return the states of an axis of which nothing is known yet; what its effects do, the axis does itself."""
        return AxisStateMachine({"watchdog fed": lambda: None, "zero set": lambda: None}, self._answers)
