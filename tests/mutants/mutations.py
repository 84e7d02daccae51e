"""Which mutations are drawn: the operators of cosmic-ray on lines that decide something.

A draw takes places first and an operator at each place second, so that a place with many possible operators
is not drawn more often than others.

Left out, because nothing that a user can measure depends on them:

- annotations, decorators (``frozen=True``, sizes of caches) and what only a type checker reads;
- texts: formatted strings, the arguments of exceptions, lines for the log, printed lines;
- ``strict=`` of ``zip``, a promise that no caller can break;
- ``__init__.py`` (exports) and the drawing of figures (widths and colours);
- moved borders (``<`` for ``<=``) between two measured quantities, which are never exactly equal; borders at
  a literal number stay in.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

PACKAGES = ("beam_model", "beam_ident", "beam_ros")
LEFT_OUT = re.compile(r"__init__\.py$|/figures(/|\.py$)")
SILENT_CALLS = {"debug", "info", "warning", "warn", "error", "fatal", "print"}

_SUMS = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul", "FloorDiv_Mul", "Mod_Mul")
_BITS = ("BitAnd_BitOr", "BitOr_BitAnd")
_BORDERS = ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt")
_GUARDS = ("Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt", "Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is")
OPERATORS = (
    *(f"ReplaceBinaryOperator_{name}" for name in (*_SUMS, *_BITS)),
    *(f"ReplaceComparisonOperator_{name}" for name in (*_BORDERS, *_GUARDS)),
    *(f"ReplaceUnaryOperator_Delete_{name}" for name in ("Not", "USub", "Invert")),
    *("AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("NumberReplacer", "ZeroIterationForLoop", "ExceptionReplacer"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak"),
)

Position = tuple[int, int]


@dataclass(frozen=True)
class Mutation:
    """One change of one place.

    Attributes
    ----------
    path : str -- file, from the tree's root
    position : tuple of int -- line (from 1) and column (from 0)
    operator : str
    occurrence : int -- number of the operator's place in the file
    """

    path: str
    position: Position
    operator: str
    occurrence: int

    def apply(self, source: str) -> str | None:
        """Return the file's mutated text; None where it would not even compile."""
        mutated = mutate_code(source, get_operator(f"core/{self.operator}")(), self.occurrence)
        try:
            compile(mutated or "", self.path, "exec")
        except (SyntaxError, ValueError):
            return None
        return mutated

    def change(self, root: Path) -> tuple[str, str]:
        """Return the first line that differs, as it is and as it becomes."""
        source = (root / self.path).read_text()
        for before, after in zip(source.splitlines(), (self.apply(source) or "").splitlines(), strict=False):
            if before != after:
                return before.strip(), after.strip()
        return "", ""


def draw(root: Path, count: int, seed: int) -> list[Mutation]:
    """Draw mutations from all modules of the three packages, each place at most once.

    The draw goes by the text of the lines, so that it stays the same when code moves.
    """
    ranked: list[tuple[bytes, list[Mutation]]] = []
    met: Counter[tuple[str, int]] = Counter()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            path = file.relative_to(root).as_posix()
            source = file.read_text()
            for place in _places(path, source) if not LEFT_OUT.search(path) else []:
                line, column = place[0].position
                text = source.splitlines()[line - 1]
                indent = len(text) - len(text.lstrip())
                met[text.strip(), column - indent] += 1
                words = f"{seed} {text.strip()} {column - indent} {met[text.strip(), column - indent]}"
                ranked.append((hashlib.sha256(words.encode()).digest(), place))
    drawn: list[Mutation] = []
    for rank, place in sorted(ranked, key=lambda pair: pair[0]):
        mutation = place[rank[-1] % len(place)]
        if mutation.apply((root / mutation.path).read_text()) is not None:
            drawn.append(mutation)
        if len(drawn) == count:
            break
    return drawn


def _places(path: str, source: str) -> list[list[Mutation]]:
    """All places of a file that can be mutated, each with its possible mutations."""
    silent = list(_silent_spans(source))
    lines = source.splitlines()
    found: dict[Position, list[Mutation]] = defaultdict(list)
    nodes = list(ast_nodes(get_ast(source)))
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        spans = (span for node in nodes for span in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(spans):
            before, after = lines[start[0] - 1][: start[1]], lines[end[0] - 1][end[1] :]
            if name.endswith(_BORDERS) and not re.match(r"\s*-?[\d.]", after):
                continue
            if name.startswith("ReplaceBinary") and (
                re.search(r"(^|[(,\[{])\s*$", before) or after[0] == ","
            ):
                continue  # the star of an argument, not of a product
            if not any(first <= start < last for first, last in silent):
                found[start].append(Mutation(path, start, name, occurrence))
    return [found[position] for position in sorted(found)]


def _silent_spans(source: str) -> Iterator[tuple[Position, Position]]:
    """Parts of a file in which a change cannot be measured (see the top of this file)."""
    for node in ast.walk(ast.parse(source)):
        for part in (node if _is_silent(node) else None, *_unmeasured_parts(node)):
            if part is not None:
                yield span(part, source)


def _is_silent(node: ast.AST) -> bool:
    if isinstance(node, ast.If):
        return ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
    if isinstance(node, ast.Call):
        return ast.unparse(node.func).rpartition(".")[2] in SILENT_CALLS
    return isinstance(node, (ast.JoinedStr, ast.Raise))


def _unmeasured_parts(node: ast.AST) -> Iterator[ast.AST | None]:
    yield getattr(node, "annotation", None)
    yield getattr(node, "returns", None)
    yield from getattr(node, "decorator_list", ())
    if isinstance(node, ast.keyword) and node.arg == "strict":
        yield node.value


def span(node: ast.AST, source: str) -> tuple[Position, Position]:
    """Start and end of a node, with columns in characters as the mutations count them."""

    def position(line: int, column: int) -> Position:
        return line, len(_lines(source)[line - 1].encode()[:column].decode())

    return position(node.lineno, node.col_offset), position(node.end_lineno, node.end_col_offset)


@cache
def _lines(source: str) -> list[str]:
    return source.splitlines()
