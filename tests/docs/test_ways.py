"""A newcomer finds the page from the index in two clicks, and a message that is met where it is explained."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

# A question, the pages on the way from the index, and words of the answer.
QUESTIONS = (
    ("how do I give two sensors different delays", ("sensors.md",), "`delay` | both"),
    ("my frames come at 25 a second", ("frequency-domain.md",), "Half the frame rate is 25 Hz"),
    ("a sample of the hub is missing", ("missing-samples.md",), "`InputSignal.gaps`"),
    ("why is my marker never valid", ("refused-measurements.md",), "| `smear` |"),
    ("how do I connect an ODrive", ("connect-your-axis.md", "axis-odrive.md"), "`odrivetool`"),
    ("the driver reports other_host", ("hub-faults.md",), "`other_host`"),
    ("my film has no constant rate", ("frame-times.md",), "variable rate"),
    ("my damping grows with the swing", ("amplitude.md",), "one pole does not describe"),
    ("what do I buy for a first rig", ("parts.md",), "linear guide"),
    ("how do I cite this", ("versions.md",), "`CITATION.cff`"),
    ("I have a CSV file and no rig", ("files.md",), "--input force_N"),
    ("may a stranger see my rig's page", ("view.md",), "holds a token"),
    ("how is the uncertainty of a position found", ("camera-likelihood.md",), "Cramér–Rao bound"),
    ("is it faster than other packages", ("measured/index.md", "measured/peers.md"), "SIPPY"),
)


def links_of(page: str) -> set[str]:
    """Return the pages to which a page leads, its table of contents included, seen from docs."""
    text = (DOCS / page).read_text(encoding="utf-8")
    targets = set(re.findall(r"\]\(([^)#:]+\.md)", text))
    for tree in re.findall(r"```\{toctree\}\n(.*?)```", text, re.S):
        targets |= {f"{name}.md" for name in re.findall(r"^(?:.*<)?([\w/-]+)>?$", tree, re.M)}
    return {str((DOCS / page).parent.joinpath(target).resolve().relative_to(ROOT)) for target in targets}


@pytest.mark.parametrize(("question", "way", "words"), QUESTIONS, ids=[row[0] for row in QUESTIONS])
def test_a_question_is_answered_within_two_clicks_of_the_index(
    question: str, way: tuple[str, ...], words: str
) -> None:
    assert len(way) <= 2
    for page, following in zip(("index.md", *way), way, strict=False):
        assert f"docs/{following}" in links_of(page), f"{question}: {page} does not lead to {following}"
    answer = " ".join((DOCS / way[-1]).read_text(encoding="utf-8").split())
    assert words in answer, question


def test_every_page_can_be_reached_from_the_index() -> None:
    reached, waiting = set(), {"docs/index.md"}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        if page.startswith("docs/") and (ROOT / page).exists():
            waiting |= links_of(page.removeprefix("docs/")) - reached
    assert {str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md")} - reached == set()


@functools.cache
def printed() -> str:
    """Return all strings of the code that may be printed, values in them as one mark."""
    files = [
        ROOT / "bootstrap.py",
        *(path for room in ("beam_ident", "beam_ros") for path in (ROOT / room).rglob("*.py")),
    ]
    found = []
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                found.append(
                    "".join(
                        str(getattr(part, "value", "")) if isinstance(part, ast.Constant) else "|"
                        for part in node.values
                    )
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


@pytest.mark.slow  # all of the code is read
def test_the_readme_names_the_messages_that_a_reader_meets_as_they_are_printed() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    table = text[text.index("## Troubleshooting") : text.index("## Documentation")]
    met = re.findall(r"^\| `([^`]+)` \|", table, re.M)
    assert len(met) >= 4
    for message in met:
        for part in message.split("..."):
            words = part.strip(" :")
            assert len(words) < 4 or words in printed(), f"{message!r}: nobody prints {words!r}"
