"""One dialect in all three packages and on their pages: one docstring markup, one name for a thing, plain words."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("beam_model", "beam_ident", "beam_ros")
HELP_TEXTS = ("beam_ros/cli/live", "beam_ros/cli/offline")  # their docstrings are read in a terminal

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
    r"frequencies": "omegas [rad/s], natural_frequencies [rad/s] or frequencies_hz",
    r"(maximum|minimum)_\w+": "max_..., min_...",
    r"_?(MOST|LEAST|LARGEST|SMALLEST|MAXIMUM|MINIMUM|FEWEST|LONGEST)(_\w+)?": "MAX_..., MIN_...",
}
SINGLE_BACKTICKS = r"(?<!`)`(?!`)[^`\n]+`(?!`)|:(class|func|meth|mod|attr|ref|doc):"
PARTS = (ast.Module, ast.ClassDef, ast.FunctionDef)


def sources() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def is_help_text(path: Path) -> bool:
    return path.relative_to(ROOT).as_posix().startswith(HELP_TEXTS)


def texts() -> Iterator[tuple[str, str]]:
    """Yield every page, and every string of code with its place."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        yield page.name, page.read_text(encoding="utf-8")
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", node.value


@pytest.mark.parametrize("pattern", WORDS)
def test_pages_docstrings_and_messages_are_in_plain_words(pattern: str) -> None:
    # A quotation in backticks is somebody else's word.
    found = [place for place, text in texts() if re.search(pattern, re.sub(r"`[^`]*`", "", text))]
    assert not found, f"write {WORDS[pattern]!r} instead"


@pytest.mark.parametrize("pattern", NAMES)
def test_a_thing_has_one_name(pattern: str) -> None:
    found = []
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                [a.arg for a in (*node.args.args, *node.args.kwonlyargs)]
                if isinstance(node, PARTS[2])
                else []
            )
            if isinstance(node, ast.ClassDef):
                names = [
                    field.target.id
                    for field in node.body
                    if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
                ]
            if isinstance(node, ast.Module):
                targets = [t for part in node.body if isinstance(part, ast.Assign) for t in part.targets]
                names = [target.id for target in targets if isinstance(target, ast.Name)]
            found += [f"{path.relative_to(ROOT)}: {name}" for name in names if re.fullmatch(pattern, name)]
    assert not found, f"call it {NAMES[pattern]}"


def test_literals_in_docstrings_stand_in_double_backticks() -> None:
    found = []
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, PARTS) and not is_help_text(path):
                text = ast.get_docstring(node) or ""
                found += [f"{path.relative_to(ROOT)}: {m[0]}" for m in re.finditer(SINGLE_BACKTICKS, text)]
    assert not found
