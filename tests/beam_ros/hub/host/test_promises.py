"""What an order promises is compared with what the axis does: one that does not act is a fault, and silence."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from beam_ros.hub.faults import NO_FAULT, fault
from beam_ros.hub.line import protocol
from beam_ros.hub.parameters import AxisParameters
from tests.beam_ros.hub.hub_scenes import LoopbackRig, altered, chunks_of, frozen, only, rest_to_rest

PARAMETERS = AxisParameters()
VELOCITY = dataclasses.replace(PARAMETERS, command_mode="velocity")
STOPS = ("stop", "disable")


class Deaf:
    """A device that ignores stops, and says what it is told to say of them; notes what else it is sent."""

    def __init__(self, rig: LoopbackRig, answer: str = "") -> None:
        self.answer = answer
        self.asked: list[int] = []
        self.heard: list[protocol.Message] = []
        rig.to_device, rig.to_host = altered(self.hear), self.to_host

    def hear(self, message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Request) and message.kind in STOPS:
            self.asked.append(message.number)
            return protocol.Heartbeat()  # what is heard keeps the watchdog from acting
        self.heard.append(message)
        return message

    def to_host(self, data: bytes) -> bytes:
        said = [protocol.RequestReply(number, self.answer, "") for number in self.asked if self.answer]
        self.asked.clear()
        return data + b"".join(map(protocol.encode, said))

    def sent(self, *kinds: type) -> int:
        return sum(isinstance(message, kinds) for message in self.heard)


def playing(seconds: float = 3.0, parameters: AxisParameters = PARAMETERS) -> LoopbackRig:
    """A rig in the middle of a sequence that moves the hub for a long time."""
    rig = LoopbackRig(parameters)
    rig.connect()
    rig.enable()
    for chunk in chunks_of(rest_to_rest(round(1000 * seconds)), rig.now.unix_ns + 300_000_000):
        rig.hub.load(chunk, rig.now)
    rig.run(1.0)
    assert abs(rig.firmware.axis.velocity) > 0.01
    return rig


def creeping(rig: LoopbackRig, speed: float) -> Callable[[bytes], bytes]:
    """A line on which the hub moves as nobody commands, from now on [m/s]."""
    start_ns = rig.steady_ns

    def change(message: protocol.Telemetry) -> protocol.Telemetry:
        way = speed * (rig.steady_ns - start_ns) * 1e-9 / PARAMETERS.encoder_resolution
        counts = message.ticks.position_counts + round(way)
        return protocol.Telemetry(dataclasses.replace(message.ticks, position_counts=counts))

    return only(protocol.Telemetry, change)


def test_a_ramp_that_takes_seconds_is_waited_for():
    rig = LoopbackRig(dataclasses.replace(VELOCITY, stop_deceleration=0.1, travel=1.0))
    rig.connect()
    rig.enable()
    for _ in range(10):
        assert rig.hub.setpoint(rig.now.unix_ns, 0.15, rig.now).success
        rig.run(0.05)
    assert rig.ask("stop").success
    assert rig.hub.poll(rig.now).status.fault is NO_FAULT


@pytest.mark.parametrize("kind", STOPS)
@pytest.mark.parametrize("answer", ["", "success", "pending"])
def test_a_stop_that_the_device_ignores_is_a_fault_a_false_answer_and_silence(kind, answer):
    rig = playing()
    deaf = Deaf(rig, answer)
    ordered_ns, speed = rig.steady_ns, abs(rig.firmware.axis.velocity)
    outcome = rig.ask(kind)
    waited_s = (rig.steady_ns - ordered_ns) * 1e-9
    # The ramp, 0.3 s, and a few batches of 20 ms until it is seen.
    assert waited_s <= speed / PARAMETERS.stop_deceleration + 0.3 + 0.1
    assert not outcome.success
    assert "did not come to rest" in outcome.message
    assert deaf.sent(protocol.Samples, protocol.Setpoint, protocol.Arm) == 0
    # Its watchdog does what it was told: the host is silent, so that the axis stands a watchdog's time later.
    n_heard = len(deaf.heard)
    reports = rig.run(PARAMETERS.watchdog_s + 0.1)
    assert len(deaf.heard) == n_heard
    assert (rig.firmware.axis.state, rig.firmware.axis.velocity) == ("homed", 0.0)
    status = reports[-1].status
    assert (status.state, status.fault.name) == ("fault", "stop_ignored")


@pytest.mark.parametrize("answer", ["", "success", "pending"])
def test_set_points_are_refused_while_the_axis_comes_to_rest_and_none_is_sent(answer):
    rig = LoopbackRig(VELOCITY)
    rig.connect()
    rig.enable()
    for _ in range(10):
        rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now)
        rig.run(0.05)
    deaf = Deaf(rig, answer)
    rig.hub.request("stop")
    outcomes = []
    for _ in range(4):
        outcomes.append(rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now))
        rig.run(0.05)
    assert not any(outcome.success for outcome in outcomes)
    assert "stop" in outcomes[0].message
    assert deaf.sent(protocol.Setpoint) == 0


@pytest.mark.parametrize("kind", STOPS)
def test_a_stop_that_acts_is_answered_when_the_axis_is_seen_at_rest(kind):
    rig = playing()
    outcome = rig.ask(kind)
    assert outcome.success, outcome.message
    assert rig.firmware.axis.velocity == 0.0
    assert rig.run(1.0)[-1].status.state == "homed"
    assert rig.ask("enable").success
    for chunk in chunks_of(rest_to_rest(600), rig.now.unix_ns + 300_000_000, "again"):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda report: any(own.state == "done" for own in report.sequences))


def test_what_a_device_holds_back_from_a_silent_host_is_not_missed():
    """Its telemetry ends a second after the host's last word; the host's own silence takes longer than that."""
    rig = playing(parameters=dataclasses.replace(PARAMETERS, stop_deceleration=0.1, travel=2.0))
    Deaf(rig, "success")
    assert not rig.ask("stop").success
    rig.to_device = rig.to_host = lambda data: data
    assert rig.run(3.0)[-1].status.fault.name == "stop_ignored"
    assert rig.ask("clear_fault").success
    # Its own word on why it stopped in the silence is no news of what is missing.
    assert {report.status.fault.name for report in rig.run(6.0)} <= {"none", "underrun"}


def test_a_stop_that_is_asked_for_again_and_again_gains_no_time():
    rig = playing()
    deaf = Deaf(rig, "success")
    for _ in range(20):
        rig.hub.request("stop")
        rig.run(0.05)
        if rig.reports[-1].status.state == "fault":
            break
    assert rig.reports[-1].status.fault.name == "stop_ignored"
    assert deaf.sent(protocol.Samples) == 0


def test_a_disabled_hub_that_is_pushed_by_hand_may_be_told_to_stop():
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.enable()
    assert rig.ask("disable").success
    rig.to_host = creeping(rig, 0.02)
    rig.run(0.2)
    assert rig.ask("stop").success
    assert rig.run(1.0)[-1].status.state == "homed"


def test_a_stop_waits_for_a_connection_that_takes_long_to_come_up():
    rig = LoopbackRig(PARAMETERS)
    is_held = [True]

    rig.to_host = only(protocol.LimitsReply, lambda message: None if is_held[0] else message)
    rig.run(0.1)
    requested = rig.hub.request("stop")
    reports = rig.run(1.5)
    is_held[0] = False
    reports += rig.run(2.0)
    (outcome,) = [
        outcome for report in reports for number, outcome in report.completed if number == requested
    ]
    assert outcome.success, outcome.message
    assert reports[-1].status.fault.name == "none"


def test_an_axis_at_rest_is_stopped_at_once():
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.enable()
    rig.run(0.3)
    before_ns = rig.steady_ns
    assert rig.ask("stop").success
    assert (rig.steady_ns - before_ns) * 1e-9 < 0.15


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("ticks", [1, 100])
def test_what_was_applied_and_is_no_number_blinds_nothing(value, ticks):
    """One tick is passed over, three in a row are a fault; nothing that is no number is integrated or published."""
    rig = playing()
    reports_before = len(rig.reports)
    left = [ticks]

    def spoil(message: protocol.Telemetry) -> protocol.Telemetry:
        applied = message.ticks.applied.copy()
        applied[: max(left[0], 0)] = value
        left[0] -= len(applied)
        return protocol.Telemetry(dataclasses.replace(message.ticks, applied=applied))

    rig.to_host = only(protocol.Telemetry, spoil)
    rig.run(0.3)
    assert all(
        np.all(np.isfinite(batch.accelerations))
        for report in rig.reports[reports_before:]
        for batch in report.applied
    )
    if ticks > 3:
        assert rig.reports[-1].status.fault.name == "not_finite"
        return
    assert rig.reports[-1].status.state == "enabled"
    # The watch is not blind afterwards: a hub that stands still is seen.
    rig.to_host = only(protocol.Telemetry, frozen())
    rig.run(0.7)
    assert rig.reports[-1].status.fault.name == "motion_unexplained"


class Misses:
    """A device that misses a tick in so many and numbers the others as if it had not."""

    def __init__(self, rig: LoopbackRig, one_in: int) -> None:
        self.one_in, self.n_seen, self.n_missed = one_in, 0, 0
        rig.to_host = altered(self.say)

    def say(self, message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Telemetry):
            ticks, before = message.ticks, self.n_missed
            self.n_seen += len(ticks)
            self.n_missed = self.n_seen // self.one_in
            kept = ticks[self.n_missed - before :]
            return protocol.Telemetry(dataclasses.replace(kept, first_tick=ticks.first_tick - before))
        if isinstance(message, protocol.Status):
            return dataclasses.replace(message, tick=message.tick - self.n_missed)
        return message


@pytest.mark.parametrize("one_in", [100, 500, 5000])
def test_a_device_that_misses_ticks_is_a_fault_before_its_stamps_are_late(one_in):
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.enable()
    rig.run(2.0)
    start_ns, missed = rig.steady_ns, Misses(rig, one_in)
    for _ in range(300):
        if rig.run(0.1)[-1].status.state == "fault":
            break
    status = rig.reports[-1].status
    assert status.fault.name == "clock_jumped"
    assert "ticks" in status.reason
    # A millisecond is missing after so many ticks; three windows of a second until it is believed.
    assert (rig.steady_ns - start_ns) * 1e-9 < 2e-3 * one_in + 3.5
    assert missed.n_missed < 3 + 3500 / one_in


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
@pytest.mark.parametrize("speed", [0.002, -0.005, 0.02])
def test_a_held_hub_that_creeps_is_seen_when_it_has_left_its_place(speed, mode):
    rig = LoopbackRig(dataclasses.replace(PARAMETERS, command_mode=mode))
    rig.connect()
    rig.enable()
    rig.run(0.2)
    start_ns = rig.steady_ns
    rig.to_host = creeping(rig, speed)
    rig.until(lambda report: report.status.state == "fault")
    assert rig.reports[-1].status.fault.name == "motion_unexplained"
    crept = abs(speed) * (rig.steady_ns - start_ns) * 1e-9
    assert crept < PARAMETERS.max_following_error + 0.06 * abs(speed) + 1e-4


@pytest.mark.parametrize("name", ["end_switch", "encoder_lost", "following_error"])
def test_a_fault_of_the_device_that_loses_home_asks_for_it_whatever_the_device_believes(name):
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.enable()
    assert rig.ask("disable").success

    def says(number: int) -> Callable[[bytes], bytes]:
        return only(protocol.Status, lambda message: dataclasses.replace(message, fault_number=number))

    rig.to_host = says(fault(name).number)
    rig.run(0.2)
    rig.to_host = says(0)  # cleared, and the device believes that it knows where it is
    rig.run(0.2)
    outcome = rig.ask("enable")
    assert not outcome.success
    assert "home it first" in outcome.message
    for kind in ("home", "enable"):
        assert rig.ask(kind).success
