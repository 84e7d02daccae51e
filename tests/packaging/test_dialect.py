"""One dialect in all three packages and on their pages: one docstring markup, one name for a thing, plain words."""

import ast
import functools
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # all of the code is read

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("beam_model", "beam_ident", "beam_ros")
HELP_TEXTS = (
    "beam_ros/cli/live",
    "beam_ros/cli/offline",
    "beam_ros/cli/results",
)  # their docstrings are read in a terminal

# What is not written, and what is written instead.
WORDS = {
    r"\b(is|are) told\b(?! (apart|from))": "is reported, is described",
    r"\b(what|which) (is|are) no\b(?! (longer|more|better))": "not a ..., unless it is a ...",
    r"\b[Ww]hoever\b": "those who",
    r"\bto the last digit\b": "exactly",
    r"\bto be had\b": "possible, available",
    r"\b(angular|circular|radian) frequenc": "omega [rad/s], natural frequency",
}
NAMES = {
    # A recipe's fields are named as in the rig file, in Hz.
    r"beam_(model|ident)/(?!excitation/).*:frequencies": "omegas, natural_frequencies [rad/s] or frequencies_hz",
    r".*:(maximum|minimum)_\w+": "max_..., min_...",
    r".*:_?(LEAST|SMALLEST|MAXIMUM|MINIMUM|FEWEST|LONGEST)(_\w+)?": "MAX_..., MIN_...",
}
SINGLE_BACKTICKS = r"(?<!`)`(?!`)[^`\n]+`(?!`)|:(class|func|meth|mod|attr|ref|doc):"
PARTS = (ast.Module, ast.ClassDef, ast.FunctionDef)


@functools.cache
def nodes() -> list[tuple[str, ast.AST]]:
    """Return every node of the packages' code with its file."""
    files = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return [
        (path.relative_to(ROOT).as_posix(), node)
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, (*PARTS, ast.Constant))
    ]


@functools.cache
def texts() -> list[tuple[str, str]]:
    """Return every page, and every string of code with its place; what they quote is not theirs."""
    pages = [(page.name, page.read_text(encoding="utf-8")) for page in sorted((ROOT / "docs").glob("*.md"))]
    strings = [
        (f"{name}:{node.lineno}", node.value)
        for name, node in nodes()
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return [(place, re.sub(r"`[^`]*`", "", text)) for place, text in pages + strings]


def names_of(node: ast.AST) -> list[str]:
    """Return the arguments of a function, the fields of a class, or the constants of a module."""
    if isinstance(node, ast.FunctionDef):
        return [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]
    body = node.body if isinstance(node, ast.ClassDef | ast.Module) else []
    targets = [part.target for part in body if isinstance(part, ast.AnnAssign)]
    targets += [target for part in body if isinstance(part, ast.Assign) for target in part.targets]
    return [target.id for target in targets if isinstance(target, ast.Name)]


@pytest.mark.parametrize("pattern", WORDS)
def test_pages_docstrings_and_messages_are_in_plain_words(pattern: str) -> None:
    found = [place for place, text in texts() if re.search(pattern, text)]
    assert not found, f"write {WORDS[pattern]!r} instead"


@pytest.mark.parametrize("pattern", NAMES)
def test_a_thing_has_one_name(pattern: str) -> None:
    found = [
        f"{file}: {name}"
        for file, node in nodes()
        for name in names_of(node)
        if re.fullmatch(pattern, f"{file}:{name}")
    ]
    assert not found, f"call it {NAMES[pattern]}"


def test_literals_in_docstrings_stand_in_double_backticks() -> None:
    found = [
        f"{file}: {match[0]}"
        for file, node in nodes()
        if isinstance(node, PARTS) and not file.startswith(HELP_TEXTS)
        for match in re.finditer(SINGLE_BACKTICKS, ast.get_docstring(node) or "")
    ]
    assert not found
