"""Plans against the device's own integration, tick by tick, and against closed forms."""

from __future__ import annotations

import re

import numpy as np
import pytest

from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.motion import HubMotion
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import rest_to_rest

MODES = ("acceleration", "velocity", "position")


def _samples(mode: str) -> np.ndarray:
    accelerations = np.repeat(rest_to_rest(200), 3)
    velocities = np.cumsum(accelerations) * 1e-3
    return {
        "acceleration": accelerations,
        "velocity": velocities,
        "position": 0.003 + np.concatenate(([0.0], np.cumsum(velocities) * 1e-3)),
    }[mode]


@pytest.mark.parametrize("mode", MODES)
def test_a_sequence_goes_where_the_device_would_take_it_at_every_instant(mode: str) -> None:
    parameters = AxisParameters(command_mode=mode)
    values = _samples(mode)
    device = HubMotion(parameters, RigidPlant(0.8, 1e-3), SimulatedDevice(initial_position=0.003))
    for value in values[1:] if mode == "position" else values:
        device.follow(value)
    instants = np.arange(1, device.tick * 4) * 250_000
    plan = MotionPlan.sequence(values, parameters, 0.003)
    positions, _, _ = plan.sample(instants * 1e-9)
    # Counting 1e-3 s in doubles leaves 1e-16 s, and the hub moves at centimetres a second.
    np.testing.assert_allclose(positions, device.snapshots(instants).positions, rtol=0, atol=2e-15)
    assert plan.objection(parameters) == ""


def test_equal_samples_in_a_row_are_one_piece_and_nothing_is_lost() -> None:
    values = np.repeat([0.5, -0.5, 0.0, -0.5, 0.5], [300, 300, 400, 300, 300])
    plan = MotionPlan.sequence(values, AxisParameters(), 0.0)
    assert len(plan.accelerations) == 5
    np.testing.assert_array_equal(plan.sample(np.arange(1600) * 1e-3)[2], values)
    assert plan.at(1.6) == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)
    assert plan.positions[2] == pytest.approx(0.5 * 0.3**2)


@pytest.mark.parametrize("velocity", [0.0, 0.04, -0.04, 0.2])
@pytest.mark.parametrize("target", [0.02, -0.001, 0.0003])
def test_a_move_ends_at_rest_on_its_target_within_speed_and_acceleration(
    target: float, velocity: float
) -> None:
    plan = MotionPlan.move(0.001, velocity, target, 0.05, 0.5)
    times = np.linspace(0.0, plan.duration, 20_001)
    positions, velocities, _ = plan.sample(times)
    assert positions[-1] == pytest.approx(target, abs=1e-14)
    # The velocity is the position's derivative, and never jumps: 3e-6 s of 0.5 m/s^2.
    np.testing.assert_allclose(np.diff(positions) / np.diff(times), velocities[:-1], atol=1e-4)
    assert np.max(np.abs(np.diff(velocities))) < 1.01 * 0.5 * times[1]
    assert np.max(np.abs(velocities)) <= max(0.05, abs(velocity)) + 1e-12


def test_a_move_is_no_slower_than_a_trapezoid_can_be() -> None:
    # Up to 0.05 m/s in 0.1 s and 2.5 mm, down likewise, and 15 mm between.
    assert MotionPlan.move(0.0, 0.0, 0.02, 0.05, 0.5).duration == pytest.approx(0.5)
    # Too short for the full speed: 2 sqrt(d / a).
    assert MotionPlan.move(0.0, 0.0, 0.002, 0.05, 0.5).duration == pytest.approx(2 * np.sqrt(0.002 / 0.5))


@pytest.mark.parametrize(("mode", "value"), [("acceleration", 0.2), ("velocity", -0.03)])
def test_a_set_point_lasts_for_the_watchdogs_time_and_then_stops(mode: str, value: float) -> None:
    parameters = AxisParameters(command_mode=mode, stop_deceleration=4.0)
    plan = MotionPlan.towards(0.01, 0.02, value, parameters)
    held = plan.at(0.25 - 1e-9)[1]
    expected = 0.02 + 0.2 * 0.25 if mode == "acceleration" else -0.03
    assert held == pytest.approx(expected, abs=1e-8)
    assert plan.duration == pytest.approx(0.25 + abs(held) / 4.0, abs=1e-8)
    assert plan.at(plan.duration)[1] == 0.0


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        ([(0.1, 6.0), (0.1, -6.0)], "would reach 0.6 m/s"),
        ([(0.01, 12.0), (0.01, -12.0)], "needs 12 m/s"),
        ([(0.4, 0.4), (0.4, -0.4)], "would take the hub to 0.064"),
        ([(0.5, 1.0), (1.0, -1.0)], "would reach|would take the hub to 0.2"),
    ],
)
def test_a_plan_beyond_a_limit_is_refused_wherever_it_is_exceeded(pieces: list, words: str) -> None:
    reason = MotionPlan.ramps(0.0, 0.0, pieces).objection(AxisParameters())
    assert re.search(words, reason)


def test_a_turn_between_two_knots_counts_as_reached() -> None:
    # 0.4 m/s against 2 m/s^2 turns 40 mm further on, at 0.2 s, and is back at 0.4 s.
    plan = MotionPlan.ramps(0.02, 0.4, [(0.4, -2.0), (0.2, 2.0)])
    assert "0.060000 m" in plan.objection(AxisParameters())
    assert plan.objection(AxisParameters(travel=0.1201)) == ""
