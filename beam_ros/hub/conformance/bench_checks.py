"""Accidents of the axis: checks that need one that is not there, whose sensors can be interfered with."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from beam_ros.hub.conformance import motions
from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import Bench, Dialogue
from beam_ros.hub.conformance.kinematics import motion, require_ramp
from beam_ros.hub.conformance.limit_checks import require_way_home
from beam_ros.hub.conformance.motion_checks import stopped_by
from beam_ros.hub.conformance.playing import Played, play

_CRUISE_S = 0.3
_TOLD_S = 0.05
"""How soon an axis stops on what its sensors read: the tick, and the batch that its Status may wait for [s]."""


def _held(**signals: bool) -> Callable[[Bench], None]:
    return lambda bench: bench.hold_signals(**signals)


def _leaping(offset: float) -> Callable[[Bench], None]:
    return lambda bench: bench.lie(offset, 1.0)


@dataclass(frozen=True)
class _Stopped:
    """The ticks at which a motion began, and at which its stop ramp did."""

    start_tick: int
    ramp_tick: int


@contextlib.contextmanager
def _bench(host: Dialogue) -> Iterator[Bench]:
    """Give the axis into somebody's hands, who leaves it whole."""
    try:
        yield host.bench
    finally:
        host.bench.hold_signals()
        host.bench.lie(0.0, 1.0)
        host.bench.stick(is_stuck=False)


def _move(host: Dialogue, side: int, seconds: float = _CRUISE_S) -> Played:
    """Enable the axis at home, and let it move at a steady speed towards +x (1) or -x (-1)."""
    identity = host.enable(within=0.0)
    values = motions.cruise(identity, seconds, host.position())
    if host.position() > 0.0:
        values = -values
    return play(host, side * values, until_tick=round(2 * motions.RISE_S / host.period_s()))


def _accident(host: Dialogue, name: str, happen: Callable[[Bench], None], *, side: int = 1) -> _Stopped:
    """Let something happen to a moving axis: it must stop by its ramp, name the fault, and ask for home."""
    with _bench(host) as bench:
        played = _move(host, side)
        before = host.fresh_status().tick
        happen(bench)
        status = host.wait_for_rest(seconds=_TOLD_S + host.limits.max_speed / host.limits.stop_deceleration)
        stopped_by(status, name)
        require(
            status.sequence_state == "aborted", f"the sequence is {status.sequence_state}: expected aborted"
        )
        ramp_tick = require_ramp(host, before, status.tick, is_begun=False)
    host.listen(_TOLD_S)
    if host.fresh_status().state == "fault":
        host.must("clear_fault")
    reply = host.ask("enable")
    require(
        reply.phase == "failure" and reply.text != "",
        f"enable gave {reply.phase} after {name}: expected a refusal until the axis has been homed",
    )
    host.must("home")
    host.must("enable")
    host.must("disable")
    return _Stopped(played.start_tick, ramp_tick)


@check("stops on either end switch, not off it, and asks for home", moves=True, needs_bench=True)
def _end_switches(host: Dialogue) -> None:
    for side, signal, other in (
        (-1, "is_at_low_end", "is_at_high_end"),
        (1, "is_at_high_end", "is_at_low_end"),
    ):
        _accident(host, "end_switch", _held(**{signal: True}), side=side)
        with _bench(host) as bench:
            # Off a switch, the hub may go.
            _move(host, side)
            bench.hold_signals(**{other: True})
            host.listen(0.05)
            status = host.fresh_status()
            require(status.activity == "sequence", f"it is {status.activity} on its way off an end switch")
            host.must("disable")


@check("stops on an alarm of the drive, and asks for home", moves=True, needs_bench=True)
def _drive_alarm(host: Dialogue) -> None:
    _accident(host, "drive_alarm", _held(has_drive_alarm=True))
    with _bench(host) as bench:
        bench.hold_signals(has_drive_alarm=True)
        host.listen(0.05)
        for kind in ("enable", "home"):
            require(host.ask(kind).phase == "failure", f"{kind} worked under an alarm of the drive")


@check("stops when the encoder is lost or leaps, and asks for home", moves=True, needs_bench=True)
def _encoder_lost(host: Dialogue) -> None:
    identity = host.open_session()
    _accident(host, "encoder_lost", _held(is_counter_valid=False))
    # A way that no hub can go within a tick.
    leap = 10 * identity.widest.max_speed * host.period_s()
    for offset in (leap, -leap):
        _accident(host, "encoder_lost", _leaping(offset))


@check("stops when the hub does not follow, and asks for home", moves=True, needs_bench=True)
def _following_error(host: Dialogue) -> None:
    identity = host.open_session()
    if identity.command_mode == "effort":
        return  # Under a force a hub has no reference to follow.
    for side in (-1, 1):
        begun = _accident(host, "following_error", lambda bench: bench.stick(is_stuck=True), side=side)
        allowed = host.bench.max_following_error
        ticks = host.ticks(begun.start_tick, begun.ramp_tick - begun.start_tick)
        moved = motion(host, begun.start_tick, begun.ramp_tick, rests_at="first")
        path = moved.way(host.period_s(), is_ramped=identity.command_mode == "acceleration")
        stuck = (ticks.position_counts[-1] - ticks.position_counts[0]) * identity.encoder_resolution
        error = abs(float(path[-1]) - stuck)
        # The way of the tick in which it is passed, and of the one in which the ramp begins.
        most = allowed + 2 * float(np.abs(moved.speeds).max()) * host.period_s()
        least = allowed - identity.encoder_resolution
        require(
            least <= error <= most, f"it stopped {error:.6f} m off: expected {allowed:.6f} to {most:.6f} m"
        )


@check("stops where its drive makes no steps in time, and asks for home", moves=True, needs_bench=True)
def _steps_lost(host: Dialogue) -> None:
    _accident(host, "following_error", _held(has_lost_steps=True))


@check("ends a search for home after the travel, and is not homed", moves=True, needs_bench=True)
def _home_switch_dead(host: Dialogue) -> None:
    """The travel is narrowed: the search must end after it, and be undone by nothing but a home that is found."""
    for is_below in (True, False):
        host.go_home(within=0.0)
        travel = 0.1 * host.limits.travel
        host.obey(replace(host.limits, travel=travel))
        with _bench(host) as bench:
            bench.hold_signals(is_below_home=is_below)
            host.listen(0.05)
            begun = bench.true_position
            reply = host.ask("home")
            require(
                reply.phase == "failure", f"home ended with {reply.phase} though its switch never changed"
            )
            status = host.wait_for_rest()
            stopped_by(status, "homing_failed")
            way = (bench.true_position - begun) * (1 if is_below else -1)
            ramp = host.limits.homing_speed**2 / (2 * host.limits.stop_deceleration)
            # The ramp begins up to two ticks after the way has been gone.
            most = travel + ramp + 2 * host.limits.homing_speed * host.period_s()
            require(travel <= way <= most, f"it searched {way:.6f} m: expected {travel:.6f} to {most:.6f} m")
        require(host.ask("enable").phase == "failure", "enable worked although home was not found")
        host.obey(host.limits)
        host.listen(_TOLD_S)
        host.must("home")


@check("finds the same home from either side", moves=True, needs_bench=True)
def _home_from_both_sides(host: Dialogue) -> None:
    identity = host.open_session()
    for side in (-1, 1):
        _move(host, side, seconds=0.2)
        host.must("disable")
        require_way_home(host)
        off = host.bench.true_position / identity.encoder_resolution
        require(
            abs(off) <= 2,
            f"homed from {'+x' if side > 0 else '-x'}, the hub stands {off:.1f} counts beside home",
        )


@check("tells position and speed of the tick that it names", moves=True, needs_bench=True)
def _sensed(host: Dialogue) -> None:
    """Position and speed belong to their ticks: a hub that has no lag is where its reference is."""
    identity = host.enable(within=0.0)
    period = host.period_s()
    speed = min(motions.CRUISE_RATE * host.limits.travel, motions.SHARE_OF_LIMITS * host.limits.max_speed)
    rise = motions.trapezoid(period, speed, speed / motions.RISE_S, 0.03)
    values = motions.led(identity, np.concatenate([rise, -rise[::-1]]), host.position())
    played = play(host, values)
    ticks = host.ticks(played.start_tick - 1, len(values) + 2)
    counts = ticks.position_counts
    # Where the acceleration is steady, the speed at a tick is the mean of those around it. Every count is wrong by
    # up to a half: a speed by 1/2, the mean of two ways by 1/2, and three differences of positions by 4.
    is_steady = np.abs(np.diff(counts, n=3)) <= 4
    is_steady = is_steady[:-1] & is_steady[1:]
    errors = np.abs(ticks.velocity_counts[2:-2] - (counts[3:-1] - counts[1:-3]) / 2)[is_steady]
    require(
        errors.max() <= 2,
        f"a speed in Telemetry is {errors.max():.1f} counts off the positions around its tick: expected at most 2",
    )
    if identity.command_mode != "effort":
        moved = motion(host, played.start_tick, played.start_tick + len(values), rests_at="first")
        path = (
            moved.way(period, is_ramped=identity.command_mode == "acceleration") / identity.encoder_resolution
        )
        off = float(np.abs(counts[1:] - counts[1] - path).max())
        require(
            off <= 2,
            f"a position in Telemetry is {off:.1f} counts off its tick's reference: expected at most 2",
        )
    host.must("disable")
