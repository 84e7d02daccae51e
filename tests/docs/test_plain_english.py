"""Pages and messages that a reader in any country reads once: short sentences, short paragraphs, plain words."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in (*(ROOT / "docs").rglob("*.md"), *(ROOT / "changelog.d").glob("*.md"), *ROOT.glob("*.md"))
)
# Pages in which something is looked up; nobody reads them from top to bottom.
REFERENCES = ("CHANGELOG.md", "docs/architecture.md", "docs/protocol.md")

MEAN_WORDS, SENTENCE_WORDS, PARAGRAPH_WORDS, PAGE_LINES = 18, 35, 120, 250

# Words that hide what is meant, and what is written instead. What stands in backticks is not prose.
HIDING = {
    r"\b(is|are|was|were) told\b": "is reported, is known",
    r"\b[Ss]aid\b": "stated, reported, named",
    r"\b[Oo]f late\b": "recently",
    r"\bin vain\b": "without effect",
    r"\b[Ww]hat is (left|no)\b": "the residuals, the remaining ...; not a ...",
    r"(?<!its |our )(?<!your )(?<!their )\bown\b(?=[.,;:)]| (of|to|with|in|for|by|is|are)\b)": "own and its noun",
}


def blocks_of(text: str) -> tuple[list[str], list[str]]:
    """Return the paragraphs and list items of a page, and the cells of its tables, as plain words."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    text = re.sub(r"`[^`]*`", "x", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text))
    paragraphs, cells = [""], []
    for line in text.splitlines():
        if line.startswith("|"):
            cells += line.strip("|").split("|")
        elif not line.strip() or line.startswith(("#", "    ")):
            paragraphs.append("")
        elif re.match(r"\s*([-*]|\d+\.) ", line):
            paragraphs.append(re.sub(r"^\s*([-*]|\d+\.) ", "", line))
        else:
            paragraphs[-1] = f"{paragraphs[-1]} {line.strip()}".strip()
    return [part for part in paragraphs if part], cells


def sentences_of(block: str) -> list[int]:
    """Return the number of words of every sentence; what has fewer than three is none."""
    counts = (len(part.split()) for part in re.split(r"(?<=[.!?])\s+", block))
    return [count for count in counts if count > 2]


def faults_of(text: str) -> list[str]:
    """Return what makes a page hard to read."""
    paragraphs, cells = blocks_of(text)
    sentences = [count for part in paragraphs for count in sentences_of(part)]
    mean = sum(sentences) / max(len(sentences), 1)
    faults = [f"{mean:.1f} words a sentence in the mean"] if mean > MEAN_WORDS else []
    for part in (*paragraphs, *cells):
        if max(sentences_of(part), default=0) > SENTENCE_WORDS:
            faults.append(f"a sentence of {max(sentences_of(part))} words in: {part.strip()[:60]}")
    for part in paragraphs:
        if len(part.split()) > PARAGRAPH_WORDS:
            faults.append(f"a paragraph of {len(part.split())} words: {part[:60]}")
    plain = "\n".join((*paragraphs, *cells))
    for pattern, instead in HIDING.items():
        faults += [f"{match[0]!r}, where {instead!r} says it" for match in re.finditer(pattern, plain)]
    return faults


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_read_once(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    faults = faults_of(text)
    assert not faults, "\n".join((f"{name}: write shorter", *faults))
    assert name in REFERENCES or len(text.splitlines()) <= PAGE_LINES, f"{name}: more than one question"


def test_the_counting_sees_what_makes_a_page_heavy() -> None:
    long = " ".join(["word"] * 36)
    page = (
        f"# Heading\n\nOne two three. Four `a b c` six!\n\n- an item\n- another\n  of two\n\n| a | {long} |\n"
    )
    assert blocks_of(page)[0] == ["One two three. Four x six!", "an item", "another of two"]
    assert faults_of(page) == [f"a sentence of 36 words in: {long[:60]}"]
    assert "words a sentence in the mean" in faults_of(" ".join(["word"] * 19) + ".")[0]
    assert "a paragraph of 124 words" in faults_of("One two three four. " * 31)[0]
    assert [fault.split("'")[1] for fault in faults_of("He said what is left of its own, on their own.")] == [
        "said",
        "what is left",
    ]
    assert faults_of("```text\nIt was said.\n```\n\nA `said` in code.") == []


# Messages ---------------------------------------------------------------------------------------------------


def text_of(node: ast.expr) -> str:
    """Return the text that an expression formats, with x for each value."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) if isinstance(part, ast.Constant) else "x" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return text_of(node.left) + text_of(node.right)
    return "x"


def messages() -> list[tuple[str, str]]:
    """Return the text of every error that is raised, with its place."""
    found = []
    for package in ("beam_model", "beam_ident", "beam_ros"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                    place = f"{path.relative_to(ROOT)}:{node.lineno}"
                    found += [(place, text_of(part)) for part in node.exc.args]
    return found


@pytest.mark.slow  # all of the code is read
def test_no_message_has_a_part_of_more_than_35_words() -> None:
    """A message has the form "what: expected; remedy", of which each part is read by itself."""
    found = messages()
    assert len(found) > 1000
    long = [
        f"{place}: {text}"
        for place, text in found
        if max(len(part.split()) for part in re.split(r"[.;]\s+", text)) > SENTENCE_WORDS
    ]
    assert not long, "\n".join(long)


@pytest.mark.slow
def test_messages_have_no_words_that_hide_the_meaning() -> None:
    found = [
        f"{place}: {match[0]!r} in {text}"
        for place, text in messages()
        for pattern in HIDING
        for match in re.finditer(pattern, text)
    ]
    assert not found, "\n".join(found)


# Equations --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_equation_that_code_cites_stands_on_the_page_that_it_names() -> None:
    number = r"\(([A-Z]\.\d+)\)"
    on_pages = {
        path.name: set(re.findall(rf"{number}$", path.read_text(encoding="utf-8"), re.M))
        for path in (ROOT / "docs").glob("*.md")
    }
    everywhere = set().union(*on_pages.values())
    cited = 0
    for package in ("beam_model", "beam_ident", "beam_ros"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            ours = set(re.findall(number, text))
            assert ours <= everywhere, f"{path}: {ours - everywhere}"
            page = re.search(r"[Ee]quation\s+numbers\s+are\s+those\s+of\s+(?:``)?docs/([\w-]+\.md)", text)
            if page is not None:
                cited += 1
                assert ours & on_pages[page[1]], f"{path} cites no equation of {page[0]}"
    assert cited > 25
