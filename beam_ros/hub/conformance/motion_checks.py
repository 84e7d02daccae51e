"""Requests, set-points, and every way in which an axis stops by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import Dialogue, only
from beam_ros.hub.conformance.kinematics import require_followed, require_ramp
from beam_ros.hub.conformance.playing import play
from beam_ros.hub.faults import fault
from beam_ros.hub.line import protocol

REMEMBERED = 16
"""Requests that a device knows again."""
LATE_S = 0.03
"""By how much a watchdog may be late: its tick, and the batch that its Status may wait for [s]."""
EDGE = 1e-3
"""What lies this share within a limit is followed, what lies this share beyond it is not."""


def stopped_by(status: protocol.Status, *names: str) -> None:
    """Require that a Status at rest names one of these faults."""
    numbers = {fault(name).number for name in names}
    words = " or ".join(f"{fault(name).number} ({name})" for name in names)
    require(
        status.fault_number in numbers,
        f"fault {status.fault_number} ({status.reason!r}) in Status: expected {words}",
    )


@check("homes, says pending and then success, and stands at 0", moves=True)
def _homing(host: Dialogue) -> None:
    identity = host.go_home()
    number = host.next_number()
    host.say(protocol.Request(number, "home"))
    reply = host.until(only(protocol.RequestReply, number=number), "RequestReply")
    require(reply.phase != "failure", "home failed at once")
    reply = host.ask("home", number)
    require(reply.phase == "success", f"home ended with {reply.phase} {reply.text!r}")
    status = host.wait_for_rest()
    require(status.state == "homed", f"the axis is {status.state} after homing")
    require(
        abs(status.position_count) <= 2,
        f"it stands at {status.position_count * identity.encoder_resolution:g} m after homing: expected 0",
    )


@check("enables, disables and stops on request, and then is homed", moves=True)
def _enabling(host: Dialogue) -> None:
    host.enable()
    status = host.fresh_status()
    require(
        (status.state, status.activity) == ("enabled", "hold"), f"it is {status.state}, {status.activity}"
    )
    for kind in ("disable", "enable", "stop"):
        host.must(kind)
    status = host.wait_for_rest()
    require(status.state == "homed", f"the axis is {status.state} after a stop")
    require(status.fault_number == 0, f"fault {status.fault_number} after a stop that was asked for")


@check("does a request once, and answers it again", moves=True)
def _repeated_request(host: Dialogue) -> None:
    host.go_home(within=0.02)
    enabling = host.next_number()
    require(host.ask("enable", enabling).phase == "success", "enable failed")
    number = host.next_number()
    host.say(protocol.Request(number, "disable"))
    first = host.ask("disable", number)
    require(host.ask("enable").phase == "success", "enable failed")
    again = host.ask("disable", number)
    require(again == first, f"the answer changed from {first} to {again}")
    require(host.fresh_status().state == "enabled", "a repeated request was done again")
    host.must("disable")
    for _ in range(REMEMBERED - 4):
        host.must("clear_fault")
    require(host.ask("enable", enabling).phase == "success", "a repeated request has another answer")
    require(
        host.fresh_status().state != "enabled",
        f"an enable that was repeated after {REMEMBERED - 1} others enabled the axis again",
    )


@check("answers a request that changes nothing, as often as it is asked")
def _no_fault(host: Dialogue) -> None:
    host.prepare()
    number = host.next_number()
    first = host.ask("clear_fault", number)
    require(first.phase == "success", f"clear_fault without a fault gave {first.phase}")
    for _ in range(3):
        require(host.ask("clear_fault", number) == first, "a repeated request has another answer")


@check("follows set-points, and names the newest", moves=True)
def _setpoints(host: Dialogue) -> None:
    identity = host.enable()
    value = motions.setpoint(identity, host.position())
    begun = host.position()
    for _ in range(10):
        number = host.next_number()
        host.say(protocol.Setpoint(number, value))
        host.listen(0.02)
    status = host.fresh_status()
    require(
        status.setpoint_number == number, f"set-point {status.setpoint_number} in Status, {number} was sent"
    )
    require(
        (status.state, status.activity) == ("enabled", "setpoint"), f"it is {status.state}, {status.activity}"
    )
    way = (host.position() - begun) * np.sign(value)
    require(way > 0, f"the hub moved {way:g} m in the set-point's direction")
    host.must("disable")


@check(
    "refuses and counts set-points beyond the limit, that are no numbers, or come while disabled", moves=True
)
def _refused_setpoints(host: Dialogue) -> None:
    identity = host.go_home(within=0.02)
    gentle = abs(motions.setpoint(identity, host.position()))
    host.obey(motions.with_command_limit(identity, host.limits, gentle))
    host.must("enable")
    refused = host.fresh_status().setpoints_refused
    beyond = gentle * (1 + EDGE)
    for value in (beyond, -beyond, float("nan"), float("inf"), 1e300):
        host.say(protocol.Setpoint(host.next_number(), value))
        status = host.fresh_status()
        refused = (refused + 1) & 0xFFFF
        require(status.setpoints_refused == refused, f"a set-point of {value:g} was not counted as refused")
        require(status.activity == "hold", f"a set-point of {value:g} made the axis {status.activity}")
    within = gentle * (1 - EDGE)
    host.say(protocol.Setpoint(host.next_number(), -within if host.position() > 0.0 else within))
    status = host.fresh_status()
    require(
        (status.setpoints_refused, status.activity) == (refused, "setpoint"),
        f"a set-point of {within:g} was refused: expected it followed up to {gentle:g}",
    )
    host.must("disable")
    host.say(protocol.Setpoint(host.next_number(), 0.0))
    status = host.fresh_status()
    require(status.setpoints_refused == (refused + 1) & 0xFFFF, "a set-point was taken by a disabled axis")


@check("stops when a set-point is not refreshed; a position holds", moves=True)
def _old_setpoint(host: Dialogue) -> None:
    """The same number again is the same set-point: it does not refresh it."""
    identity = host.enable()
    value = motions.setpoint(identity, host.position())
    number = host.next_number()
    host.say(protocol.Setpoint(number, value))
    told_ns = host.clock().reply.received_ns
    for _ in range(round((host.limits.watchdog_ns * 1e-9 + 0.2) / 0.02)):
        host.say(protocol.Setpoint(number, value))
        host.listen(0.02)
    if identity.command_mode == "position":
        require(host.fresh_status().state == "enabled", "a position set-point aged")
        host.must("disable")
        return
    # It has had time enough for its ramp; a little later it would be too old in any case.
    status = host.wait_for_rest(seconds=0.1)
    require(status.state == "homed", f"the axis is {status.state}: expected homed")
    stopped_by(status, "setpoint_old")
    told = told_ns // identity.period_ns
    begun = require_ramp(host, told, status.tick, is_begun=False)
    if begun > told:
        _require_in_time(host, begun * identity.period_ns - told_ns)


@check("counts every silence once, in time, also at rest")
def _silence_at_rest(host: Dialogue) -> None:
    identity = host.prepare()
    for _ in range(2):
        before = host.fresh_status()
        fed_ns = host.clock().reply.received_ns
        host.listen(3e-9 * host.limits.watchdog_ns + 3 * LATE_S, alive=False)
        status = host.newest_status()
        require(
            status.silences == (before.silences + 1) & 0xFFFF,
            f"{status.silences - before.silences} silences counted: expected one",
        )
        _require_in_time(host, status.silence_tick * identity.period_ns - fed_ns)
        require(status.state == before.state, f"silence made a resting axis {status.state}")


def _require_in_time(host: Dialogue, silent_ns: int) -> None:
    watchdog_ns, period_s = host.limits.watchdog_ns, host.period_s()
    require(
        watchdog_ns - 2e9 * period_s <= silent_ns <= watchdog_ns + 1e9 * (LATE_S + 2 * period_s),
        f"the axis acted {silent_ns * 1e-9:.4f} s after the host's last word: expected {watchdog_ns * 1e-9:g} s",
    )


def _fall_silent(host: Dialogue) -> None:
    """Say nothing more until the axis rests, and look at how it got there."""
    identity = host.identity
    before = host.fresh_status()
    fed_ns = host.clock().reply.received_ns
    status = host.wait_for_rest(alive=False, seconds=host.limits.watchdog_ns * 1e-9 + 0.7)
    require(status.silences != before.silences, "the axis rests, but no silence was counted")
    _require_in_time(host, status.silence_tick * identity.period_ns - fed_ns)
    stopped_by(status, "host_silent")
    require_ramp(host, status.silence_tick, status.tick)
    require(status.state != "fault", "silence ends in fault: expected a disabled axis")
    host.listen(0.1)
    after = host.fresh_status()
    require(after.state == status.state, "the axis changed its state when the host was back")
    stopped_by(after, "host_silent")


@check("is disabled by silence while it holds", moves=True)
def _silence_while_holding(host: Dialogue) -> None:
    host.enable()
    _fall_silent(host)
    host.must("enable")
    status = host.fresh_status()
    require(
        (status.fault_number, status.reason) == (0, ""),
        f"fault {status.fault_number} ({status.reason!r}) of an enabled axis: expected the last stop's forgotten",
    )
    host.must("disable")


@check("stops by its ramp on silence while following", moves=True)
def _silence_while_following(host: Dialogue) -> None:
    identity = host.enable()
    value = motions.setpoint(identity, host.position())
    for _ in range(5):
        host.say(protocol.Setpoint(host.next_number(), value))
        host.listen(0.02)
    host.say(protocol.Setpoint(host.next_number(), value))
    fed_ns = host.clock().reply.received_ns
    status = host.wait_for_rest(alive=False, seconds=host.limits.watchdog_ns * 1e-9 + 0.7)
    # The set-point is as old as the host's last word, or older: either may be noticed first.
    stopped_by(status, "host_silent", "setpoint_old")
    require(status.state == "homed", f"the axis is {status.state} after a silence: expected homed")
    period_ns = identity.period_ns
    due = (fed_ns + host.limits.watchdog_ns) // period_ns
    # It can be no faster than its set-points make it in the time that they have.
    fastest = min(motions.SHARE_OF_LIMITS * host.limits.max_speed, host.limits.travel)
    ramp_s = fastest / host.limits.stop_deceleration
    late_s = (status.tick - due) * period_ns * 1e-9
    require(
        late_s <= LATE_S + ramp_s,
        f"it rests {late_s:.4f} s after the watchdog's time: expected {ramp_s:.4f} s",
    )
    require_ramp(host, due - 2, status.tick, is_begun=False)


@check("stops by its ramp on silence in a sequence", moves=True)
def _silence_while_running(host: Dialogue) -> None:
    identity = host.enable()
    watchdog_ticks = round(host.limits.watchdog_ns / identity.period_ns)
    values = motions.bump(identity, 4 * watchdog_ticks, host.position())
    played = play(host, values, until_tick=2 * watchdog_ticks)
    status = host.wait_for_rest(alive=False, seconds=host.limits.watchdog_ns * 1e-9 + 0.7)
    # A small buffer is empty before the watchdog's time has passed.
    stopped_by(status, "host_silent", "underrun")
    require(
        status.sequence_state in ("aborted", "underrun"),
        f"the sequence is {status.sequence_state} after a silence",
    )
    require(status.sequence_reason != "", "it gives no reason why the sequence ended early")
    require(status.state == "homed", f"the axis is {status.state} after a silence: expected homed")
    if status.fault_number == fault("host_silent").number:
        require_ramp(host, status.silence_tick, status.tick)
        require_followed(host, played.start_tick, status.tick)


@check("stops by its ramp on silence while homing", moves=True)
def _silence_while_homing(host: Dialogue) -> None:
    identity = host.enable()
    play(host, motions.shift(identity, round(0.4 / host.period_s()), host.position()))
    host.must("disable")
    slow = replace(host.limits, homing_speed=host.limits.homing_speed / 20)
    host.obey(slow)
    number = host.next_number()
    host.say(protocol.Request(number, "home"))
    host.until(
        only(protocol.Status, activity="homing"),
        "Status while homing",
    )
    _fall_silent(host)
    require(host.newest_status().state == "identified", "an axis is homed although homing was ended early")
    reply = host.ask("home", number)
    require(reply.phase == "failure", f"the request home ended with {reply.phase}: expected failure")


@check("stops and is disabled by a new session", moves=True)
def _hello_stops(host: Dialogue) -> None:
    _stops_on(host, protocol.Hello(), "session_opened")


@check("stops and is disabled by the end of its session", moves=True)
def _goodbye_stops(host: Dialogue) -> None:
    _stops_on(host, protocol.Goodbye(), "session_closed")


def _stops_on(host: Dialogue, word: protocol.Message, name: str) -> None:
    identity = host.enable()
    values = motions.bump(identity, round(1.0 / host.period_s()), host.position())
    play(host, values, until_tick=round(0.5 / host.period_s()))
    host.say(word)
    if isinstance(word, protocol.Goodbye):
        host.listen(0.3, alive=False)
        host.say(protocol.Hello())
    host.until(only(protocol.Identity), "Identity")
    host.until(only(protocol.Status), "Status")
    status = host.wait_for_rest()
    require(status.state == "homed", f"the axis is {status.state}: expected homed")
    stopped_by(status, name)
    require(
        (status.sequence_number, status.sequence_state) == (0, "none"),
        f"sequence {status.sequence_number} of an earlier session is {status.sequence_state}: expected it forgotten",
    )
    reply = host.ask("enable")
    require(reply.phase == "failure", "enable worked although the new session has no limits")
