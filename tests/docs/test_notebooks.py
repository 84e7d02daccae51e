"""The notebooks: what their pages state, run, and with figures."""

from __future__ import annotations

import json
import os
import re
import runpy
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "make_notebooks.py"))
FOLDER = ROOT / "examples" / "notebooks"


@pytest.mark.parametrize("name", SCRIPT["PAGES"])
def test_a_notebook_is_its_page_and_has_been_run(name: str) -> None:
    page = ROOT / "docs" / f"{name}.md"
    stored = json.loads((FOLDER / f"{page.stem}.ipynb").read_text(encoding="utf-8"))
    assert (stored["nbformat"], stored["nbformat_minor"]) == (4, 5)
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in stored["cells"]]
    assert cells == SCRIPT["cells_of"](page), "run docs/make_notebooks.py"
    assert len({cell["id"] for cell in stored["cells"]}) == len(cells)
    outputs = [out for cell in stored["cells"] for out in cell.get("outputs", ())]
    assert any("image/png" in out.get("data", {}) for out in outputs)
    assert any(out.get("name") == "stdout" for out in outputs)
    for kind, source in cells:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", source) if kind == "markdown" else ():
            assert (FOLDER / target).exists(), target


def test_every_notebook_has_a_page() -> None:
    assert {path.stem for path in FOLDER.iterdir()} == {Path(name).name for name in SCRIPT["PAGES"]}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SCRIPT["PAGES"] if name.startswith("notebooks/")])
def test_a_page_of_a_notebook_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setitem(os.environ, "BEAM_BAGS", str(ROOT / "bags"))
    names: dict[str, object] = {}
    for kind, source in SCRIPT["cells_of"](ROOT / "docs" / f"{name}.md"):
        if kind == "code":
            SCRIPT["run"](source, names)


def test_a_cell_shows_what_it_prints_and_the_value_of_its_last_line() -> None:
    shown = SCRIPT["run"]("x = 2\nprint(x)\nx + 1", {})
    assert [out["output_type"] for out in shown] == ["stream", "display_data"]
    assert shown[0]["text"] == ["2\n"]
    assert shown[1]["data"]["text/plain"] == ["3"]
    assert SCRIPT["run"]("x = 2", {}) == []
