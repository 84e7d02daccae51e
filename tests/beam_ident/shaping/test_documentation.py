"""docs/quiet-moves.md: its code runs, and prints what the page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pages import run_page

PAGE = Path(__file__).resolve().parents[3] / "docs" / "quiet-moves.md"


@pytest.mark.slow
def test_the_code_of_the_page_prints_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    run_page(PAGE.name)
    printed = capsys.readouterr().out
    assert "time-optimal: 0." in printed
    assert printed.count("dampable") == 2
    assert printed.split("\n", 1)[1].strip() in text
