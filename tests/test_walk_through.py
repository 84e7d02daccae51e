"""The commands of the pages are commands, and the walk-through says what they print."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path

import pytest

from beam_ros.cli.main import VERBS, main, verb_parser

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", *sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md")))


def commands(page: str) -> list[list[str]]:
    """Return the words of every `beam` command that stands on a line of its own."""
    text = (ROOT / page).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^(?: {4})?beam (\w+(?: .*)?)$", text, re.MULTILINE)
    return [shlex.split(part, comments=True) for line in lines for part in line.split(" && beam ")]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_is_understood(page: str) -> None:
    for verb, *words in commands(page):
        assert verb in VERBS
        if "--help" not in words:
            verb_parser(verb).parse_args(words)


def test_commands_are_found_on_pages() -> None:
    assert all(commands(f"docs/{page}.md") for page in ("axis", "excitation", "walk-through"))


@pytest.mark.slow
def test_the_walk_through_says_what_the_recordings_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    command = next(words for words in commands("docs/walk-through.md") if words[0] == "identify")
    assert main([*command[: command.index("--report")], "--report", str(tmp_path / "report")]) == 0
    page = (ROOT / "docs" / "walk-through.md").read_text(encoding="utf-8")
    printed = capsys.readouterr().out
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if "+-" in line}
    stated = [line.split() for line in page.splitlines() if line.startswith("    ") and "+-" in line]
    assert len(stated) == len(rows) == 2
    for number, frequency, *_ in stated:
        # Other versions of SciPy end their iterations elsewhere, by far less than the intervals.
        assert float(rows[number][1]) == pytest.approx(float(frequency), rel=1e-5)
    assert (tmp_path / "report" / "report.html").is_file()


def test_the_walk_through_says_of_the_recordings_what_they_are() -> None:
    page = (ROOT / "docs" / "walk-through.md").read_text(encoding="utf-8")
    recordings = json.loads((ROOT / "bags" / "expected.json").read_text()).values()
    truths = [own["truth"]["natural_frequencies"][0] / (2 * math.pi) for own in recordings]
    led = [own["identified"]["modes"][0]["frequency_hz"] for own in recordings]
    led = [found for found, truth in zip(led, truths, strict=True) if truth == truths[0]]
    assert (len(truths), len(led)) == (8, 7)
    assert "The table has eight rows. Seven are experiments on a hub that is led" in page
    assert max(abs(found / truths[0] - 1.0) for found in led) < 20e-6
    assert "within 20 parts per million of the truth" in page
