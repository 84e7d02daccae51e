"""A ledger of the numbers that decide: constants of modules. Their count may only fall."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LEDGER = {"beam_ident": 663, "beam_model": 39, "beam_ros": 771}
ARITHMETIC = (ast.BinOp, ast.UnaryOp, ast.Constant, ast.operator, ast.unaryop)


def constants(source: str) -> Iterator[str]:
    """Yield the names of a module's constants that are numbers, or are computed of numbers alone."""
    for node in ast.parse(source).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = getattr(node, "value", None)
        if not (isinstance(target, ast.Name) and value is not None and target.id == target.id.upper()):
            continue
        parts = list(ast.walk(value))
        is_number = any(isinstance(own, ast.Constant) and type(own.value) in (int, float) for own in parts)
        if is_number and all(isinstance(own, ARITHMETIC) for own in parts):
            yield target.id


@pytest.mark.parametrize("package", LEDGER)
def test_the_number_of_constants_only_falls(package):
    found = sum(
        len(list(constants(path.read_text(encoding="utf-8")))) for path in (ROOT / package).rglob("*.py")
    )
    assert found <= LEDGER[package], (
        f"{package} has {found} constants: derive the new one from another, make it an argument with a unit, or "
        "find one that is not needed"
    )
    assert found == LEDGER[package], f"{package} has only {found} constants left: write that into LEDGER"


def test_a_constant_is_a_name_in_capitals_for_a_number():
    source = (
        "_A = 1e-3\nB: float = 2.0 * 3\nC = -1\nD = 'no'\ne = 4\nF = (1, 2)\nG = True\ndef f():\n    H = 5\n"
    )
    assert list(constants(source)) == ["_A", "B", "C"]
