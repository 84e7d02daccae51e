from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.contract import HostTime, SequenceChunk
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from tests.beam_ros.hub.hub_scenes import STEADY_START, UNIX_START, SimulatedRig, chunks_of, rest_to_rest


def states(reports):
    return [s.state for r in reports for s in r.sequences]


def test_batches_have_twenty_ticks_and_strictly_increasing_stamps_without_gaps():
    rig = SimulatedRig(
        AxisParameters(), device=SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=987_654_321_000)
    )
    rng = np.random.default_rng(1)
    for _ in range(200):
        rig.run(float(rng.uniform(0.001, 0.03)), step_ns=10**9)
    measured = [b for r in rig.reports for b in r.measured]
    applied = [b for r in rig.reports for b in r.applied]
    assert {len(b) for b in measured} == {20}
    stamps = np.array([b.stamp_ns for b in measured])
    assert [b.stamp_ns for b in applied] == stamps.tolist()
    # 20 ms of a clock that runs 35 ppm fast last 20 ms - 0.7 us.
    assert np.all(np.abs(np.diff(stamps) - (20_000_000 - 700)) <= 1)
    assert abs(stamps[0] - UNIX_START) <= 1_000_000


def test_a_sequence_runs_at_its_start_stamp_and_is_reported_all_the_way():
    rig = SimulatedRig(
        AxisParameters(), device=SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=5_000_000_123)
    )
    rig.enable()
    values = rest_to_rest(1200)
    start_ns = rig.now.unix_ns + 300_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    assert not rig.hub.setpoint(rig.now.unix_ns, 0.0, rig.now).success
    reports = rig.run(2.0)
    assert states(reports) == ["loading", "loading", "loading", "ready", "running", "done"]
    batches = [b for r in reports for b in r.applied]
    stamps = np.concatenate([b.stamp_ns + np.arange(20) * 1_000_000 for b in batches])
    applied = np.concatenate([b.accelerations for b in batches])
    first = np.flatnonzero(applied == values[1])[0] - 1
    assert np.array_equal(applied[first : first + 1200], values)
    assert 0 <= stamps[first] - start_ns < 1_001_000
    assert reports[-1].status.state == "enabled"
    assert rig.hub.setpoint(rig.now.unix_ns, 0.0, rig.now).success


def test_stop_aborts_a_running_sequence_and_unloads_it():
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    for chunk in chunks_of(rest_to_rest(1200), rig.now.unix_ns + 200_000_000):
        rig.hub.load(chunk, rig.now)
    rig.run(0.6)
    request_id = rig.hub.request("stop")
    reports = rig.run(0.1)
    assert states(reports) == ["aborted"]
    assert any(i == request_id and o.success for r in reports for i, o in r.completed)
    assert reports[-1].status.state == "homed"


def test_stop_before_the_start_unloads_the_sequence():
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    for chunk in chunks_of(rest_to_rest(500), rig.now.unix_ns + 500_000_000):
        rig.hub.load(chunk, rig.now)
    rig.run(0.1)
    rig.hub.request("stop")
    assert states(rig.run(1.0)) == ["aborted"]


def test_stop_while_loading_unloads_the_chunks():
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    chunks = chunks_of(rest_to_rest(1000), rig.now.unix_ns + 900_000_000)
    rig.hub.load(chunks[0], rig.now)
    rig.hub.request("stop")
    assert states(rig.run(0.1)) == ["loading", "aborted"]


def test_a_host_that_stops_polling_finds_the_axis_stopped():
    rig = SimulatedRig(AxisParameters(command_mode="velocity"))
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.05, rig.now)
    (report,) = rig.run(0.5, step_ns=10**9)
    assert report.status.state == "homed"
    assert "0.25 s" in report.status.reason
    assert [e.level for e in report.events] == ["warning"]
    assert len(report.measured) == 25


def test_a_stalled_computer_does_not_abort_a_sequence():
    """Device and host are one process: when both stand still for a second, neither has left the other."""
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    for chunk in chunks_of(rest_to_rest(1500), rig.now.unix_ns + 200_000_000):
        rig.hub.load(chunk, rig.now)
    rig.run(0.5)
    rig.run(1.2, step_ns=1_200_000_000)
    assert states(rig.run(1.5))[-1] == "done"
    assert rig.reports[-1].status.state == "enabled"


def test_a_long_pause_opens_a_new_clock_epoch_with_later_stamps():
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    rig.run(0.1)
    before = rig.reports[-1].measured or rig.run(0.02)[-1].measured
    rig.run(60.0, step_ns=10**12)
    rig.run(0.1)
    batches = [b for r in rig.reports for b in r.measured]
    stamps = np.array([b.stamp_ns for b in batches])
    assert np.all(np.diff(stamps) > 0)
    assert {b.epoch for b in batches} == {1, 2}
    assert batches[-1].stamp_ns - before[0].stamp_ns > 59 * 10**9
    assert rig.reports[-1].status.state == "homed"


def test_the_real_time_factor_scales_time_and_stamps():
    rig = SimulatedRig(AxisParameters(), real_time_factor=2.0)
    reports = rig.run(1.0)
    stamps = [b.stamp_ns for r in reports for b in r.measured]
    assert len(stamps) == 100
    assert stamps[-1] - stamps[0] == 99 * 20_000_000


def test_a_jump_of_the_real_time_clock_is_an_error_and_the_stamps_do_not_follow():
    rig = SimulatedRig(AxisParameters())
    rig.run(0.1)
    events, stamps = [], []
    for k in range(20):
        steady = rig.steady_ns + k * 10_000_000
        jumped = 3_600 * 10**9 if k > 5 else 0
        report = rig.hub.poll(HostTime(steady, steady - STEADY_START + UNIX_START + jumped))
        events += [e for e in report.events if "jumped" in e.text]
        stamps += [b.stamp_ns for b in report.measured]
    assert [e.level for e in events] == ["error"]
    assert "3600.000 s" in events[0].text
    assert np.all(np.diff(stamps) == 20_000_000)
    assert report.status.counters["real_time_jumps"] == 1


def test_the_clock_syncs_redo_the_map():
    rig = SimulatedRig(AxisParameters(), device=SimulatedDevice(clock_drift_ppm=-80.0, clock_start_ns=10**15))
    rig.run(20.0)
    syncs = [s for r in rig.reports for s in r.clock]
    assert len(syncs) >= 95
    device = np.array([s.device_ns - 10**15 for s in syncs], dtype=float)
    host = np.array([s.host_ns - UNIX_START for s in syncs], dtype=float)
    rate, offset = np.polyfit(device, host, 1)
    assert rate == pytest.approx(1 / (1 - 80e-6), abs=1e-9)
    assert abs(offset) < 5


def test_a_camera_sees_the_hub_at_exact_stamps_of_the_past():
    rig = SimulatedRig(
        AxisParameters(), device=SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=123_456_789)
    )
    rig.enable()
    values = rest_to_rest(800, 2.0)
    start_ns = rig.now.unix_ns + 200_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    reports = rig.run(1.2)
    batches = [b for r in reports for b in r.measured]
    for batch in batches[::7]:
        shown = rig.hub.snapshots([batch.stamp_ns])
        assert shown.positions[0] == pytest.approx(batch.positions[0], abs=0.6e-7)
    assert rig.hub.snapshots([rig.hub.reached_ns]).coordinates.shape == (1, 0)


def test_close_leaves_the_axis_at_rest_and_disabled():
    rig = SimulatedRig(AxisParameters(command_mode="velocity"))
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.2, rig.now)
    rig.run(0.1)
    rig.hub.close()
    assert rig.hub.axis.state == "homed"
    assert rig.hub.axis.velocity == 0.0


def test_an_unusable_chunk_never_reaches_the_axis():
    rig = SimulatedRig(AxisParameters())
    rig.enable()
    rig.hub.load(SequenceChunk("old", 1, 1, 0, 1_000_000, 0, np.zeros(5)), rig.now)
    (report,) = rig.run(0.01)
    assert [(s.sequence_id, s.state) for s in report.sequences] == [("old", "refused")]
    assert not rig.hub.axis.has_sequence
