"""Sequences: applied to the last bit, refused where they must be, and stopped where they fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import Check, require
from beam_ros.hub.conformance.dialogue import Dialogue
from beam_ros.hub.conformance.motion_checks import require_ramp, stopped_by
from beam_ros.hub.conformance.playing import AHEAD_S, arm, play, start_in
from beam_ros.hub.line import protocol
from beam_ros.hub.ticks import TickBatch


def _ticks(host: Dialogue, seconds: float) -> int:
    return max(round(seconds / host.period_s()), 40)


def _require_applied(host: Dialogue, values: FloatArray, start_tick: int) -> None:
    """Require that the samples are what was applied, bit for bit, from the tick of the start on."""
    identity = host.identity
    assert identity is not None
    n = len(values)
    applied = host.ticks(start_tick, n).applied
    # In position mode a tick begins where the hub is, and leads to the sample after its own.
    first, end = (1, n - 1) if identity.command_mode == "position" else (0, n)
    wrong = np.flatnonzero(applied[first:end] != values[first:end])
    if len(wrong):
        k = int(wrong[0]) + first
        require(
            False,
            f"{len(wrong)} of {end - first} samples were not applied as they were sent: sample {k} is "
            f"{applied[k]!r}, expected {values[k]!r}",
        )


def _sequence(host: Dialogue) -> None:
    identity = host.enable()
    values = motions.bump(identity, _ticks(host, 0.5), host.position())
    played = play(host, values)
    status = host.fresh_status()
    require(status.sequence_state == "done", f"the sequence is {status.sequence_state}: expected done")
    require(status.received == len(values), f"{status.received} samples received, {len(values)} were sent")
    require(
        (status.state, status.activity) == ("enabled", "hold"), f"it is {status.state}, {status.activity}"
    )
    _require_applied(host, values, played.start_tick)
    host.must("disable")


def _overlap_and_gap(host: Dialogue) -> None:
    identity = host.enable()
    values = motions.bump(identity, 80, host.position())
    start_tick = start_in(host, AHEAD_S)
    number = host.next_number()
    require(arm(host, len(values), start_tick, number).is_accepted, "a sequence was refused")
    other = np.zeros(30)
    host.say(protocol.Samples(number, 0, values[:30]))
    host.say(protocol.Samples(number, 40, other))
    require(host.fresh_status().received == 30, "samples beyond a gap were taken")
    host.say(protocol.Samples(number, 0, other[:10]))
    host.say(protocol.Samples((number + 1) & 0xFFFF, 30, other))
    host.say(protocol.Samples(number, 20, np.concatenate([other[:10], values[30:60]])))
    require(host.fresh_status().received == 60, "samples that overlap and go on were not taken")
    host.say(protocol.Samples(number, 60, values[60:]))
    host.listen(AHEAD_S + len(values) * host.period_s() + 0.05)
    require(host.fresh_status().sequence_state == "done", f"it is {host.newest_status().sequence_state}")
    _require_applied(host, values, start_tick)
    host.must("disable")


def _room(host: Dialogue) -> None:
    """A host that counts wrongly must not break the buffer."""
    identity = host.enable()
    n = min(identity.buffer_samples, 0xFFFF) + 150
    values = motions.bump(identity, n, host.position())
    start_tick = start_in(host, 2 * AHEAD_S)
    number = host.next_number()
    require(arm(host, n, start_tick, number).is_accepted, "a sequence was refused")
    for first in range(0, n, protocol.MAX_SAMPLES):
        host.say(protocol.Samples(number, first, values[first : first + protocol.MAX_SAMPLES]))
    status = host.fresh_status()
    require(
        status.received + status.free <= identity.buffer_samples and status.received <= n,
        f"{status.received} samples received and room for {status.free}: expected {identity.buffer_samples} in all",
    )
    host.must("stop")


def _underrun(host: Dialogue) -> None:
    identity = host.enable()
    values = motions.bump(identity, _ticks(host, 0.4), host.position())
    start_tick = start_in(host, AHEAD_S)
    number = host.next_number()
    require(arm(host, len(values), start_tick, number).is_accepted, "a sequence was refused")
    there = min(len(values) // 2, identity.buffer_samples)
    for first in range(0, there, protocol.MAX_SAMPLES):
        host.say(protocol.Samples(number, first, values[first : min(first + protocol.MAX_SAMPLES, there)]))
    status = host.wait_for_rest()
    require(
        status.sequence_state == "underrun", f"the sequence is {status.sequence_state}: expected underrun"
    )
    require(status.state == "homed", f"the axis is {status.state} after an underrun: expected homed")
    stopped_by(status, "underrun")
    _require_applied(host, values[:there], start_tick)
    require_ramp(host, start_tick + there, status.tick)


def _refused_sequences(host: Dialogue) -> None:
    host.prepare()
    require(not arm(host, 100).is_accepted, "a sequence was accepted by a disabled axis")
    host.must("enable")
    require(not arm(host, 100, 1).is_accepted, "a sequence was accepted whose start has passed")
    require(not arm(host, 1).is_accepted, "a sequence of one sample was accepted")
    number = host.next_number()
    start_tick = start_in(host, 1.0)
    first = arm(host, 100, start_tick, number)
    require(first.is_accepted, f"a sequence was refused: {first.text!r}")
    require(arm(host, 100, start_tick, number) == first, "a repeated Arm has another answer")
    other = arm(host, 100)
    require(not other.is_accepted and other.text != "", "a sequence was accepted while another is loaded")
    refused = host.fresh_status().setpoints_refused
    host.say(protocol.Setpoint(host.next_number(), 0.0))
    require(
        host.fresh_status().setpoints_refused == (refused + 1) & 0xFFFF,
        "a set-point was taken while a sequence is loaded",
    )
    host.must("disable")
    require(host.fresh_status().sequence_state == "aborted", f"it is {host.newest_status().sequence_state}")


def _breach(
    host: Dialogue,
    spoil: Callable[[protocol.Identity, FloatArray], None],
    limits: protocol.DeviceLimits,
    *names: str,
) -> TickBatch:
    """Play a sequence that the device must stop, and return its ticks; then only clear_fault leads out of fault."""
    identity = host.prepare()
    if abs(host.position()) > 0.02 * host.limits.travel:
        host.must("home")
    host.set_limits(limits)
    host.must("enable")
    values = motions.bump(identity, _ticks(host, 0.2), host.position())
    spoil(identity, values)
    start_tick = start_in(host, AHEAD_S)
    number = host.next_number()
    require(arm(host, len(values), start_tick, number).is_accepted, "a sequence was refused")
    there = min(len(values), identity.buffer_samples)
    for first in range(0, there, protocol.MAX_SAMPLES):
        host.say(protocol.Samples(number, first, values[first : min(first + protocol.MAX_SAMPLES, there)]))
    status = host.wait_for_rest()
    require(status.state == "fault", f"the axis is {status.state}: expected fault")
    stopped_by(status, *names)
    require(status.sequence_state == "aborted", f"the sequence is {status.sequence_state}: expected aborted")
    require(status.reason != "", "it gives no reason for its fault")
    for kind in ("enable", "home"):
        require(host.ask(kind).phase == "failure", f"{kind} worked in fault")
    host.must("clear_fault")
    status = host.wait_for_rest()
    require(status.state == "homed", f"the axis is {status.state} after clear_fault: expected homed")
    require(status.fault_number == 0, f"fault {status.fault_number} after clear_fault: expected 0")
    return host.ticks(start_tick, status.tick - start_tick)


def _not_finite(host: Dialogue) -> None:
    def spoil(_identity: protocol.Identity, values: FloatArray) -> None:
        values[len(values) // 2] = np.nan

    host.open_session()
    _breach(host, spoil, host.limits, "command_not_finite")


def _beyond_limit(host: Dialogue) -> None:
    identity = host.open_session()
    # Narrow limits: a device that ignores them does no more than it can.
    narrow = replace(
        host.limits,
        max_speed=host.limits.max_speed * 0.6,
        max_acceleration=host.limits.max_acceleration * 0.6,
        max_effort=host.limits.max_effort * 0.6,
    )
    mode = identity.command_mode

    def spoil(_identity: protocol.Identity, values: FloatArray) -> None:
        k = len(values) // 2
        if mode == "position":
            values[k:] += 0.01 * host.limits.travel
        else:
            values[k] = 0.7 * motions.command_limit(_identity, host.limits)

    names = {
        "acceleration": ("acceleration_limit",),
        "velocity": ("speed_limit", "acceleration_limit"),
        "position": ("speed_limit", "acceleration_limit"),
        "effort": ("effort_limit",),
    }[mode]
    _breach(host, spoil, narrow, *names)


def _beyond_travel(host: Dialogue) -> None:
    """The travel is narrowed to a tenth for this: a device that ignores it comes to no end."""
    identity = host.open_session()
    travel = 0.1 * host.limits.travel
    limits = replace(host.limits, travel=travel)

    def spoil(_identity: protocol.Identity, values: FloatArray) -> None:
        ramp = np.arange(1, len(values) + 1) / len(values)
        if identity.command_mode == "position":
            values[:] = values[0] + 0.1 * host.limits.travel * (ramp**2)
        elif identity.command_mode == "velocity":
            values[:] = 0.1 * host.limits.travel / (len(values) * host.period_s()) * 2 * ramp
        elif identity.command_mode == "acceleration":
            values[:] = 0.2 * host.limits.travel / (len(values) * host.period_s()) ** 2
        else:
            values[:] = 0.2 * host.limits.max_effort

    ticks = _breach(host, spoil, limits, "travel_limit")
    farthest = float(np.abs(ticks.position_counts).max()) * identity.encoder_resolution
    # One tick at the greatest speed passes before a free hub is braked.
    slack = 0.01 * travel + host.limits.max_speed * host.period_s() * (identity.command_mode == "effort")
    require(
        farthest <= travel / 2 + slack,
        f"the hub was {farthest:.6f} m from home: expected at most {travel / 2:.6f} m",
    )


CHECKS = (
    Check("sequence", "applies a sequence bit for bit, from its tick on", _sequence, moves=True),
    Check("overlap_and_gap", "drops what overlaps, and frames after a gap", _overlap_and_gap, moves=True),
    Check("room", "takes no more samples than it has room for", _room, moves=True),
    Check("underrun", "stops by its ramp when a sample is missing", _underrun, moves=True),
    Check(
        "refused_sequences",
        "refuses sequences while disabled, too late, too short, or beside another one",
        _refused_sequences,
        moves=True,
    ),
    Check("not_finite", "ends in fault where a sample is not a number", _not_finite, moves=True),
    Check("beyond_limit", "ends in fault where a sample is beyond a limit", _beyond_limit, moves=True),
    Check("beyond_travel", "stops within its travel, in fault", _beyond_travel, moves=True),
)
