from __future__ import annotations

import re

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import identify
from beam_ident.report.identification import with_uncertainty, write_report
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    record = beam_record(1)
    result = identify(record, n_modes=3)
    reference = [
        (f"mode {i + 1}", float(w), float(z)) for i, (w, z) in enumerate(zip(OMEGAS, ZETAS, strict=True))
    ]
    path = tmp_path_factory.mktemp("report") / "deeper" / "report.html"
    write_report(path, "A <beam>", record, result, reference, {"bag": "chirp & still"}, ["A note."])
    return path


def test_the_report_is_one_file_that_needs_nothing_else(written):
    text = written.read_text()
    assert text.startswith("<!doctype html>")
    assert not re.findall(r'(?:src|href)="(?!#)[^"]', text)  # figures refer to their own parts only
    assert "url(http" not in text
    assert [p.name for p in written.parent.iterdir()] == ["report.html"]


def test_the_report_shows_modes_figures_and_provenance_escaped(written):
    text = written.read_text()
    assert "A &lt;beam&gt;" in text
    assert "chirp &amp; still" in text
    assert text.count("<h2>Provenance</h2>") == 1
    assert text.count("<figure>") == 6
    assert text.count("<figcaption>") == 6
    assert "1 (mode 1)" in text
    assert f"{OMEGAS[0] / 2 / np.pi:.3f}" in text


def test_a_report_that_cannot_be_written_leaves_nothing_behind(written, tmp_path):
    class Broken:
        name = "broken"

        @property
        def outputs(self):
            raise RuntimeError("no outputs")

    with pytest.raises(RuntimeError):
        write_report(tmp_path / "report.html", "t", Broken(), Broken())
    assert list(tmp_path.iterdir()) == []


def test_values_are_rounded_to_their_uncertainty():
    assert with_uncertainty(4.38412345, 0.000123) == "4.38412 ± 0.00012"
    assert with_uncertainty(123.456, 12.0) == "123 ± 12"
    assert with_uncertainty(2.0, 0.0) == "2"
    assert with_uncertainty(-5.69141e-7, 6.2e-7) == "(-5.7 ± 6.2)e-07"
    assert with_uncertainty(4.8e-6, 0.0023) == "0.0000 ± 0.0023"


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (4.38391, 0.00123, "4.3839 ± 0.0012"),
        (-0.25, 0.5, "-0.25 ± 0.50"),
        (1234.5, 67.0, "1234 ± 67"),
        (1.234e-6, 2.1e-8, "(1.234 ± 0.021)e-06"),
        (-3e-9, 4.4e-8, "(-0.3 ± 4.4)e-08"),
        (1.5, 0.0, "1.5"),
        (1.5, float("inf"), "1.5"),
    ],
)
def test_a_number_is_written_to_two_digits_of_its_uncertainty(value, sd, text):
    assert with_uncertainty(value, sd) == text
