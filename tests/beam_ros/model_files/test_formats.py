"""Every format there and back, by the library that reads it; nothing written over."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.io import loadmat
from scipy.signal import lfilter

from beam_ident import InputSignal
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import FORMATS, write_new
from beam_ros.model_files.universal import line_frequencies
from beam_ros.process.checksums import checksum
from tests.beam_ros.model_files.models import (
    COVARIANCE,
    OMEGAS,
    RESIDUES,
    ZETAS,
    modal,
    request_of,
    transfer_functions,
    two_inputs,
    written,
)

MODELS = {
    "modal": [modal()],
    "force": [modal("force")],
    "paths": transfer_functions(0.01),
    "inputs": [two_inputs()],
}


@pytest.mark.parametrize("kind", MODELS)
def test_matlab_reads_states_polynomials_covariances_and_names(kind: str) -> None:
    request = request_of(MODELS[kind])
    found = loadmat(io.BytesIO(written("mat", request)))
    model = request.model
    for letter, matrix in zip(
        "ABCD", (model.transition, model.entry, model.rows, model.through), strict=True
    ):
        np.testing.assert_array_equal(found[letter], matrix)
    for j, row in enumerate(model.paths):
        for k, path in enumerate(row):
            np.testing.assert_array_equal(found["num"][j, k][0], path.numerator)
            np.testing.assert_array_equal(found["den"][j, k][0], path.denominator)
            assert found["delays_s"][j, k] == path.delay
    np.testing.assert_array_equal(found["covariance"], model.covariance)
    np.testing.assert_array_equal(found["parameters"][:, 0], model.parameters)
    assert [str(cell[0]) for cell in found["parameter_names"][:, 0]] == list(model.parameter_names)
    assert [str(cell[0]) for cell in found["output_names"][:, 0]] == list(model.output_names)
    if kind == "modal":
        np.testing.assert_array_equal(found["natural_frequencies_rad_s"][:, 0], OMEGAS)
        np.testing.assert_allclose(
            found["damping_ratio_sd"][:, 0], np.sqrt(np.diag(COVARIANCE))[2:4], rtol=1e-12
        )
        assert found["input_unit"][0] == "m/s2"


def test_a_program_of_modal_analysis_reads_shapes_and_responses(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff", reason="universal files need pyuff")
    request = request_of(MODELS["modal"])
    path = tmp_path / "m.uff"
    path.write_bytes(written("uff", request))
    sets = pyuff.UFF(str(path)).read_sets()
    kinds = [own["type"] for own in sets]
    assert kinds == [164, 55, 55, 58, 58]
    for number, own in enumerate(sets[1:3]):
        # Data sets 55 have six digits.
        assert own["freq"] == pytest.approx(OMEGAS[number] / (2 * np.pi), rel=1e-5)
        assert own["modal_damp_vis"] == pytest.approx(ZETAS[number], rel=1e-5)
        np.testing.assert_allclose(
            own["r1"],
            RESIDUES[:, number] / RESIDUES[np.argmax(np.abs(RESIDUES[:, number])), number],
            rtol=1e-5,
        )
    hertz = line_frequencies(request)
    response = request.model.response(2.0 * np.pi * hertz)
    for j, own in enumerate(sets[3:]):
        np.testing.assert_allclose(own["x"], hertz, rtol=1e-9)
        np.testing.assert_allclose(own["data"], response[:, j, 0], rtol=1e-10)
        assert (own["rsp_node"], own["ref_node"], own["orddenom_spec_data_type"]) == (1 + j, 3, 12)
    # The narrowest resonance, of 2 zeta omega, has lines in it.
    assert hertz[1] - hertz[0] < 0.3 * 2 * ZETAS[0] * OMEGAS[0] / (2 * np.pi)


def test_modelica_text_holds_every_digit() -> None:
    request = request_of(MODELS["modal"], "Beam.mo")
    text = written("modelica", request).decode()
    model = request.model
    for letter, matrix in zip(
        "ABCD", (model.transition, model.entry, model.rows, model.through), strict=True
    ):
        (found,) = re.findall(rf"Real {letter}\[{matrix.shape[0]}, {matrix.shape[1]}\] = (.*);", text)
        np.testing.assert_array_equal(json.loads(found.translate(str.maketrans("{}", "[]"))), matrix)
    assert text.startswith('model Beam "model.json')
    assert text.endswith("end Beam;\n")


def test_printers_get_frequency_and_damping_of_the_first_mode_with_intervals() -> None:
    request = request_of(MODELS["modal"])
    klipper = written("klipper", request).decode()
    marlin = written("marlin", request).decode()
    sd = float(np.sqrt(COVARIANCE[0, 0])) / (2 * np.pi)
    frequency = float(OMEGAS[0] / (2 * np.pi))
    interval = f"Natural frequency {frequency:.8g} Hz, 95 % from {frequency - 1.959964 * sd:.6g}"
    for text in (klipper, marlin):
        assert interval[:-1] in text
    found = dict(re.findall(r"^(\w+): (\S+)$", klipper, re.M))
    assert "[input_shaper]" in klipper
    assert float(found["shaper_freq_x"]) == pytest.approx(frequency, rel=1e-14)
    assert float(found["damping_ratio_x"]) == ZETAS[0]
    command = re.search(r"^M593 X F(\S+) D(\S+)$", marlin, re.M)
    assert command is not None
    assert [float(part) for part in command.groups()] == pytest.approx([frequency, ZETAS[0]], rel=1e-14)
    assert all(line[:1] in "#[sd" for line in klipper.splitlines())
    assert all(line[:1] in ";M" for line in marlin.splitlines())


def test_notches_of_a_filter_chain_leave_no_swing_behind_a_step() -> None:
    request = request_of(MODELS["modal"], "notches.yaml")
    content = YAML(typ="safe", pure=True).load(written("ros2-filter", request).decode())
    chain = content["notches"]["ros__parameters"]["filter_chain"]
    assert [own["type"] for own in chain.values()] == ["filters/TransferFunctionFilterDouble"] * 2
    period, command = 1e-3, np.ones(3000)
    for own in chain.values():
        command = lfilter(own["params"]["b"], own["params"]["a"], command)
    assert command[-1] == pytest.approx(1.0, abs=1e-9)
    times = period * np.arange(len(command))
    swing = {}
    for name, drive in (("with", command), ("without", np.ones(3000))):
        seen = modal("receptance").simulate(InputSignal("hub", "N", (0.0, period), drive, "zoh"), times)
        swing[name] = np.ptp(seen[1500:, 1])
    # What is left of the notches' own poles after a second and a half, and rounding.
    assert swing["with"] < 1e-10 * swing["without"]
    with pytest.raises(UsageError, match=r"above half the rate of a controller with hub.period 0.1 s"):
        written("ros2-filter", request_of(MODELS["modal"], "n.yaml", **{"hub.period": 0.1}))


@pytest.mark.parametrize(
    ("flag", "kind", "target", "words"),
    [
        ("modelica", "paths", "Beam.mo", "a delay of 0.01 s, which states do not have"),
        ("fmu", "paths", "Beam.fmu", "a delay of 0.01 s"),
        ("fmu", "modal", "my beam.fmu", "'my beam' is no name of a model"),
        ("modelica", "modal", "2.mo", "'2' is no name of a model"),
        ("mjcf", "paths", "b.xml", "no modal model of one input"),
        ("urdf", "force", "b.urdf", "driven by a force"),
    ],
)
def test_what_a_format_cannot_hold_is_refused(flag: str, kind: str, target: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        written(flag, request_of(MODELS[kind], target))


@pytest.fixture
def report(tmp_path: Path) -> Path:
    folder = tmp_path / "report"
    (folder / "figures").mkdir(parents=True)
    (folder / "figures" / "fit.svg").write_text("<svg/>")
    document = {"schema": 1, "model": modal().to_dict(), "summary": {"bags": ["runs/E1", "runs/E2"]}}
    (folder / "model.json").write_text(json.dumps(document))
    return folder


def test_a_crate_names_every_file_with_its_checksum_and_where_it_comes_from(report: Path) -> None:
    assert main(["export", "--model", str(report), "--ro-crate", str(report)]) == 0
    crate = json.loads((report / "ro-crate-metadata.json").read_text())
    by_id = {own["@id"]: own for own in crate["@graph"]}
    assert len(by_id) == len(crate["@graph"])
    assert by_id["ro-crate-metadata.json"]["about"] == {"@id": "./"}
    assert {own["@id"] for own in by_id["./"]["hasPart"]} == {"figures/fit.svg", "model.json"}
    assert by_id["model.json"]["sha256"] == checksum(report / "model.json")
    assert by_id["figures/fit.svg"]["encodingFormat"] == "image/svg+xml"
    assert {own["@id"] for own in by_id["#identification"]["object"]} == {"runs/E1", "runs/E2"}
    references = re.findall(r'\{"@id": "([^"]+)"\}', json.dumps(crate["@graph"]))
    assert {own for own in references if not own.startswith("http")} <= set(by_id)


def test_all_formats_are_written_at_once_and_never_over_a_file(
    report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {own.flag: f"Model.{own.flag}" for own in FORMATS if own.flag not in ("uff", "ro-crate")}
    words = ["export", "--model", str(report)]
    for flag, name in names.items():
        words += [f"--{flag}", str(tmp_path / name)]
    assert main(words) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / name) for name in names.values()]
    before = {name: (tmp_path / name).read_bytes() for name in names.values()}
    (tmp_path / "Model.mat").unlink()
    assert main(words) == 2
    assert "exists and is not written over" in capsys.readouterr().err
    assert not (tmp_path / "Model.mat").exists()
    assert {name: (tmp_path / name).read_bytes() for name in names.values() if name != "Model.mat"} == {
        name: content for name, content in before.items() if name != "Model.mat"
    }
    with pytest.raises(UsageError, match="not written over"):
        write_new(tmp_path / "Model.mjcf", b"")
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--model", "MODEL"], "--model goes with at least one of --mat"),
        (["--mat", "a.mat"], "--model goes with"),
        (["bag", "--model", "MODEL", "--mat", "a.mat"], "--model takes no bag"),
        (["bag"], "nothing says what to write"),
        (["bag", "--csv", "out", "--driven-by", "velocity"], "--driven-by goes with --model alone"),
        (["--model", "MODEL", "--mat", "nowhere/a.mat"], "there is no folder nowhere"),
        (["--model", "nowhere.json", "--mat", "a.mat"], "nowhere.json: is not there"),
    ],
)
def test_words_that_do_not_go_together_are_refused(
    report: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", *(str(report) if word == "MODEL" else word for word in words)]) == 2
    assert said in capsys.readouterr().err
