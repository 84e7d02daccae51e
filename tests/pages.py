"""The pages of docs/ as programs: what their blocks of Python define when they run from top to bottom."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def run_page(name: str, least: int = 1) -> dict[str, object]:
    """Run the Python of a page and return what it defines; fail where it has fewer blocks than at least so many."""
    page = DOCS / name
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) >= least
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(page), "exec"), names)
    return names
