"""Where the numbers of a report come from: bags with their checksums, the rig with its units, versions."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

import beam_ros
from beam_ros.excitation.recipes import describe_excitation
from beam_ros.files.formats import is_column_file
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.process.checksums import checksum
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.provenance import git_state
from beam_ros.rig.rig import Rig

_GROUPS = ("beam", "markers", "hub", "camera")  # what a rig is, beside how it is simulated and driven
_PACKAGES = ("beam_ros", "numpy", "scipy", "matplotlib", "rosbags")


def checksums(path: AnyPath) -> dict[str, str]:
    """Return the SHA-256 of every file in a bag's folder, or of the single file that it is, by name."""
    files = (
        [path] if path.is_file() else sorted((f for f in path.iterdir() if f.is_file()), key=lambda f: f.name)
    )
    return {file.name: checksum(file) for file in files}


def provenance_of_bag(experiment: Experiment) -> dict[str, str]:
    """Return where an experiment comes from: its bag, when it was, what drove it."""
    record, info = experiment.record, experiment.info
    first, last = record.inputs[0].span_s
    entries = {
        "path": str(experiment.path),
        **({} if is_column_file(experiment.path) else {"began": experiment.apparatus.date(record.start_ns)}),
        "length": f"{last - first:.3f} s",
        "structure": experiment.structure,
        "excitation": describe_excitation(info) if info else "not recorded",
    }
    rig = experiment.rig
    if info and rig is not None:
        entries["seeds"] = f"excitation {rig.excitation.seed}, simulated hardware {rig.simulation.seed}"
    if experiment.notes:
        entries["loss"] = "; ".join(experiment.notes)
    return entries | {f"SHA-256 of {name}": digest for name, digest in checksums(experiment.path).items()}


def provenance_of_rig(rig: Rig) -> dict[str, str]:
    """Return the rig's geometry, hub, markers and camera, every value with its unit."""
    values = rig.values
    return {
        name: _with_unit(values[name], RIG_PARAMETERS[name].unit)
        for name in values
        if name.partition(".")[0] in _GROUPS
    }


def provenance_of_software() -> dict[str, str]:
    """Return the versions of what computed a report, and the machine's kind."""
    commit = git_state(Path(beam_ros.__file__).resolve().parent) or "not in a source tree"
    versions = {
        "commit": commit,
        "Python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed as a package"
    return versions


def provenance_of_report(operator: str, entries: Mapping[str, str], made: str = "") -> dict[str, Any]:
    """Return when and by whom a report was made, now unless something else is given, and what was asked for."""
    now = f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
    return {"made": made or now, "operator": operator or "not said", **entries}


def _with_unit(value: object, unit: str) -> str:
    texts = [
        f"{part:g}" if isinstance(part, float) else str(part)
        for part in (value if isinstance(value, tuple) else (value,))
    ]
    suffix = f" {unit}" if unit not in ("", "1") else ""
    return f"{', '.join(texts)}{suffix}" if any(texts) else "–"
