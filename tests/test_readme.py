"""The README names what there is: every verb, node, topic and service, and no file that is missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from beam_ros.cli.main import LIVE, OFFLINE, RESULTS, VERBS
from beam_ros.interfaces.graph import NODES, SERVICES, TOPICS

ROOT = Path(__file__).parent.parent
TESTS = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLES = README + (ROOT / "docs" / "topics.md").read_text(encoding="utf-8")


def test_every_module_of_a_verb_is_listed() -> None:
    for listed, folder in ((LIVE, "live"), (OFFLINE, "offline"), (RESULTS, "results")):
        paths = (ROOT / "beam_ros" / "cli" / folder).glob("*.py")
        # A verb that is a word of Python has a line behind its module's name.
        modules = {path.stem.rstrip("_") for path in paths if path.stem != "__init__"}
        assert modules == set(listed)


def test_every_verb_node_topic_and_service_is_in_the_tables() -> None:
    for verb, meaning in VERBS.items():
        assert f"| `beam {verb}` | {meaning} |" in README
    for node in NODES.values():
        assert f"| `{node.executable}` | `{node.name}` | {node.meaning} |" in README
    for topic in TOPICS.values():
        assert f"| `{topic.name}` | {topic.type_name.replace('/msg/', '/')} |" in TABLES
        assert topic.meaning in TABLES
    for service in SERVICES:
        assert f"`{service}`" in TABLES


def anchors(page: Path) -> set[str]:
    """Return the names under which the headings of a page are linked."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    headings = (
        re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", line) for line in re.findall(r"^#+ (.*)$", text, re.M)
    )
    return {re.sub(r"[^\w\- ]", "", line.strip().lower()).replace(" ", "-") for line in headings}


PAGES = (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "bags").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_links_or_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", text):
        linked = page.parent / target if target else page
        if "://" not in target:
            assert linked.exists(), f"{page.name} links to {target}"
            assert not anchor or anchor in anchors(linked), f"{page.name} links to {target}#{anchor}"
    for name in re.findall(r"`((?:beam_\w+|tests|docs|benchmarks|examples)/[\w./-]+)`", text):
        assert (ROOT / name).exists(), f"{page.name} names {name}"
    for name in re.findall(r"\b(test_\w+\.py)\b", text):
        assert list((ROOT / "tests").rglob(name)), f"{page.name} names {name}"
    for name in re.findall(r"`(test_\w+)`", text):
        assert f"def {name}(" in TESTS, f"{page.name} names {name}"


def test_every_room_stands_on_the_page_of_the_architecture() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for package in ("beam_model", "beam_ident", "beam_ros"):
        for path in (ROOT / package).rglob("__init__.py"):
            room = path.parent.relative_to(ROOT).as_posix()
            modules = [file for file in path.parent.glob("*.py") if file.name != "__init__.py"]
            if room != package and modules:
                assert f"`{room}`" in page or f"`{room}/" in page, f"the page does not name {room}"


def test_every_decision_stands_in_the_list() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"^\d+\. \[(.+)\]\((.+)\)$", (folder / "index.md").read_text(encoding="utf-8"), re.M)
    assert [name for _, name in listed] == sorted(path.name for path in folder.glob("0*.md"))
    for number, (title, name) in enumerate(listed, start=1):
        assert (folder / name).read_text(encoding="utf-8").startswith(f"# {number}. {title}\n")
