from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.sequences import (
    CommandGate,
    check_sequence,
    expand_to_ticks,
)
from tests.beam_ros.hub.hub_scenes import UNIX_START as NOW
from tests.beam_ros.hub.hub_scenes import chunks_of, rest_to_rest

ACCELERATION = AxisParameters()
VELOCITY = AxisParameters(command_mode="velocity")
POSITION = AxisParameters(command_mode="position")
EFFORT = AxisParameters(command_mode="effort")


def feed(gate, chunks, now_ns=NOW, state="enabled", position=0.0, speed=0.0):
    for chunk in chunks:
        sequence = gate.add(chunk, now_ns, state, position, speed)
    return sequence, gate.take_reports()


def test_chunks_in_any_order_make_the_whole_sequence():
    values = rest_to_rest(1700)
    chunks = chunks_of(values, NOW + 10**9)
    sequence, reports = feed(CommandGate(ACCELERATION), [chunks[2], chunks[0], chunks[3], chunks[1]])
    assert np.array_equal(sequence.values, values)
    assert sequence.start_ns == NOW + 10**9
    assert [r.state for r in reports] == ["loading"] * 4 + ["ready"]
    assert reports[-1].points == 1700


def test_the_same_chunk_twice_is_harmless_and_a_different_one_is_not():
    chunks = chunks_of(rest_to_rest(1000), NOW + 10**9)
    _, reports = feed(CommandGate(ACCELERATION), [chunks[0], chunks[0], chunks[1]])
    assert reports[-1].state == "ready"
    changed = dataclasses.replace(chunks[0], values=chunks[0].values + 1e-3)
    _, reports = feed(CommandGate(ACCELERATION), [chunks[0], changed])
    assert reports[-1].state == "refused"
    assert "twice" in reports[-1].reason


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"start_ns": 0}, "stamp 0"),
        ({"start_ns": NOW - 300_000_000}, "old"),
        ({"start_ns": NOW + 10**13}, "ahead"),
        ({"start_ns": NOW + 2 * 10**9}, "start_ns"),
        ({"count": 5}, "count"),
        ({"period_ns": 2_000_000}, "period_ns"),
        ({"period_ns": 1_500_000}, "multiple"),
        ({"index": 9}, "1 <= k <= n"),
        ({"first_tick": -1}, "0 or more"),
        ({"first_tick": 501}, "no gap"),
        ({"values": np.zeros(501)}, "1 to 500"),
        ({"values": np.zeros(0)}, "1 to 500"),
        ({"values": np.full(500, np.nan)}, "finite"),
    ],
)
def test_a_chunk_that_does_not_fit_refuses_the_sequence(change, reason):
    chunks = chunks_of(rest_to_rest(1000), NOW + 10**9)
    sequence, reports = feed(CommandGate(ACCELERATION), [chunks[0], dataclasses.replace(chunks[1], **change)])
    assert sequence is None
    assert reports[-1].state == "refused"
    assert reason in reports[-1].reason


def test_the_rest_of_a_refused_sequence_is_ignored_but_a_later_start_is_a_new_try():
    gate = CommandGate(ACCELERATION)
    values = rest_to_rest(1500)
    bad = chunks_of(values, NOW - 10**9)
    _, reports = feed(gate, bad)
    assert [r.state for r in reports] == ["refused"]
    sequence, _ = feed(gate, chunks_of(values, NOW + 10**9))
    assert sequence is not None


def test_an_incomplete_sequence_is_refused_when_its_start_comes():
    gate = CommandGate(ACCELERATION)
    feed(gate, chunks_of(rest_to_rest(1500), NOW + 10**9)[:2])
    gate.expire(NOW + 10**9 - 1)
    assert gate.take_reports() == []
    gate.expire(NOW + 10**9 + 1)
    (report,) = gate.take_reports()
    assert report.state == "refused"
    assert "2 of 3 chunks" in report.reason


def test_a_sequence_completed_too_late_is_refused():
    _, reports = feed(CommandGate(ACCELERATION), chunks_of(rest_to_rest(400), NOW + 50_000_000))
    assert "later start stamp" in reports[-1].reason


@pytest.mark.parametrize("state", ["disconnected", "identified", "homed", "fault"])
def test_nothing_passes_an_axis_that_is_not_enabled(state):
    gate = CommandGate(ACCELERATION)
    outcome = gate.check_setpoint(NOW, 0.1, NOW, state)
    assert not outcome.success
    assert state in outcome.message
    _, reports = feed(gate, chunks_of(rest_to_rest(400), NOW + 10**9), state=state)
    assert reports[-1].state == "refused"


def test_a_second_sequence_is_refused_while_one_is_loaded_and_does_not_harm_it():
    gate = CommandGate(ACCELERATION)
    feed(gate, chunks_of(rest_to_rest(400), NOW + 10**9, "first"))
    _, reports = feed(gate, chunks_of(rest_to_rest(900), NOW + 10**9, "second"))
    assert [(r.sequence_id, r.state) for r in reports] == [("second", "refused")]
    assert gate.sequence_id == "first"


def test_setpoints_are_refused_while_a_sequence_is_loading():
    gate = CommandGate(ACCELERATION)
    feed(gate, chunks_of(rest_to_rest(1500), NOW + 10**9)[:1])
    assert "loaded" in gate.check_setpoint(NOW, 0.1, NOW, "enabled").message
    gate.finish("aborted")
    assert gate.check_setpoint(NOW, 0.1, NOW, "enabled").success


@pytest.mark.parametrize(
    ("stamp_ns", "value", "word"),
    [
        (0, 0.1, "stamp 0"),
        (NOW - 200_000_001, 0.1, "old"),
        (NOW + 200_000_001, 0.1, "ahead"),
        (NOW, 10.1, "within"),
        (NOW, float("nan"), "within"),
        (NOW, float("inf"), "within"),
    ],
)
def test_a_setpoint_with_a_bad_stamp_or_value_is_refused(stamp_ns, value, word):
    outcome = CommandGate(ACCELERATION).check_setpoint(stamp_ns, value, NOW, "enabled")
    assert not outcome.success
    assert word in outcome.message


def test_a_guard_has_the_last_word():
    gate = CommandGate(ACCELERATION, guard=lambda values: f"tip bends {values.max():.1f}")
    _, reports = feed(gate, chunks_of(rest_to_rest(400), NOW + 10**9))
    assert "tip bends" in reports[-1].reason


def _velocity(values):
    return check_sequence(np.asarray(values), VELOCITY, 0.0)


def test_acceleration_sequences_are_checked_by_exact_integration():
    good = rest_to_rest(2000)
    assert check_sequence(good, ACCELERATION, 0.0) is None
    assert "ends with" in check_sequence(good[:1500], ACCELERATION, 0.0)
    assert "acceleration reaches" in check_sequence(good * 40, ACCELERATION, 0.0)
    # The move's own extremum is 0.0136 m or so: from 0.049 m it leaves the travel.
    assert "travel" in check_sequence(good, ACCELERATION, 0.049)
    there_and_back = np.concatenate([np.full(200, 3.0), np.full(400, -3.0), np.full(200, 3.0)])
    assert "speed reaches" in check_sequence(there_and_back, ACCELERATION, 0.0)


def test_travel_is_checked_between_ticks_too():
    # A tick that turns round in its middle: 20 mm from the start at both ends, 30 mm in between.
    slow = AxisParameters(period_ns=100_000_000)
    values = np.array([4.0, -8.0, 4.0])
    assert check_sequence(values, slow, 0.02) is None
    assert "travel" in check_sequence(values, slow, 0.0201)


def test_velocity_sequences_start_from_rest_and_end_at_rest():
    ramp = np.linspace(0, 0.2, 101)
    there = np.concatenate([ramp, ramp[::-1]])
    assert _velocity(np.concatenate([there, -there])) is None
    assert "start from rest" in _velocity([0.05, 0.05, 0.0])
    assert "acceleration" in _velocity([0.0, 0.05, 0.0])
    assert "ends with" in _velocity(ramp)


def test_position_sequences_begin_where_the_hub_is():
    x = 0.01 * (1 - np.cos(2 * np.pi * np.arange(1001) / 1000))
    assert check_sequence(x, POSITION, 0.0) is None
    assert "starts at" in check_sequence(x, POSITION, 1e-4)
    assert "acceleration" in check_sequence(np.array([0.0, 1e-3, 1e-3]), POSITION, 0.0)
    assert "travel" in check_sequence(x + 0.045, POSITION, 0.045)


def test_effort_sequences_stay_within_the_force():
    assert check_sequence(np.array([0.0, 5.0, 0.0]), EFFORT, 0.0) is None
    assert "effort reaches" in check_sequence(np.array([0.0, 25.0]), EFFORT, 0.0)


def test_coarser_samples_are_held_or_joined_as_the_mode_does_it():
    assert expand_to_ticks(np.array([1.0, 2.0]), 3, ACCELERATION).tolist() == [1, 1, 1, 2, 2, 2]
    assert expand_to_ticks(np.array([0.0, 3.0]), 3, POSITION).tolist() == [0, 1, 2, 3]
    sequence, _ = feed(
        CommandGate(ACCELERATION), chunks_of(rest_to_rest(400), NOW + 10**9, period_ns=2_000_000)
    )
    assert len(sequence.values) == 800
