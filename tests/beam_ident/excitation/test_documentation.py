"""docs/excitation.md: its code runs, and its tables name what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import beam_ident
from beam_ident.excitation import RECIPES
from tests.pages import run_page

PAGE = Path(__file__).resolve().parents[3] / "docs" / "excitation.md"


@pytest.mark.slow
def test_the_code_of_the_page_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    run_page(PAGE.name, 6)
    printed = capsys.readouterr().out
    assert "peak travel" in printed
    crest_factors = [
        float(re.search(rf"^{word} ([\d.]+)$", printed, re.M)[1]) for word in ("random", "crest")
    ]
    # What the table says of them.
    assert 3.0 < crest_factors[0] < 4.1
    assert crest_factors[1] < 1.55
    assert "mode at 4.4 Hz" in printed


@pytest.mark.slow
def test_the_code_of_the_page_on_the_best_excitation_runs(capsys: pytest.CaptureFixture[str]) -> None:
    run_page("best-excitation.md")
    assert "D-optimal" in capsys.readouterr().out


def test_every_recipe_stands_in_the_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for recipe in RECIPES.values():
        assert f"`{recipe.__name__}" in text
        assert getattr(beam_ident, recipe.__name__) is recipe


def test_every_parameter_of_the_rig_stands_on_the_page() -> None:
    table = pytest.importorskip("beam_ros.interfaces.rig_parameters")
    text = PAGE.read_text(encoding="utf-8")
    names = [name.split(".")[1] for name in table.RIG_PARAMETERS if name.startswith("excitation.")]
    assert [name for name in names if f"`{name}`" not in text and f".{name}" not in text] == []


def test_the_page_says_what_each_kind_reads() -> None:
    kinds = pytest.importorskip("beam_ros.excitation.recipes").KINDS
    assert set(kinds) == set(RECIPES)
    table = PAGE.read_text(encoding="utf-8").partition("| kind | parameters")[2].partition("\n\n")[0]
    found = {}
    for row in table.splitlines()[2:]:
        named, read = row.strip("|").split("|")
        for kind in re.findall(r"`(\w+)`", named):
            found[kind] = re.findall(r"`(\w+)`", read)
    assert found == {name: [p for p in kind.reads if p != "still"] for name, kind in kinds.items()}
