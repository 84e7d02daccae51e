"""The phases of a set-point against the axis's own profiles, tick by tick."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.kinematics import answer, braked_velocity, command_towards, in_ticks, ramp
from beam_ros.hub.parameters import AxisParameters


def of_the_axis(parameters: AxisParameters, setpoint: float, x: float, v: float, n_ticks: int) -> np.ndarray:
    """Positions of an axis that follows a set-point, as ``HubMotion`` integrates them."""
    period, positions = parameters.period, [x]
    for _ in range(n_ticks):
        command = command_towards(setpoint, x, v, parameters)
        if parameters.command_mode == "position":
            v, x = (command - x) / period, command
        else:
            v = command
            x += v * period
        positions.append(x)
    return np.array(positions)


def of_the_phases(
    parameters: AxisParameters, setpoint: float, x: float, v: float, n_ticks: int
) -> np.ndarray:
    positions = [x]
    for length, acceleration in in_ticks(answer(setpoint, x, v, parameters), parameters.period, n_ticks):
        for _ in range(length):
            x += (v + acceleration * parameters.period / 2) * parameters.period
            v += acceleration * parameters.period
            positions.append(x)
    return np.array(positions)


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_phases_follow_the_axis_within_its_ticks(mode: str) -> None:
    rng = np.random.default_rng(3)
    parameters = AxisParameters(command_mode=mode)
    for _ in range(40):
        x, v = rng.uniform(-0.02, 0.02), rng.uniform(-0.05, 0.05) * rng.integers(2)
        setpoint = rng.uniform(-0.02, 0.02) if mode == "position" else rng.uniform(-0.5, 0.5)
        truth = of_the_axis(parameters, setpoint, x, v, 1500)
        found = of_the_phases(parameters, setpoint, x, v, 1500)
        assert len(found) == len(truth)
        # The axis's velocity jumps at a tick where the phases' is ramped: half a tick of speed at most, and for
        # moves, phases that are rounded to ticks.
        assert np.abs(found - truth).max() < 1e-3 * (0.5 if mode == "velocity" else 0.1)
        if mode == "position":
            phases = in_ticks(answer(setpoint, x, v, parameters), parameters.period)
            n_ticks = sum(phase.n_ticks for phase in phases)
            assert np.abs(truth[min(n_ticks + 3, 1500) :] - setpoint).max(initial=0.0) < 1e-5
            assert n_ticks < 3 or np.abs(truth[max(0, n_ticks - 40)] - setpoint) > 1e-6


def test_a_stop_takes_as_long_as_the_axis_needs() -> None:
    parameters = AxisParameters()
    for velocity in (0.5, -0.2345, 0.01, 1e-5):
        v, n_ticks = velocity, 0
        while v:
            v, n_ticks = braked_velocity(v, parameters), n_ticks + 1
        (phase,) = in_ticks([ramp(velocity, 0.0, parameters.stop_deceleration)], parameters.period)
        assert phase.n_ticks == n_ticks
        assert velocity + phase.drive * n_ticks * parameters.period == pytest.approx(0.0, abs=1e-15)
    assert in_ticks([ramp(0.1, 0.1, 10.0)], 1e-3) == []
