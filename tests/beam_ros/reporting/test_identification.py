from __future__ import annotations

import csv
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import AmplitudeCurves, ModalModel, TimeRecord, models_of
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.report.evidence import mode_rows
from beam_ident.report.gates import Gate
from beam_ros.errors import UsageError
from beam_ros.offline.identification import Identification, identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.reporting.identification import deflection_of, format_files, report_identification
from beam_ros.reporting.theory import theory_of_rig
from beam_ros.rig.rig import Rig

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(outcome: Identification, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    gates = [Gate("clock", "passed", "2 us", "below 50 us")]
    report_identification(outcome, folder, gates=gates, operator="A. Person", temperature_k=1.5)
    return folder


def test_everything_lies_beside_the_page(folder: Path, outcome: Identification) -> None:
    assert {path.name for path in folder.iterdir()} == {"report.html", "model.json", "poles.csv", "figures"}
    document = json.loads((folder / "model.json").read_text())
    model = ModalModel.from_dict(document["model"])
    rows = list(csv.DictReader((folder / "poles.csv").open()))
    assert [float(row["frequency_hz"]) for row in rows] == pytest.approx(model.frequencies_hz, rel=1e-12)
    text = (folder / "report.html").read_text()
    drawings = list((folder / "figures").glob("*.svg"))
    assert len(drawings) == text.count("<figure>")
    assert all("<text" in drawing.read_text() for drawing in drawings)


def test_the_page_says_where_everything_comes_from(folder: Path, bag: Path) -> None:
    text = (folder / "report.html").read_text()
    for file in bag.iterdir():
        assert hashlib.sha256(file.read_bytes()).hexdigest() in text
    for said in (
        "A. Person",
        "beam.length",
        "0.3 m",
        "seed",
        "numpy",
        "temperature known to",
        "1.5 K",
        "UTC",
    ):
        assert said in text, said
    assert "below 50 us" in text


def test_the_page_holds_theory_budget_and_validation(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    assert "The budget of theory" in text
    assert "Young&#x27;s modulus" in text
    assert "time base [mHz]" in text
    assert "FIT from rest [%]" in text
    assert "Mode shapes" in text


def test_the_theory_of_a_simulated_beam_is_what_was_simulated(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    table = re.search(r"Shape and amplitude.*?</table>", text, re.DOTALL)[0]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", table)
    z = [float(value) for value in cells[6::8]]
    assert len(z) == 6
    assert all(abs(value) < 4.0 for value in z)


def test_a_report_is_not_lost_to_another(folder: Path, outcome: Identification) -> None:
    before = (folder / "report.html").read_bytes()
    with pytest.raises(UsageError, match="--overwrite"):
        report_identification(outcome, folder)
    assert (folder / "report.html").read_bytes() == before


def test_other_estimators_have_reports_too(bag: Path, tmp_path: Path) -> None:
    found = identification_of_bags(bag, estimator="local_polynomial", n_modes=2)
    files = report_identification(found, tmp_path / "report")
    assert files.report.exists()
    said = format_files(files.to_dict())
    assert str(files.poles) in said
    assert "film" not in said


def test_the_deflection_is_what_the_hub_does_not_explain() -> None:
    times = 1e-3 * np.arange(2000)
    hub = 0.01 * np.sin(7.0 * times)
    bent = np.where((times > 0.5) & (times < 0.7), 0.002, 0.0)
    record = TimeRecord(
        (InputSignal("hub", "m", times, hub, "cubic"),),
        (OutputSignal("z", "m", times[2:-2], (hub + bent)[2:-2]),),
    )
    assert deflection_of(record) == pytest.approx(0.002, rel=1e-3)


def test_curves_over_amplitude_are_drawn_stored_and_judged(tmp_path: Path) -> None:
    """A strip in air: its damping ratio is the steel's, and in proportion to its amplitude the air's."""
    rig = Rig.from_file().with_values(
        {
            "excitation.kind": "doublet",
            "excitation.acceleration": 1.5,
            "excitation.step_size": 0.002,
            "excitation.width": 0.1,
            "excitation.gap": 0.1,
            "excitation.still": 12.0,
            "simulation.drag_coefficient": 6.0,
        }
    )
    simulate(rig, tmp_path / "bag")
    found = identification_of_bags(tmp_path / "bag", options=FitOptions(n_modes=1, amplitude=True))
    curves = found.curves
    assert curves is not None
    assert not curves.is_one_pole
    # Energy lost a cycle to 1/2 rho C_d b |v| v: zeta = 4/(3 pi) 1/2 rho C_d b int |phi|^3 dz A / m_b, A of q_1.
    model = rig.beam_model()
    z = np.linspace(0.0, rig.beam.length, 4001)
    drag = 0.5 * 1.2 * 6.0 * rig.beam.width * float(np.sum(np.abs(model.shape(z)[:, 0]) ** 3) * (z[1] - z[0]))
    q = curves.amplitudes / abs(model.shape([0.285])[0, 0])
    expected = 0.005 + 4.0 / (3.0 * np.pi) * drag * q / model.basis.modal_mass
    assert curves.damping_ratios == pytest.approx(expected, rel=0.01)
    assert found.linearity is not None
    assert not found.linearity.is_linear
    theory = theory_of_rig(rig, "base_motion", mode_rows(models_of(found.result)))
    assert theory.over_amplitude is not None
    law = theory.over_amplitude("z285", 4.4, curves.amplitudes)
    assert law is not None
    assert law[1] == pytest.approx(expected, rel=1e-3)
    assert law[0] == pytest.approx(curves.frequencies_hz, rel=1e-3)
    assert theory.over_amplitude("hub", 4.4, curves.amplitudes) is None
    report_identification(found, tmp_path / "report")
    assert (tmp_path / "report" / "figures" / "amplitude.svg").exists()
    page = (tmp_path / "report" / "report.html").read_text()
    assert "hold at one amplitude only" in page
    assert "One pole does not describe mode 1" in page
    assert "Dotted: what the rig" in page
    stored = json.loads((tmp_path / "report" / "model.json").read_text())["summary"]["amplitude"]
    assert AmplitudeCurves.from_dict(stored).verdict == curves.verdict
