"""The table of states: what a device must refuse, or take without a change, in each of its conditions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import Dialogue, end_of, only
from beam_ros.hub.conformance.limit_checks import breach, broken_cruise, cruise
from beam_ros.hub.conformance.misfits import misfits
from beam_ros.hub.conformance.motion_checks import stopped_by
from beam_ros.hub.conformance.playing import arm, play
from beam_ros.hub.contract import REQUEST_KINDS
from beam_ros.hub.line import protocol
from beam_ros.hub.simulated import transitions
from beam_ros.hub.simulated.transitions import TRANSITION_OF, Condition


@dataclass
class _Questions:
    """All that changes nothing in a condition: every request, set-point and sequence that the table leaves it in."""

    condition: Condition
    messages: list[protocol.Message] = field(default_factory=list)
    expected: dict[int, str] = field(default_factory=dict)
    is_setpoint_refused: bool = False
    sequence: int = 0

    @classmethod
    def of(cls, condition: Condition, host: Dialogue) -> _Questions:
        """Return them in the order of the table's causes; an Arm for a second from now."""
        self = cls(condition)
        soon_ns = host.clock().reply.sent_ns + 1_000_000_000
        for kind in REQUEST_KINDS:
            row = TRANSITION_OF[condition, kind]
            if row.goal is None:
                number = host.next_number()
                self.messages.append(protocol.Request(number, kind))
                self.expected[number] = "failure" if row.is_refused else "success"
        if TRANSITION_OF[condition, "set-point"].is_refused:
            self.is_setpoint_refused = True
            self.messages.append(protocol.Setpoint(host.next_number(), 0.0))
        if TRANSITION_OF[condition, "arm"].is_refused:
            self.sequence = host.next_number()
            self.messages.append(protocol.Arm(self.sequence, soon_ns, 100))
        return self


def _ask(host: Dialogue, condition: Condition, *before: protocol.Message) -> None:
    """Bring the axis into a condition by some words, and ask in the same breath all that must not change it."""
    questions = _Questions.of(condition, host)
    refused = host.fresh_status().setpoints_refused
    mark = host.mark()
    host.say(*before, *questions.messages)
    kinds = {m.number: m.kind for m in questions.messages if isinstance(m, protocol.Request)}
    for number, expected in questions.expected.items():
        reply = host.until(end_of(number), f"the end of the request {kinds[number]}", since=mark)
        require(
            reply.phase == expected,
            f"{kinds[number]} gave {reply.phase} ({reply.text!r}) in the condition {condition.name}: expected "
            f"{expected}",
        )
        require(expected == "success" or reply.text != "", f"{kinds[number]} was refused without a word")
    if questions.sequence:
        answer = host.until(
            only(protocol.ArmReply, number=questions.sequence),
            "ArmReply",
            since=mark,
        )
        require(not answer.is_accepted, f"a sequence was accepted in the condition {condition.name}")
    now = host.fresh_status().setpoints_refused
    require(
        now == (refused + questions.is_setpoint_refused) & 0xFFFF,
        f"a set-point was not counted as refused in the condition {condition.name}",
    )


def _require_still(host: Dialogue, condition: Condition) -> None:
    status = host.fresh_status()
    require(
        (status.state, status.activity) == (condition.state, condition.activity),
        f"the axis is {status.state}, {status.activity} after what the condition {condition.name} does not take: "
        f"expected {condition.state}, {condition.activity}",
    )


@check("refuses what the table of states refuses while homed, holding, armed and in fault", moves=True)
def _states_at_rest(host: Dialogue) -> None:
    identity = host.go_home(within=0.02)
    _ask(host, transitions.HOMED)
    _require_still(host, transitions.HOMED)
    host.must("enable")
    _ask(host, transitions.HOLDING)
    _require_still(host, transitions.HOLDING)
    require(arm(host, 100, host.fresh_status().tick + round(1.0 / host.period_s())).is_accepted, "arm failed")
    _ask(host, transitions.ARMED)
    _require_still(host, transitions.ARMED)
    host.must("disable")
    breach(host, broken_cruise(identity, math.nan), host.limits, "command_not_finite", clear=False)
    _ask(host, transitions.FAULT)
    _require_still(host, transitions.FAULT)
    host.must("clear_fault")
    _require_still(host, transitions.HOMED)


@check("refuses what the table of states refuses while running, following and stopping", moves=True)
def _states_in_motion(host: Dialogue) -> None:
    cruise(host)
    _ask(host, transitions.RUNNING)
    _require_still(host, transitions.RUNNING)
    _ask(host, transitions.STOPPING, protocol.Request(host.next_number(), "stop"))
    host.wait_for_rest()
    identity = host.enable(within=0.02)
    value = motions.setpoint(identity, host.position())
    for _ in range(5):
        host.say(protocol.Setpoint(host.next_number(), value))
        host.listen(0.02)
    _ask(host, transitions.FOLLOWING)
    _require_still(host, transitions.FOLLOWING)
    host.must("disable")


@check(
    "refuses what the table of states refuses while homing, and is identified where that is stopped",
    moves=True,
)
def _states_on_the_way_home(host: Dialogue) -> None:
    identity = host.enable(within=0.0)
    play(host, motions.shift(identity, round(0.4 / host.period_s()), host.position()))
    host.must("disable")
    number = host.next_number()
    _ask(host, transitions.HOMING, protocol.Request(number, "home"))
    host.listen(0.03)
    _ask(host, transitions.HOMING_STOPS, protocol.Request(host.next_number(), "stop"))
    reply = host.ask("home", number)
    require(reply.phase == "failure", f"a home that was stopped ended with {reply.phase}: expected failure")
    host.wait_for_rest()
    _require_still(host, transitions.IDENTIFIED)
    _ask(host, transitions.IDENTIFIED)
    _require_still(host, transitions.IDENTIFIED)
    host.must("home")
    _require_still(host, transitions.HOMED)


@check("is disabled in time while it holds and nothing but frames that do not fit comes", moves=True)
def _misfits_stop(host: Dialogue) -> None:
    """Nothing but frames that do not fit keeps coming; the axis must take it for silence."""
    host.enable()
    before = host.fresh_status()
    frames = list(misfits(host.limits).values())
    fed_ns = host.clock().reply.received_ns
    patience_s = host.limits.watchdog_ns * 1e-9 + 0.1
    pause_s = 0.005
    for k in range(round(patience_s / pause_s)):
        host.say_bytes(frames[k % len(frames)])
        host.listen(pause_s, alive=False)
    status = host.wait_for_rest(alive=False, seconds=0.1)
    stopped_by(status, "host_silent")
    require(status.silences == (before.silences + 1) & 0xFFFF, "the silence was not counted")
    silent_ns = status.silence_tick * host.identity.period_ns - fed_ns
    require(
        silent_ns <= host.limits.watchdog_ns + round(1e9 * patience_s) // 4,
        f"frames that do not fit put the watchdog off: it acted after {silent_ns * 1e-9:.4f} s",
    )
