from __future__ import annotations

import csv
import io
import re

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import identify, validate
from beam_ident.data.records import busiest_stretch
from beam_ident.errors import ReportError
from beam_ident.report.evidence import ErrorSources, Theory, Trial, Unseen, mode_rows
from beam_ident.report.gates import Gate
from beam_ident.report.identification import (
    identification_page,
    poles_table,
    write_report,
)
from tests.beam_ident.result_cases import BY_NAME, record, result
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record


@pytest.fixture(scope="module")
def modal():
    return beam_record(1), identify(beam_record(1), n_modes=3)


@pytest.fixture(scope="module")
def theory():
    return Theory(
        "A beam.",
        np.array(OMEGAS),
        np.array(ZETAS),
        0.992 * np.array(OMEGAS),
        {"thickness": np.full(3, 0.02), "length": np.full(3, -0.003)},
        False,
        {"z285": np.ones(3)},
        {"z285": np.full(3, 0.1)},
        np.linspace(0.0, 0.3, 20),
        np.ones((20, 3)),
        {"z285": (0.285, 0.0005)},
    )


@pytest.fixture(scope="module")
def page(modal, theory):
    data, found = modal
    unseen = Unseen("another", (validate(found.model, beam_record(2)),))
    trials = [Trial("low", found.model, 1e-3), Trial("high", found.model, 5e-3)]
    return identification_page(
        "A <beam>",
        data,
        found,
        provenance={"Bag": {"path": "chirp & still"}, "Versions": {"NumPy": "1"}},
        notes=["62 frames are missing"],
        gates=[Gate("frames", "doubtful", "62 lost", "none lost", "Use a shorter cable.")],
        validation=[unseen],
        theory=theory,
        sources=ErrorSources(1e-5, 2.0, -1.25e-4, {"z285": 0.01}),
        trials=trials,
        links=[("The model", "model.json")],
    )


@pytest.mark.slow
def test_the_report_is_one_file_that_needs_nothing_else(page, tmp_path):
    path = page.write(tmp_path / "deeper" / "report.html")
    text = path.read_text()
    assert text.startswith("<!doctype html>")
    assert set(re.findall(r'(?:src|href)="(?!#)([^"]*)"', text)) == {"data:,", "model.json"}
    assert "http" not in text
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_the_report_has_every_section_in_the_order_of_a_reader(page):
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", page.text())
    assert headings == [
        "Verdict",
        "Modes",
        "Validation",
        "Assumptions",
        "Before you sign",
        "Modes and shapes",  # the evidence begins
        "Data quality",
        "Model",
        "Residuals",
        "Frequency response",
        "Order",
        "Theory",
        "Predictions",
        "Linearity and repeatability",
        "Provenance",
    ]


def test_every_figure_has_a_caption_a_name_and_words_for_those_who_do_not_see_it(page):
    text = page.text()
    n = text.count("<figure>")
    assert n == len(page.figures)
    assert n == text.count("<figcaption") == text.count('role="img" aria-label="')
    assert {
        "record",
        "fit",
        "modes",
        "response",
        "residuals",
        "spectra",
        "stabilisation",
        "shapes",
        "poles",
    } <= set(page.figures)
    assert "validation-another-z010--z225--z285" in page.figures


def test_the_report_shows_modes_data_and_provenance_escaped(page):
    text = page.text()
    assert "A &lt;beam&gt;" in text
    assert "chirp &amp; still" in text
    assert f"{OMEGAS[0] / 2 / np.pi:.3f}" in text
    assert "62 frames are missing." in text
    assert "Use a shorter cable." in text
    assert "FIT from rest [%]" in text


@pytest.mark.slow
def test_a_report_names_every_unit_of_its_equation(modal):
    text = identification_page("t", *modal).text()
    table = re.search(r"<caption[^>]*><span>Every symbol.*?</table>", text, re.DOTALL)[0]
    units = re.findall(r"<tr><th[^>]*>([^<]*)</th><td[^>]*>[^<]*</td><td[^>]*>([^<]*)</td>", table)
    found = dict(units)
    assert found["ω1"] == "rad/s"
    assert found["T"] == "s"
    assert found["R[z285]"] == "s^2"
    assert found["c[z285]"] == found["r1[z285]"] == found["ζ1"] == "1"
    assert found["σ[z285]"] == "m"


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_NAME)
def test_every_estimator_has_a_report(name):
    found = result(name)
    text = identification_page("t", record(), found).text()
    assert "Damping ratio over natural frequency" in text
    assert "Every symbol of the equation" in text
    assert "3.1" in text  # Hz, of the plant
    rows = list(csv.DictReader(io.StringIO(poles_table(mode_rows_of(found)))))
    assert float(rows[0]["frequency_hz"]) == pytest.approx(20.0 / 2 / np.pi, rel=0.02)


def mode_rows_of(found):
    from beam_ident.summary import models_of

    return mode_rows(models_of(found))


def test_the_table_of_poles_has_their_place_in_the_plane(modal):
    rows = list(csv.DictReader(io.StringIO(poles_table(mode_rows((modal[1].model,))))))
    poles = [complex(float(row["pole_real_rad_s"]), float(row["pole_imaginary_rad_s"])) for row in rows]
    assert np.allclose(poles, modal[1].model.poles, rtol=1e-12)


@pytest.mark.slow
def test_a_report_is_not_overwritten_unasked(modal, tmp_path):
    path = write_report(tmp_path / "report.html", "first", *modal)
    with pytest.raises(ReportError, match="is there already"):
        write_report(path, "second", *modal)
    write_report(path, "second", *modal, overwrite=True)
    assert "second" in path.read_text()


@pytest.mark.slow
def test_several_records_are_drawn_one_by_one(modal):
    records = [beam_record(1), beam_record(2)]
    page = identification_page("t", records, identify(records, n_modes=3))
    assert {"record-1", "record-2"} <= set(page.figures)


@pytest.mark.slow
def test_a_long_record_is_shown_where_its_input_moves_most(modal):
    data, found = modal
    assert busiest_stretch(data) is data
    n = len(data.outputs[0].times_s)
    shown = busiest_stretch(data, n // 3)
    assert len(shown.outputs[0].times_s) == pytest.approx(n / 3, abs=2)
    first, last = shown.outputs[0].times_s[[0, -1]]
    drive = data.inputs[0]
    inside = (drive.times_s >= first) & (drive.times_s <= last)
    assert np.var(drive.values[inside]) >= np.var(drive.values)
    page = identification_page("A stretch", data, found)
    assert "The record is long" not in page.text()
