"""Make the notebooks of examples/notebooks from pages of the documentation, and run them.

    .venv/bin/python docs/make_notebooks.py [FOLDER]         # default: examples/notebooks

A page is the source: its Markdown becomes cells of text, its blocks of Python cells of code, with what they print and
the figure or table that their last line gives. So a page and its notebook cannot say different things.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    "tutorials/first-identification",
    "notebooks/hammer",
    "notebooks/many-bags",
    "notebooks/real-arm",
)
_CODE = re.compile(r"^```python\n(.*?)^```\n", re.M | re.S)


def cells_of(page: Path) -> list[tuple[str, str]]:
    """Return kind and source of the cells of a page; its links lead from the folder of the notebooks."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^!\[[^\]]*\]\([^)]*\)\n\n", "", text, flags=re.M)  # the cells draw them
    cells = []
    for k, part in enumerate(_CODE.split(text)):
        source = part.strip("\n")
        if k % 2 == 0:
            source = re.sub(
                r"\]\((?!https?:)([^)#]+)", lambda link: f"]({from_notebooks(page, link[1])}", source
            )
        if source:
            cells.append(("markdown" if k % 2 == 0 else "code", source))
    return cells


def from_notebooks(page: Path, target: str) -> str:
    """Return a link of a page as it is written in a notebook."""
    return os.path.relpath((page.parent / target).resolve(), ROOT / "examples" / "notebooks")


def run(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Run a cell, and return what it shows: its print, and the value of its last line."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    value = None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, "cell", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    shown: list[dict[str, Any]] = []
    if printed.getvalue():
        shown.append({"output_type": "stream", "name": "stdout", "text": lines_of(printed.getvalue())})
    if value is not None:
        data: dict[str, Any] = {"text/plain": lines_of(repr(value))}
        if isinstance(value, Figure):
            data["image/png"] = picture_of(value)
        shown.append({"output_type": "display_data", "metadata": {}, "data": data})
    return shown


def picture_of(figure: Figure) -> str:
    """Return a figure as a small PNG in base 64."""
    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=80)
    Image.open(drawn).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def lines_of(text: str) -> list[str]:
    """Return a text as notebooks hold it."""
    return text.splitlines(keepends=True)


def notebook_of(page: Path) -> dict[str, Any]:
    """Return a page as a notebook that has been run."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells: list[dict[str, Any]] = []
    for number, (kind, source) in enumerate(cells_of(page)):
        cell: dict[str, Any] = {
            "id": f"cell-{number}",
            "cell_type": kind,
            "metadata": {},
            "source": lines_of(source),
        }
        if kind == "code":
            cell |= {"execution_count": None, "outputs": run(source, names)}
        cells.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def make_notebooks(folder: Path) -> list[Path]:
    """Write every notebook into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)  # from where the pages name files
    os.environ.pop("ROBOT_ARM_DATA", None)  # what is stored is made of data that all readers have
    files = []
    for name in PAGES:
        page = ROOT / "docs" / f"{name}.md"
        files.append(folder / f"{page.stem}.ipynb")
        files[-1].write_text(
            json.dumps(notebook_of(page), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    return files


if __name__ == "__main__":
    for made in make_notebooks(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "examples" / "notebooks"):
        print(f"{made}   {made.stat().st_size / 1000:.0f} kB")
