"""What turns docstrings and pages into the built documentation."""

from __future__ import annotations

import runpy
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

EXTENSIONS = Path(__file__).parents[2] / "docs" / "extensions"


@pytest.fixture(scope="module")
def dialect() -> dict[str, Any]:
    return runpy.run_path(str(EXTENSIONS / "docstring_dialect.py"))


@pytest.fixture(scope="module")
def mend_links() -> Any:
    return runpy.run_path(str(EXTENSIONS / "tree_pages.py"))["mend_links"]


def test_an_entry_on_one_line_becomes_two(dialect: dict[str, Any]) -> None:
    lines = [
        "Parameters",
        "----------",
        "y : ndarray, shape (n,) -- displacement [m] -- of u",
        "    and more",
    ]
    assert dialect["spread_over_two_lines"](lines) == [
        "Parameters",
        "----------",
        "y : ndarray, shape (n,)",
        "    displacement [m] -- of u",
        "    and more",
    ]


def test_dashes_outside_of_lists_of_entries_stay(dialect: dict[str, Any]) -> None:
    lines = ["A line -- with dashes.", "", "Notes", "-----", "More -- of them."]
    assert dialect["spread_over_two_lines"](lines) == lines


def test_bars_are_kept_but_in_literals(dialect: dict[str, Any]) -> None:
    assert dialect["keep_bars"]("|w(L)| and ``a | b``") == r"\|w(L)\| and ``a | b``"


@pytest.mark.parametrize(
    ("text", "folder", "mended"),
    [
        ("[vision](docs/vision.md#where)", ".", "[vision](vision.md#where)"),
        ("[rig](beam_ros/config/rig.yaml)", ".", "rig"),
        ("[changes](CHANGELOG.md)", ".", "[changes](changelog.md)"),
        ("![rig](docs/pictures/rig.png)", ".", "![rig](pictures/rig.png)"),
        ("[start](../README.md), [page](vision.md)", "docs", "[start](readme.md), [page](vision.md)"),
        ("[forge](https://example.org/x.md)", ".", "[forge](https://example.org/x.md)"),
    ],
)
def test_links_of_the_tree_become_links_of_the_built_pages(
    mend_links: Any, text: str, folder: str, mended: str
) -> None:
    assert mend_links(text, PurePosixPath(folder), PurePosixPath("docs")) == mended
