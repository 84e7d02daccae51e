"""Metadata of a report's folder as an RO-Crate 1.1: what every file is, who made it of what, with checksums.

The form is JSON-LD (https://w3id.org/ro/crate/1.1); archives and catalogues of research data read it.
"""

from __future__ import annotations

import json
import mimetypes
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

from beam_ros.model_files.formats import WriteRequest
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.provenance import machine_provenance

_CONTEXT = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "https://schema.org/sha256"}]
_KINDS = {
    "report.html": "Report of the identification",
    "model.json": "Identified model with its covariance",
    "poles.csv": "Natural frequencies and damping ratios with standard deviations",
    "axis.yaml": "Mass and friction of the axis, as a rig file",
    "film.mp4": "Film with the model's prediction",
}
_FORMATS = {
    ".json": "application/json",
    ".yaml": "application/yaml",
    ".cfg": "text/plain",
    ".gcode": "text/plain",
}


def ro_crate_file(request: WriteRequest) -> bytes:
    """Return the metadata of the folder that they are written into."""
    folder = request.target.parent
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    parts = [_file(path, folder) for path in files if path != request.target]
    operator = machine_provenance().get("operator", "not stated")
    written = datetime.fromtimestamp(request.model_file.stat().st_mtime, timezone.utc)
    modes = len(request.model.modes)
    data = _data(request.model_file)
    graph: list[dict[str, Any]] = [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
            "about": {"@id": "./"},
        },
        {
            "@id": "./",
            "@type": "Dataset",
            "name": f"Identification {folder.resolve().name}",
            "description": f"Continuous-time model of {', '.join(request.model.output_names)}, {modes or 'no'} modes",
            "datePublished": written.isoformat(timespec="seconds"),
            "license": "not stated",
            "creator": {"@id": "#operator"},
            "hasPart": [{"@id": part["@id"]} for part in parts],
            "mentions": [{"@id": "#identification"}],
        },
        *parts,
        *({"@id": own, "@type": "Dataset", "name": Path(own).name} for own in data),
        {"@id": "#operator", "@type": "Person", "name": operator},
        {
            "@id": "#beam_ros",
            "@type": "SoftwareApplication",
            "name": "beam_ros",
            "version": metadata.version("beam_ros"),
        },
        {
            "@id": "#identification",
            "@type": "CreateAction",
            "name": "beam identify",
            "agent": {"@id": "#operator"},
            "instrument": {"@id": "#beam_ros"},
            "object": [{"@id": own} for own in data],
            "result": [{"@id": part["@id"]} for part in parts],
            "endTime": written.isoformat(timespec="seconds"),
        },
    ]
    return (strict_json({"@context": _CONTEXT, "@graph": graph}, indent=2) + "\n").encode()


def _file(path: Path, folder: Path) -> dict[str, Any]:
    name = path.relative_to(folder).as_posix()
    guessed = _FORMATS.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    return {
        "@id": name,
        "@type": "File",
        "name": _KINDS.get(name, name),
        "encodingFormat": guessed,
        "contentSize": path.stat().st_size,
        "sha256": checksum(path),
    }


def _data(model_file: Path) -> list[str]:
    """Return the bags or files that the model was identified from, as it says."""
    try:
        summary = json.loads(model_file.read_text(encoding="utf-8")).get("summary", {})
    except (OSError, ValueError, AttributeError):
        return []
    return [str(own) for own in summary.get("bags", [summary["bag"]] if "bag" in summary else [])]
