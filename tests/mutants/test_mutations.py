"""The sample of mutations: stable when code moves, silent about texts, and with no stale exceptions."""

from __future__ import annotations

from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[2]

MODULE = '''
def guard(value: int | None, limit: float = 2.0) -> float:
    """Return one half."""
    if value is None or value < 3:
        raise ValueError(f"value is {1 + 1}")
    return value * limit
'''


def test_every_mutation_called_equivalent_names_a_line_that_is_there():
    for entry in YAML(typ="safe").load(Path(__file__).with_name("equivalent.yaml")):
        lines = [line.strip() for line in (ROOT / entry["file"]).read_text().splitlines()]
        assert entry["line"] in lines, entry
        assert entry["becomes"] not in ("", entry["line"])
        assert entry["reason"]


def test_a_draw_goes_by_the_lines_and_leaves_texts_alone(tmp_path):
    pytest.importorskip("cosmic_ray", reason="cosmic-ray comes with the extra dev")
    from tests.mutants.mutations import draw

    changes = []
    for folder, before in (("first", ""), ("second", '"""Moved."""\n\nOTHER = "text"\n\n\n')):
        for package in ("beam_model", "beam_ident", "beam_ros"):
            (tmp_path / folder / package).mkdir(parents=True)
        name = "module.py" if folder == "first" else "elsewhere.py"
        (tmp_path / folder / "beam_model" / name).write_text(before + MODULE)
        drawn = draw(tmp_path / folder, 50, 3)
        changes.append([mutation.change(tmp_path / folder) for mutation in drawn])
    assert changes[0] == changes[1]
    # 2.0, the guard as a whole, `is None`, `or`, `<`, 3 and the product; neither annotations nor the message.
    assert len(changes[0]) == 7
    assert not any("ValueError" in line for line, _ in changes[0])
