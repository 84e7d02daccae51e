from __future__ import annotations

import csv
import hashlib
import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import AmplitudeCurves, ModalModel, TimeRecord
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.quantities import with_uncertainty
from beam_ident.report.evidence import beside_theory
from beam_ident.report.modes import modes_by_output
from beam_ros.errors import UsageError
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.identification_summary import IdentificationOutcome, format_table
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.offline.theory import theory_of_rig
from beam_ros.reporting.identification import deflection_of, format_files, report_identification
from beam_ros.rig.rig import Rig
from benchmarks.recomputed_report import compared

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(outcome: IdentificationOutcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    report_identification(outcome, folder, operator="A. Person")
    return folder


def test_everything_lies_beside_the_page(folder: Path, outcome: IdentificationOutcome) -> None:
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
    assert "time base [mHz]" in text
    assert "FIT from rest [%]" in text
    assert "Shape and amplitude at the poles" in text


def test_a_simulated_beam_is_held_against_what_was_simulated_and_a_real_one_against_a_budget(
    folder: Path, outcome: IdentificationOutcome
) -> None:
    text = (folder / "report.html").read_text()
    assert "The budget of theory" not in text  # a clamp or air that was not simulated takes nothing off
    assert outcome.theory is not None
    assert outcome.theory.is_exact
    assert np.array_equal(outcome.theory.predicted, outcome.theory.natural_frequencies)
    assert outcome.agreement is not None
    assert outcome.agreement.p_value > 1e-3  # of noise alone, seeded
    assert outcome.experiment.rig is not None
    real = theory_of_rig(outcome.experiment.rig, "base_motion")
    assert "Young's modulus" in real.contributions
    assert "camera clock" not in real.contributions  # counted with what was identified
    assert np.all(real.predicted < real.natural_frequencies)
    against = beside_theory(outcome.modes, real)
    # All modes lie above by what the clamp and the air would take: together as likely as each.
    assert all(0.1 < one.z < 1.0 for one in against.beside)
    assert 0.0 < against.chi_squared < 60.0


def test_nobody_can_take_simulated_data_for_measured_ones(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    head, _, _ = text.partition("</header>")
    assert "The data are simulated: no beam was measured." in head
    assert '@top-right{content:"SIMULATED DATA"' in head
    assert "2023-11-14" not in text  # the simulator's time, which nobody measured
    assert "no date: simulated" in text


def test_the_sheet_to_sign_comes_first_and_can_be_signed(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    sheet, _, evidence = text.partition('<div class="evidence">')
    for heading in ("Verdict", "Modes", "Validation", "Assumptions", "Before you sign"):
        assert f">{heading}</h2>" in sheet
    assert "approved by" in sheet
    assert "A. Person" in sheet
    assert sheet.count("<figure>") == 2
    assert "<details>" in evidence
    assert ">Provenance</h2>" in evidence
    assert ">git<" in evidence or ">commit<" in evidence


def test_an_operator_who_is_not_named_is_missed(outcome: IdentificationOutcome, tmp_path: Path) -> None:
    files = report_identification(outcome, tmp_path / "report", drawn="none")
    text = files.report.read_text()
    assert "Nobody is named as operator." in text
    assert files.figures == ()
    assert "<figure>" not in text


def test_every_place_has_one_frequency_with_one_uncertainty(
    folder: Path, outcome: IdentificationOutcome
) -> None:
    """Screen, model.json, poles.csv, table and sheet: the same value, standard uncertainty, theory and z."""
    summary = json.loads((folder / "model.json").read_text())["summary"]["modes"]
    poles = list(csv.DictReader((folder / "poles.csv").open()))
    text = html.unescape((folder / "report.html").read_text()).replace("\u00a0", " ")
    screen = format_table(outcome.content)
    drawn = modes_by_output(outcome.modes)["identified, 95 %"]
    assert outcome.agreement is not None
    for k, (own, row, mode) in enumerate(zip(summary, poles, outcome.modes, strict=True)):
        parts = own["frequency_sd_parts_hz"]
        assert parts["temperature"] > 0.0  # 1.5 K are stated: more than the statistics
        total = np.sqrt(sum(part**2 for part in parts.values()))
        assert own["frequency_sd_hz"] == pytest.approx(total, rel=1e-12)
        assert float(row["frequency_sd_hz"]) == pytest.approx(total, rel=1e-12)
        assert float(row["frequency_hz"]) == pytest.approx(own["frequency_hz"], rel=1e-14)
        assert drawn[2][k] / (2.0 * np.pi) == pytest.approx(total, rel=1e-12)
        assert with_uncertainty(own["frequency_hz"], total) in text
        assert f"+- {total:.2g}" in screen
        beside = outcome.agreement.of(mode)
        assert beside is not None
        assert own["frequency_z"] == beside.z
        theory = f"{own['theory_frequency_hz']:.4f}"
        assert theory in screen
        assert theory in text


def test_every_number_of_the_page_is_what_other_code_makes_of_bag_and_model(
    folder: Path, bag: Path, tmp_path: Path
) -> None:
    found = list(compared(bag, folder))
    assert len(found) > 50
    assert [own for own in found if not own.agrees] == []
    fit = next(own for own in found if own.name == "z285: FIT [%]")
    forged = shutil.copytree(folder, tmp_path / "forged")
    page = forged / "report.html"
    page.write_text(page.read_text().replace(f">{fit.printed}<", f">{float(fit.printed) - 0.02:.3f}<"))
    assert [own.name for own in compared(bag, forged) if not own.agrees] == ["z285: FIT [%]"]


def test_the_theory_of_a_simulated_beam_is_what_was_simulated(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    table = re.search(r"Shape and amplitude.*?</table>", text, re.DOTALL)[0]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", table)
    z = [float(value) for value in cells[6::8]]
    assert len(z) == 6
    assert all(abs(value) < 4.0 for value in z)


def test_a_report_is_not_lost_to_another(folder: Path, outcome: IdentificationOutcome) -> None:
    before = (folder / "report.html").read_bytes()
    with pytest.raises(UsageError, match="--overwrite"):
        report_identification(outcome, folder)
    assert (folder / "report.html").read_bytes() == before


def test_other_estimators_have_reports_too(bag: Path, tmp_path: Path) -> None:
    found = identification_of_bags(bag, options=FitOptions(estimator="local_polynomial", n_modes=2))
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
    theory = theory_of_rig(rig, "base_motion")
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
