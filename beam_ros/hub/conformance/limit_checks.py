"""What the axis keeps by itself: the stop ramp, the speed and acceleration of its moves, and its limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import ANSWER_S, Dialogue, only
from beam_ros.hub.conformance.kinematics import (
    SLACK,
    profile_motion,
    require_followed,
    require_profile,
    require_ramp,
)
from beam_ros.hub.conformance.motion_checks import EDGE, stopped_by
from beam_ros.hub.conformance.playing import Played, begin, play, send
from beam_ros.hub.host.motion_watch import NOISE_COUNTS
from beam_ros.hub.line import protocol
from beam_ros.hub.ticks import TickBatch

_CRUISE_S = 0.3
"""How long a motion that is to be stopped goes on where it is not [s]."""


# The stop ramp --------------------------------------------------------------------------------------------


def cruise(host: Dialogue) -> Played:
    """Enable the axis, and let it move at a steady speed."""
    identity = host.enable(within=0.06)
    values = motions.cruise(identity, _CRUISE_S, host.position())
    return play(host, values, until_tick=round(1.2 * motions.RISE_S / host.period_s()))


@check("keeps the stop ramp's deceleration to rest, when it is asked to", moves=True)
def _stop_ramp(host: Dialogue) -> None:
    for kind in ("stop", "disable"):
        played = cruise(host)
        before = host.newest_status().tick
        host.must(kind)
        status = host.wait_for_rest()
        require_ramp(host, before, status.tick, is_begun=False)
        require_followed(host, played.start_tick, status.tick)


@check("keeps the ramp of the limits that a session had, when it ends or another begins", moves=True)
def _session_ramp(host: Dialogue) -> None:
    """The limits are forgotten with the session; a ramp that runs keeps those that it began with."""
    for words in ((protocol.Hello(),), (protocol.Goodbye(), protocol.Hello())):
        cruise(host)
        mark = host.mark()
        host.say(*words)
        host.until(only(protocol.Identity), "Identity", since=mark)
        seen = [k for k, m in enumerate(host.since(mark)) if isinstance(m, protocol.Identity)][-1]
        begun = host.until(only(protocol.Status), "Status after Identity", since=mark + seen).tick
        status = host.wait_for_rest(seconds=2 * ANSWER_S, since=mark + seen)
        require_ramp(host, begun, status.tick)


# Moves ----------------------------------------------------------------------------------------------------


def _speed_within(way: float, speed: float, acceleration: float) -> float:
    """Return the speed that a move over this way reaches and keeps for a half of it, or a lower one."""
    return min(speed, math.sqrt(0.5 * way * acceleration))


@check("homes with the speed and the acceleration that it was handed", moves=True)
def _way_home(host: Dialogue) -> None:
    identity = host.enable(within=0.0)
    play(host, motions.shift(identity, round(0.4 / host.period_s()), host.position()))
    host.must("disable")
    require_way_home(host)


def require_way_home(host: Dialogue) -> None:
    """Home a disabled axis from where it is, and require the speed and the acceleration that were asked for."""
    acceleration = host.limits.homing_acceleration
    speed = _speed_within(abs(host.position()), host.limits.homing_speed, acceleration)
    host.obey(replace(host.limits, homing_speed=speed))
    first = host.fresh_status().tick
    host.must("home")
    # The zero is set where the hub rests: the last ticks may belong to another one.
    last = host.wait_for_rest().tick - 3
    require_profile(profile_motion(host, first, last, acceleration), speed, acceleration, "it homed")


@check("moves to set-points as its mode and its limits say", moves=True)
def _moves(host: Dialogue) -> None:
    identity = host.go_home(within=0.0)
    mode = identity.command_mode
    value = motions.setpoint(identity, host.position())
    speed, acceleration = abs(value), abs(value)
    limits = host.limits
    if mode == "position":
        acceleration = limits.move_acceleration
        speed = _speed_within(abs(value), limits.move_speed, acceleration)
        limits = replace(limits, move_speed=speed)
    elif mode == "velocity":
        acceleration = speed / motions.RISE_S
        limits = motions.narrowed(limits, max_acceleration=acceleration)
    host.obey(limits)
    host.must("enable")
    begun = host.fresh_status()
    # A move gets to its speed in v/a, and over its way in as much again and way/v.
    seconds = 2 * speed / acceleration + abs(value) / speed if mode == "position" else 2 * motions.RISE_S
    for _ in range(math.ceil(seconds / 0.02)):
        host.say(protocol.Setpoint(host.next_number(), value))
        host.listen(0.02)
    last = host.fresh_status().tick
    applied = host.ticks(begun.tick, last - begun.tick).applied
    if mode in ("acceleration", "effort"):
        require(
            set(applied) <= {0.0, value},
            f"{applied.min():g} to {applied.max():g} applied: expected {value:g}",
        )
        require(applied[-1] == value, f"{applied[-1]:g} applied: expected the set-point {value:g}")
    else:
        moved = profile_motion(host, begun.tick, last, acceleration)
        require_profile(moved, speed, acceleration, "it moved to a set-point")
    if mode == "position":
        off = host.fresh_status().position_count - value / identity.encoder_resolution
        require(abs(off) <= NOISE_COUNTS, f"it holds {off:g} counts beside its position set-point")
        require_followed(host, begun.tick, last)
    host.must("disable")


# Limits ---------------------------------------------------------------------------------------------------


_Samples = Callable[[float], FloatArray]
"""The samples of a sequence that begins at rest at a position [m]."""


def _load(host: Dialogue, samples: _Samples, limits: protocol.DeviceLimits) -> tuple[int, int]:
    """Send an axis with these limits a whole sequence near home; return the tick of its start, and its length."""
    identity = host.go_home(within=0.02)
    host.obey(limits)
    host.must("enable")
    values = samples(host.position())
    played = begin(host, len(values))
    send(host, played.number, values[: identity.buffer_samples])
    return played.start_tick, len(values)


def breach(
    host: Dialogue, samples: _Samples, limits: protocol.DeviceLimits, *names: str, clear: bool = True
) -> TickBatch:
    """Play a sequence that the device must end in fault, and return its ticks; ``clear``: leave the fault again."""
    start_tick, _ = _load(host, samples, limits)
    status = host.wait_for_rest()
    require(status.state == "fault", f"the axis is {status.state}: expected fault")
    stopped_by(status, *names)
    require(status.sequence_state == "aborted", f"the sequence is {status.sequence_state}: expected aborted")
    require(status.reason != "", "it gives no reason for its fault")
    require_ramp(host, start_tick, status.tick, is_begun=False)
    if clear:
        host.must("clear_fault")
        cleared = host.fresh_status()
        require(cleared.state == "homed", f"the axis is {cleared.state} after clear_fault: expected homed")
        require(cleared.fault_number == 0, f"fault {cleared.fault_number} after clear_fault: expected 0")
    return host.ticks(start_tick, status.tick - start_tick)


def _allow(host: Dialogue, samples: _Samples, limits: protocol.DeviceLimits, what: str) -> None:
    """Play a sequence that the device must follow to its end."""
    start_tick, n_samples = _load(host, samples, limits)
    host.ticks(start_tick, n_samples + 2)
    status = host.fresh_status()
    require(
        status.sequence_state == "done",
        f"a sequence within {what} is {status.sequence_state} ({status.sequence_reason!r}): expected done",
    )
    host.must("disable")


def broken_cruise(identity: protocol.Identity, value: float) -> _Samples:
    """Return a motion at a steady speed in which one sample is this value."""

    def samples(position: float) -> FloatArray:
        values = motions.cruise(identity, _CRUISE_S, position)
        values[round(1.5e9 * motions.RISE_S / identity.period_ns)] = value
        return values

    return samples


@check("ends in fault where a sample is not a number", moves=True)
def _not_finite(host: Dialogue) -> None:
    identity = host.open_session()
    for value in (math.nan, math.inf):
        breach(host, broken_cruise(identity, value), host.limits, "command_not_finite")


@check("follows commands up to its limits, and ends in fault beyond them", moves=True)
def _limit_edges(host: Dialogue) -> None:
    identity = host.go_home(within=0.02)
    if identity.command_mode == "effort":
        _effort_edges(host)
        return
    # Narrow limits: a device that ignores them does no more than it can.
    period, limits = host.period_s(), host.limits
    speed = min(motions.CRUISE_RATE * limits.travel, motions.SHARE_OF_LIMITS * limits.max_speed)
    acceleration = speed / motions.RISE_S
    rise = motions.trapezoid(period, speed, 0.5 * acceleration, 0.03)
    spike = np.zeros(60)
    spike[20], spike[40] = acceleration, -acceleration
    cases: tuple[tuple[str, FloatArray, protocol.DeviceLimits, str], ...] = (
        (
            "speed_limit",
            np.concatenate([rise, -rise[::-1]]),
            motions.narrowed(limits, max_speed=speed),
            "the speed limit",
        ),
        (
            "acceleration_limit",
            spike,
            motions.narrowed(limits, max_acceleration=acceleration),
            "the acceleration limit",
        ),
    )
    for name, motion, narrow, what in cases:
        for share in (1 - EDGE, 1 + EDGE):
            samples = partial(motions.led, identity, share * motion)
            if share < 1:
                _allow(host, samples, narrow, what)
            else:
                breach(host, samples, narrow, name)


def _effort_edges(host: Dialogue) -> None:
    """The mass is not known: the force is gentle, and the greatest speed is a tenth of a travel a second."""
    identity, limits = host.identity, host.limits
    spike = np.zeros(60)
    spike[20], spike[40] = 1.0, -1.0
    force = motions.led(identity, spike, 0.0)
    narrow = motions.narrowed(limits, max_effort=float(np.abs(force).max()))
    _allow(host, lambda _: (1 - EDGE) * force, narrow, "the effort limit")
    breach(host, lambda _: (1 + EDGE) * force, narrow, "effort_limit")
    speed = 0.1 * limits.travel
    pushed = np.ones(round(1.0 / host.period_s()))
    ticks = breach(
        host, partial(motions.led, identity, pushed), motions.narrowed(limits, max_speed=speed), "speed_limit"
    )
    step = identity.encoder_resolution / host.period_s()
    speeds = np.abs(np.diff(ticks.position_counts)) * step
    gained = float(np.abs(np.diff(speeds)).max())
    fastest = float(speeds.max())
    # A force shows its effect a tick later, and the encoder tells a speed of two ticks' difference.
    require(
        abs(fastest - speed) <= 2 * gained + 2 * step,
        f"a force drove the hub up to {fastest:.6g} m/s: expected {speed:.6g} +- {2 * (gained + step):.2g}",
    )


@check("uses its travel, and stops within it, in fault", moves=True)
def _beyond_travel(host: Dialogue) -> None:
    """The travel is narrowed to a tenth for this: a device that ignores it comes to no end."""
    identity = host.go_home(within=0.0)
    period = host.period_s()
    limits = replace(host.limits, travel=0.1 * host.limits.travel)
    half, braking = limits.travel / 2, limits.stop_deceleration
    speed = min(motions.CRUISE_RATE * host.limits.travel, motions.SHARE_OF_LIMITS * limits.max_speed)
    rise = motions.trapezoid(period, speed, speed / motions.RISE_S, 0.0)
    if identity.command_mode != "effort":
        # Right up to the edge, and back: its last braking is hardly less than the ramp's.
        fall = -motions.trapezoid(period, speed, 0.9 * braking, 0.0)
        way = speed * (len(rise) + len(fall)) / 2 * period
        kept = np.zeros(int((0.98 * half - way) / (speed * period)))
        there = np.concatenate([rise, kept, fall])
        _allow(host, partial(motions.led, identity, np.concatenate([there, -there])), limits, "the travel")
    host.go_home(within=0.0)
    kept = np.zeros(round(2 * half / (speed * period)))
    pushed = rise if identity.command_mode != "effort" else np.ones(len(kept))
    ticks = breach(
        host, partial(motions.led, identity, np.concatenate([pushed, kept])), limits, "travel_limit"
    )
    counts = np.abs(ticks.position_counts)
    farthest = float(counts.max()) * identity.encoder_resolution
    # What would leave no way to stop is refused a tick ahead; a force shows its effect a tick later.
    fastest = float(np.abs(np.diff(ticks.position_counts)).max()) * identity.encoder_resolution
    rounding = braking * period**2 + SLACK * half
    require(
        farthest <= half + rounding + 2 * fastest * (identity.command_mode == "effort"),
        f"the hub was {farthest:.6f} m from home: expected at most {half:.6f} m",
    )
    require(
        farthest >= half - rounding - 2 * fastest,
        f"the hub was stopped {farthest:.6f} m from home: expected it to use its {half:.6f} m to either side",
    )
