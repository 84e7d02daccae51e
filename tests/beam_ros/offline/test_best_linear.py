from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beam_ident import BestLinearApproximation, LogChirp
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.best_linear import best_linear_of
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

pytestmark = pytest.mark.slow

RIG = Rig.from_file().with_values(
    {
        "excitation.kind": "multisine",
        "excitation.lines": "random_odd",
        "excitation.line_period": 1.0,
        "excitation.duration": 6.0,
        "excitation.still": 0.0,
        "excitation.end_frequency": 30.0,
        "simulation.drag_coefficient": 60.0,
        "excitation.acceleration": 1.5,
        "simulation.hub_clock_ppm": 80.0,
        "beam.damping_ratios": [0.05],
    }
)


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> list[Path]:
    """Two realisations of a multisine on a strip in heavy air, on a hub whose clock is fast."""
    folder = tmp_path_factory.mktemp("bags")
    for seed in (1, 2):
        simulate(RIG.with_values({"excitation.seed": seed, "simulation.seed": seed}), folder / f"b{seed}")
    return [folder / f"b{seed}" for seed in (1, 2)]


def test_air_shows_as_odd_distortion_on_the_command_line(bags, tmp_path, capsys):
    arguments = ["identify", *map(str, bags), "--best-linear", "--modes", "1", "--json"]
    arguments += ["--estimator", "local_polynomial"]
    assert main(arguments) == 0
    found = BestLinearApproximation.from_dict(json.loads(capsys.readouterr().out)["best_linear"])
    # The air's force goes with |v| v, which is odd.
    assert {level.parity for level in found.distortion.levels if level.is_detected} == {"odd"}
    assert found.verdict.startswith("nonlinear")
    assert found.reference_name == "command"
    assert min(found.n_periods) >= 3
    # Off by the air's share of the damping alone: the static response of a clamped strip is 1.
    assert np.abs(found.response[0]) == pytest.approx([1.0, 1.0, 1.0], abs=0.15)


def test_a_bag_that_is_no_realisation_is_named_with_the_remedy(bags):
    experiments = [load_experiment(bag) for bag in bags]
    other = {**experiments[1].info["recipe"], "line_period": 2.0}
    with pytest.raises(UsageError, match=r"periods 1, 2 s; expected one: record a multisine"):
        best_linear_of(
            [experiments[0], replace(experiments[1], info={**experiments[1].info, "recipe": other})]
        )
    for recipe, says in (
        ({}, "does not say what its excitation was"),
        ({"recipe": LogChirp().to_dict()}, "a chirp"),
    ):
        info = {key: value for key, value in experiments[1].info.items() if key != "recipe"} | recipe
        with pytest.raises(UsageError, match=says):
            best_linear_of([experiments[0], replace(experiments[1], info=info)])
