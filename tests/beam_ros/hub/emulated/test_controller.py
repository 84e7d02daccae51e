"""The emulated controller with faults on request, and the real driver on its pseudo-terminal."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.clock_mapping import fit_affine
from beam_ros.hub.emulated.injected_faults import read_schedule
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from tests.beam_ros.hub.hub_scenes import DriverRig, chunks_of, rest_to_rest

VELOCITY = AxisParameters(command_mode="velocity", watchdog_s=0.5)


@pytest.fixture
def rig(tmp_path):
    rig = DriverRig(VELOCITY, tmp_path)
    rig.connect()
    rig.enable()
    yield rig
    rig.close()


def bring_about(rig, text):
    rig.emulator.bring_about(read_schedule(text, "test", rig.emulator.elapsed))


@pytest.mark.first_case
@pytest.mark.parametrize(
    "fault",
    [
        "{fault: unplug, for: 0.4}",
        "{fault: reset}",
        "{fault: stall, for: 0.8}",
        "{fault: drop, share: 0.5, for: 0.8}",
        "{fault: corrupt, share: 0.5, for: 0.8, direction: to_device}",
    ],
)
def test_a_moving_axis_comes_to_rest_stays_there_and_can_be_used_again(rig, fault):
    rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now)
    rig.run(0.1)
    bring_about(rig, fault)
    rig.run(1.2)
    assert rig.emulator.axis.velocity == 0.0
    assert rig.emulator.axis.state != "enabled"
    rig.until(lambda r: r.status.state in ("identified", "homed"), 6.0)
    assert rig.emulator.axis.velocity == 0.0
    assert rig.emulator.take_notes()[0].startswith("fault: ")
    rig.enable()


def test_a_late_line_is_slow_but_works(rig):
    bring_about(rig, "{fault: delay, seconds: 0.08}")
    rig.run(0.3)
    assert rig.ask("stop").success
    assert rig.ask("enable").success


def test_the_clock_runs_faster_from_then_on(rig):
    bring_about(rig, "{fault: drift, ppm: 500}")
    reports = rig.run(2.5)
    assert reports[-1].status.fault.name != "clock_jumped"
    syncs = [sync for report in reports for sync in report.clock][5:]
    # The fit weighs by the round trips, which a busy computer makes long, and says how well it knows the rate then.
    fit = fit_affine(syncs)
    assert abs(1.0 / fit.rate - 1.000535) < 2e-4 + 5.0 * np.sqrt(fit.covariance[1, 1])


def test_a_clock_whose_rate_changes_by_a_hundredth_is_a_fault(rig):
    rig.run(2.0)  # A clock that has always been so far off would be followed.
    bring_about(rig, "{fault: drift, ppm: 10000}")
    # Found as soon as two questions, a second apart, are answered within milliseconds.
    rig.until(lambda r: r.status.fault.name == "clock_jumped", 30.0)


@pytest.mark.slow
def test_a_line_that_is_too_slow_for_the_samples_is_a_fault_and_nothing_worse(tmp_path):
    rig = DriverRig(VELOCITY, tmp_path, line_baud=115_200, fifo_bytes=1024)
    try:
        rig.until(lambda r: r.status.fault.name == "telemetry_stopped", 10.0)
        rig.run(1.0)
        status = rig.reports[-1].status
        assert status.state == "fault"
        assert "baud" in status.fault.remedy
        assert status.counters["bad_frames"] > 10
        assert not rig.ask("home", 10.0).success
        assert rig.ask("stop", 10.0).success
    finally:
        rig.close()


@pytest.mark.slow
@pytest.mark.parametrize(("baud", "period_ns"), [(300_000, 1_000_000), (115_200, 4_000_000)])
def test_a_line_that_is_just_fast_enough_carries_a_sequence_and_is_never_flooded(tmp_path, baud, period_ns):
    """At 1 kHz the device says 26 kB/s with all its states, at 250 Hz a quarter of it."""
    parameters = AxisParameters(
        period_ns=period_ns, watchdog_s=1.0
    )  # this process may have to wait for a processor
    device = SimulatedDevice(buffer_samples=2048)
    rig = DriverRig(parameters, tmp_path, device=device, line_baud=baud, fifo_bytes=16_384)
    try:
        rig.connect()
        rig.enable()
        values = rest_to_rest(round(5e9 / period_ns), 0.2)
        for chunk in chunks_of(values, rig.now.unix_ns + 600_000_000, period_ns=period_ns):
            rig.hub.load(chunk, rig.now)
        reports = rig.until(lambda r: any(s.state in ("done", "underrun") for s in r.sequences), 30.0)
        assert [s.state for r in reports for s in r.sequences][-1] == "done"
        reports += rig.run(0.5)
        applied = np.concatenate([batch.accelerations for r in reports for batch in r.applied])
        first = np.flatnonzero(applied == values[1])[0] - 1
        assert np.array_equal(applied[first : first + len(values)], values)
        # The port may be opened in the middle of a frame.
        assert reports[-1].status.counters["bad_frames"] <= 1
        # A computer that stands still for a moment makes the host ask; it never sends all again.
        assert reports[-1].status.counters["resent_samples"] <= 100
    finally:
        rig.close()


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("{fault: lying_encoder, offset: 0.02}", "position_jumped"),
        ("{fault: lying_encoder, offset: 0.2}", "beyond_travel"),
        ("{fault: sticking_axis}", "motion_unexplained"),
    ],
)
def test_an_axis_that_does_not_do_as_it_is_led_is_stopped_and_named(rig, fault, name):
    rig.hub.setpoint(rig.now.unix_ns, 0.05, rig.now)
    rig.run(0.1)
    bring_about(rig, fault)
    rig.hub.setpoint(rig.now.unix_ns, 0.05, rig.now)
    reports = rig.until(lambda r: r.status.state == "fault")
    assert reports[-1].status.fault.name in (name, "position_jumped")
    rig.run(0.3)
    assert rig.emulator.axis.velocity == 0.0
    assert rig.emulator.axis.state != "enabled"
