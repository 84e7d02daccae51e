"""The excitation against the hub's limits and the beam's predicted motion."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from beam_ident import Recipe
from beam_ros.cli.offline import design as design_verb
from beam_ros.cli.offline.design import describe_design
from beam_ros.errors import UsageError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.rig.rig import Rig


def objection(rig: Rig, values: np.ndarray) -> str | None:
    """Why the hub's own guard would refuse these samples."""
    loads = rig.beam_guard().sequence()
    return loads.add(values) or loads.objection()


def test_the_default_chirp_keeps_the_tip_within_linear_theory() -> None:
    plan = plan_excitation(Rig.from_file())
    # 18.5 mm in mode 1 by the one-mode estimate for 0.7 m/s^2 over 20 s without gravity; upright a little more.
    assert 0.018 < plan.prediction.tip_deflection < 0.022
    assert np.max(np.abs(plan.sampled.positions)) <= 0.005
    assert np.max(np.abs(plan.sampled.accelerations)) <= 0.7 * (1 + 1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"excitation.acceleration": 2.0}, "hub.max_tip_deflection"),
        (
            {
                "excitation.kind": "multisine",
                "excitation.acceleration": 9.0,
                "excitation.start_frequency": 40.0,
            },
            "peak acceleration",
        ),
        ({"hub.travel": 0.005}, "peak travel"),
        ({"hub.max_speed": 0.01}, "peak speed"),
        ({"hub.max_effort": 0.1}, "hub.max_effort"),
        ({"beam.max_root_strain": 1e-4}, "beam.max_root_strain"),
    ],
)
def test_what_leaves_a_limit_is_refused_with_the_limit_named(change: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        plan_excitation(Rig.from_file().with_values(change))


@pytest.mark.parametrize("kind", ["chirp", "multisine", "step"])
@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_every_signal_in_every_mode_passes_the_hubs_own_guard(kind: str, mode: str) -> None:
    rig = Rig.from_file().with_values(
        {
            "excitation.kind": kind,
            "hub.command_mode": mode,
            "excitation.duration": 4.0,
            "excitation.still": 1.0,
            "excitation.acceleration": 0.2,
        }
    )
    plan = plan_excitation(rig)
    assert objection(rig, plan.values) is None
    assert np.all(np.isfinite(plan.values))


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_the_guard_refuses_a_resonant_sequence_in_every_mode(mode: str) -> None:
    rig = Rig.from_file().with_values({"hub.command_mode": mode})
    t = np.arange(8000) * 1e-3
    omega = rig.beam_model().natural_frequencies[0]
    x = 1e-3 * np.sin(omega * t)
    values = {"position": x, "velocity": np.gradient(x, t), "acceleration": -(omega**2) * x}[mode]
    assert "predicted tip" in str(objection(rig, values))


@pytest.mark.parametrize("kind", RIG_PARAMETERS["excitation.kind"].choices)
def test_every_kind_of_the_schema_makes_a_plan_with_the_packaged_values(kind: str, tmp_path: Path) -> None:
    rig = Rig.from_file().with_values(
        {"excitation.kind": kind, "excitation.acceleration": 0.2, "excitation.duration": 5.0}
    )
    if kind == "file":
        (tmp_path / "path.csv").write_text("t_s,x_mm\n0,0\n1,1\n2,0\n")
        rig = rig.with_values({"excitation.file": str(tmp_path / "path.csv")})
    if kind == "shaped_move":
        there = (0.4, *([0.0] * 999), -0.4)
        rig = rig.with_values({"excitation.command": there, "excitation.move_to": 0.0004})
    plan = plan_excitation(rig)
    assert objection(rig, plan.values) is None
    assert Recipe.from_dict(plan.info(rig)["recipe"]) == plan.recipe
    assert abs(plan.sampled.positions[-1]) < 1e-12


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (
            {"kind": "multisine", "lines": "random_odd", "detection_group": 5, "line_period": 4.0, "seed": 9},
            {"lines": "random_odd", "detection_group": 5, "line_period": 4.0, "n_periods": 5, "seed": 9},
        ),
        (
            {"kind": "multisine", "lines": "odd", "phases": "schroeder"},
            {"lines": "odd", "phases": "schroeder", "n_periods": 2, "line_period": 10.0},
        ),
        ({"kind": "linear_chirp", "max_velocity": 0.01}, {"max_velocity": 0.01, "duration": 20.0}),
        ({"kind": "chirp"}, {"max_velocity": 0.0}),
        (
            {"kind": "prbs", "drive": "velocity", "order": 9, "clock_period": 0.01, "edge_time": 0.01},
            {"drive": "velocity", "amplitude": 0.05, "order": 9, "edge_time": 0.01, "n_periods": 4},
        ),
        (
            {"kind": "prbs", "inverse_repeat": True, "order": 10, "high_pass": 2.0},
            {"inverse_repeat": True, "n_periods": 2, "high_pass": 2.0, "amplitude": 0.7},
        ),
        (
            {"kind": "pulse", "drive": "position", "step_size": -1e-4, "width": 0.3},
            {"amplitude": -1e-4, "width": 0.3},
        ),
        (
            {"kind": "sine", "start_frequency": 3.0, "duration": 10.0},
            {"start_frequency": 3.0, "duration": 10.0},
        ),
        (
            {"kind": "stepped_sine", "frequencies": [3.0, 5.0], "measure_cycles": 7},
            {"frequencies": (3.0, 5.0), "measure_cycles": 7},
        ),
        (
            {"kind": "moves", "waypoints": [0.01, 0.0], "profile": "quintic", "jerk": 5.0},
            {"waypoints": (0.01, 0.0), "profile": "quintic", "jerk": 5.0, "acceleration": 0.7},
        ),
    ],
)
def test_parameters_reach_their_recipe(values: dict[str, object], expected: dict[str, object]) -> None:
    rig = Rig.from_file().with_values({f"excitation.{name}": value for name, value in values.items()})
    recipe = recipe_of_rig(rig)
    assert {name: getattr(recipe, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"kind": "prbs", "clock_period": 0.0015}, "a whole number of periods of 0.001 s"),
        ({"kind": "moves", "waypoints": [0.001]}, "at least two displacements"),
        ({"kind": "noise", "end_frequency": 600.0}, "half the rate of hub.period"),
        ({"kind": "pulse", "edge_time": 1.0}, "at most width"),
        ({"max_jerk": 100.0}, "peak jerk"),
    ],
)
def test_parameters_that_make_no_signal_are_refused(values: dict[str, object], words: str) -> None:
    rig = Rig.from_file().with_values({f"excitation.{name}": value for name, value in values.items()})
    with pytest.raises(UsageError, match=words):
        plan_excitation(rig)


def test_a_design_tells_crest_factors_band_and_unresolved_modes() -> None:
    design = describe_design(Rig.from_file())
    assert [level["quantity"] for level in design["levels"]] == ["acceleration", "velocity", "position"]
    low, high = design["band_hz"]
    assert low < 1.5
    assert 85.0 < high < 100.0
    assert [mode["is_in_band"] for mode in design["modes"]] == [True, True, True, False, False]
    # 30 s tell 0.033 Hz apart, the first mode's band is 0.044 Hz wide.
    assert len(design["warnings"]) == 1
    assert "mode at 4.38" in design["warnings"][0]
    json.dumps(design)


def test_a_design_is_printed_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    design_verb.add_arguments(parser)
    assert design_verb.run(parser.parse_args(["-p", "excitation.kind:=multisine"])) == 0
    text = capsys.readouterr().out
    assert "e-0" not in text.partition("predicted tip [mm]")[2]  # no lengths of a few nanometres
    assert "< 0.001" in text
    (warning,) = [line for line in text.splitlines() if "half-power bands of" in line]
    assert warning.startswith("modes at 4.384 and 28.26 Hz: 0.44 and 2.8 lines")


def test_a_plan_describes_itself_completely() -> None:
    rig = Rig.from_file()
    info = plan_excitation(rig).info(rig)
    assert info["recipe"]["kind"] == "chirp"
    assert info["hold"] == "zoh"
    assert Rig.from_nested(info["rig"]) == rig


@pytest.mark.parametrize(("is_inverse", "n_periods"), [(False, 4), (True, 2)])
def test_a_binary_sequence_is_repeated_as_often_as_its_duration_holds_it(
    is_inverse: bool, n_periods: int
) -> None:
    # 511 clocks of 10 ms, and with the inverted half behind it twice that, in 20.5 s.
    changes = {
        "excitation.kind": "prbs",
        "excitation.order": 9,
        "excitation.clock_period": 0.01,
        "excitation.duration": 20.5,
        "excitation.inverse_repeat": is_inverse,
    }
    recipe = recipe_of_rig(Rig.from_file().with_values(changes))
    assert recipe.n_periods == n_periods
    assert recipe.total_s - recipe.still == pytest.approx(4 * 511 * 0.01, abs=0.5)


@pytest.mark.parametrize(("duration", "fade_in", "fade_out"), [(0.4, 0.1, 0.1), (20.0, 1.0, 0.25)])
def test_the_fades_of_a_chirp_take_at_most_a_quarter_of_it(
    duration: float, fade_in: float, fade_out: float
) -> None:
    recipe = recipe_of_rig(Rig.from_file().with_values({"excitation.duration": duration}))
    assert (recipe.fade_in, recipe.fade_out) == pytest.approx((fade_in, fade_out))
