"""A release: its notes, its components, its checksums, its citation, and the workflow that would try it elsewhere."""

from __future__ import annotations

import hashlib
import json
import re
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from beam_ros.cli.main import VERBS
from tests.packaging.conftest import ROOT

RELEASE = runpy.run_path(str(ROOT / ".ci" / "release.py"))
WORKFLOW = YAML(typ="safe", pure=True).load(ROOT / ".github" / "workflows" / "ci.yml")


@pytest.fixture
def tree_of_changes(tmp_path: Path) -> Path:
    (tmp_path / "changelog.d").mkdir()
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\nWords.\n\n## 0.1.0 - 2026-11-21\n\nThe first.\n")
    (tmp_path / "changelog.d" / "README.md").write_text("how")
    return tmp_path


def test_fragments_become_the_newest_section(tree_of_changes: Path) -> None:
    for name, words in (
        ("b.fixed", "A mend.\n"),
        ("a.added", "One\nnew thing.\n"),
        ("c.added", "Another.\n"),
    ):
        (tree_of_changes / "changelog.d" / f"{name}.md").write_text(words)
    RELEASE["notes"](tree_of_changes, "0.2.0", "2027-01-02")
    log = (tree_of_changes / "CHANGELOG.md").read_text()
    assert log == (
        "# Changelog\n\nWords.\n\n## 0.2.0 - 2027-01-02\n\n### Added\n\n- One new thing.\n- Another.\n\n"
        "### Fixed\n\n- A mend.\n\n## 0.1.0 - 2026-11-21\n\nThe first.\n"
    )
    assert [path.name for path in (tree_of_changes / "changelog.d").iterdir()] == ["README.md"]


def test_a_release_without_changes_or_with_a_wrong_number_is_refused(tree_of_changes: Path) -> None:
    with pytest.raises(SystemExit, match=r"expected NAME\.KIND\.md"):
        RELEASE["notes"](tree_of_changes, "0.2.0", "2027-01-02")
    (tree_of_changes / "changelog.d" / "a.added.md").write_text("A thing.")
    with pytest.raises(SystemExit, match="expected three numbers"):
        RELEASE["notes"](tree_of_changes, "v2", "2027-01-02")
    assert (tree_of_changes / "changelog.d" / "a.added.md").exists()


def test_every_fragment_is_of_a_kind_and_short() -> None:
    for path in (ROOT / "changelog.d").iterdir():
        assert path.name == "README.md" or path.name.split(".")[-2] in RELEASE["KINDS"], path.name
        assert path.name == "README.md" or len(path.read_text(encoding="utf-8").split()) <= 60, path.name


def test_the_components_are_those_of_an_installation_and_the_checksums_hold(tmp_path: Path) -> None:
    (tmp_path / "beam_ros-0.1.0.tar.gz").write_bytes(b"archive")
    RELEASE["seal"](tmp_path)
    listed = json.loads((tmp_path / "beam_ros.cdx.json").read_text())
    assert (listed["bomFormat"], listed["specVersion"]) == ("CycloneDX", "1.5")
    assert listed["metadata"]["component"]["name"] == "beam-ros"
    names = {part["name"] for part in listed["components"]}
    assert {"numpy", "scipy", "rosbags", "mcap", "jinja2", "matplotlib", "markupsafe"} <= names
    assert "pytest" not in names  # of an extra
    assert all(part["purl"] == f"pkg:pypi/{part['name']}@{part['version']}" for part in listed["components"])
    sums = dict(line.split()[::-1] for line in (tmp_path / "SHA256SUMS").read_text().splitlines())
    assert sums["beam_ros-0.1.0.tar.gz"] == hashlib.sha256(b"archive").hexdigest()
    assert set(sums) == {"beam_ros-0.1.0.tar.gz", "beam_ros.cdx.json"}
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=tmp_path, check=True)


def test_what_is_cited_is_this_version(setup_arguments: dict[str, Any]) -> None:
    meta = json.loads((ROOT / "codemeta.json").read_text(encoding="utf-8"))
    citation = YAML(typ="safe", pure=True).load(ROOT / "CITATION.cff")
    assert meta["@context"] == "https://w3id.org/codemeta/3.0"
    assert meta["version"] == citation["version"] == setup_arguments["version"]
    assert meta["name"] == citation["title"]
    assert meta["license"].endswith(citation["license"])
    assert citation["license"] == setup_arguments["license"]
    assert meta["description"] == citation["abstract"].strip()
    assert sorted(meta["keywords"]) == sorted(citation["keywords"])


def test_the_workflow_tries_every_python_and_platform_that_is_declared(
    setup_arguments: dict[str, Any],
) -> None:
    """It has never run: only its form is held here, and what it names."""
    declared = {
        line.rpartition(" ")[2] for line in setup_arguments["classifiers"] if re.search(r":: 3\.\d+$", line)
    }
    matrix = WORKFLOW["jobs"]["offline"]["strategy"]["matrix"]
    assert {str(python) for python in matrix["python"]} == declared
    assert {re.match(r"[a-z]+", system)[0] for system in matrix["system"]} == {"ubuntu", "macos", "windows"}
    assert any(system.endswith("-arm") for system in matrix["system"])


def test_the_workflow_runs_what_there_is() -> None:
    assert set(WORKFLOW) >= {"name", "permissions", "jobs"}
    for name, job in WORKFLOW["jobs"].items():
        assert job["runs-on"], name
        assert job["timeout-minutes"] <= 120
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            if "uses" in step:
                assert re.fullmatch(r"actions/[\w-]+@v\d+", step["uses"])
            for verb in re.findall(r"^beam (\w+)", step.get("run", ""), re.M):
                assert verb in VERBS
            for path in re.findall(r"(?<![\w/])(?:\.ci|tests|docs)/[\w./-]+", step.get("run", "")):
                assert (ROOT / path).exists(), path
            for target in re.findall(r"^make (\w+)", step.get("run", ""), re.M):
                assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)
