from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from beam_ros.vision.tracking.spots import Reason

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE, REASONS = DOCS / "vision.md", DOCS / "refused-measurements.md"
MEASURED = (DOCS / "measured" / "vision.md", DOCS / "measured" / "vision-peers.md")


def test_the_example_of_the_page_runs_and_says_what_it_promises(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1
    names: dict[str, object] = {}
    exec(compile(blocks[0], str(PAGE), "exec"), names)
    found = names["found"]
    # 0.006 px of noise at 1500 px/m
    assert found.x_m == pytest.approx([0.001, 0.002, 0.003], abs=2e-5)
    assert capsys.readouterr().out.count("'ok'") == 3


@pytest.mark.parametrize("page", MEASURED, ids=lambda page: page.stem)
def test_every_test_that_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    files = {path.stem: path.read_text(encoding="utf-8") for path in Path(__file__).parent.rglob("test_*.py")}
    for name in re.findall(r"`(test_\w+)", text):
        assert name in files or name in "".join(files.values()), name


def test_every_reason_for_no_measurement_stands_on_the_page():
    text = REASONS.read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| ((?:`\w+`(?:, )?)+) \|", text[text.index("## When a measurement is refused") :], re.M
    )
    named = {word for row in rows for word in re.findall(r"\w+", row)}
    assert {*get_args(Reason), "unreadable"} - {"ok"} <= named
