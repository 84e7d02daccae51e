"""A motion controller that lives in the host: for axes whose own controller knows no states and no limits of ours.

``HostAxis`` keeps what the suite's firmware keeps for itself elsewhere: the states of the table in
``beam_ros.hub.simulated.transitions``, the ageing of set-points, stop ramps, limits. What is to be done is a
``MotionPlan`` and the steady time at which it begins; a link writes it to its controller sample by sample, or hands
it over whole. The axis reads no clock: every call says what time it is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

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
from beam_ros.hub.host.motion_watch import CertainMotion
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.state_machine import AxisStateMachine
from beam_ros.hub.simulated.transitions import ARMED, FOLLOWING, HOMING, HOMING_STOPS, RUNNING, Cause

AT_REST = 0.002
"""A slower measured hub is taken for one at rest [m/s]: what a drive's speed estimate shows of a standing motor."""
SETTLING_NS = 100_000_000
"""So long the motor holds the hub after a plan has come to rest, before it may be switched off [ns]."""
MAX_LATENESS = 0.5
"""A command that is later than this share of the watchdog's time while the hub is to move has lost the pace ..."""
MAX_JUMP = 0.005
"""... and so has one that is further than this from where the last one was due [m]."""
LAG_NS = 150_000_000
"""A drive may be this much behind its commands, and a measurement behind the hub [ns]."""
FOLLOWED_TICKS = 1000
"""So many ticks of the past at most are shown to the gate in one poll."""
STAMP_JITTER_S = 0.005
"""A measurement's stamp may be wrong by so much [s]."""
HELD = 0.001
"""A hub that is further than this from where it is held does not follow [m]."""


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

    Attributes
    ----------
    plan : MotionPlan
        What is being done.
    plan_ns : int
        Steady time at which it begins [ns].
    revision : int
        Grows with every new plan.
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
    ) -> None:
        self.parameters = parameters
        self.plan = MotionPlan.rest(0.0)
        self.plan_ns = 0
        self.revision = 0
        self.powering: list[tuple[int, RequestKind]] = []
        self.journal = Journal(counters)
        self._gate = CommandGate(parameters, guard, in_background=True)
        self._homes_here = homes_here
        self._objection = objection
        self._machine = _machine()
        self._clock: HostClock | None = None
        self._polled_ns = 0
        self._lapse_ns = 0
        self._followed_ns = 0
        self._stepped_ns = 0
        self._next_request = 1
        self._completed: list[tuple[int, Outcome]] = []
        self._applied: list[SampleBatch] = []
        self._measured: list[SampleBatch] = []
        self._zero = 0.0
        self._raw = 0.0
        self._velocity = 0.0
        self._led: deque[tuple[int, float]] = deque()
        self._fault: Fault = fault("no_answer")
        self._reason = "the controller has not answered yet"
        self._told = ""
        self._is_connected = False
        self._supervisor = Supervisor(parameters, self.journal)
        # What the encoder's step is on somebody else's axis, the rig file need not know.
        self._motion = CertainMotion(parameters, parameters.max_following_error, STAMP_JITTER_S)

    # What it is like -----------------------------------------------------------------------------------

    @property
    def state(self) -> AxisState:
        """Disconnected, identified, homed, enabled or fault."""
        if not self._is_connected:
            return "disconnected"
        if self.is_broken:
            return "fault"
        return self._machine.condition.state

    @property
    def activity(self) -> Activity:
        """What the axis is doing now."""
        return self._machine.condition.activity

    @property
    def is_powered(self) -> bool:
        """Whether the motor is to hold or to move; else it is to be off."""
        return self.activity != "idle"

    @property
    def position(self) -> float:
        """Measured position, from home [m]."""
        return self._raw - self._zero

    @property
    def zero(self) -> float:
        """Where home is on the controller's own scale [m]."""
        return self._zero

    def reference(self, now_ns: int) -> tuple[float, float, float]:
        """Return where the hub is to be now: position from home [m], velocity [m/s], acceleration [m/s^2]."""
        return self.plan.at((now_ns - self.plan_ns) * 1e-9)

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
        number = self._next_request
        self._next_request += 1
        if not self._is_connected:
            words = kind.replace("_", " ")
            self._complete(number, False, f"cannot {words}: the controller is disconnected: {self._reason}")
        elif (answer := self._supervisor.answer(kind, self._machine.condition.state)) is not None:
            self._completed.append((number, answer))
            if kind == "clear_fault" and answer.success and self._supervisor.has_lost_home:
                self._machine = _machine()
        elif kind in ("enable", "home") and not self.is_powered:
            self.powering.append((number, kind))
        else:
            if kind in ("stop", "disable"):
                self._gate.abort_loading(f"{kind} was asked for")
            self._ask(number, kind, now_ns)
        return number

    def grant(self, now_ns: int) -> None:
        """Do what waits for the motor, which now holds the hub where it stands."""
        waiting, self.powering = self.powering, []
        for number, kind in waiting:
            if kind == "home" and self._homes_here:
                self._zero = self._raw
            elif kind == "home":
                self._zero = 0.0
            if abs(self.position) > self.parameters.position_limit:
                self._complete(
                    number,
                    False,
                    f"cannot {kind}: the hub stands at {self.position:.6f} m, expected within "
                    f"+-{self.parameters.position_limit:g} m; move it by hand, and home it",
                )
                continue
            self._motion.forget()
            self._set_plan(MotionPlan.rest(self.position), now_ns)
            self._ask(number, kind, now_ns)
            if self._machine.condition is HOMING:
                p = self.parameters
                way = MotionPlan.move(self.position, 0.0, 0.0, p.homing_speed, p.homing_acceleration)
                self._set_plan(way, now_ns)

    def deny(self, reason: str) -> None:
        """Refuse what waits for the motor."""
        waiting, self.powering = self.powering, []
        for number, kind in waiting:
            self._complete(number, False, f"cannot {kind}: {reason}")

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Take one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        now_ns = self.clock(now).stamp_ns(now.steady_ns)
        position, velocity, _ = self.reference(now.steady_ns)
        outcome = self._gate.check_setpoint(stamp_ns, value, now_ns, self.state, position, velocity)
        if outcome.success:
            plan = self._towards(value, now.steady_ns)
            outcome = self._react("set-point", now.steady_ns, objection=plan.objection(self.parameters))
            if outcome.success:
                self._set_plan(plan, now.steady_ns)
                self._lapse_ns = now.steady_ns + round(self.parameters.watchdog_s * 1e9)
        if not outcome.success:
            self.journal.counters["setpoints_refused"] += 1
        return outcome

    def _towards(self, setpoint: float, now_ns: int) -> MotionPlan:
        position, velocity, _ = self.reference(now_ns)
        p = self.parameters
        if p.command_mode == "position":
            return MotionPlan.move(position, velocity, setpoint, p.move_speed, p.move_acceleration)
        return MotionPlan.refreshed(position, velocity, setpoint, p)

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Take one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        clock = self.clock(now)
        position, velocity, _ = self.reference(now.steady_ns)
        self._gate.add(chunk, clock.stamp_ns(now.steady_ns), self.state, position, velocity)

    def _take_checked(self, now: HostTime) -> None:
        """Make a plan of the sequence that has passed its check, if one has."""
        clock = self.clock(now)
        position, velocity, _ = self.reference(now.steady_ns)
        sequence = self._gate.poll(clock.stamp_ns(now.steady_ns), self.state, position, velocity)
        if sequence is None:
            return
        plan = MotionPlan.sequence(sequence.ticks(0, sequence.n_ticks), self.parameters, position)
        astray = abs(self.position - position)
        objection = self._objection(plan)
        if astray > HELD:
            objection = f"the hub stands {astray * 1e3:.2f} mm from where it is held: expected at most 1 mm"
        outcome = self._react("arm", now.steady_ns, objection=objection)
        if outcome.success:
            self._set_plan(plan, clock.steady_ns(sequence.start_ns))
        else:
            self._gate.finish("refused", outcome.message)

    # What the link sees --------------------------------------------------------------------------------

    def connect(self) -> None:
        """Note that the controller answers."""
        self._is_connected = True
        self._told = ""
        self._fault, self._reason = NO_FAULT, ""
        self._motion.forget()

    def disconnect(self, name: str, reason: str) -> None:
        """Note that the controller cannot be reached: nothing is known of the hub any more."""
        if name != self._told:
            self.journal.tell("error", reason)
        self._told = name
        self._is_connected = False
        self._fault, self._reason = fault(name), reason
        self.deny(reason)
        if self.is_powered:
            self._machine.react("emergency stop", 0, reason, fault=fault(name))
            self._machine.react("rest", 0)
        self._gate.finish("aborted", reason)
        for number, _ in self._machine.take_completed():
            self._complete(number, False, f"the controller is disconnected: {reason}")
        self._machine = _machine()

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
        is_known = self.is_broken
        self._supervisor.report(name, reason)
        if is_known:
            return
        self.deny(reason)
        if self.is_powered:
            self._react("emergency stop", now_ns, reason, fault(name))
            if is_limp:
                self._set_plan(MotionPlan.rest(self.position), now_ns)
                self._react("rest", now_ns)

    def note_late(self, late_ns: int, now_ns: int) -> None:
        """Stop if the host was so late with a command that the pace is lost; of a sequence, the rest is lost.

        The stop begins where the hub was just measured: the plan has gone on without it.
        """
        before, after = self.reference(now_ns - late_ns), self.reference(now_ns)
        is_still = before[1:] == after[1:] == (0.0, 0.0) and before[0] == after[0]
        is_far = (
            abs(after[0] - before[0]) > MAX_JUMP or late_ns * 1e-9 > MAX_LATENESS * self.parameters.watchdog_s
        )
        if is_far and not is_still and self.is_powered:
            is_running = self._machine.condition is RUNNING
            reason = f"the host was {late_ns * 1e-9:.3f} s late with a position"
            self._react("underrun" if is_running else "emergency stop", now_ns, reason, fault("underrun"))
            self._brake_where_it_is(now_ns)

    def observe(self, raw_position: float, velocity: float) -> None:
        """Note what was measured: position on the controller's own scale [m], velocity [m/s]."""
        self._raw, self._velocity = raw_position, velocity

    @property
    def is_broken(self) -> bool:
        """Whether a fault waits to be cleared."""
        return self._supervisor.fault is not NO_FAULT

    @property
    def is_moving(self) -> bool:
        """Whether the measured hub moves."""
        return abs(self._velocity) > AT_REST

    def add_applied(self, batch: SampleBatch) -> None:
        """Report what was commanded."""
        self._applied.append(batch)

    def add_measured(self, stamp_ns: int, position: float, velocity: float, effort: float | None) -> None:
        """Report one measured sample with a stamp of its own [ns, UNIX], position on the controller's scale [m]."""
        batch = SampleBatch(
            stamp_ns,
            0,
            1,
            positions=np.array([position - self._zero]),
            velocities=np.array([velocity]),
            efforts=None if effort is None else np.array([effort]),
        )
        self._measured.append(batch)
        self._watch_measured(stamp_ns)

    # Time ----------------------------------------------------------------------------------------------

    def step(self, now_ns: int) -> None:
        """Do what time alone brings about: starts, ends, silence, set-points that were not refreshed."""
        self._supervisor.look(now_ns)
        self._stepped_ns = now_ns
        self._watch(now_ns)
        condition = self._machine.condition
        end_ns = self.plan_ns + round(self.plan.duration * 1e9)
        is_over, is_settled = now_ns >= end_ns, now_ns >= end_ns + SETTLING_NS
        watchdog_ns = round(self.parameters.watchdog_s * 1e9)
        if self.activity not in ("idle", "stopping") and now_ns - self._polled_ns > watchdog_ns:
            reason = f"the host's program stood still for {self.parameters.watchdog_s:g} s"
            self._react("silence", now_ns, reason, fault("host_silent"))
        elif condition is ARMED and now_ns >= self.plan_ns:
            self._react("start", now_ns)
        elif condition is RUNNING and is_over:
            self._react("end", now_ns)
        elif (
            condition is FOLLOWING and self.parameters.command_mode != "position" and now_ns > self._lapse_ns
        ):
            patience = self.parameters.watchdog_s
            reason = f"set-point not refreshed for {patience:g} s"
            self._react("old set-point", now_ns, reason, fault("setpoint_old"))
        elif condition is HOMING and is_settled:
            self._react("home reached", now_ns)
        elif self.activity == "stopping" and is_settled:
            self._react("rest", now_ns)
        self._supervisor.note_status(self._machine.condition.state, self.activity, 0)

    def poll(self, now: HostTime) -> HubReport:
        """Note that the host is alive, and collect what happened."""
        clock = self.clock(now)
        self._polled_ns = now.steady_ns
        self._let_gate_follow(now.steady_ns, clock)
        self.journal.watch_clock(clock, now)
        self._take_checked(now)
        for event in self._machine.take_events():
            self.journal.add(self._gate.note(event.kind, event.text))
        applied, self._applied = self._applied, []
        measured, self._measured = self._measured, []
        completed, self._completed = [*self._completed, *self._machine.take_completed()], []
        return HubReport(
            applied=applied,
            measured=measured,
            sequences=self._gate.take_reports(),
            clock=[],
            completed=completed,
            status=self._status(),
            events=self.journal.take_events(),
        )

    # Inside --------------------------------------------------------------------------------------------

    def _let_gate_follow(self, now_ns: int, clock: HostClock) -> None:
        """Show the gate what was commanded since the last poll, tick by tick, for its model of the beam."""
        period_ns, mode = self.parameters.period_ns, self.parameters.command_mode
        begin_ns = max(self._followed_ns, now_ns - FOLLOWED_TICKS * period_ns)
        if self.plan_ns <= now_ns:
            begin_ns = max(begin_ns, self.plan_ns)
        first = -((self.plan_ns - begin_ns) // period_ns)
        last = (now_ns - self.plan_ns) // period_ns
        if last <= first:
            return
        self._followed_ns = self.plan_ns + last * period_ns
        ticks = np.arange(first, last) * (period_ns * 1e-9)
        positions, velocities, accelerations = self.plan.sample(np.asarray(ticks, dtype=np.float64))
        stamp_ns = clock.stamp_ns(self.plan_ns + first * period_ns)
        applied = SampleBatch(
            stamp_ns,
            period_ns,
            1,
            velocities=None if mode == "acceleration" else velocities,
            accelerations=accelerations if mode == "acceleration" else None,
        )
        measured = SampleBatch(stamp_ns, period_ns, 1, positions=positions, velocities=velocities)
        self._gate.follow([(applied, measured)])

    def _watch(self, now_ns: int) -> None:
        """Compare what was measured with what was commanded."""
        led = self._led
        if not self.is_powered or self.is_broken:
            led.clear()
            return
        led.append((now_ns, self.reference(now_ns)[0]))
        while now_ns - led[0][0] > LAG_NS:
            led.popleft()
        ways = [position for _, position in led]
        astray = max(min(ways) - self.position, self.position - max(ways))
        if astray > self.parameters.max_following_error:
            most = self.parameters.max_following_error * 1e3
            reason = (
                f"the hub is {astray * 1e3:.2f} mm from where it was led: expected at most {most:g} mm "
                "(hub.max_following_error)"
            )
            self.fail("motion_unexplained", reason, now_ns)
            self._brake_where_it_is(now_ns)

    def _watch_measured(self, stamp_ns: int) -> None:
        """Look at a measurement by itself: no command is needed to see that it cannot be, or must not be."""
        if self._machine.condition in (HOMING, HOMING_STOPS):
            self._motion.forget()
            return
        found = self._motion.find(
            np.array([stamp_ns * 1e-9]),
            np.array([self.position]),
            is_homed=self._machine.condition.state in ("homed", "enabled")
            and not self._supervisor.has_lost_home,
            is_enabled=self.is_powered,
        )
        if found is None:
            return
        was_led = self.is_powered and not self.is_broken
        self.fail(*found, self._stepped_ns)
        if was_led and found[0] != "position_jumped":
            self._brake_where_it_is(self._stepped_ns)

    def _brake_where_it_is(self, now_ns: int) -> None:
        """Stop from the measured motion: a hub that went astray is not pulled back."""
        stop = self.parameters.stop_deceleration
        self._led.clear()
        self._set_plan(MotionPlan.brake(self.position, self._velocity, stop), now_ns)

    def _status(self) -> HubStatus:
        if not self._is_connected:
            return HubStatus(fault=self._fault, reason=self._reason, counters=dict(self.journal.counters))
        status = HubStatus(
            self._machine.condition.state,
            self.position,
            self._velocity,
            self.activity,
            self._machine.fault,
            self._machine.reason,
            dict(self.journal.counters),
        )
        return self._supervisor.seen(status)

    def _complete(self, number: int, success: bool, message: str) -> None:
        self._completed.append((number, Outcome(success, message)))

    def _ask(self, number: int, kind: RequestKind, now_ns: int) -> None:
        was_stopping = self.activity == "stopping"
        self._machine.ask(0, number, kind)
        self._brake_if_stopping(was_stopping, now_ns)

    def _react(
        self, cause: Cause, now_ns: int, reason: str = "", why: Fault = NO_FAULT, *, objection: str = ""
    ) -> Outcome:
        was_stopping = self.activity == "stopping"
        outcome = self._machine.react(cause, 0, reason, fault=why, objection=objection)
        self._brake_if_stopping(was_stopping, now_ns)
        return outcome

    def _brake_if_stopping(self, was_stopping: bool, now_ns: int) -> None:
        if self.activity == "stopping" and not was_stopping:
            position, velocity, _ = self.reference(now_ns)
            stop = self.parameters.stop_deceleration
            self._set_plan(MotionPlan.brake(position, velocity, stop), now_ns)

    def _set_plan(self, plan: MotionPlan, start_ns: int) -> None:
        self.plan, self.plan_ns = plan, start_ns
        self.revision += 1


def _machine() -> AxisStateMachine:
    """Return the states of an axis of which nothing is known yet; what its effects do, the axis does itself."""
    return AxisStateMachine({"watchdog fed": lambda: None, "zero set": lambda: None})
