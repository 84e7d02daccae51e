"""Beams that the rig file does not have, found again from their modes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beam_ident import ModalModel
from beam_model import ParameterPrior
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.reporting.physical_fit import fit_rig, read_priors
from beam_ros.rig.rig import Rig

TRUTH = {
    "beam.youngs_modulus": 205e9,
    "beam.viscous_damping": 0.02,
    "beam.internal_damping": 1e-5,
    "beam.damping_ratios": [0.0],
    "beam.tip_mass": 0.003,
}


def write_model(path: Path, rig: Rig, n_modes: int = 3, seed: int = 1, first: int = 0) -> Path:
    """Modes of a rig as an identification would store them: with noise, and a camera's scale of 0.5 %."""
    rng = np.random.default_rng(seed)
    theory = rig.beam_model()
    kept = slice(first, first + n_modes)
    omega, zeta = theory.natural_frequencies[kept], theory.damping_ratios[kept]
    r = theory.motion_residues(rig.markers.heights)[:, kept]
    n, m = n_modes, len(rig.markers.names)
    scale = 1.005
    values = np.concatenate(
        [omega, zeta, [0.0, 0.0], *(np.r_[scale, 0.0, scale * row] for row in r)],
    )
    sd = np.concatenate(
        [1e-5 * omega, 1e-3 * zeta, [0.0, 0.0], *(np.r_[1e-4, 0.0, np.full(n, 1e-4)] for _ in r)]
    )
    drawn = values + sd * rng.standard_normal(len(values))
    per_output = drawn[2 * n + 2 :].reshape(m, n + 2)
    model = ModalModel(
        structure="base_motion",
        input_name="hub",
        output_names=rig.markers.names,
        natural_frequencies=drawn[:n],
        damping_ratios=drawn[n : 2 * n],
        residues=per_output[:, 2:],
        residual_terms=np.zeros(m),
        gains=per_output[:, 0],
        latency=0.0,
        clock_rate=0.0,
        covariance=np.diag(sd**2),
        noise_sd=np.full(m, 1e-5),
    )
    path.write_text(json.dumps({"model": model.to_dict()}), encoding="utf-8")
    return path


def test_stiffness_and_damping_come_back(tmp_path: Path) -> None:
    truth = Rig.from_file().with_values(TRUTH)
    write_model(tmp_path / "model.json", truth)
    found = fit_rig(Rig.from_file().with_values({"beam.tip_mass": 0.003}), tmp_path)
    assert found.fit.names == ("stiffness", "viscous", "internal")
    assert found.rig_parameters["beam.youngs_modulus"] == pytest.approx(205e9, rel=1e-3)
    # Damping ratios are taken for true to 5 %.
    assert found.rig_parameters["beam.viscous_damping"] == pytest.approx(0.02, rel=0.02)
    assert found.rig_parameters["beam.internal_damping"] == pytest.approx(1e-5, rel=0.02)
    assert found.fitted_hz == pytest.approx(found.measured_hz, rel=1e-4)
    again = Rig.from_file().with_values({**TRUTH, **found.rig_parameters})
    assert again.beam_model().natural_frequencies[:3] / (2 * np.pi) == pytest.approx(
        found.measured_hz, rel=1e-4
    )
    assert "does not explain" not in found.to_text()


@pytest.mark.slow
def test_a_tip_mass_needs_its_prior_and_takes_residues(tmp_path: Path) -> None:
    file = write_model(tmp_path / "model.json", Rig.from_file().with_values(TRUTH))
    with pytest.raises(UsageError, match="tip_mass needs a stated prior"):
        fit_rig(Rig.from_file(), file, ("stiffness", "tip_mass"))
    found = fit_rig(
        Rig.from_file(), file, ("stiffness", "tip_mass"), {"tip_mass": ParameterPrior(0.002, 0.002)}
    )
    assert found.marker_names == ("z010", "z225", "z285")
    k = found.fit.names.index("tip_mass")
    assert abs(found.fit.values[k] - 0.003) < 3.0 * found.fit.standard_deviations[k]
    assert found.fit.standard_deviations[k] < 2e-4
    assert "with residues" in found.to_text()


def test_a_beam_that_is_another_one_is_said_not_to_explain_the_modes(tmp_path: Path) -> None:
    file = write_model(tmp_path / "model.json", Rig.from_file().with_values(TRUTH))
    assert "does not explain the modes" in fit_rig(Rig.from_file(), file).to_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"first": 1}, "expected the first|the first identified mode lies at"),
        ({"n_modes": 1}, "stiffness"),
    ],
)
def test_modes_that_are_not_the_first_ones_are_refused_or_left_out(
    tmp_path: Path, options: dict[str, int], words: str
) -> None:
    file = write_model(tmp_path / "model.json", Rig.from_file().with_values(TRUTH), **options)
    if options.get("first"):
        with pytest.raises(UsageError, match=words):
            fit_rig(Rig.from_file().with_values(TRUTH), file)
    else:
        assert fit_rig(Rig.from_file().with_values(TRUTH), file).fit.names == ("stiffness", "viscous")


def test_the_verb_prints_it_and_refuses_what_is_no_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_model(tmp_path / "model.json", Rig.from_file().with_values(TRUTH))
    assert main(["model", "--fit", str(file), "-p", "beam.tip_mass:=0.003", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rig"]["beam.youngs_modulus"] == pytest.approx(205e9, rel=1e-3)
    assert told["separation"][0]["parameters"] == ["flexural_rigidity", "tip_mass"]
    for wrong in (["--fit", str(tmp_path / "no.json")], ["--free", "viscous"], ["--prior", "viscous=1:1"]):
        assert main(["model", *wrong]) == 2
        assert "beam model: " in capsys.readouterr().err
    with pytest.raises(UsageError, match="two numbers of which the second is above 0"):
        read_priors(["tip_mass=0.003:0"])
    with pytest.raises(UsageError, match="with a name of stiffness"):
        read_priors(["mass=0.003:0.1"])


def test_what_the_page_of_the_beam_says_for_people_is_called_by_a_verb() -> None:
    root = Path(__file__).parents[3]
    page = (root / "docs" / "beam-model.md").read_text(encoding="utf-8")
    written = "\n".join(file.read_text(encoding="utf-8") for file in (root / "beam_ros").rglob("*.py"))
    summary = (root / "beam_model" / "advice" / "summary.py").read_text(encoding="utf-8")
    for name in ("fit_beam", "identifiability", "compare_with_theory", "summarise", "validity", "advise"):
        assert f"`{name}`" in page
        assert re.search(rf"\b{name}\(", written + summary)
