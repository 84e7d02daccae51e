"""One row of a study: what is identified in one bag, how good its data are, and where it comes from.

A row is flat and holds plain numbers and words, so that it goes into JSON, Parquet and CSV alike. Modes stand in
columns of the mode of theory that is nearest, so that a column means the same mode in every row.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from beam_ident.report.gates import Gate
from beam_ros.bags.reading import STORAGE_SUFFIXES, Bag
from beam_ros.bags.summary import BagInfo, summarise
from beam_ros.errors import UsageError, faults_of_the_user
from beam_ros.excitation.recipes import describe_excitation
from beam_ros.files.formats import is_column_file
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

GatesOf = Callable[[Path, Rig | None, FitOptions], Sequence[Gate]]
"""What is said of a bag before it is identified; a function of a module, so that it goes to workers."""

Row = dict[str, Any]
"""Column by name: numbers, words, truth values, or None where there is nothing to say."""

_OF_MODE = ("frequency_hz", "frequency_sd_hz", "damping_ratio", "damping_ratio_sd")
_OF_THEORY = ("theory_frequency_hz", "theory_damping_ratio")


@dataclass(frozen=True)
class Settings:
    """How every bag of a study is identified.

    Attributes
    ----------
    identifier : IdentifierSettings -- what ``beam identify`` may be told
    rig : Rig, optional -- None: as each bag says; of simulated experiments, what is simulated
    """

    identifier: IdentifierSettings
    rig: Rig | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return them in plain values, to compare and to store."""
        return {
            "identifier": asdict(self.identifier),
            "rig": None if self.rig is None else self.rig.to_nested(),
        }


@dataclass(frozen=True)
class Item:
    """What becomes one row: a recorded bag, or an experiment that is simulated with a seed."""

    bag: Path | None = None
    seed: int | None = None

    @property
    def name(self) -> str:
        """What the row is called: the bag's absolute path, or the seed."""
        return f"seed {self.seed}" if self.bag is None else str(self.bag.absolute())

    @property
    def key(self) -> str:
        """Name of the row's file, the same whenever the same bag is named."""
        return hashlib.sha256(self.name.encode()).hexdigest()[:20]

    @property
    def mark(self) -> str:
        """What changes when the bag does: names, sizes and times of its files; empty where nothing is recorded."""
        if self.bag is None:
            return ""
        try:
            stats = [(path.name, path.stat()) for path in _files(self.bag)]
        except OSError:
            return "unreadable"
        return " ".join(f"{name}:{stat.st_size}:{stat.st_mtime_ns}" for name, stat in stats)


def find_bags(patterns: Sequence[str]) -> list[Path]:
    """Return the bags that paths and patterns name.

    Parameters
    ----------
    patterns : sequence of str
        Bags, folders that hold bags at any depth, patterns such as ``runs/*/bag``, or files of columns.

    Returns
    -------
    list of Path -- each once, in the order in which they are named

    Raises
    ------
    UsageError
        A path or pattern names no bag.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = Path(pattern)
        if not path.exists() and any(sign in pattern for sign in "*?["):
            root = Path(path.anchor) if path.is_absolute() else Path()
            named = sorted(root.glob(str(path.relative_to(root))))
        else:
            named = [path]
        bags = [bag for one in named for bag in _bags_in(one, is_column_file(path))]
        if not bags:
            raise UsageError(
                f"{pattern} names no bag: expected a bag, a folder that holds bags, or a pattern such as "
                "'runs/*/bag' or 'runs/*.csv'; check the path"
            )
        found.update(dict.fromkeys(bags))
    return list(found)


def _bags_in(path: Path, is_named: bool = False) -> Iterator[Path]:
    """Yield a bag, or those in a folder: folders with a storage file, and single files where they are named."""
    if path.is_file():
        if path.suffix in STORAGE_SUFFIXES or (is_named and is_column_file(path)):
            yield path
    elif path.is_dir():
        if any(file.suffix in STORAGE_SUFFIXES for file in path.iterdir()):
            yield path
            return
        for inside in sorted(path.iterdir()):
            if inside.is_dir():
                yield from _bags_in(inside)


def study_row(item: Item, settings: Settings, gates_of: GatesOf) -> Row:
    """Make the row of a bag or a seed; whatever is wrong with it is in the row."""
    row: Row = {"bag": item.name, "verdict": "failed", "error": None, "mark": item.mark}
    row["beam_ros"] = version("beam_ros")
    try:
        if item.bag is not None:
            row.update(_row_of_bag(item.bag, settings, gates_of))
        else:
            assert item.seed is not None
            with tempfile.TemporaryDirectory(prefix="beam-study-") as scratch:
                rig = (settings.rig or Rig.from_file()).with_values({"simulation.seed": item.seed})
                simulate(rig, Path(scratch) / "bag")
                row.update(_row_of_bag(Path(scratch) / "bag", settings, gates_of))
    except faults_of_the_user() as err:
        row["error"] = str(err)
    except Exception as err:  # noqa: BLE001 - one bag must not end the study of a thousand
        row["error"] = f"{type(err).__name__}: {err}"
    return row


def failed_row(item: Item, reason: str) -> Row:
    """Return the row of a bag that could not even be tried."""
    return {"bag": item.name, "verdict": "failed", "error": reason, "mark": item.mark}


def _row_of_bag(path: Path, settings: Settings, gates_of: GatesOf) -> Row:
    info = None if is_column_file(path) else _summary(path)
    options = FitOptions.of(settings.identifier)
    gates = gates_of(path, settings.rig, replace(options, estimator="modal"))
    found = identification_of_bags(path, rig=settings.rig, options=options).content
    doubts = [mode["doubt"] for mode in found["modes"] if mode.get("doubt")]
    is_good = (
        not _names(gates, "failed")
        and not _names(gates, "doubtful")
        and found["converged"]
        and not doubts
        and not found["warnings"]
    )
    return {
        "verdict": "passed" if is_good else "doubtful",
        **_provenance(path, info),
        "estimator": found["estimator"],
        "structure": found["structure"],
        "beam": _beam_of(info, settings.rig, found["structure"]),
        "converged": found["converged"],
        "n_modes": len(found["modes"]),
        **_modes(found["modes"]),
        **{name: found.get(name) for name in ("latency_s", "latency_sd_s", "clock_rate", "clock_rate_sd")},
        **{f"fit_percent_{name}": own["fit_percent"] for name, own in found["scores"].items()},
        **(_quality(info) if info else {}),
        **{f"gates_{verdict}": _names(gates, verdict) for verdict in ("failed", "doubtful")},
        "notes": " | ".join(found["notes"]),
        "doubts": " | ".join((*doubts, *found["warnings"])),
    }


def _summary(path: Path) -> BagInfo:
    with Bag(path) as bag:
        return summarise(bag)


def _beam_of(info: BagInfo | None, rig: Rig | None, structure: str) -> str:
    """Return a mark of the beam and its ends, the same for all bags of one; empty where none is described."""
    excitation = info.excitation if info else None
    described = (excitation or {}).get("rig") if rig is None else rig.to_nested()
    if not described:
        return ""
    loads = described.get("hub", {}).get("mass") if structure == "force" else None
    markers = described.get("markers", {})
    own = [described.get("beam"), markers.get("heights"), markers.get("masses"), structure == "force", loads]
    return hashlib.sha256(strict_json(own).encode()).hexdigest()[:12]


def _modes(modes: Sequence[Mapping[str, Any]]) -> Row:
    """Return the columns of the modes, numbered as the nearest of theory; without a theory in their order."""
    nearest: dict[int, Mapping[str, Any]] = {}
    has_theory = any("theory_mode" in mode for mode in modes)
    for rank, mode in enumerate(modes, start=1):
        number = mode.get("theory_mode") if has_theory else rank
        if number is None:  # near no mode of theory
            continue
        if number not in nearest or _distance(mode) < _distance(nearest[number]):
            nearest[number] = mode
    return {
        f"mode{number}_{name}": nearest[number].get(name)
        for number in sorted(nearest)
        for name in (*_OF_MODE, *_OF_THEORY)
    }


def _distance(mode: Mapping[str, Any]) -> float:
    return float(abs(mode["frequency_hz"] - mode.get("theory_frequency_hz", mode["frequency_hz"])))


def _provenance(path: Path, info: BagInfo | None) -> Row:
    files = _files(path)
    of_files = {"bytes": sum(file.stat().st_size for file in files), "sha256": checksum(*files)}
    if info is None:  # a file of columns says nothing of where it comes from
        return of_files
    return {
        "recorded": info.apparatus.date(info.start_ns) if info.apparatus.has_date else None,
        "apparatus": info.apparatus.kind,
        "duration_s": info.duration_ns * 1e-9,
        "messages": info.message_count,
        **of_files,
        "excitation": describe_excitation(info.excitation or {}),
    }


def _files(path: Path) -> list[Path]:
    """Return the storage files of a bag."""
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES)


def _names(gates: Sequence[Gate], verdict: str) -> str:
    """Return the names of the gates that came out so."""
    return ", ".join(gate.name for gate in gates if gate.verdict == verdict)


def _quality(info: BagInfo) -> Row:
    """Return what was lost of the hub and of the frames, and how fast the hub's clock ran."""
    signals = {signal.topic.rpartition("/")[2]: signal for signal in info.signals}
    hub, frames = signals.get("measured"), signals.get("displacement")
    clock = info.clocks[0] if info.clocks else None
    return {
        "hub_samples_lost": None if hub is None else hub.lost,
        "hub_gaps": None if hub is None else hub.gaps,
        "frames_lost": None if frames is None else frames.lost,
        "markers_unseen": None if frames is None else sum(frames.unseen),
        "hub_clock_ppm": None if clock is None else clock.rate_ppm,
    }
