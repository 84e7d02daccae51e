"""Opening and closing sessions, and the limits that a session has."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import SAME, Dialogue, only
from beam_ros.hub.contract import RequestKind
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import encode_frame
from beam_ros.hub.parameters import MAX_BATCH_TICKS


@check("answers Hello with Identity, then Status")
def _handshake(host: Dialogue) -> None:
    identity = host.open_session()
    status = host.newest_status()
    require(
        status.boot_id == identity.boot_id,
        f"boot id {status.boot_id} in Status, {identity.boot_id} in Identity",
    )


@check("names a tick, batches, room and widest limits that an axis can have")
def _identity(host: Dialogue) -> None:
    identity = host.open_session()
    numbers = {"period": identity.period_ns, "encoder resolution": identity.encoder_resolution}
    for name, value in {**numbers, **vars(identity.widest)}.items():
        require(math.isfinite(value) and value > 0, f"{name} is {value}: expected a positive number")
    ticks, room = identity.batch_ticks, identity.buffer_samples
    require(1 <= ticks <= MAX_BATCH_TICKS, f"{ticks} ticks in a batch: expected 1 to {MAX_BATCH_TICKS}")
    require(room >= 1, f"room for {room} samples: expected some")


@check("says version 0 to a host of other versions, and begins no session")
def _versions(host: Dialogue) -> None:
    host.open_session()
    host.say(protocol.Hello(protocol.VERSION + 5, protocol.VERSION + 7))
    other = host.until(_identity_of(0), "Identity with version 0 for a host of other versions")
    require(
        other.lowest_version <= protocol.VERSION <= other.highest_version,
        f"it speaks {other.lowest_version} to {other.highest_version}: expected {protocol.VERSION} among them",
    )
    host.listen(0.15, alive=False)
    host.say(protocol.ClockQuery(1))
    came = host.listen(0.2, alive=False)
    require(
        not any(isinstance(m, protocol.ClockReply) for m in came),
        "it answers a ClockQuery although there is no common version",
    )
    host.say(protocol.Hello(1, protocol.VERSION + 7))
    host.until(_identity_of(protocol.VERSION), "Identity for a host of versions below and above")


def _identity_of(version: int) -> Callable[[protocol.Message], protocol.Identity | None]:
    return only(protocol.Identity, version=version)


@check("ignores what a later version adds to Hello")
def _longer_hello(host: Dialogue) -> None:
    host.say_bytes(encode_frame(protocol.encode_payload(protocol.Hello()) + b"more of a later version"))
    host.until(_identity_of(protocol.VERSION), "Identity for a longer Hello", alive=False)


@check("is silent without a session, and answers frames with Identity, every 0.1 s at most")
def _no_session(host: Dialogue) -> None:
    host.open_session()
    host.say(protocol.Goodbye())
    host.listen(0.3, alive=False)
    came = host.listen(0.5, alive=False)
    require(not came, f"it sends {type(came[0]).__name__ if came else ''} by itself without a session")
    host.say(protocol.ClockQuery(1))
    host.until(_identity_of(protocol.VERSION), "Identity for a frame without a session", alive=False)
    seen = 0
    for _ in range(20):
        host.say(protocol.Heartbeat())
        came = host.listen(0.02, alive=False)
        seen += sum(isinstance(m, protocol.Identity) for m in came)
        others = [m for m in came if not isinstance(m, protocol.Identity)]
        require(not others, f"it sends {type(others[0]).__name__ if others else ''} without a session")
    require(1 <= seen <= 6, f"{seen} Identity in 0.4 s of frames: expected one every 0.1 s at most")


@check("forgets set-points, requests, sequences and silences at Hello, and keeps its boot id")
def _new_session(host: Dialogue) -> None:
    host.prepare()
    host.say(protocol.Setpoint(host.next_number(), 0.0))
    number = host.next_number()
    require(host.ask("clear_fault", number).phase == "success", "clear_fault without a fault failed")
    boot_id = host.newest_status().boot_id
    host.open_session()
    status = host.newest_status()
    require(status.boot_id == boot_id, "Hello changed the boot id: expected it to change at a start only")
    require(status.setpoint_number == 0, f"set-point number {status.setpoint_number}: expected it forgotten")
    require(status.sequence_number == 0, f"sequence number {status.sequence_number}: expected it forgotten")
    require(status.silences == 0, f"{status.silences} silences: expected those of this session")
    require(status.silence_tick == 0, f"tick {status.silence_tick} of the last silence: expected 0 for none")
    # Without limits it must fail; the answer of the earlier session was a success.
    require(host.ask("enable", number).phase == "failure", "a request of an earlier session was remembered")


@check("refuses enable and home before SetLimits, and answers zeros")
def _no_limits(host: Dialogue) -> None:
    host.open_session()
    host.wait_for_rest()
    kinds: tuple[RequestKind, ...] = ("enable", "home")
    for kind in kinds:
        reply = host.ask(kind)
        require(reply.phase == "failure" and reply.text != "", f"{kind} gave {reply.phase} {reply.text!r}")
    answer = host.set_limits(dataclasses.replace(host.limits, travel=math.nan))
    require(
        answer == protocol.DeviceLimits(),
        f"LimitsReply {answer}: expected zeros where there are no limits yet",
    )


@check("obeys the limits that it is handed")
def _limits(host: Dialogue) -> None:
    host.open_session()
    host.wait_for_rest()
    for share in (1.0, 0.5):
        host.obey(_scaled(host.limits, share))


@check("obeys its own limits where wider ones are asked for")
def _wide_limits(host: Dialogue) -> None:
    identity = host.open_session()
    host.wait_for_rest()
    _require_same(host.set_limits(_scaled(identity.widest, 10.0)), identity.widest)


def _scaled(limits: protocol.DeviceLimits, share: float) -> protocol.DeviceLimits:
    numbers = {name: value * share for name, value in vars(limits).items()}
    # The watchdog keeps its time where it gets shorter: a device may need two batches.
    watchdog_ns = min(max(int(limits.watchdog_ns * share), limits.watchdog_ns), 0xFFFFFFFF)
    return protocol.DeviceLimits(**{**numbers, "watchdog_ns": watchdog_ns})


def _require_same(answer: protocol.DeviceLimits, wanted: protocol.DeviceLimits) -> None:
    for name, value in vars(wanted).items():
        obeyed = getattr(answer, name)
        require(abs(obeyed - value) <= SAME * value, f"{name} {obeyed:g} in LimitsReply: expected {value:g}")


@check("changes nothing for limits that are not finite or not positive")
def _impossible_limits(host: Dialogue) -> None:
    host.open_session()
    host.wait_for_rest()
    in_force = host.set_limits(host.limits)
    for name in vars(host.limits):
        bad = (0,) if name == "watchdog_ns" else (math.nan, math.inf, -math.inf, 0.0, -1.0)
        for value in bad:
            answer = host.set_limits(protocol.DeviceLimits(**{**vars(host.limits), name: value}))
            require(answer == in_force, f"{name} = {value} changed the limits: expected them as they were")


@check("changes no limits while it is enabled or moves", moves=True)
def _limits_while_enabled(host: Dialogue) -> None:
    host.enable()
    in_force = host.set_limits(_scaled(host.limits, 0.5))
    _require_same(in_force, host.limits)
    require(host.fresh_status().state == "enabled", "SetLimits disabled the axis")
    host.must("disable")
    mark, number = host.mark(), host.next_number()
    host.say(
        protocol.Request(host.next_number(), "home"), protocol.SetLimits(number, _scaled(host.limits, 0.5))
    )
    reply = host.until(
        only(protocol.LimitsReply, number=number),
        "LimitsReply",
        since=mark,
    )
    _require_same(reply.limits, host.limits)
    host.must("stop")
    host.obey(_scaled(host.limits, 0.5))
