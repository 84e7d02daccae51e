"""Sequences: applied to the last bit, refused where they must be, and stopped where they fail."""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import Dialogue
from beam_ros.hub.conformance.kinematics import require_followed, require_ramp
from beam_ros.hub.conformance.motion_checks import stopped_by
from beam_ros.hub.conformance.playing import AHEAD_S, arm, begin, play, send, start_in
from beam_ros.hub.line import protocol


def _ticks(host: Dialogue, seconds: float) -> int:
    return max(round(seconds / host.period_s()), 40)


def _require_applied(host: Dialogue, values: FloatArray, start_tick: int) -> None:
    """Require that the samples are what was applied, bit for bit, from the tick of the start on."""
    identity = host.identity
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


@check("applies a sequence bit for bit, from its tick on", moves=True)
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


@check("sends a Status at a change, without waiting for a batch", moves=True)
def _changes(host: Dialogue) -> None:
    """A sequence begins in the middle of a batch: its Status does not wait for the batch."""
    identity = host.enable()
    values = motions.bump(identity, 80, host.position())
    mark = host.mark()
    host.listen(0.1)
    batch = next(m.ticks for m in host.since(mark) if isinstance(m, protocol.Telemetry))
    soon = start_in(host, AHEAD_S) - batch.first_tick
    start_tick = batch.first_tick + soon // len(batch) * len(batch) + len(batch) // 2
    host.say(protocol.Samples(begin(host, len(values), start_tick).number, 0, values))
    mark = host.mark()
    host.ticks(start_tick, len(batch))
    for message in host.since(mark):
        if isinstance(message, protocol.Status) and message.sequence_state == "running":
            break
        require(
            not isinstance(message, protocol.Telemetry)
            or start_tick >= message.ticks.first_tick + len(message.ticks),
            f"Telemetry of tick {start_tick} came before the Status that a sequence begins with it",
        )
    host.must("disable")


@check("drops what overlaps, and frames after a gap", moves=True)
def _overlap_and_gap(host: Dialogue) -> None:
    identity = host.enable()
    values = motions.bump(identity, 80, host.position())
    played = begin(host, len(values), is_on_tick=True)
    number, start_tick = played.number, played.start_tick
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


@check("takes no more samples than it has room for", moves=True)
def _room(host: Dialogue) -> None:
    """A host that counts wrongly must not break the buffer."""
    identity = host.enable()
    n = min(identity.buffer_samples, 0xFFFF) + 150
    values = motions.bump(identity, n, host.position())
    send(host, begin(host, n, start_in(host, 2 * AHEAD_S)).number, values)
    status = host.fresh_status()
    require(
        status.received + status.free <= identity.buffer_samples and status.received <= n,
        f"{status.received} samples received and room for {status.free}: expected {identity.buffer_samples} in all",
    )
    host.must("stop")


@check("stops by its ramp when a sample is missing", moves=True)
def _underrun(host: Dialogue) -> None:
    identity = host.enable()
    values = motions.cruise(identity, 1.0, host.position())
    played = begin(host, len(values))
    start_tick = played.start_tick
    there = min(round(2 * motions.RISE_S / host.period_s()), identity.buffer_samples)
    send(host, played.number, values[:there])
    status = host.wait_for_rest()
    require(
        status.sequence_state == "underrun", f"the sequence is {status.sequence_state}: expected underrun"
    )
    require(status.state == "homed", f"the axis is {status.state} after an underrun: expected homed")
    stopped_by(status, "underrun")
    _require_applied(host, values[:there], start_tick)
    # In position mode a tick leads to the sample after its own.
    require_ramp(host, start_tick + there - (identity.command_mode == "position"), status.tick)
    require_followed(host, start_tick, status.tick)


@check(
    "refuses sequences while disabled, too late, too short, while the hub moves, or beside another one",
    moves=True,
)
def _refused_sequences(host: Dialogue) -> None:
    identity = host.go_home(within=0.02)
    require(not arm(host, 100).is_accepted, "a sequence was accepted by a disabled axis")
    host.must("enable")
    require(not arm(host, 100, 1).is_accepted, "a sequence was accepted whose start has passed")
    require(not arm(host, 1).is_accepted, "a sequence of one sample was accepted")
    for _ in range(5):
        host.say(protocol.Setpoint(host.next_number(), motions.setpoint(identity, host.position())))
        host.listen(0.02)
    require(not arm(host, 100).is_accepted, "a sequence was accepted while the hub moves")
    host.must("disable")
    host.must("enable")
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
