"""Estimators by name: those of the table, and one that another package adds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beam_ident import (
    ESTIMATORS,
    EstimationError,
    EstimatorSettings,
    InputSignal,
    OutputSignal,
    Prior,
    TimeRecord,
    estimator_meanings,
    find_estimator,
    restore,
    run_estimator,
)
from beam_ros.cli.main import main
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig
from tests.beam_ident import result_cases
from tests.beam_ident.test_exports import loaded_after

SHORT = {
    "excitation.duration": 3.0,
    "excitation.still": 1.0,
    "excitation.end_frequency": 12.0,
    "markers.names": ["z285"],
    "markers.heights": [0.285],
    "markers.height_uncertainties": [0.0005],
    "markers.masses": [0.0],
}

TOY = """
from types import SimpleNamespace
import numpy as np

def estimate(record, settings):
    seen = record.outputs[0]
    peak = seen.times_s[np.argmax(np.abs(seen.values))]
    model = SimpleNamespace(to_dict=lambda: {"type": "toy", "peak_s": float(peak)})
    said = (f"the largest sample of {seen.name} is at {peak:.2f} s",)
    return SimpleNamespace(model=model, converged=True, reason="looked once", iterations=0, warnings=said)

def nothing(record, settings):
    return None
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short experiment that excites the first mode alone."""
    path = tmp_path_factory.mktemp("seen") / "bag"
    simulate(Rig.from_file().with_values(SHORT), path)
    return path


@pytest.fixture(scope="module")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same once more, with other noise."""
    path = tmp_path_factory.mktemp("unseen") / "bag"
    simulate(Rig.from_file().with_values({**SHORT, "simulation.seed": 21}), path)
    return path


@pytest.fixture
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of a laboratory, installed as pip leaves one."""
    folder = tmp_path / "installed"
    (folder / "toy_lab-1.0.dist-info").mkdir(parents=True)
    (folder / "toy_lab.py").write_text(TOY)
    about = folder / "toy_lab-1.0.dist-info"
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-lab\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[beam_ident.estimators]\npeak = toy_lab:estimate\nempty = toy_lab:nothing\n"
        "gone = toy_lab.nowhere:estimate\nmodal = toy_lab:nothing\n"
    )
    monkeypatch.syspath_prepend(str(folder))


@pytest.mark.slow
@pytest.mark.usefixtures("laboratory")
def test_the_estimator_of_another_package_identifies_a_bag(
    tmp_path: Path, bag: Path, unseen: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(bag), "--estimator", "peak", "--report", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "note: the largest sample of z285 is at" in printed
    assert "report.html" in printed
    assert '"type": "toy"' in (tmp_path / "out" / "model.json").read_text()
    assert main(["identify", str(bag), "--estimator", "peak", "--validate", str(unseen)]) == 2
    assert "take the estimator modal" in capsys.readouterr().err
    assert main(["identify", "--help"]) == 0
    assert "peak               added by toy-lab" in capsys.readouterr().out


@pytest.mark.usefixtures("laboratory")
def test_the_librarys_own_estimators_cannot_be_replaced_and_a_broken_one_says_whose_it_is() -> None:
    assert find_estimator("modal").__module__ == "beam_ident.record_estimators"
    assert estimator_meanings()["modal"] == ESTIMATORS["modal"].meaning
    with pytest.raises(EstimationError, match=r"toy_lab\.nowhere:estimate .*install that package anew"):
        find_estimator("gone")
    with pytest.raises(EstimationError, match="returned a NoneType; expected a Result"):
        run_estimator("empty", result_cases.record(), EstimatorSettings())


@pytest.mark.parametrize(
    ("name", "hint"),
    [("modl", "did you mean 'modal'"), ("xyz", "a package adds one as entry point of beam_ident.estimators")],
)
def test_an_unknown_name_is_answered_with_the_likeliest(name: str, hint: str) -> None:
    with pytest.raises(EstimationError, match=f"estimator is '{name}': expected one of modal, .*; {hint}"):
        find_estimator(name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["modal", "transfer_function", "common_poles", "po_moesp", "local_polynomial"]
)
def test_an_estimator_of_every_kind_of_result_identifies_a_bag(
    name: str, tmp_path: Path, bag: Path, unseen: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    validation = () if name == "po_moesp" else ("--validate", str(unseen))
    options = ("--estimator", name, "--modes", "1", "--report", str(out))
    assert main(["identify", str(bag), *options, *validation]) == 0
    printed = capsys.readouterr().out
    assert ("prediction: FIT" in printed) == (name != "po_moesp")
    assert ("do not trust this damping ratio" in printed) == (name == "local_polynomial")
    assert {path.name for path in out.iterdir()} == {"figures", "model.json", "poles.csv", "report.html"}
    document = json.loads((out / "model.json").read_text())
    for stored in document.get("models", [document.get("model")]):
        assert restore(stored).to_dict() == stored
    # The first mode, 4.3839 Hz: lines of 0.3 Hz place it within a fraction of one.
    assert "4.38" in printed if name != "local_polynomial" else "4.3" in printed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["common_poles", "po_moesp"])
def test_degrees_are_chosen_where_none_are_given(name: str) -> None:
    found = run_estimator(name, result_cases.record(), EstimatorSettings("receptance"))
    models = getattr(found, "models", (found,))
    assert all(len(model.modes()[0]) >= 1 for model in models)
    assert models[0].modes()[0][0] == pytest.approx(20.0, rel=0.01)
    assert found.converged


@pytest.mark.first_case
@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_offset_and_a_drift_of_the_outputs_move_no_pole(name: str) -> None:
    record = result_cases.record()
    drifting = tuple(
        OutputSignal(own.name, own.unit, own.times_s, own.values + np.std(own.values) * (10.0 + own.times_s))
        for own in record.outputs
    )
    found = run_estimator(name, TimeRecord(record.inputs, drifting), EstimatorSettings("receptance", 1))
    for model in getattr(found, "models", None) or (getattr(found, "model", found),):
        natural_frequencies, damping_ratios, *_ = model.modes()
        assert natural_frequencies[0] == pytest.approx(20.0, rel=1e-3)
        # The lines of the local polynomials are 0.1 Hz apart, a sixth of the half-power band.
        assert damping_ratios[0] == pytest.approx(0.1, rel=0.05 if name == "local_polynomial" else 0.005)


@pytest.mark.slow
def test_the_table_of_orders_has_the_degrees_that_were_asked_for() -> None:
    settings = EstimatorSettings("receptance", orders=((1, 0), (2, 0)))
    found = run_estimator("srivc", result_cases.record(), settings)
    assert [model.n_poles for model in found.models] == [2, 2]
    assert [output.method for output in found.outputs] == ["srivc", "srivc"]
    # A line of its own before the head; the chosen one, which is best, stands first and is marked by an arrow.
    assert [line.replace("->", "").split()[:2] for line in found.tables[0].splitlines()[2:]] == [
        ["2", "0"],
        ["1", "0"],
    ]


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("modal", EstimatorSettings(orders=((4, 3),)), "orders is .*modal has no choice"),
        ("modal", EstimatorSettings(noise="white"), "noise is 'white'"),
        ("srivc", EstimatorSettings("receptance", noise="white"), "noise is 'white'"),
        ("common_poles", EstimatorSettings("receptance", orders=((2, 0), (4, 2))), "orders is"),
        ("po_moesp", EstimatorSettings("receptance", without=("offset",)), "without is"),
        ("local_polynomial", EstimatorSettings("receptance", without=("ramp",)), "without is"),
    ],
)
def test_what_an_estimator_has_no_choice_of_is_refused(
    name: str, settings: EstimatorSettings, words: str
) -> None:
    with pytest.raises(EstimationError, match=words):
        run_estimator(name, result_cases.record(), settings)


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("modal", EstimatorSettings("receptance", 1)),
        ("srivc", EstimatorSettings("receptance", 1, latency=Prior(0.0))),
        ("po_moesp", EstimatorSettings("receptance", 1)),
        ("local_polynomial", EstimatorSettings("receptance", 1)),
    ],
)
def test_several_records_are_one_fit(name: str, settings: EstimatorSettings) -> None:
    record = result_cases.record()
    found = run_estimator(name, [record, record], settings)
    for model in getattr(found, "models", None) or (getattr(found, "model", found),):
        assert model.modes()[0][0] == pytest.approx(20.0, rel=1e-3)


def test_terms_that_are_left_out_and_a_known_latency_reach_the_fit() -> None:
    settings = EstimatorSettings("receptance", 1, latency=Prior(4e-3), without=("ramp", "free_response"))
    found = run_estimator("modal", result_cases.record(), settings)
    assert not found.structure.has_ramp
    assert found.structure.has_offset
    assert found.model.latency == 4e-3


@pytest.mark.slow
def test_common_poles_stand_at_the_delay_that_the_outputs_show() -> None:
    record = result_cases.record()
    late = tuple(
        OutputSignal(own.name, own.unit, own.times_s[:-2] + 4e-3, own.values[:-2]) for own in record.outputs
    )
    shifted = TimeRecord(record.inputs, late)
    found = run_estimator("common_poles", shifted, EstimatorSettings("receptance", 1))
    # A hundredth of noise at 3 Hz places a step of 10 ms within a few tenths of a millisecond.
    assert [model.delay for model in found.models] == pytest.approx([4e-3, 4e-3], abs=5e-4)
    assert "taken as known" in found.warnings[-1]


@pytest.mark.parametrize("name", ["po_moesp", "local_polynomial"])
def test_what_drifts_is_refused_where_poles_at_zero_are_not_known(name: str) -> None:
    with pytest.raises(EstimationError, match="structure 'force' has poles at zero"):
        run_estimator(name, result_cases.record(), EstimatorSettings("force"))


@pytest.mark.slow
def test_the_output_that_cannot_be_estimated_is_named() -> None:
    rng = np.random.default_rng(4)
    drive = InputSignal("u", "N", (0.0, 0.01), rng.standard_normal(200), "zoh")
    noise = OutputSignal("still", "m", 0.01 * np.arange(1, 200), rng.standard_normal(199))
    with pytest.raises(EstimationError, match=r"output 'still': none of .* passes the gates"):
        run_estimator("transfer_function", TimeRecord((drive,), (noise,)), EstimatorSettings("receptance"))


def test_listing_the_estimators_loads_none_of_them() -> None:
    loaded = loaded_after("import beam_ident; beam_ident.estimator_meanings()")
    assert "beam_ident.estimators" in loaded
    assert not {"numpy", "scipy", "beam_ident.record_estimators"} & loaded
    assert "importlib.metadata" not in loaded_after("import beam_ident.estimators")
