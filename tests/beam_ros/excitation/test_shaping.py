"""Moves for a rig: within what its gate allows, and refused with a remedy where there is none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.shaping.known_beam import PoleDrift
from beam_ident.shaping.residual import nominal_swings
from beam_ros.errors import UsageError
from beam_ros.excitation.optimal import theory_of_drive
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.shaping import MoveOrder, RigMove, shape_for_rig, with_move
from beam_ros.rig.rig import Rig

RIG = Rig.from_file()
KNOWN = PoleDrift(5e-4, 0.05)


def identified(**changes: object) -> object:
    """Return the rig's theory of two modes as if it had been identified without uncertainty."""
    model = theory_of_drive(RIG)
    n, m = 2, len(model.output_names)
    size = 2 * n + 2 + m * (n + 2)
    return dataclasses.replace(
        model,
        natural_frequencies=model.natural_frequencies[:n],
        damping_ratios=model.damping_ratios[:n],
        residues=model.residues[:, :n],
        covariance=np.zeros((size, size)),
        **changes,
    )


@pytest.fixture(scope="module")
def forty() -> RigMove:
    return shape_for_rig(RIG, MoveOrder(0.0, 0.04, 1e-4, drift=KNOWN), identified())


@pytest.mark.slow
def test_forty_millimetres_that_the_tips_limit_forbids_unshaped_are_allowed_shaped(forty: RigMove) -> None:
    choice = forty.choice
    plain = choice.others[0]
    assert "tip deflection" in plain.objection
    with pytest.raises(UsageError, match="predicted tip deflection"):
        plan_excitation(with_move(RIG, plain.move, MoveOrder(0.0, 0.04, 1e-4)))
    plan = plan_excitation(forty.rig)
    assert plan.prediction.tip_deflection <= RIG.hub.max_tip_deflection
    assert choice.keeps_aim
    assert choice.chosen.probability < 0.05


@pytest.mark.slow
def test_the_rig_plays_exactly_the_command_that_was_chosen(forty: RigMove) -> None:
    plan = plan_excitation(forty.rig)
    command = forty.choice.chosen.move.accelerations
    assert plan.recipe.kind == "shaped_move"
    np.testing.assert_array_equal(plan.values[: len(command)], command)
    again = Rig.from_nested(forty.rig.to_nested())
    np.testing.assert_array_equal(plan_excitation(again).values, plan.values)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_an_axis_of_another_mode_is_commanded_in_it(mode: str) -> None:
    rig = RIG.with_values({"hub.command_mode": mode})
    found = shape_for_rig(rig, MoveOrder(0.01, 0.02, 1e-4, drift=KNOWN), identified())
    assert found.choice.chosen.move.quantity == mode
    assert len(plan_excitation(found.rig).values) > 0


def test_a_hub_under_force_is_refused_with_the_remedy() -> None:
    with pytest.raises(UsageError, match=r"set hub\.command_mode"):
        shape_for_rig(RIG.with_values({"hub.command_mode": "effort"}), MoveOrder(0.0, 0.02, 1e-4))


def test_places_outside_of_the_travel_an_aim_of_nothing_and_a_model_of_a_force_are_refused() -> None:
    with pytest.raises(UsageError, match="travel ends at"):
        shape_for_rig(RIG, MoveOrder(0.0, 0.08, 1e-4), identified())
    with pytest.raises(UsageError, match="aim is 0"):
        shape_for_rig(RIG, MoveOrder(0.0, 0.02, 0.0), identified())
    with pytest.raises(UsageError, match=r"hub\.command_mode"):
        shape_for_rig(RIG, MoveOrder(0.0, 0.02, 1e-4), identified(structure="receptance"))


@pytest.mark.parametrize("wrong", [1e-3, 1e3])
def test_frequencies_in_units_a_thousand_times_another_are_named_before_any_search(wrong: float) -> None:
    model = identified()
    scaled = dataclasses.replace(model, natural_frequencies=wrong * model.natural_frequencies)
    with pytest.raises(UsageError, match=r"first mode is at .*thousand times.*--rig-file"):
        shape_for_rig(RIG, MoveOrder(0.0, 0.02, 1e-4), scaled)


@pytest.mark.slow
def test_a_model_without_covariance_is_called_nominal(forty: RigMove) -> None:
    assert any("no covariance" in note for note in forty.notes)
    assert any("follow exactly" in note for note in forty.notes)


@pytest.mark.slow
def test_modes_that_drag_splits_are_one_where_curves_say_so() -> None:
    model = identified()
    omega = float(model.natural_frequencies[0])
    amplitudes = np.linspace(0.001, 0.01, 10)
    zetas, flat = 0.005 + 0.5 * amplitudes, np.full(10, 1e-5)
    hertz = np.full(10, omega / (2 * np.pi))
    band = np.stack([hertz, hertz])
    curves = AmplitudeCurves(
        *(amplitudes, hertz, band, zetas, band, flat, flat, False, 0.0, "", 0.01),
        *(np.array([omega, 0.0]), np.zeros(2), np.zeros((4, 4)), "z285", "m", flat[:1], True, "", 1, ()),
    )
    half = model.residues[:, :1] / 2.0
    split = dataclasses.replace(
        model,
        natural_frequencies=np.array([omega, 1.001 * omega, model.natural_frequencies[1]]),
        damping_ratios=np.array([0.006, 0.02, 0.005]),
        residues=np.concatenate([half, half, model.residues[:, 1:]], axis=1),
        covariance=np.zeros((8 + 3 * 5, 8 + 3 * 5)),
    )
    one, other = (
        shape_for_rig(RIG, MoveOrder(0.0, 0.01, 1e-3, drift=KNOWN), own, curves=curves)
        for own in (model, split)
    )
    assert other.choice.beam.model.n_modes == 2
    assert other.choice.beam.model.residues == pytest.approx(one.choice.beam.model.residues)
    swings = [nominal_swings(one.choice.others[0].move, own.choice.beam) for own in (one, other)]
    assert swings[0] == pytest.approx(swings[1])
