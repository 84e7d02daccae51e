"""A release: its notes from the fragments of changes, and what lies beside its archives.

python .ci/release.py notes VERSION [--date YYYY-MM-DD]     # changelog.d becomes a section of CHANGELOG.md
python .ci/release.py seal FOLDER                           # the components, and a checksum of every file
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from datetime import date
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KINDS = ("added", "changed", "deprecated", "removed", "fixed", "security")
PACKAGE = "beam_ros"


def notes(root: Path, version: str, day: str) -> str:
    """Move the fragments of changes into the changelog, as the section of a version, and return that section."""
    fragments = {kind: sorted(path for path in (root / "changelog.d").glob(f"*.{kind}.md")) for kind in KINDS}
    if not any(fragments.values()):
        raise SystemExit(
            "changelog.d holds no fragments; expected NAME.KIND.md for each change since the last version"
        )
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise SystemExit(f"version {version!r}; expected three numbers, as 0.2.0")
    section = f"## {version} - {day}\n"
    for kind, paths in fragments.items():
        if paths:
            items = (" ".join(path.read_text(encoding="utf-8").split()) for path in paths)
            section += f"\n### {kind.capitalize()}\n\n" + "".join(f"- {item}\n" for item in items)
    log = root / "CHANGELOG.md"
    text = log.read_text(encoding="utf-8")
    place = text.index("\n## ") + 1
    log.write_text(f"{text[:place]}{section}\n{text[place:]}", encoding="utf-8")
    for paths in fragments.values():
        for path in paths:
            path.unlink()
    return section


def components() -> dict[str, Any]:
    """Return the package and all that an installation of it brings along here, as CycloneDX 1.5."""
    found: dict[str, Any] = {}
    waiting = [PACKAGE]
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in found:
            continue
        try:
            own = distribution(name)
        except PackageNotFoundError:  # of an extra, or of another platform
            continue
        found[name] = {
            "type": "application" if name == "beam-ros" else "library",
            "bom-ref": f"pkg:pypi/{name}@{own.version}",
            "name": name,
            "version": own.version,
            "purl": f"pkg:pypi/{name}@{own.version}",
            **licence_of(own.metadata),
        }
        needed = [need for need in own.requires or () if "extra ==" not in need]
        waiting += [re.match(r"[\w.-]+", need)[0] for need in needed]  # type: ignore[index]
    ours = found.pop("beam-ros")
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": ours},
        "components": [found[name] for name in sorted(found)],
    }


def licence_of(metadata: Any) -> dict[str, Any]:
    """Return the licence that a distribution states, where it is short enough to be a name."""
    stated = metadata.get("License-Expression") or metadata.get("License") or ""
    return {"licenses": [{"license": {"name": stated}}]} if stated and len(stated) < 60 else {}


def seal(folder: Path) -> Path:
    """Write the components of an installation into a folder of archives, and the checksums of all files there."""
    sums = folder / "SHA256SUMS"
    (folder / f"{PACKAGE}.cdx.json").write_text(json.dumps(components(), indent=1) + "\n", encoding="utf-8")
    files = sorted(path for path in folder.iterdir() if path.is_file() and path != sums)
    lines = (f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files)
    sums.write_text("".join(lines), encoding="utf-8")
    return sums


def main(words: list[str]) -> int:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    of_notes = verbs.add_parser("notes")
    of_notes.add_argument("version")
    of_notes.add_argument("--date", default=date.today().isoformat())
    verbs.add_parser("seal").add_argument("folder", type=Path)
    given = parser.parse_args(words)
    print(notes(ROOT, given.version, given.date) if given.verb == "notes" else seal(given.folder))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
