"""What the hub does against what it was commanded to do."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from scipy import signal

from beam_ros.hub.host.motion_watch import CertainMotion, Measuring, MotionWatch
from beam_ros.hub.parameters import COMMAND_MODES, AxisParameters
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.hub.ticks import TickBatch
from tests.beam_ros.hub.hub_scenes import enabled_axis

PARAMETERS = AxisParameters()
BATCH = 20
MOTION = ("acceleration", "velocity", "position")


def batches(
    parameters: AxisParameters, seconds: float, set_point: Callable[[float], float]
) -> list[TickBatch]:
    """Return what a healthy axis does under set-points, as functions of time."""
    axis = enabled_axis(parameters)
    done = []
    for k in range(round(seconds / parameters.period) // BATCH):
        # Values of the middle of what they hold for: the mean velocity is then zero.
        assert axis.setpoint(set_point((k + 0.5) * BATCH * parameters.period)).success
        axis.feed()
        done.append(axis.advance(axis.device_ns + BATCH * parameters.period_ns))
    assert axis.state == "enabled", axis.reason
    return done


def wave(mode: str, frequency: float = 1.0) -> Callable[[float], float]:
    """Return set-points that shake the hub by some 10 mm."""
    omega = 2 * np.pi * frequency
    amplitude = {"acceleration": 0.01 * omega**2, "velocity": 0.01 * omega, "position": 0.01, "effort": 0.3}
    return lambda t: float(amplitude[mode] * np.cos(omega * t))


def measured_as(batch: TickBatch, positions: np.ndarray, *, later: int = 0) -> TickBatch:
    """Return ticks with other positions, and ``later`` by so many ticks."""
    counts = np.round(positions).astype(np.int64)
    return dataclasses.replace(batch, first_tick=batch.first_tick + later, position_counts=counts)


def watching(parameters: AxisParameters) -> MotionWatch:
    return MotionWatch(parameters, Measuring.by_encoder(parameters))


def faults(watch: MotionWatch, done: list[TickBatch], **about: bool) -> list[tuple[int, str]]:
    about = {"is_homed": True, "is_enabled": True} | about
    found = [(k, watch.find(batch, 0, **about)) for k, batch in enumerate(done)]
    return [(k, fault[0]) for k, fault in found if fault is not None]


@pytest.mark.parametrize("mode", COMMAND_MODES)
def test_a_healthy_axis_raises_no_alarm(mode):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    done = batches(parameters, 5.0, wave(mode))
    assert max(np.max(np.abs(b.position_counts)) for b in done) * 1e-7 > 5e-3
    assert faults(watching(parameters), done) == []


@pytest.mark.parametrize("mode", COMMAND_MODES)
@pytest.mark.parametrize("resolution", [1e-7, 1e-5, 1e-4])
def test_lag_noise_and_coarse_steps_of_a_real_axis_raise_no_alarm(mode, resolution):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode, encoder_resolution=resolution)
    done = batches(parameters, 4.0, wave(mode, 2.0))
    positions = np.concatenate([batch.position_counts for batch in done]).astype(float)
    # 3 ms behind, with backlash of 50 um, ripple of 20 um and noise of two counts.
    late = np.concatenate([np.zeros(3), positions[:-3]])
    backlash = np.sign(np.diff(late, prepend=0.0)) * (25e-6 / resolution)
    ripple = 20e-6 / resolution * np.sin(positions * resolution / 1e-3)
    noise = 2.0 * np.random.default_rng(8).standard_normal(len(positions))
    real = late - backlash + ripple + noise
    done = [measured_as(b, real[k * BATCH : (k + 1) * BATCH]) for k, b in enumerate(done)]
    assert faults(watching(parameters), done) == []


@pytest.mark.parametrize("mode", MOTION)
def test_a_servo_of_20_hz_at_the_limits_of_the_axis_raises_no_alarm(mode):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    # Full acceleration forth and back, in steps: the servo's mass is pulled along by 10 m/s^2 / (2 pi 20 Hz)^2.
    accelerations = np.tile(np.repeat([10.0, -10.0, -10.0, 10.0], 45), 20)
    velocities = np.append(0.0, np.cumsum(accelerations)) * 1e-3
    reference = np.append(0.0, np.cumsum((velocities[:-1] + velocities[1:]) / 2)) * 1e-3
    omega, damping = 2 * np.pi * 20.0, 0.7
    lag = signal.lsim(
        ([-1.0], [1.0, 2 * damping * omega, omega**2]), accelerations, np.arange(len(accelerations)) * 1e-3
    )[1]
    assert 0.5e-3 < np.max(np.abs(lag)) < 1e-3
    applied = {
        "acceleration": accelerations,
        "velocity": np.diff(reference) / 1e-3,
        "position": reference[:-1],
    }
    positions = (reference[:-1] + lag) / 1e-7
    done = []
    for k in range(0, len(positions), BATCH):
        part = slice(k, k + BATCH)
        zeros = np.zeros(BATCH, dtype=np.float32)
        done.append(measured_as(TickBatch(k, applied[mode][part], zeros, zeros, zeros), positions[part]))
    assert faults(watching(parameters), done) == []
    # With a gap amid the motion the path begins anew, at full speed.
    del done[50:55]
    watch = watching(parameters)
    found = [
        watch.find(batch, 5 * BATCH if k == 50 else 0, is_homed=True, is_enabled=True)
        for k, batch in enumerate(done)
    ]
    assert found == [None] * len(done)


@pytest.mark.parametrize("mode", MOTION)
def test_a_jam_is_found_when_the_error_is_as_large_as_allowed(mode):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    done = batches(parameters, 4.0, wave(mode))
    positions = np.concatenate([batch.position_counts for batch in done]) * 1e-7
    stuck_from = 100 * BATCH
    real = np.concatenate(
        [positions[:stuck_from], np.full(len(positions) - stuck_from, positions[stuck_from])]
    )
    beyond = np.flatnonzero(np.abs(real - positions) > parameters.max_following_error)[0]
    done = [measured_as(b, real[k * BATCH : (k + 1) * BATCH] / 1e-7) for k, b in enumerate(done)]
    (first, name), *_ = faults(watching(parameters), done)
    assert name == "motion_unexplained"
    assert beyond // BATCH <= first <= beyond // BATCH + 3


@pytest.mark.parametrize("mode", ["acceleration", "velocity"])
def test_a_creep_that_no_command_made_is_found(mode):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    done = batches(parameters, 8.0, wave(mode))
    creep = 5e-3 * np.maximum(0.0, np.arange(len(done) * BATCH) * 1e-3 - 3.0)
    done = [
        measured_as(b, b.position_counts + creep[k * BATCH : (k + 1) * BATCH] / 1e-7)
        for k, b in enumerate(done)
    ]
    (first, name), *_ = faults(watching(parameters), done)
    assert name == "motion_unexplained"
    # 2 mm at 5 mm/s, and what the path was pulled along meanwhile.
    assert 3.4 < first * 0.02 < 3.8


@pytest.mark.parametrize("mode", COMMAND_MODES)
@pytest.mark.parametrize("where", [0, 7, 19])
def test_a_position_that_jumps_is_found_at_once(mode, where):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    done = batches(parameters, 1.0, wave(mode))
    counts = done[30].position_counts.copy()
    counts[where:] += 30_000
    done[30] = dataclasses.replace(done[30], position_counts=counts)
    assert faults(watching(parameters), done)[0] == (
        30,
        "position_jumped",
    )


def test_lost_ticks_are_no_jump_but_a_jump_beyond_their_time_is():
    watch = watching(PARAMETERS)
    done = batches(PARAMETERS, 2.0, wave("acceleration"))
    for k, batch in enumerate(done):
        if k % 10:
            assert watch.find(batch, 20 if k % 10 == 1 else 0, is_homed=True, is_enabled=True) is None
    counts = np.full(BATCH, done[-1].position_counts[-1] + 40 * 10_000 + 1_000_000)
    away = measured_as(done[-1], counts, later=2 * BATCH)
    assert watch.find(away, 20, is_homed=True, is_enabled=True)[0] == "position_jumped"


def test_travel_counts_from_home_and_ends_at_the_limit_and_the_lag():
    limit = PARAMETERS.position_limit + PARAMETERS.max_following_error
    for beyond, about, expected in (
        (1e-5, {}, ["beyond_travel"]),
        (-1e-5, {}, []),
        (1e-5, {"is_homed": False}, []),
        (1e-5, {"is_enabled": False}, ["beyond_travel"]),
    ):
        for side in (-1, 1):
            counts = np.full(BATCH, round(side * (limit + beyond) / 1e-7), dtype=np.int64)
            zeros = np.zeros(BATCH)
            batch = TickBatch(0, zeros, counts, counts * 0, zeros.astype(np.float32))
            assert [name for _, name in faults(watching(PARAMETERS), [batch], **about)] == expected


def test_a_hub_that_is_faster_than_its_limit_is_found_in_effort_mode_too():
    parameters = dataclasses.replace(PARAMETERS, command_mode="effort")
    zeros = np.zeros(BATCH)
    for speed, expected in ((0.49, []), (0.6, ["motion_unexplained"])):
        done = []
        for k in range(10):
            positions = speed * 1e-3 * np.arange(k * BATCH, (k + 1) * BATCH) / 1e-7 - 450_000
            done.append(
                measured_as(TickBatch(k * BATCH, zeros, zeros, zeros, zeros.astype(np.float32)), positions)
            )
        names = [name for _, name in faults(watching(parameters), done, is_homed=False)]
        assert names[:1] == expected


def test_a_hand_on_a_disabled_axis_is_no_fault_and_leaves_no_error_behind():
    watch = watching(PARAMETERS)
    zeros = np.zeros(BATCH)

    def at(positions: np.ndarray) -> list[TickBatch]:
        batch = TickBatch(0, zeros, zeros, zeros, zeros.astype(np.float32))
        parts = positions.reshape(-1, BATCH)
        return [measured_as(batch, part / 1e-7, later=k * BATCH) for k, part in enumerate(parts)]

    pushed = 0.03 * np.sin(np.linspace(0, np.pi / 2, 1000))
    assert faults(watch, at(pushed), is_enabled=False) == []
    watch.forget()
    assert faults(watch, at(np.full(3000, 0.03))) == []


@pytest.mark.parametrize("period_ns", [100_000, 50_000_000])
def test_ticks_of_any_length_are_followed(period_ns):
    parameters = dataclasses.replace(
        PARAMETERS, period_ns=period_ns, max_acceleration=0.5, stop_deceleration=0.5, watchdog_s=1.0
    )
    axis = enabled_axis(parameters, RigidPlant(0.8, parameters.period))
    watch = watching(parameters)
    for k in range(60):
        assert axis.setpoint(0.05 * float(np.cos(0.5 * k))).success
        axis.feed()
        batch = axis.advance(axis.device_ns + parameters.batch_ns)
        assert watch.find(batch, 0, is_homed=True, is_enabled=True) is None
    jammed = measured_as(
        batch, np.full(len(batch), batch.position_counts[-1] + 1e-3 / 1e-7), later=len(batch)
    )
    found = watch.find(jammed, 0, is_homed=True, is_enabled=True)
    assert (found is not None) is (period_ns == 100_000)  # 1 mm is a jump in 0.1 ms, and the way of 50 ms


@pytest.mark.parametrize("is_enabled", [False, True])
def test_what_is_remembered_of_an_axis_at_rest_is_bounded(is_enabled):
    watch = CertainMotion(AxisParameters(), Measuring(1e-5, 1e-5))

    def follow(first: int, last: int) -> None:
        for batch in range(first, last):
            times = 1e-3 * np.arange(20.0 * batch, 20.0 * (batch + 1))
            assert watch.find(times, np.zeros(20), is_homed=True, is_enabled=is_enabled) is None

    follow(0, 100)
    tracemalloc.start()
    follow(100, 5000)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 5_000
