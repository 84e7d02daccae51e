"""A person's own trajectory, read from a file of columns for ``excitation.kind: file``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from beam_ros.errors import UsageError
from beam_ros.files.columns import ColumnChoice, ColumnFile, TimeBase, choose_column, read_columns, time_base
from beam_ros.files.formats import open_columns
from beam_ros.files.units import find_unit
from beam_ros.interfaces.rig_parameters import ExcitationSettings
from beam_ros.process.checksums import checksum

_QUANTITIES = {"m": "position", "m/s": "velocity", "m/s^2": "acceleration"}
"""What a column of motion is, by its SI unit."""
_DIGITS = 12  # of a checksum: enough to tell two files apart


def read_trajectory(excitation: ExcitationSettings) -> dict[str, Any]:
    """Return what the file of a trajectory says, as fields of the recipe.

    Raises
    ------
    UsageError
        No file is named, or none or several of its columns are a motion.
    ColumnFileError
        The file cannot be read, or has a row that cannot be right; the message names it.
    """
    if not excitation.file:
        raise UsageError(
            "excitation.file is empty; expected the path of a CSV (or MAT, NPZ, UFF, TDMS) file with a time and a "
            "position, velocity or acceleration"
        )
    path = Path(excitation.file)
    file = open_columns(path)
    # Points of a path may lie at any times: what happens between them is stated.
    base = replace(time_base(file, excitation.file_time), may_be_uneven=True)
    choice = _motion(file, base, excitation.file_values)
    data = read_columns(file, base, [choice], [True])
    return {
        "quantity": _QUANTITIES[choice.unit.si],
        "times": tuple(data.times_s.tolist()),
        "values": tuple(data.values[0].tolist()),
        "source": f"{path.name} {checksum(path)[:_DIGITS]}",
    }


def _motion(file: ColumnFile, base: TimeBase, text: str) -> ColumnChoice:
    """Return the column that is the motion: the one that is named, or the only one with a unit of motion."""
    name, _, option = (part.strip() for part in text.partition(","))
    word, _, unit = option.partition("=")
    if option and word != "unit":
        raise UsageError(
            f"excitation.file_values is {text!r}; expected a column and perhaps its unit, as x,unit=mm"
        )
    if not name:
        time = base.choice.column if base.choice else None
        found = [
            own.heading
            for own in file.columns
            if own != time and (known := find_unit(own.unit)) and known.si in _QUANTITIES
        ]
        if len(found) != 1:
            raise UsageError(
                f"{file.path}: {len(found) or 'no'} columns have a unit of motion; name one with "
                "excitation.file_values, as x,unit=mm. The columns are "
                f"{', '.join(own.heading for own in file.columns)}"
            )
        name = found[0]
    choice = choose_column(file, name, unit)
    if choice.unit.si not in _QUANTITIES:
        raise UsageError(
            f"{file.path}: column {choice.column.heading!r} is in {choice.unit.si}; expected a position, velocity or "
            "acceleration: m, m/s, m/s^2 and their multiples"
        )
    return choice
