"""The commands of the pages are commands, and the walk-through says what they print."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from beam_ros.cli.main import VERBS, _verb_parser, main

ROOT = Path(__file__).parent.parent
PAGES = ("walk-through", "viewers", "studies", "experiments")


def commands(page: str) -> list[list[str]]:
    """Return the words of every `beam` command in the blocks of a page."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    blocks = "\n".join(re.findall(r"```(?:sh|bash)\n(.*?)```", text, re.DOTALL)).replace("\\\n", " ")
    return [shlex.split(line, comments=True)[1:] for line in blocks.splitlines() if line.startswith("beam ")]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_is_understood(page: str) -> None:
    found = commands(page)
    assert found
    for verb, *words in found:
        assert verb in VERBS
        _verb_parser(verb).parse_args(words)


def test_the_walk_through_says_what_the_recordings_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    command = next(words for words in commands("walk-through") if words[0] == "identify")
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
