"""The pictures of the pages: made by the project's script, small, and shown somewhere."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"

pytest.importorskip("cv2")


@pytest.mark.slow
def test_the_script_makes_every_picture_and_no_other(tmp_path: Path) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "make_pictures.py"))
    made = script["make_pictures"](tmp_path)
    # Those of pages need a browser, which need not be here.
    of_pages = {f"{name}.png" for name in script["PAGE_PICTURES"]}
    names = {path.name for path in made}
    assert names - of_pages == {path.name for path in PICTURES.iterdir()} - of_pages
    assert not names & of_pages or of_pages < names
    for path in (*made, *PICTURES.iterdir()):
        assert 5_000 < path.stat().st_size < 200_000, path


def test_every_picture_is_shown_on_a_page() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    shown = "".join(page.read_text(encoding="utf-8") for page in pages)
    for path in PICTURES.iterdir():
        assert f"pictures/{path.name})" in shown
