"""A shaped move as a recipe: exactly the command that was given, quiet ways around it, and home at the end."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from beam_ident.errors import ExcitationError
from beam_ident.excitation import AxisLimits, Recipe, ShapedMove
from beam_ident.shaping.command import s_curve

LIMITS = AxisLimits(travel=0.05, speed=0.5, acceleration=8.0, jerk=600.0)


def recipe(start: float, end: float, **more: float) -> ShapedMove:
    command = s_curve(end - start, LIMITS, 1e-3).accelerations
    return ShapedMove(start, end, 2e-5, 1e-3, tuple(command.tolist()), **{"dwell": 0.3, "still": 0.2, **more})


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.03), (0.04, 0.03), (-0.02, 0.0), (-0.045, 0.045)])
def test_it_goes_from_place_to_place_as_commanded_and_home_again(start: float, end: float) -> None:
    own = recipe(start, end)
    sampled = own.sample(1e-3, LIMITS)
    first, last = round(own.move_start_s / 1e-3), round(own.move_end_s / 1e-3)
    assert sampled.accelerations[first:last] == pytest.approx(own.command, abs=1e-15)
    assert sampled.positions[first] == pytest.approx(start, abs=1e-12)
    assert sampled.positions[last] == pytest.approx(end, abs=1e-12)
    assert sampled.positions[-1] == pytest.approx(0.0, abs=1e-12)
    assert sampled.velocities[-1] == pytest.approx(0.0, abs=1e-13)
    assert len(sampled.accelerations) * 1e-3 == pytest.approx(own.total_s)
    rest = sampled.accelerations[last : last + 300]
    assert not np.any(rest), "it rests after the move"


def test_ways_from_home_are_no_longer_than_the_move() -> None:
    own = recipe(0.045, 0.035)
    sampled = own.sample(1e-3)
    approach = sampled.accelerations[: round((own.move_start_s - 0.3) / 1e-3)]
    assert np.max(np.abs(approach)) <= np.max(np.abs(own.command)) * (1.0 + 1e-12)


def test_displacements_between_ticks_are_those_of_held_accelerations() -> None:
    own = recipe(0.0, 0.03)
    sampled = own.sample(1e-3)
    ticks = np.arange(len(sampled.positions)) * 1e-3
    assert own.displacement(ticks) == pytest.approx(sampled.positions, abs=1e-14)
    middle = own.displacement(np.array([0.0305]))[0]
    a, v, x = sampled.accelerations[30], sampled.velocities[30], sampled.positions[30]
    assert middle == pytest.approx(x + v * 5e-4 + 0.5 * a * 25e-8, abs=1e-14)


def test_it_is_written_down_without_loss() -> None:
    own = recipe(0.01, 0.03)
    assert Recipe.from_dict(json.loads(json.dumps(own.to_dict()))) == own


def test_another_tick_a_missing_command_and_one_that_goes_elsewhere_are_refused() -> None:
    own = recipe(0.0, 0.03)
    with pytest.raises(ExcitationError, match=r"axis's tick is 0\.002 s"):
        own.sample(2e-3)
    with pytest.raises(ExcitationError, match="beam shape"):
        ShapedMove(command=(0.0,))
    with pytest.raises(ExcitationError, match="shape the move anew"):
        dataclasses.replace(own, move_to=0.031)
    with pytest.raises(ExcitationError, match="another place"):
        dataclasses.replace(own, move_to=0.0)
