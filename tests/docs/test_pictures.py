"""The pictures of the pages: made by the project's script, small, and shown somewhere."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"

pytest.importorskip("cv2")


def _script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "make_pictures.py"))


@pytest.mark.slow
def test_the_script_draws_what_takes_seconds() -> None:
    script = _script()
    rig = script["Rig"].from_file()
    drawn = [script[f"{name}_picture"](rig) for name in ("rig", "frame", "excitation", "whole_beam")]
    drawn += [*script["tutorial_pictures"]().values(), *script["identification_pictures"]().values()]
    assert all(figure.axes for figure in drawn)


@pytest.mark.verify
def test_the_script_makes_every_picture_and_no_other(tmp_path: Path) -> None:
    script = _script()
    made = script["make_pictures"](tmp_path)
    # Those of pages need a browser, which need not be here.
    of_pages = {f"{name}.png" for name in script["PAGE_PICTURES"]}
    names = {path.name for path in made}
    assert names - of_pages == {path.name for path in PICTURES.iterdir()} - of_pages
    assert not names & of_pages or of_pages < names
    assert all(_is_of_a_page(path) for path in made)


def _is_of_a_page(path: Path) -> bool:
    return 5_000 < path.stat().st_size < 200_000


def test_every_picture_is_shown_on_a_page() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    shown = "".join(page.read_text(encoding="utf-8") for page in pages)
    for path in PICTURES.iterdir():
        assert f"pictures/{path.name})" in shown
        assert _is_of_a_page(path), path
