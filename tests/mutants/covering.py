"""Which tests can notice a mutation: those that run its line; where that runs at import, the module's own as well."""

from __future__ import annotations

import ast
import json
import re
from functools import cached_property
from pathlib import Path

import coverage

from tests.mutants.mutations import Mutation, Position, span
from tests.test_structure import ROOT, in_table, own_tests

Lines = set[int]


class CoverageMap:
    """What ``coverage_map.py`` has measured.

    Parameters
    ----------
    cache : Path -- where the measurement lies
    root : Path -- the tree that it belongs to
    """

    def __init__(self, cache: Path, root: Path) -> None:
        self._root = root
        self._data = coverage.CoverageData(str(cache / "coverage"))
        self._data.read()
        self.durations_s: dict[str, float] = json.loads((cache / "durations.json").read_text())

    def tests(self, mutation: Mutation, budget_s: float) -> dict[str, float]:
        """Choose the tests for a mutation.

        Returns
        -------
        dict of str to float -- duration [s] of each test, in the order in which they should run: the module's own
            file and then quick files first, and no more than `budget_s` in all
        """
        source = (self._root / mutation.path).read_text()
        chosen: set[str] = set()
        for context in self._contexts(mutation, source):
            chosen |= self._tests_of(context)
        own = _own_file(mutation.path)
        in_file: dict[str, float] = {}
        for test in chosen:
            in_file[_file(test)] = in_file.get(_file(test), 0.0) + self.durations_s[test]
        kept: dict[str, float] = {}
        order = {test: (_file(test) != own, in_file[_file(test)], _file(test)) for test in chosen}
        for test in sorted(chosen, key=lambda t: (*order[t], self.durations_s[t])):
            if not kept or sum(kept.values()) + self.durations_s[test] <= budget_s:
                kept[test] = self.durations_s[test]
        return kept

    def _contexts(self, mutation: Mutation, source: str) -> set[str]:
        tree = ast.parse(source)
        statements, is_in_function = _statements(tree, source, mutation.position)
        by_line = self._data.contexts_by_lineno(mutation.path)
        if is_in_function:
            # The interpreter leaves no trace of some lines, such as a bare `continue`: then what holds them counts.
            for first, last in statements:
                found = {c for line in range(first, last + 1) for c in by_line.get(line, ()) if c}
                if found:
                    return found
            return set()
        # Run once, at import: whoever uses the name that the statement gives can notice, and who reads the module.
        name = _name_given(tree, mutation.position[0])
        used = re.compile(rf"\b{re.escape(name)}\b")
        contexts = {_own_file(mutation.path)}
        for path in sorted(self._data.measured_files()):
            if not (self._root / path).is_file():  # it left after the measurement
                continue
            text = (self._root / path).read_text()
            numbers = {k for k, line in enumerate(text.splitlines(), 1) if used.search(line)}
            if numbers:
                inside = _lines_in_functions(ast.parse(text)) & numbers
                measured = self._data.contexts_by_lineno(path)
                contexts |= {context for line in inside for context in measured.get(line, ())}
        return contexts

    def _tests_of(self, context: str) -> set[str]:
        """Tests behind a context: one test, or a file's where a shared fixture or a cached function ran."""
        test, _, phase = context.partition(" (")
        if test in self.durations_s and not phase.startswith("setup"):
            return self._in_file[_file(test)] if self._is_cached(_file(test)) else {test}
        return self._in_file.get(_file(test), set())

    @cached_property
    def _in_file(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        for test in self.durations_s:
            found.setdefault(_file(test), set()).add(test)
        return found

    def _is_cached(self, file: str) -> bool:
        return re.search(r"^@(functools\.)?(lru_)?cache", (self._root / file).read_text(), re.M) is not None


def _own_file(path: str) -> str:
    """File of the tests of a module, in the mirrored tree or by the table."""
    module = Path(path).with_suffix("")
    file = in_table().get(module, own_tests(module))
    return file.relative_to(ROOT).as_posix()


def _file(test: str) -> str:
    return test.partition("::")[0]


def _statements(tree: ast.Module, source: str, position: Position) -> tuple[list[tuple[int, int]], bool]:
    """First and last line of the statements around a position, the innermost first; whether a function holds it."""
    lines: list[tuple[int, int]] = []
    is_in_function = False
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        for child in ast.iter_child_nodes(node):
            if not hasattr(child, "lineno"):
                pending.append(child)
                continue
            first, last = span(child, source)
            if not first <= position < last:
                continue
            is_body = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and child in node.body
            is_in_function |= is_body or isinstance(node, ast.Lambda)
            if isinstance(child, ast.stmt):
                body = getattr(child, "body", None)
                is_in_header = body is not None and position < span(body[0], source)[0]
                lines.insert(0, (child.lineno, body[0].lineno - 1 if is_in_header else last[0]))
            pending.append(child)
    return [(first, max(first, last)) for first, last in lines], is_in_function


def _name_given(tree: ast.Module, line: int) -> str:
    """Name that a statement outside functions gives: of a constant, a field or a function's default."""
    name = "?"
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or line):
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            name = getattr(node, "name", None) or getattr(target, "id", None) or name
    return name


def _lines_in_functions(tree: ast.Module) -> Lines:
    inside: Lines = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            body = node.body if isinstance(node.body, list) else [node.body]
            for part in body:
                inside |= set(range(part.lineno, (part.end_lineno or part.lineno) + 1))
    return inside
