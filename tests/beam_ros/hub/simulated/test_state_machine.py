"""The virtual axis does what the table says: every pair of condition and cause is brought about."""

from __future__ import annotations

import dataclasses

import pytest

from beam_ros.hub.contract import REQUEST_KINDS, Outcome
from beam_ros.hub.faults import NO_FAULT, fault
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.hub.simulated.transitions import (
    ARMED,
    CONDITIONS,
    FAULT,
    FAULTING,
    FOLLOWING,
    HOLDING,
    HOMED,
    HOMING,
    HOMING_STOPS,
    IDENTIFIED,
    RUNNING,
    STOPPING,
    TRANSITION_OF,
    Cause,
    Condition,
)

TICK = 1_000_000
HOME, LATER = 1, 99
COMMANDS: tuple[Cause, ...] = (*REQUEST_KINDS, "set-point", "arm", "emergency stop")


def run(axis: VirtualAxis, ticks: int, *, is_fed: bool = True) -> None:
    for _ in range(ticks):
        if is_fed:
            axis.feed()
        axis.advance(axis.device_ns + TICK)


def until(axis: VirtualAxis, condition: Condition) -> None:
    for _ in range(3000):
        if axis.condition is condition:
            return
        run(axis, 1)
    raise AssertionError(f"{axis.condition.name} instead of {condition.name}")


class Noticed(Exception):
    """Ends a tick right after a transition, before the next one follows in the same tick."""


def run_to_first_cause(axis: VirtualAxis, monkeypatch: pytest.MonkeyPatch, *, is_fed: bool) -> Cause:
    """Run until the device notices something, and return what."""
    react = axis._machine.react

    def react_and_end(cause: Cause, *arguments: object, **options: object) -> None:
        react(cause, *arguments, **options)
        raise Noticed(cause)

    monkeypatch.setattr(axis._machine, "react", react_and_end)
    with pytest.raises(Noticed) as noticed:
        run(axis, 3000, is_fed=is_fed)
    return noticed.value.args[0]


def play(axis: VirtualAxis, values: list[float], announced: int = 0) -> None:
    assert axis.arm(axis.device_ns, announced or len(values)).success
    assert axis.append(0, values).success


def axis_in(condition: Condition) -> VirtualAxis:
    """Bring an axis into a condition by what a host can do."""
    axis = VirtualAxis(AxisParameters(), RigidPlant(0.8, 1e-3), SimulatedDevice(initial_position=0.02))
    if condition in (HOMING, HOMING_STOPS) or condition.state != "identified":
        axis.request(HOME, "home")
        run(axis, 50)
    if condition is HOMING_STOPS:
        axis.request(2, "stop")
    if condition.state != "identified":
        until(axis, HOMED)
    if condition.state in ("enabled", "fault"):
        axis.request(3, "enable")
    if condition is FOLLOWING:
        assert axis.setpoint(0.0).success
    elif condition is ARMED:
        assert axis.arm(axis.device_ns + 500 * TICK, 100).success
    elif condition is RUNNING:
        play(axis, [0.1] * 400, announced=500)
        run(axis, 10)
    elif condition is STOPPING:
        assert axis.setpoint(1.0).success
        run(axis, 50)
        axis.request(4, "stop")
    elif condition in (FAULTING, FAULT):
        assert axis.setpoint(10.0).success
        until(axis, condition)
    axis.take_events()
    axis.take_completed()
    assert axis.condition is condition
    return axis


def bring_about(axis: VirtualAxis, cause: Cause) -> Outcome:
    """Command an axis, with nothing that the device itself would object to."""
    if cause == "set-point":
        return axis.setpoint(0.1)
    if cause == "arm":
        return axis.arm(axis.device_ns + 50 * TICK, 10)
    if cause == "emergency stop":
        axis.emergency_stop(fault("session_closed"), "someone pulled the plug")
    else:
        axis.request(LATER, cause)
    completed = dict(axis.take_completed())
    if HOME in completed:
        assert not completed[HOME].success
        assert "homing failed" in TRANSITION_OF[HOMING, cause].effects
    return completed.get(LATER, Outcome(True, ""))


@pytest.mark.parametrize("cause", COMMANDS)
@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda condition: condition.name)
def test_every_command_does_in_every_condition_what_the_table_says(
    condition: Condition, cause: Cause
) -> None:
    axis = axis_in(condition)
    row = TRANSITION_OF[condition, cause]
    reason = axis.reason
    answer = row.answer.format(condition=condition, state=condition.state, reason=reason)
    assert bring_about(axis, cause) == Outcome(not row.is_refused, answer)
    goal = row.goal or condition
    assert axis.condition is goal
    kinds = [effect.replace(" ", "_") for effect in row.effects if effect.startswith("sequence")]
    kinds += ["state"] if goal.state != condition.state else []
    assert [event.kind for event in axis.take_events()] == kinds
    if "reason kept" in row.effects:
        assert axis.reason == "someone pulled the plug"
        assert axis.fault is fault("session_closed")
    else:
        assert axis.reason == ("" if "reason cleared" in row.effects else reason)
    # Whatever was asked for, the axis stands enabled in a second only if it was, or if it was asked to be.
    run(axis, 1000)
    if axis.state == "enabled":
        assert condition.state == "enabled" or cause == "enable"
    if "answered at rest" in row.effects:
        word = {"stop": "stopped", "disable": "disabled"}[cause]
        assert (LATER, Outcome(True, word)) in axis.take_completed()


def _limit(axis: VirtualAxis) -> None:
    if axis.condition is FOLLOWING:
        axis.setpoint(10.0)
    else:
        axis.append(400, [20.0] * 100)


def _brake_slowly(axis: VirtualAxis) -> None:
    axis.obey(dataclasses.replace(axis.parameters, stop_deceleration=0.01))


NOTICED = {
    # What the device notices by itself: how a host that feeds it, or does not, lets it happen.
    (ARMED, "start"): lambda axis: None,
    (RUNNING, "end"): lambda axis: axis.append(400, [0.0] * 100),
    (RUNNING, "underrun"): lambda axis: None,
    (RUNNING, "limit"): _limit,
    (FOLLOWING, "limit"): _limit,
    (FOLLOWING, "old set-point"): lambda axis: None,
    (HOMING, "home reached"): lambda axis: None,
    (HOMING_STOPS, "rest"): lambda axis: None,
    (STOPPING, "rest"): lambda axis: None,
    (FAULTING, "rest"): lambda axis: None,
    **{
        (condition, "silence"): _brake_slowly if condition.activity == "stopping" else lambda axis: None
        for condition in CONDITIONS
    },
}


FAULT_OF = {"silence": "host_silent", "old set-point": "setpoint_old", "underrun": "underrun"}


def test_what_the_device_notices_is_all_here() -> None:
    assert set(NOTICED) == {(origin, cause) for origin, cause in TRANSITION_OF if cause not in COMMANDS}


@pytest.mark.parametrize("pair", NOTICED, ids=lambda pair: f"{pair[0].name}: {pair[1]}")
def test_what_the_device_notices_leads_where_the_table_says(
    pair: tuple[Condition, Cause], monkeypatch: pytest.MonkeyPatch
) -> None:
    condition, cause = pair
    axis = axis_in(condition)
    row = TRANSITION_OF[pair]
    NOTICED[pair](axis)
    assert run_to_first_cause(axis, monkeypatch, is_fed=cause != "silence") == cause
    goal = row.goal or condition
    assert axis.condition is goal
    kinds = [effect.replace(" ", "_") for effect in row.effects if effect.startswith("sequence")]
    kinds += ["state"] if goal.state != condition.state else []
    assert [event.kind for event in axis.take_events()] == kinds
    if "reason kept" in row.effects:
        assert axis.fault.name == FAULT_OF.get(cause, axis.fault.name)
        assert axis.fault is not NO_FAULT
        word = {"silence": "watchdog", "old set-point": "set-point not refreshed"}.get(cause, cause)
        assert axis.reason.startswith(word)
    if "zero set" in row.effects:
        assert axis.position == axis.true_position == 0.0
    answers = {"homing failed": (HOME, False), "homing answered": (HOME, True)}
    wanted = {answers[effect] for effect in row.effects if effect in answers}
    assert {
        (number, outcome.success) for number, outcome in axis.take_completed() if number == HOME
    } == wanted


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda condition: condition.name)
@pytest.mark.parametrize("is_fed", [True, False])
def test_left_alone_no_axis_becomes_enabled(condition: Condition, is_fed: bool) -> None:
    axis = axis_in(condition)
    for _ in range(60):
        was_enabled = axis.state == "enabled"
        run(axis, 50, is_fed=is_fed)
        assert was_enabled or axis.state != "enabled"
    if not is_fed:
        assert axis.state != "enabled"
        assert axis.velocity == 0.0


@pytest.mark.parametrize(
    ("start_ns", "n_samples", "word"), [(-5 * TICK, 10, "its start was 0.005 s ago"), (0, 1, "1 samples")]
)
def test_a_sequence_that_the_device_objects_to_changes_nothing(
    start_ns: int, n_samples: int, word: str
) -> None:
    axis = axis_in(HOLDING)
    outcome = axis.arm(axis.device_ns + start_ns, n_samples)
    assert not outcome.success
    assert word in outcome.message
    assert axis.condition is HOLDING


def test_a_power_on_axis_is_identified() -> None:
    assert axis_in(IDENTIFIED).condition is IDENTIFIED
