from __future__ import annotations

import dataclasses
import time
import tracemalloc

import numpy as np
import pytest

from beam_ros.hub.contract import SequenceChunk
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.parameters import AxisParameters
from beam_ros.rig.rig import Rig
from tests.beam_ros.hub.hub_scenes import UNIX_START as NOW
from tests.beam_ros.hub.hub_scenes import chunks_of, rest_to_rest

ACCELERATION = AxisParameters()


def gate_at_once(parameters=ACCELERATION, guard=None):
    return CommandGate(parameters, guard, in_background=False)


def feed(gate, chunks, now_ns=NOW, state="enabled", position=0.0, speed=0.0):
    for chunk in chunks:
        gate.add(chunk, now_ns, state, position, speed)
    sequence = gate.poll(now_ns, state, position, speed)
    return sequence, gate.take_reports()


def test_chunks_in_any_order_make_the_whole_sequence():
    values = rest_to_rest(1700)
    chunks = chunks_of(values, NOW + 10**9)
    sequence, reports = feed(gate_at_once(), [chunks[2], chunks[0], chunks[3], chunks[1]])
    assert np.array_equal(sequence.values, values)
    assert sequence.start_ns == NOW + 10**9
    assert [r.state for r in reports] == ["loading"] * 4 + ["ready"]
    assert reports[-1].points == 1700


def test_the_same_chunk_twice_is_harmless_and_a_different_one_is_not():
    chunks = chunks_of(rest_to_rest(1000), NOW + 10**9)
    _, reports = feed(gate_at_once(), [chunks[0], chunks[0], chunks[1]])
    assert reports[-1].state == "ready"
    changed = dataclasses.replace(chunks[0], values=chunks[0].values + 1e-3)
    _, reports = feed(gate_at_once(), [chunks[0], changed])
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
    sequence, reports = feed(gate_at_once(), [chunks[0], dataclasses.replace(chunks[1], **change)])
    assert sequence is None
    assert reports[-1].state == "refused"
    assert reason in reports[-1].reason


def test_the_rest_of_a_refused_sequence_is_ignored_but_a_later_start_is_a_new_try():
    gate = gate_at_once()
    values = rest_to_rest(1500)
    bad = chunks_of(values, NOW - 10**9)
    _, reports = feed(gate, bad)
    assert [r.state for r in reports] == ["refused"]
    sequence, _ = feed(gate, chunks_of(values, NOW + 10**9))
    assert sequence is not None


def test_an_incomplete_sequence_is_refused_when_its_start_comes():
    gate = gate_at_once()
    feed(gate, chunks_of(rest_to_rest(1500), NOW + 10**9)[:2])
    gate.poll(NOW + 10**9 - 1, "enabled", 0.0, 0.0)
    assert gate.take_reports() == []
    gate.poll(NOW + 10**9 + 1, "enabled", 0.0, 0.0)
    (report,) = gate.take_reports()
    assert report.state == "refused"
    assert "2 of 3 chunks" in report.reason


def test_a_sequence_completed_too_late_is_refused():
    _, reports = feed(gate_at_once(), chunks_of(rest_to_rest(400), NOW + 50_000_000))
    assert "later start stamp" in reports[-1].reason


def last_report(gate, chunks, now_ns=NOW, **condition):
    return feed(gate, chunks, now_ns, **condition)[1][-1]


def test_what_is_refused_for_its_time_alone_is_said_to_be_late():
    """Made anew with a later start it may be taken; nothing else may."""
    values = rest_to_rest(1000)
    in_time = chunks_of(values, NOW + 10**9)
    old = chunks_of(values, NOW - 300_000_000)
    assert last_report(gate_at_once(), old).is_late
    assert last_report(gate_at_once(), chunks_of(values, NOW + 50_000_000)).is_late
    incomplete = gate_at_once()
    feed(incomplete, in_time[:1])
    assert last_report(incomplete, [], NOW + 10**9 + 1).is_late
    unchecked = CommandGate(ACCELERATION, in_background=True)
    feed(unchecked, in_time[:1])
    unchecked.add(in_time[1], NOW, "enabled", 0.0, 0.0)
    assert last_report(unchecked, [], NOW + 10**9 - 40_000_000).is_late

    assert not last_report(gate_at_once(), in_time).is_late
    assert not last_report(gate_at_once(), chunks_of(values, NOW + 10**13)).is_late
    assert not last_report(gate_at_once(), chunks_of(values, 0)).is_late
    assert not last_report(gate_at_once(), in_time, state="homed").is_late
    assert not last_report(gate_at_once(), in_time, speed=0.1).is_late
    faulty = [dataclasses.replace(chunk, fault="of another mode") for chunk in old]
    assert not last_report(gate_at_once(), faulty).is_late


@pytest.mark.parametrize("state", ["disconnected", "identified", "homed", "fault"])
def test_nothing_passes_an_axis_that_is_not_enabled(state):
    gate = gate_at_once()
    outcome = gate.check_setpoint(NOW, 0.1, NOW, state, 0.0, 0.0)
    assert not outcome.success
    assert state in outcome.message
    _, reports = feed(gate, chunks_of(rest_to_rest(400), NOW + 10**9), state=state)
    assert reports[-1].state == "refused"


def test_a_second_sequence_is_refused_while_one_is_loaded_and_does_not_harm_it():
    gate = gate_at_once()
    feed(gate, chunks_of(rest_to_rest(400), NOW + 10**9, "first"))
    _, reports = feed(gate, chunks_of(rest_to_rest(900), NOW + 10**9, "second"))
    assert [(r.sequence_id, r.state) for r in reports] == [("second", "refused")]
    assert gate.sequence_id == "first"


def test_setpoints_are_refused_while_a_sequence_is_loading():
    gate = gate_at_once()
    feed(gate, chunks_of(rest_to_rest(1500), NOW + 10**9)[:1])
    assert "loaded" in gate.check_setpoint(NOW, 0.1, NOW, "enabled", 0.0, 0.0).message
    gate.finish("aborted")
    assert gate.check_setpoint(NOW, 0.1, NOW, "enabled", 0.0, 0.0).success


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
    outcome = gate_at_once().check_setpoint(stamp_ns, value, NOW, "enabled", 0.0, 0.0)
    assert not outcome.success
    assert word in outcome.message


def test_a_sequence_that_would_bend_the_beam_too_far_is_refused_and_another_is_not():
    """4.4 Hz at 2.5 m/s^2, near the first resonance: 169 mm at the tip by linear theory."""
    t = np.arange(8000) * 1e-3
    values = 2.5 * np.sin(2 * np.pi * 4.4 * t) * np.sin(np.pi * t / 8.0) ** 2
    values -= np.hanning(8000) * values.sum() / np.hanning(8000).sum()
    guard = Rig.from_file().beam_guard()
    for scale, state in ((1.0, "refused"), (0.1, "ready")):
        _, reports = feed(gate_at_once(guard=guard), chunks_of(scale * values, NOW + 10**9))
        assert reports[-1].state == state, reports[-1].reason
        assert scale < 1.0 or "predicted tip deflection" in reports[-1].reason


@pytest.mark.slow
def test_a_sequence_is_checked_in_a_thread_and_set_points_wait_meanwhile():
    values = np.zeros(1_800_000)
    values[:2000] = rest_to_rest(2000)
    gate = CommandGate(ACCELERATION, Rig.from_file().beam_guard())
    begun = time.monotonic()
    for chunk in chunks_of(values, NOW + 300 * 10**9):
        gate.add(chunk, NOW, "enabled", 0.0, 0.0)
    # Whoever hands the last chunk over does not wait for its check.
    assert gate.take_reports()[-1].state == "loading"
    assert "loaded" in gate.check_setpoint(NOW, 0.1, NOW, "enabled", 0.0, 0.0).message
    while (sequence := gate.poll(NOW, "enabled", 0.0, 0.0)) is None:
        assert time.monotonic() - begun < 60.0, gate.take_reports()
        time.sleep(0.01)
    assert gate.take_reports()[-1].state == "ready"
    assert np.array_equal(sequence.values, values)


def test_a_start_that_passes_during_the_check_refuses_the_sequence():
    gate = CommandGate(ACCELERATION, Rig.from_file().beam_guard())
    for chunk in chunks_of(np.zeros(1_800_000), NOW + 10**9):
        gate.add(chunk, NOW, "enabled", 0.0, 0.0)
    assert gate.poll(NOW + 10**9, "enabled", 0.0, 0.0) is None
    (report,) = [r for r in gate.take_reports() if r.state != "loading"]
    assert report.state == "refused"
    assert "could not be checked before its start" in report.reason
    assert "start stamp" in report.reason
    assert gate.sequence_id is None


def test_a_hub_that_moved_during_the_check_refuses_the_sequence():
    gate = gate_at_once()
    for chunk in chunks_of(rest_to_rest(400), NOW + 10**9):
        gate.add(chunk, NOW, "enabled", 0.0, 0.0)
    assert gate.poll(NOW, "enabled", 1e-3, 0.0) is None
    assert "moved by 0.001 m" in gate.take_reports()[-1].reason


@pytest.mark.parametrize("sequence_id", ["move", ""])
def test_a_malformed_chunk_refuses_its_sequence_at_once_and_frees_the_gate(sequence_id):
    gate = gate_at_once()
    chunks = chunks_of(rest_to_rest(1500), NOW + 10**9)
    broken = SequenceChunk(sequence_id, 0, 0, 0, 0, 0, np.zeros(0), fault="points without values")
    _, reports = feed(gate, [chunks[0], broken])
    assert [(r.sequence_id, r.state, r.reason) for r in reports[1:]] == [
        ("move", "refused", "points without values")
    ]
    assert gate.sequence_id is None
    assert gate.check_setpoint(NOW, 0.1, NOW, "enabled", 0.0, 0.0).success


def test_a_malformed_chunk_of_another_sequence_does_not_harm_the_one_that_is_loading():
    gate = gate_at_once()
    chunks = chunks_of(rest_to_rest(1000), NOW + 10**9)
    broken = SequenceChunk("other", 0, 0, 0, 0, 0, np.zeros(0), fault="points without values")
    _, reports = feed(gate, [chunks[0], broken, chunks[1]])
    assert [(r.sequence_id, r.state) for r in reports] == [
        ("move", "loading"),
        ("other", "refused"),
        ("move", "loading"),
        ("move", "ready"),
    ]


def test_what_would_be_too_long_is_refused_before_it_is_expanded():
    """500 points 100 s apart are 5e7 ticks, 400 MB before anything of them is checked."""
    tracemalloc.start()
    chunk = chunks_of(np.zeros(500), NOW + 10**9, period_ns=100_000_000_000)[0]
    _, reports = feed(gate_at_once(), [chunk])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert reports[-1].state == "refused"
    assert "at most 3600000 ticks" in reports[-1].reason
    assert "cut it" in reports[-1].reason
    assert peak < 1e6
