"""The source archive holds what a clone holds, and what is installed says what it is."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import pytest

from tests.packaging.conftest import ROOT

BUILD = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"


@pytest.fixture(scope="module")
def archive(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """Files of the source archive, seen from its root, and their sizes."""
    folder = tmp_path_factory.mktemp("dist")
    built = subprocess.run(
        [sys.executable, "-c", BUILD, str(folder)],
        cwd=tree,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    (path,) = folder.glob("*.tar.gz")
    with tarfile.open(path) as opened:
        return {member.name.partition("/")[2]: member.size for member in opened if member.isfile()}


@pytest.mark.slow
def test_the_source_archive_holds_all_that_the_tree_holds(archive: dict[str, int], tree: Path) -> None:
    made = ("beam_ros.egg-info", "docs/api", "dist", "build")
    files = {path.relative_to(tree).as_posix() for path in tree.rglob("*") if path.is_file()}
    ours = {name for name in files if not name.startswith(made)}
    assert ours - set(archive) == set()
    for example in (
        "bags/chirp_6s/chirp_6s_0.mcap",
        "docs/conf.py",
        "examples/data.py",
        ".ci/run",
        "bootstrap.py",
    ):
        assert archive[example] > 0


def test_the_metadata_say_what_a_reader_of_an_index_wants_to_know(setup_arguments: dict[str, Any]) -> None:
    assert setup_arguments["long_description"] == (ROOT / "README.md").read_text(encoding="utf-8")
    assert setup_arguments["long_description_content_type"] == "text/markdown"
    for name in ("author", "maintainer", "maintainer_email", "keywords", "license"):
        assert setup_arguments[name]


def test_citation_and_changelog_name_this_version(setup_arguments: dict[str, Any]) -> None:
    version = setup_arguments["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {version} - " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
