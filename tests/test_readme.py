"""The README names what there is: every verb, node, topic and service, and no file that is missing."""

from __future__ import annotations

import re
from pathlib import Path

from beam_ros.cli.main import VERBS
from beam_ros.interfaces.graph import NODES, SERVICES, TOPICS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_verb_node_topic_and_service_is_in_the_tables() -> None:
    for verb, meaning in VERBS.items():
        assert f"| `beam {verb}` | {meaning} |" in README
    for node in NODES.values():
        assert f"| `{node.executable}` | `{node.name}` | {node.meaning} |" in README
    for topic in TOPICS.values():
        assert f"| `{topic.name}` | {topic.type_name.replace('/msg/', '/')} |" in README
        assert topic.meaning in README
    for service in SERVICES:
        assert f"`{service}`" in README


def test_every_linked_file_is_there() -> None:
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "bags").glob("*.md")):
        for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} links to {target}"
