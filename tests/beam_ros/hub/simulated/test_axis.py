from __future__ import annotations

import hashlib
import random

import numpy as np
import pytest

from beam_ros.hub.contract import Outcome
from beam_ros.hub.errors import SnapshotError
from beam_ros.hub.faults import fault
from beam_ros.hub.kinematics import profile_velocity
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import enabled_axis, rest_to_rest

T = 1e-3
TICK = 1_000_000
RESOLUTION = 1e-7


def run_sequence(axis, values, extra_ticks=20):
    """Arm and play a sequence with a living host; return the ticks from its start on."""
    start_ns = axis.device_ns + 10 * TICK
    assert axis.arm(start_ns, len(values)).success
    assert axis.append(0, list(values)).success
    axis.advance(start_ns)
    batches = []
    for _ in range(0, len(values) + extra_ticks, 10):
        axis.feed()
        batches.append(axis.advance(axis.device_ns + 10 * TICK))
    return {
        "applied": np.concatenate([b.applied for b in batches]),
        "x": np.concatenate([b.position_counts for b in batches]) * RESOLUTION,
        "v": np.concatenate([b.velocity_counts for b in batches]) * RESOLUTION / T,
        "f": np.concatenate([b.efforts for b in batches]),
    }


def test_held_accelerations_are_integrated_exactly_to_half_an_encoder_count():
    values = rest_to_rest(2000, 2.0)
    record = run_sequence(enabled_axis(AxisParameters()), values)
    v = np.concatenate([[0], np.cumsum(values)]) * T
    x = np.concatenate([[0], np.cumsum((v[:-1] + v[1:]) / 2) * T])
    assert np.array_equal(record["applied"][:2000], values)
    assert np.max(np.abs(record["x"][:2001] - x)) < 0.51 * RESOLUTION
    assert np.max(np.abs(record["v"][:2001] - v)) < 0.51 * RESOLUTION / T
    assert record["f"][:2000] == pytest.approx(0.8 * values, rel=1e-6)


def test_velocities_are_held_through_each_tick():
    values = 0.1 * np.sin(np.pi * np.arange(401) / 400) ** 2
    values[-1] = 0.0
    record = run_sequence(enabled_axis(AxisParameters(command_mode="velocity")), values)
    x = np.concatenate([[0], np.cumsum(values) * T])
    assert np.array_equal(record["applied"][:401], values)
    assert np.max(np.abs(record["x"][:402] - x)) < 0.51 * RESOLUTION


def test_positions_are_reached_at_their_ticks_and_joined_by_lines():
    axis = enabled_axis(AxisParameters(command_mode="position"))
    values = 0.01 * (1 - np.cos(2 * np.pi * np.arange(401) / 400))
    record = run_sequence(axis, values)
    assert record["applied"][:401] == pytest.approx(values, abs=1e-15)
    assert np.max(np.abs(record["x"][:401] - values)) < 0.51 * RESOLUTION
    start = axis.tick - len(record["x"])
    between = axis.snapshots([(start + 100) * TICK + 250_000])
    assert between.positions[0] == pytest.approx(0.75 * values[100] + 0.25 * values[101], abs=1e-15)


def test_a_force_moves_a_free_mass_as_newton_says():
    values = np.concatenate([np.full(100, 2.0), np.full(100, -2.0)])
    record = run_sequence(enabled_axis(AxisParameters(command_mode="effort")), values)
    v = np.concatenate([[0], np.cumsum(values / 0.8)]) * T
    x = np.concatenate([[0], np.cumsum((v[:-1] + v[1:]) / 2) * T])
    assert np.max(np.abs(record["x"][:201] - x)) < 0.51 * RESOLUTION
    assert np.array_equal(record["applied"][:200], values)


def test_snapshots_inside_ticks_lie_on_the_exact_parabola():
    axis = enabled_axis(AxisParameters())
    values = rest_to_rest(200, 5.0)
    record = run_sequence(axis, values)
    start = axis.tick - len(record["x"])
    times = np.array([(start + 57) * TICK + k * 125_000 for k in range(9)])
    snapshots = axis.snapshots(times)
    v = np.concatenate([[0], np.cumsum(values)]) * T
    x = np.concatenate([[0], np.cumsum((v[:-1] + v[1:]) / 2) * T])
    tau = np.arange(8) * 125e-6
    expected = x[57] + v[57] * tau + values[57] * tau**2 / 2
    assert snapshots.positions[:8] == pytest.approx(expected, abs=1e-14)
    assert snapshots.positions[8] == pytest.approx(x[58], abs=1e-14)
    assert snapshots.accelerations[:8] == pytest.approx(values[57])


def test_the_axis_does_not_invent_instants_it_has_not_reached_or_has_forgotten():
    axis = enabled_axis(AxisParameters())
    axis.advance(axis.device_ns + 6000 * TICK)
    axis.snapshots([axis.device_ns])
    for time_ns in (axis.device_ns + 1, axis.device_ns - 5000 * TICK, -5):
        with pytest.raises(SnapshotError, match="snapshot at"):
            axis.snapshots([time_ns])


def test_at_power_on_the_axis_stands_where_it_stands():
    axis = VirtualAxis(AxisParameters(), RigidPlant(0.8, T), SimulatedDevice(initial_position=0.004))
    first = axis.snapshots([axis.device_ns])
    assert (first.positions[0], first.accelerations[0]) == (0.004, 0.0)


def test_the_state_machine_asks_for_home_before_enable_and_says_so():
    axis = VirtualAxis(AxisParameters(), RigidPlant(0.8, T), SimulatedDevice(initial_position=0.004))
    axis.request(1, "enable")
    (failed,) = axis.take_completed()
    assert not failed[1].success
    assert "home" in failed[1].message
    axis.request(2, "home")
    for _ in range(100):
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
    assert axis.take_completed()[0][0] == 2
    assert axis.state == "homed"
    assert axis.position == 0.0
    axis.request(3, "enable")
    assert axis.take_completed()[0][1].success
    assert axis.state == "enabled"
    axis.request(4, "home")
    assert not axis.take_completed()[0][1].success


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_homing_finds_home_within_its_limits_in_every_mode(mode):
    parameters = AxisParameters(command_mode=mode)
    axis = VirtualAxis(parameters, RigidPlant(0.8, T), SimulatedDevice(initial_position=-0.0123))
    axis.request(1, "home")
    axis.feed()
    ticks = []
    while axis.state != "homed":
        axis.feed()
        ticks.append(axis.advance(axis.device_ns + 10 * TICK))
        assert axis.tick < 5000
    v = np.concatenate([b.velocity_counts for b in ticks]) * RESOLUTION / T
    assert np.max(np.abs(v)) <= parameters.homing_speed + RESOLUTION / T
    assert np.max(np.abs(np.diff(v))) / T <= parameters.homing_acceleration + 1.1 * RESOLUTION / T**2
    assert axis.snapshots([axis.device_ns]).positions[0] == pytest.approx(0.0, abs=1e-12)
    # 0.6 s at full speed, and two ramps of 0.1 s.
    assert axis.tick == pytest.approx(715, abs=20)


@pytest.mark.parametrize("is_ramped", [False, True])
@pytest.mark.parametrize("distance", [1e-9, 3.3e-6, 1.7e-4, -0.02, 0.09])
def test_a_profiled_move_lands_on_its_target_within_its_limits(distance, is_ramped):
    x, v = 0.0, 0.0
    ticks = 0
    while not (abs(distance - x) < 1e-12 and abs(v) < 1e-9):
        ticks += 1
        assert ticks < 20_000
        new = profile_velocity(distance - x, v, 0.05, 0.5, T, is_ramped=is_ramped)
        assert abs(new) <= 0.05
        assert abs(new - v) <= 0.5 * T * (1 + 1e-12)
        x += ((v + new) / 2 if is_ramped else new) * T
        v = new
    # Time-optimal to within two ticks: t = d/v + v/a, or 2 sqrt(d/a) where full speed is not reached.
    d = abs(distance)
    optimal = d / 0.05 + 0.05 / 0.5 if d > 0.05**2 / 0.5 else 2 * np.sqrt(d / 0.5)
    assert ticks * T <= optimal + 3 * T


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_stop_decelerates_at_the_limit_and_then_disables(mode):
    axis = enabled_axis(AxisParameters(command_mode=mode))
    n = 400
    ramp = {
        "acceleration": np.full(n, 0.5),
        "velocity": 0.5 * T * np.arange(n),
        "position": 0.25 * (T * np.arange(n)) ** 2,
        "effort": np.full(n, 0.4),
    }[mode]
    axis.arm(axis.device_ns, n)
    axis.append(0, list(ramp))
    axis.advance(axis.device_ns + 200 * TICK)
    speed = axis.velocity
    assert speed == pytest.approx(0.1, rel=0.02)
    axis.request(7, "stop")
    batch = axis.advance(axis.device_ns + 30 * TICK)
    v = batch.velocity_counts * RESOLUTION / T
    assert axis.take_completed() == [(7, Outcome(True, "stopped"))]
    assert axis.state == "homed"
    assert [e.kind for e in axis.take_events()] == ["sequence_running", "sequence_aborted", "state"]
    rest = int(np.argmax(v == 0.0))
    assert rest * T == pytest.approx(speed / 10.0, abs=2 * T)
    assert np.all(v[rest:] == 0.0)
    assert not axis.setpoint(0.0).success


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "effort"])
def test_setpoints_that_are_not_refreshed_stop_the_axis(mode):
    axis = enabled_axis(AxisParameters(command_mode=mode))
    assert axis.setpoint(0.1).success
    for _ in range(24):
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
    assert axis.state == "enabled"
    for _ in range(10):
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
    assert axis.state == "homed"
    assert "not refreshed" in axis.reason
    assert axis.velocity == 0.0


def test_a_position_setpoint_is_a_move_that_holds_without_refreshing():
    axis = enabled_axis(AxisParameters(command_mode="position"))
    axis.setpoint(0.02)
    for _ in range(200):
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
    assert axis.state == "enabled"
    assert axis.position == pytest.approx(0.02, abs=RESOLUTION / 2)


def test_a_silent_host_stops_the_axis_after_the_watchdogs_time():
    axis = enabled_axis(AxisParameters(command_mode="velocity"))
    axis.setpoint(0.1)
    axis.feed()
    batch = axis.advance(axis.device_ns + 400 * TICK)
    v = batch.velocity_counts * RESOLUTION / T
    assert np.all(v[100:250] == pytest.approx(0.1))
    assert v[270] == 0.0
    assert axis.state == "homed"
    assert "watchdog" in axis.reason


def test_nothing_enables_the_axis_again_by_itself():
    axis = enabled_axis(AxisParameters())
    axis.advance(axis.device_ns + 400 * TICK)
    for _ in range(50):
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
    assert axis.state == "homed"
    axis.request(9, "enable")
    assert axis.state == "enabled"
    assert axis.reason == ""


def test_an_underrun_stops_and_disables():
    axis = enabled_axis(AxisParameters())
    axis.arm(axis.device_ns, 400)
    axis.append(0, [0.5] * 100)
    axis.feed()
    axis.advance(axis.device_ns + 150 * TICK)
    kinds = [e.kind for e in axis.take_events()]
    assert kinds == ["sequence_running", "sequence_underrun", "state"]
    assert "sample 100 of 400" in axis.reason
    assert axis.state == "homed"
    assert axis.velocity == 0.0


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "effort"])
def test_the_end_of_the_travel_is_guarded_and_leaves_a_fault_to_clear(mode):
    axis = enabled_axis(AxisParameters(command_mode=mode))
    extreme = 0.0
    for _ in range(300):
        if axis.state == "enabled" and axis.activity != "stopping":
            assert axis.setpoint({"acceleration": 1.0, "velocity": 0.4, "effort": 1.0}[mode]).success
        axis.feed()
        axis.advance(axis.device_ns + 10 * TICK)
        extreme = max(extreme, axis.position)
    assert axis.state == "fault"
    assert "limit" in axis.reason
    assert 0.049 < extreme < 0.05 + 2e-5
    axis.request(1, "enable")
    assert not axis.take_completed()[0][1].success
    axis.request(2, "clear_fault")
    assert axis.take_completed()[0][1].success
    assert axis.state == "homed"


def test_the_buffer_takes_what_it_has_room_for_and_only_in_order():
    axis = enabled_axis(AxisParameters(), buffer_samples=128)
    assert not axis.append(0, [0.0]).success
    axis.arm(axis.device_ns + 10 * TICK, 300)
    assert axis.append(0, [0.0] * 128).success
    assert axis.buffer_free == 0
    assert not axis.append(128, [0.0]).success
    axis.feed()
    axis.advance(axis.device_ns + 60 * TICK)
    assert axis.buffer_free == 50
    assert not axis.append(127, [0.0]).success
    assert axis.append(128, [0.0] * 50).success
    assert not axis.setpoint(0.1).success
    assert not axis.arm(axis.device_ns + 10 * TICK, 10).success


def test_a_start_in_the_past_is_refused_and_a_start_between_ticks_rounds_up():
    axis = enabled_axis(AxisParameters())
    axis.advance(100 * TICK)
    assert not axis.arm(99 * TICK, 10).success
    assert axis.arm(110 * TICK + 1, 2).success
    axis.append(0, [1.0, -1.0])
    batch = axis.advance(120 * TICK)
    assert batch.applied[10:14].tolist() == [0.0, 1.0, -1.0, 0.0]


def test_ticks_do_not_depend_on_how_the_time_is_cut():
    values = rest_to_rest(300)
    records = []
    for step in (TICK, 7 * TICK, 1_234_567, 200 * TICK):
        axis = enabled_axis(AxisParameters())
        start = axis.device_ns + 10 * TICK
        axis.arm(start, 300)
        axis.append(0, values.tolist())
        counts = []
        to = axis.device_ns
        while to < start + 310 * TICK:
            to += step
            axis.feed()
            counts += axis.advance(min(to, start + 310 * TICK)).position_counts.tolist()
        records.append(counts)
    assert all(record == records[0] for record in records)


@pytest.mark.parametrize(
    ("mode", "limit"), [("acceleration", "max_acceleration"), ("effort", "max_effort"), ("velocity", None)]
)
def test_a_command_at_its_limit_is_obeyed_and_one_beyond_it_is_a_fault(mode, limit):
    def state_after(share):
        parameters = AxisParameters(command_mode=mode, max_effort=4.0)
        axis = enabled_axis(parameters)
        # In velocity the first step from rest is what the acceleration allows in a tick.
        most = parameters.max_acceleration * T if limit is None else getattr(parameters, limit)
        run_sequence(axis, np.full(5, share * most), extra_ticks=0)
        return axis.state, axis.reason

    assert "limit" not in state_after(1.0)[1]
    state, reason = state_after(1.001)
    assert state == "fault"
    assert "limit" in reason


@pytest.mark.parametrize("seed", range(6))
def test_no_force_drives_the_hub_beyond_its_speed_limit(seed):
    # A tick of the greatest force changes the speed by 5 %: the axis stops before it, not after it.
    parameters = AxisParameters(command_mode="effort", travel=0.4)
    axis = enabled_axis(parameters)
    rng = np.random.default_rng(seed)
    # Held forces, steps, and a swing: what pushes a hub to its limit.
    steps = np.repeat(rng.choice([-20.0, 2.0, 12.0, 20.0], 100), rng.integers(4, 8))
    swing = 20.0 * np.sin(2 * np.pi * rng.uniform(3, 6) * T * np.arange(300))
    record = run_sequence(axis, [np.full(100, 20.0), steps, swing][seed % 3], extra_ticks=100)
    assert axis.fault.name == "speed_limit"
    # A swing that still grows changes the force by 0.75 N a tick, too little to learn from: 1 mm/s.
    assert 0.94 * parameters.max_speed < np.max(np.abs(record["v"])) <= 1.002 * parameters.max_speed


def seeded_run(axis, seed):
    """Ask, command and neglect an axis at random for 1500 steps; return a digest of all that it does."""
    rng = random.Random(seed)
    limit = axis.parameters.command_limit
    digest = hashlib.sha256()
    for number in range(1500):
        roll = rng.random()
        answer = None
        if roll < 0.12:
            kind = ("enable", "enable", "home", "home", "stop", "disable", "clear_fault")[
                int(rng.random() * 7)
            ]
            axis.request(number, kind)
        elif roll < 0.3:
            answer = axis.setpoint((2.2 * rng.random() - 1.1) * limit * (1.0, 0.1)[int(rng.random() * 2)])
        elif roll < 0.42:
            answer = axis.arm(axis.device_ns + int(rng.random() * 30_000_001), 200)
        elif roll < 0.44:
            axis.emergency_stop(fault("session_opened"), "by chance")
        if axis.has_sequence and rng.random() < 0.95:
            room = min(200 - axis.n_received, axis.buffer_free, 50)
            start = axis.position if axis.parameters.command_mode == "position" else 0.0
            axis.append(axis.n_received, [start + 0.01 * limit * (k % 2) for k in range(room)])
        if rng.random() < 0.9:
            axis.feed()
        ticks = axis.advance(axis.device_ns + (TICK, 5 * TICK, 20 * TICK, 1_234_567)[int(rng.random() * 4)])
        for array in (ticks.applied, ticks.position_counts, ticks.velocity_counts, ticks.efforts):
            digest.update(array.tobytes())
        events = [(event.tick, event.kind, event.text) for event in axis.take_events()]
        digest.update(repr((answer, axis.state, axis.reason, events, axis.take_completed())).encode())
    return digest.hexdigest()[:16]


@pytest.mark.parametrize(
    ("mode", "digest"),
    [
        ("acceleration", "c2e55764f50c324d"),
        ("velocity", "94e494ca106ad2b6"),
        ("position", "68f29463604d852a"),
        ("effort", "33eb0b146da7c1d4"),
    ],
)
def test_a_seeded_run_is_the_same_to_the_last_bit_as_it_always_was(mode, digest):
    """All of it is sums, products, quotients and square roots, which every computer rounds alike."""
    parameters = AxisParameters(command_mode=mode)
    assert seeded_run(VirtualAxis(parameters, RigidPlant(0.8, T), buffer_samples=128), 7) == digest


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_a_hub_that_sticks_stands_still_and_lacks_the_way_afterwards(mode):
    parameters = AxisParameters(command_mode=mode)
    axis = enabled_axis(parameters)
    n = 400
    smooth = np.sin(np.pi * np.arange(n) / (n - 1)) ** 4
    way = {"acceleration": rest_to_rest(n, 0.5), "velocity": 0.05 * smooth, "position": 0.01 * smooth}[mode]
    assert axis.arm(axis.device_ns + TICK, n).success
    axis.append(0, way.tolist())
    axis.advance(axis.device_ns + 150 * TICK)
    where = axis.true_position
    axis.stick(is_stuck=True)
    ticks = axis.advance(axis.device_ns + 50 * TICK)
    assert axis.true_position == where
    assert len(set(ticks.position_counts[1:].tolist())) == 1
    axis.stick(is_stuck=False)
    lost = axis.reference_position - where
    assert abs(lost) > 1e-4
    axis.feed()
    axis.advance(axis.device_ns + 250 * TICK)
    assert axis.reference_position - axis.true_position == pytest.approx(lost, abs=1e-9)


def test_a_lying_encoder_shows_in_the_counts_alone():
    axis = enabled_axis(AxisParameters())
    axis.lie(0.002, 1.5)
    (count,) = axis.advance(axis.device_ns + TICK).position_counts
    assert count == round(0.002 / axis.parameters.encoder_resolution)
    assert axis.true_position == 0.0
