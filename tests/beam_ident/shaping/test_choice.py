"""The choice: the shortest move that keeps the aim, or the best one with what would be needed."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from beam_ident.errors import ExcitationError
from beam_ident.shaping.choice import choose_move
from beam_ident.shaping.known_beam import AxisErrors, KnownBeam, PoleDrift
from beam_ident.shaping.residual import ALLOWED, predict_residual
from beam_ident.shaping.time_optimal import MoveTask
from tests.beam_ident.shaping.beams import LIMITS, beam_model

TASK = MoveTask(0.0, 0.02, dataclasses.replace(LIMITS, period_s=4e-3))


@pytest.fixture(scope="module")
def chosen() -> object:
    return choose_move(TASK, KnownBeam(beam_model(), PoleDrift(5e-4, 0.05)), 5e-5)


def test_the_chosen_move_keeps_aim_and_limits_and_no_other_that_does_is_shorter(chosen: object) -> None:
    own = chosen.chosen  # type: ignore[attr-defined]
    assert chosen.keeps_aim  # type: ignore[attr-defined]
    assert own.probability < ALLOWED
    assert own.objection == ""
    for trial in chosen.shapers:  # type: ignore[attr-defined]
        assert not trial.is_fine or trial.move.duration_s >= own.move.duration_s
    assert 0.0 < chosen.lower_bound_s <= own.move.duration_s  # type: ignore[attr-defined]


def test_other_draws_agree_that_the_aim_is_kept(chosen: object) -> None:
    beam = dataclasses.replace(chosen.beam, seed=99)  # type: ignore[attr-defined]
    assert predict_residual(chosen.chosen.move, beam).probability_above(5e-5) < ALLOWED + 0.01  # type: ignore[attr-defined]


def test_a_better_known_beam_is_moved_as_quickly_or_quicker(chosen: object) -> None:
    known = choose_move(TASK, KnownBeam(beam_model(1e-5, 1e-3)), 5e-5)
    assert known.chosen.move.duration_s <= chosen.chosen.move.duration_s  # type: ignore[attr-defined]
    # Where nothing is uncertain, the robust optimum is the bound itself, but for a tick or two of polygons.
    assert known.chosen.move.duration_s <= known.lower_bound_s + 2 * TASK.period_s


def test_textbook_values_leave_more_than_identified_ones(chosen: object) -> None:
    by_name = {trial.move.name: trial for trial in chosen.others}  # type: ignore[attr-defined]
    textbook = next(trial for name, trial in by_name.items() if "damping 0.1" in name)
    assert np.max(textbook.residual.median) > 20.0 * np.max(chosen.chosen.residual.median)  # type: ignore[attr-defined]
    assert by_name["S-curve, as long"].move.duration_s == pytest.approx(
        chosen.chosen.move.duration_s,  # type: ignore[attr-defined]
        abs=2 * TASK.period_s,
    )


@pytest.mark.slow
def test_poles_known_to_ten_per_cent_are_told_how_well_they_would_have_to_be_known() -> None:
    short = dataclasses.replace(TASK, end=0.03)
    found = choose_move(short, KnownBeam(beam_model(0.1, 0.1)), 3e-6)
    assert not found.keeps_aim
    assert "first frequency known to" in found.needed
    assert "now 10 %" in found.needed


def test_an_axis_that_strays_too_far_is_named() -> None:
    found = choose_move(TASK, KnownBeam(beam_model(), axis=AxisErrors(1e-4, ((1.0, 1e-5),))), 1e-5)
    assert not found.keeps_aim
    assert "lags 100 um by friction" in found.needed


def test_an_axis_without_friction_that_strays_is_not_blamed_for_lagging() -> None:
    beam = KnownBeam(beam_model(), axis=AxisErrors(0.0, ((1.0, 1e-4),)))
    assert re.search(r"the hub strays by \S+ um: needed is", choose_move(TASK, beam, 1e-5).needed)


@pytest.mark.parametrize("aim", [0.0, -1e-5, np.nan, 20.0])
def test_an_aim_that_is_no_length_is_refused(aim: float) -> None:
    with pytest.raises(ExcitationError, match="length above 0"):
        choose_move(TASK, KnownBeam(beam_model()), aim)
