"""The demo at full length, both ways, held to the figures that the README gives."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import chi2

from beam_ident import ModalModel, compare_models
from beam_ros.rig.rig import Rig

pytestmark = [pytest.mark.verify, pytest.mark.ros]
pytest.importorskip("rclpy")

DEMO_S = 120.0
"""A demo takes less than two minutes after the set-up."""


def _demo(executables: Any, folder: Path, rig: str) -> dict[str, Any]:
    demo = executables.run("beam", "demo", "--rig", rig, "--out", str(folder), "--json", timeout_s=DEMO_S)
    output = demo.output()
    assert demo.process.returncode == 0, output
    result: dict[str, Any] = json.loads(output[output.index("{\n") :])
    return result


def test_both_demos_find_the_simulated_truth_and_agree_with_each_other(
    executables: Any, tmp_path: Path
) -> None:
    model = Rig.from_file().beam_model()
    models = []
    for rig in ("simulated", "emulated"):
        result = _demo(executables, tmp_path / rig, rig)
        print(rig, json.dumps(result["modes"], indent=1))  # noqa: T201 - the figures, with `pytest -s`
        assert result["converged"]
        assert len(result["modes"]) >= 2
        for k, mode in enumerate(result["modes"]):
            truth = model.natural_frequencies[k] / (2 * math.pi)
            if k < 2:
                assert mode["frequency_hz"] == pytest.approx(truth, rel=3e-3)
                assert mode["damping_ratio"] == pytest.approx(model.damping_ratios[k], rel=0.15)
            assert abs(mode["frequency_hz"] - truth) < 4 * mode["frequency_sd_hz"]
            assert abs(mode["damping_ratio"] - model.damping_ratios[k]) < 4 * mode["damping_ratio_sd"]
        document = json.loads((tmp_path / rig / "model.json").read_text())
        models.append(ModalModel.from_dict(document["model"]))
    comparison = compare_models(*models)
    print("chi-squared", comparison.chi_squared, "of", comparison.degrees_of_freedom)  # noqa: T201
    assert comparison.degrees_of_freedom >= 4
    assert comparison.chi_squared < chi2.ppf(0.999, comparison.degrees_of_freedom)
