"""The pages in a real browser: nothing asked for, nothing cut off, contrast and words for everybody."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from beam_ident.report.page import Page
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.reporting.comparison import compare, write_comparison
from beam_ros.reporting.identification import report_identification
from tests.browser import faults_of_page, open_browser

BAGS = Path(__file__).resolve().parents[3] / "bags"

pytestmark = pytest.mark.verify


@pytest.mark.parametrize("estimator", ["modal", "common_poles", "local_polynomial"])
def test_a_report_reads_on_every_screen_and_on_paper(estimator: str, bag: Path, tmp_path: Path) -> None:
    with open_browser() as browser:
        found = identification_of_bags(bag, options=FitOptions(estimator=estimator, n_modes=2))
        files = report_identification(found, tmp_path / "report")
        assert faults_of_page(browser, files.report) == []


def test_a_report_with_validation_and_film_reads_too(tmp_path: Path) -> None:
    with open_browser() as browser:
        found = identification_of_bags(BAGS / "frames", validation=BAGS / "multisine")
        files = report_identification(found, tmp_path / "report", pdf=True, temperature_k=1.0)
        assert faults_of_page(browser, files.report) == []
        assert files.pdf is not None
        assert files.film is not None


def test_a_page_that_cuts_off_or_asks_for_something_is_found_out(tmp_path: Path) -> None:
    page = Page("t", "l")
    page.section("s")
    page.paragraph("x" * 30)
    text = page.text().replace(
        "</main>", '<p style="width:2000px;color:#ccc">pale</p><img src="no.png"></main>'
    )
    (tmp_path / "page.html").write_text(text)
    with open_browser() as browser:
        faults = "\n".join(faults_of_page(browser, tmp_path / "page.html"))
    for said in ("wider than the screen", "color-contrast", "image-alt", "asked for", "console", "A4"):
        assert said in faults, said


def test_a_comparison_and_a_report_of_several_bags_read_on_every_screen(
    bag: Path, second_bag: Path, tmp_path: Path
) -> None:
    with open_browser() as browser:
        page = write_comparison(compare([bag, second_bag]), tmp_path / "comparison")
        assert faults_of_page(browser, page) == []
        files = report_identification(identification_of_bags([bag, second_bag]), tmp_path / "report")
        assert faults_of_page(browser, files.report) == []
