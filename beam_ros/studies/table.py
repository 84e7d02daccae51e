"""The rows of a study as one file: Parquet, which keeps types, or CSV."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.studies.rows import Row

_HIDDEN = ("mark",)


def require_parquet() -> None:
    """Check, before any work is done, that a Parquet file can be written.

    Raises
    ------
    UsageError
        The package for that is not installed, or not for this NumPy.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as err:
        raise UsageError(
            f"a Parquet file needs pyarrow, which cannot be loaded ({err}): `pip install pyarrow` (or the extra "
            "`study` of this suite) brings it; or take --csv"
        ) from err


def columns(rows: Sequence[Row]) -> list[str]:
    """Return the names of the columns, those of the modes and outputs in their order."""
    names: dict[str, None] = {}
    for row in sorted(rows, key=len, reverse=True):
        names.update(dict.fromkeys(name for name in row if name not in _HIDDEN))
    ordered = list(names)
    modes = sorted(name for name in ordered if name.startswith("mode"))
    others = [name for name in ordered if name not in modes]
    place = others.index("n_modes") + 1 if "n_modes" in others else len(others)
    return [*others[:place], *modes, *others[place:]]


def write_table(rows: Sequence[Row], folder: Path, as_csv: bool = False) -> Path:
    """Write ``study.parquet`` or ``study.csv`` into a folder; the file appears whole or not at all.

    Returns
    -------
    Path -- the file
    """
    names = columns(rows)
    target = folder / ("study.csv" if as_csv else "study.parquet")
    partial = target.with_name(target.name + ".partial")
    if as_csv:
        with partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names, restval="", extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
    else:
        import pyarrow as pa
        from pyarrow import parquet

        table = pa.table({name: pa.array([row.get(name) for row in rows]) for name in names})
        parquet.write_table(table, partial)
    os.replace(partial, target)
    return target
