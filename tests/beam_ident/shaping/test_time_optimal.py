"""Time-optimal moves: their limits, their rest, and that nothing is quicker."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import ExcitationLimits, LimitedResponse
from beam_ident.errors import ExcitationError
from beam_ident.excitation import AxisLimits
from beam_ident.shaping.known_beam import KnownBeam, PoleDrift
from beam_ident.shaping.residual import nominal_swings
from beam_ident.shaping.time_optimal import MoveTask, lower_bound, shortest, time_optimal_move
from tests.beam_ident.shaping.beams import LIMITS, beam_model

BEAM = KnownBeam(beam_model())
TASK = MoveTask(0.0, 0.02, dataclasses.replace(LIMITS, period_s=4e-3))


def test_without_modes_to_still_the_quickest_move_is_the_textbooks() -> None:
    """Half the way at the largest acceleration, half at its negative: T = 2 sqrt(d / a)."""
    limits = ExcitationLimits(AxisLimits(travel=1.0, speed=9.0, acceleration=8.0, jerk=1e6), period_s=1e-3)
    task = MoveTask(0.0, 0.02, limits)
    bound = lower_bound(task, BEAM, 1.0, 400)
    assert bound == pytest.approx(2.0 * np.sqrt(0.02 / 8.0) / 1e-3, abs=1.0)


def test_a_move_keeps_its_limits_and_leaves_next_to_nothing() -> None:
    move = time_optimal_move(TASK, BEAM, 80)
    assert move is not None
    assert TASK.objection(move) == ""
    assert move.distance == pytest.approx(0.02, rel=1e-12)
    assert abs(move.velocities[-1]) < 1e-14
    assert np.max(nominal_swings(move, BEAM)) < 2e-6


def test_nothing_shorter_than_the_bound_exists_and_the_bound_itself_does() -> None:
    aim = 2e-5
    bound = lower_bound(TASK, BEAM, aim, 120)
    assert time_optimal_move(TASK, BEAM, bound, aim=aim) is not None
    assert time_optimal_move(TASK, BEAM, bound - 1, aim=aim) is None
    exact = KnownBeam(beam_model(0.0, 0.0))
    found = time_optimal_move(TASK, exact, bound + 2)  # the sum of two modes, in place of each
    assert found is not None
    assert np.max(nominal_swings(found, exact)) <= aim


def test_a_load_of_the_beam_is_kept_where_the_move_would_leave_it() -> None:
    free = time_optimal_move(TASK, BEAM, 90)
    assert free is not None
    bent = LimitedResponse(beam_model().driven_by("acceleration"), {"tip": 1.0})
    only_deflection = dataclasses.replace(bent, model=dataclasses.replace(bent.model, gains=np.zeros(2)))
    reached = float(
        np.max(
            np.abs(
                dataclasses.replace(TASK.limits, responses=(only_deflection,)).over_time(free.accelerations)[
                    -1
                ]
            )
        )
    )
    tighter = dataclasses.replace(only_deflection, limits={"tip": 0.9 * reached})
    task = dataclasses.replace(TASK, limits=dataclasses.replace(TASK.limits, responses=(tighter,)))
    assert "tip" in task.objection(free)
    held = time_optimal_move(task, BEAM, 90)
    assert held is not None
    assert task.objection(held) == ""


def test_known_disturbances_are_cancelled_by_the_command() -> None:
    beside = np.array([3e-3 + 1e-3j, 0.0])
    move = time_optimal_move(TASK, BEAM, 90, disturbance=beside)
    assert move is not None
    left = move.end_phasors(BEAM.model.poles) + beside
    assert np.all(np.abs(left) < 1e-4)


def test_a_robust_move_is_flatter_than_one_for_a_beam_that_is_known() -> None:
    other = dataclasses.replace(BEAM.model, natural_frequencies=1.01 * BEAM.model.natural_frequencies)
    sure, robust = (
        time_optimal_move(TASK, KnownBeam(beam_model(), PoleDrift(sd, 0.0)), 90) for sd in (0.0, 0.01)
    )
    assert sure is not None
    assert robust is not None
    left = [np.max(nominal_swings(move, KnownBeam(other))) for move in (sure, robust)]
    assert left[1] < 0.5 * left[0]


def test_places_outside_of_the_travel_and_unlimited_axes_are_refused() -> None:
    with pytest.raises(ExcitationError, match="travel ends"):
        MoveTask(0.0, 0.06, LIMITS)
    with pytest.raises(ExcitationError, match="nowhere"):
        MoveTask(0.01, 0.01, LIMITS)
    with pytest.raises(ExcitationError, match="no largest jerk"):
        MoveTask(0.0, 0.01, ExcitationLimits(AxisLimits(travel=0.05, speed=1.0, acceleration=1.0)))


def test_halving_finds_the_first_length() -> None:
    move = time_optimal_move(TASK, BEAM, 80)
    assert shortest(lambda n: move if n >= 17 else None, 2, 100)[0] == 17
