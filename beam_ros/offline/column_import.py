"""A file of columns as a bag with its provenance: values in SI units, every row with its stamp.

Positions, velocities and forces become JointStates with the columns' names, accelerations an AccelStamped each, so
that ``beam identify --signals`` and other tools know what they are. The file is read once, a block of rows at a time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from beam_ros import messages
from beam_ros.arrays import FloatArray, StampArray
from beam_ros.bags.stamped_rows import StampedRows
from beam_ros.bags.writing import BagWriter
from beam_ros.errors import UsageError
from beam_ros.files.columns import (
    ColumnChoice,
    ColumnFile,
    choose_column,
    named_apart,
    time_base,
    timed_blocks,
)
from beam_ros.files.formats import open_columns
from beam_ros.files.units import INPUT_KINDS, find_unit
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.provenance import machine_provenance
from beam_ros.signals.descriptions import Signals, SignalSource

SIGNALS_NAME = "signals.yaml"
"""File in the bag's folder that says which field each signal is, for ``beam identify --signals``."""

_ARRAYS = {"position": ("position", 8), "velocity": ("velocity", 4), "force": ("effort", 0)}
"""Array of a JointState by what it holds, and how many bytes follow it: the lengths of the empty ones behind it."""
_ACCEL = "geometry_msgs/msg/AccelStamped"
_BEHIND_ACCEL_X = 40  # bytes: five more numbers

Progress = Callable[[float], None]
"""Called with the share that is done, from 0 to 1."""


@dataclass(frozen=True)
class Imported:
    """What became of a file.

    Attributes
    ----------
    path : Path -- the bag's folder
    n_rows : int
    signals : Path or None -- where input and outputs were named, the file that says so
    topics : tuple of str -- ``TOPIC:FIELD`` of every column
    notes : tuple of str
    """

    path: Path
    n_rows: int
    signals: Path | None
    topics: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Topic:
    """Columns that one message of a row carries, by their places among all that are read."""

    name: str
    type_name: str
    places: tuple[int, ...]
    rows: StampedRows


def import_columns(
    path: Path,
    target: Path,
    signals: Signals,
    *,
    time: str = "",
    start: datetime | None = None,
    operator: str = "",
    progress: Progress = lambda share: None,
) -> Imported:
    """Write a file of columns as a bag.

    Parameters
    ----------
    path : Path -- of the file
    target : Path -- the bag's folder; must not exist
    signals : Signals -- columns that are input and outputs; where none is named, every column with a unit is taken
    time : str -- as of ``time_base``
    start : datetime, optional -- when the first row was taken; by default the file's date of change, to the second
    operator : str -- who answers for it; empty: the user of the machine
    progress : callable, optional

    Raises
    ------
    ColumnFileError
        The file cannot be read, lacks a column or a unit, or has a row that cannot be right.
    BagExistsError
        Something is at the target.
    """
    file = open_columns(path)
    base = time_base(file, time)
    sources = [own for own in (signals.drive, *signals.outputs) if own is not None]
    asked = [(own.field, own.unit) for own in sources] or _all_with_units(file, base.choice)
    choices = _chosen(file, asked)
    names = _plain_names(file)
    topics, fields = _topics(choices, [names[own.column.heading] for own in choices])
    needed = [own is signals.drive for own in sources] or [False] * len(choices)
    start = start or datetime.fromtimestamp(int(path.stat().st_mtime), timezone.utc)
    start_ns = int(start.timestamp()) * messages.SECOND_NS + start.microsecond * 1000
    provenance = {
        **machine_provenance(operator),
        "imported_from": path.name,
        "imported": f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M:%S} UTC",
        "sha256": checksum(path),
        "time": time or (base.choice.column.heading if base.choice else ""),
        "columns": strict_json(
            {
                own.column.heading: {"unit": unit or own.column.unit, "si": own.unit.si, "field": field}
                for own, (_, unit), field in zip(choices, asked, fields, strict=True)
            }
        ),
    }
    count, missing = 0, 0
    with BagWriter(target, provenance=provenance) as bag:
        for topic in topics:
            bag.add_topic(topic.name, topic.type_name)
        first = None
        for times, values, state in timed_blocks(file, base, choices, needed):
            first = float(times[0]) if first is None else first
            stamps = start_ns + np.rint((times - first) * 1e9).astype(np.int64)
            _write(bag, topics, stamps, values)
            count, missing = count + len(times), state.missing
            progress(state.share)
        if count < 2:
            raise UsageError(f"{path}: {count} rows; expected at least two")
    found = _write_signals(target, signals, sources, choices, fields) if sources else None
    notes = [base.note] if base.note else []
    notes += [f"{missing} rows are missing on the grid of its times"] if missing else []
    return Imported(target, count, found, fields, tuple(notes))


def _chosen(file: ColumnFile, asked: Sequence[tuple[str, str]]) -> list[ColumnChoice]:
    """Return the columns of headings and units, each of which is named once and holds motion or force."""
    choices = [choose_column(file, wanted, unit) for wanted, unit in asked]
    headings = [own.column.heading for own in choices]
    for own in choices:
        if headings.count(own.column.heading) > 1:
            raise UsageError(
                f"{file.path}: column {own.column.heading!r} is named twice; name every column once"
            )
        if own.unit.si not in INPUT_KINDS:
            raise UsageError(
                f"{file.path}: column {own.column.heading!r} is in {own.unit.si}, neither motion nor force; "
                "leave it out"
            )
    return choices


def _all_with_units(file: ColumnFile, time: ColumnChoice | None) -> list[tuple[str, str]]:
    """Return every column that measures something an input or output may be."""
    found = [
        (own.heading, "")
        for own in file.columns
        if (time is None or own != time.column) and (unit := find_unit(own.unit)) and unit.si in INPUT_KINDS
    ]
    if not found:
        raise UsageError(
            f"{file.path}: no column has a known unit; name those that are wanted, as --output tip,unit=mm. The "
            f"columns are {', '.join(own.heading for own in file.columns)}"
        )
    return found


def _plain_names(file: ColumnFile) -> dict[str, str]:
    """Return by their headings names that topics and brackets of a field may hold, each of them once."""
    found: dict[str, str] = {}
    for own in named_apart(file.columns):
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", own.name).strip("_")
        plain = plain if plain[:1].isalpha() else f"c{plain}"
        found[own.heading] = f"{plain}_{len(found)}" if plain in found.values() else plain
    return found


def _topics(choices: Sequence[ColumnChoice], names: Sequence[str]) -> tuple[list[_Topic], tuple[str, ...]]:
    """Return the topics that carry columns, and the field of each column."""
    types = BagTypes()
    topics: list[_Topic] = []
    fields = [""] * len(choices)
    kinds = [INPUT_KINDS[own.unit.si] for own in choices]
    for kind, (array, bytes_behind) in _ARRAYS.items():
        places = tuple(k for k, own in enumerate(kinds) if own == kind)
        if not places:
            continue
        topic = f"/columns/{array}"
        message = _joint_state(types, [names[k] for k in places], array)
        template = StampedRows(types.serialize(message, graph.JOINT_STATE), len(places), bytes_behind)
        topics.append(_Topic(topic, graph.JOINT_STATE, places, template))
        for k in places:
            fields[k] = f"{topic}:{array}[{names[k]}]"
    for k in (k for k, own in enumerate(kinds) if own == "acceleration"):
        topic = f"/columns/{names[k]}"
        template = StampedRows(types.serialize(_accel(types), _ACCEL), 1, _BEHIND_ACCEL_X)
        topics.append(_Topic(topic, _ACCEL, (k,), template))
        fields[k] = f"{topic}:accel.linear.x"
    return topics, tuple(fields)


def _joint_state(types: BagTypes, names: Sequence[str], array: str) -> Any:
    """Return a JointState with zeros in one of its arrays."""
    numbers = {
        own: types.floats(np.zeros(len(names) if own == array else 0))
        for own in ("position", "velocity", "effort")
    }
    return types.make(graph.JOINT_STATE, header=messages.header(types, 0, ""), name=list(names), **numbers)


def _accel(types: BagTypes) -> Any:
    zero = types.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    accel = types.make("geometry_msgs/msg/Accel", linear=zero, angular=zero)
    return types.make(_ACCEL, header=messages.header(types, 0, ""), accel=accel)


def _write(bag: BagWriter, topics: Sequence[_Topic], stamps: StampArray, values: FloatArray) -> None:
    rows = [topic.rows.rows(stamps, values[:, list(topic.places)]) for topic in topics]
    for stamp, *own in zip(stamps.tolist(), *rows, strict=True):
        for topic, data in zip(topics, own, strict=True):
            bag.write(topic.name, stamp, data)


def _write_signals(
    target: Path,
    signals: Signals,
    sources: Sequence[SignalSource],
    choices: Sequence[ColumnChoice],
    fields: Sequence[str],
) -> Path:
    """Write which field each signal is, with what was said of its sensor."""
    entries = []
    for source, choice, text in zip(sources, choices, fields, strict=True):
        topic, _, field = text.partition(":")
        said = source.to_dict() | {
            "topic": topic,
            "field": field,
            "name": source.name or choice.column.name,
            "unit": choice.unit.si,
        }
        entries.append(said)
    content: dict[str, Any] = {"input": entries[0]} if signals.drive is not None else {}
    if signals.outputs:
        content["outputs"] = entries[-len(signals.outputs) :]
    path = target / SIGNALS_NAME
    with path.open("x", encoding="utf-8") as stream:
        YAML(typ="safe", pure=True).dump(content, stream)
    return path
