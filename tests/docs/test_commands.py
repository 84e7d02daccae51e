"""The commands of the pages are commands, and the recordings of this tree are what the pages state of them."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path

import pytest

from beam_ros.cli.main import VERBS, verb_parser

ROOT = Path(__file__).parents[2]
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
    assert all(commands(f"docs/{page}.md") for page in ("axis", "excitation", "tutorials/bag-to-report"))


def test_the_page_on_studies_says_of_the_recordings_what_they_are() -> None:
    page = " ".join((ROOT / "docs" / "studies.md").read_text(encoding="utf-8").split())
    recordings = json.loads((ROOT / "bags" / "expected.json").read_text()).values()
    truths = [own["truth"]["natural_frequencies"][0] / (2 * math.pi) for own in recordings]
    led = [own["identified"]["modes"][0]["frequency_hz"] for own in recordings]
    led = [found for found, truth in zip(led, truths, strict=True) if truth == truths[0]]
    assert (len(truths), len(led)) == (8, 7)
    assert "Its table has eight rows. Seven are experiments on a hub that is led" in page
    assert max(abs(found / truths[0] - 1.0) for found in led) < 20e-6
    assert "within 20 parts per million of the truth" in page
