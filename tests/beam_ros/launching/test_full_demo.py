"""The demo at full length, on every kind of axis, held to the figures that the README gives."""

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


ACCEPTED = ("axis.accept_no_device_limits:=true", "axis.accept_no_device_watchdog:=true")
AXES: dict[str, tuple[str, ...]] = {
    "simulated": (),
    "emulated": (),
    "odrive": ("axis.kind:=odrive", "axis.metres_per_unit:=0.02", *ACCEPTED),
    "dynamixel": (
        *("axis.kind:=dynamixel", "axis.metres_per_unit:=0.032", "hub.max_speed:=0.056"),
        *("hub.encoder_resolution:=7.8e-6", *ACCEPTED),
    ),
    "controller": ("axis.kind:=trajectory_controller", "emulator.controller_rate:=250.0", *ACCEPTED),
}
"""What moves the hub: a tick of 1 ms twice, 200 positions a second of this host's, 250 cycles a second."""
LEAST_MODES = {"simulated": 2, "emulated": 2, "odrive": 1, "dynamixel": 1, "controller": 2}
"""Where the host paces the axis, a busy computer leaves gaps in the input, which may cut a mode off."""


def _demo(executables: Any, folder: Path, axis: str) -> dict[str, Any]:
    rig = "simulated" if axis == "simulated" else "emulated"
    words = [word for parameter in AXES[axis] for word in ("-p", parameter)]
    demo = executables.run(
        "beam", "demo", "--rig", rig, "--out", str(folder), "--json", *words, timeout_s=DEMO_S
    )
    output = demo.output()
    assert demo.process.returncode == 0, output
    result: dict[str, Any] = json.loads(output[output.index("{\n") :])
    return result


def test_all_demos_find_the_simulated_truth_and_agree_with_the_first(
    executables: Any, tmp_path: Path
) -> None:
    model = Rig.from_file().beam_model()
    models = {}
    for rig in AXES:
        result = _demo(executables, tmp_path / rig, rig)
        print(rig, json.dumps(result["modes"], indent=1))  # noqa: T201 - the figures, with `pytest -s`
        assert result["converged"]
        assert len(result["modes"]) >= LEAST_MODES[rig]
        for k, mode in enumerate(result["modes"]):
            truth = model.natural_frequencies[k] / (2 * math.pi)
            if k < 2:
                assert mode["frequency_hz"] == pytest.approx(truth, rel=3e-3)
                assert mode["damping_ratio"] == pytest.approx(model.damping_ratios[k], rel=0.15)
            assert abs(mode["frequency_hz"] - truth) < 4 * mode["frequency_sd_hz"]
            assert abs(mode["damping_ratio"] - model.damping_ratios[k]) < 4 * mode["damping_ratio_sd"]
        document = json.loads((tmp_path / rig / "model.json").read_text())
        models[rig] = ModalModel.from_dict(document["model"])
    for rig in list(AXES)[1:]:
        comparison = compare_models(models["simulated"], models[rig])
        print(rig, "chi-squared", comparison.chi_squared, "of", comparison.degrees_of_freedom)  # noqa: T201
        assert comparison.degrees_of_freedom >= 2 * LEAST_MODES[rig]
        assert comparison.chi_squared < chi2.ppf(0.999, comparison.degrees_of_freedom)
