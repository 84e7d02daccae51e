"""Universal files (UFF, UNV) with functions of time: data sets 58, which vibration laboratories exchange."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.files.array_files import one_block
from beam_ros.files.columns import TIME, Column, RowBlock
from beam_ros.files.errors import ColumnFileError, unreadable_here

_TIME_RESPONSE = 1
_UNKNOWN = ("", "NONE", "NONE    ")
_DIRECTIONS = {1: "x", 2: "y", 3: "z", -1: "-x", -2: "-y", -3: "-z", 4: "rx", 5: "ry", 6: "rz", 0: ""}


class UniversalFile:
    """Functions of time in a universal file, which must share their times.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    columns : tuple of Column -- the time first

    Raises
    ------
    ColumnFileError
        pyuff is missing, it is no universal file, or holds no function of time.
    """

    row_word = "sample"

    def __init__(self, path: Path) -> None:
        try:
            import pyuff
        except ImportError as err:
            raise unreadable_here(path, "a universal file", "pyuff", "give a table of text") from err
        try:
            file = pyuff.UFF(str(path))
            places = [k for k, kind in enumerate(file.get_set_types()) if int(kind) == 58]
            sets = [file.read_sets(k) for k in places]
        except Exception as err:
            # pyuff raises whatever damaged text leads it to.
            raise ColumnFileError(
                f"{path}: is no universal file ({type(err).__name__}: {err}); expected data sets 58"
            ) from err
        times = [own for own in sets if int(own["func_type"]) == _TIME_RESPONSE]
        if not times:
            raise ColumnFileError(
                f"{path}: holds {len(sets)} data sets 58, and none of them is a function of time (type 1); expected "
                "samples, not spectra"
            )
        self.path = path
        self._x = np.asarray(times[0]["x"], dtype=np.float64)
        self._values: dict[str, FloatArray] = {}
        columns = [TIME]
        for number, own in enumerate(times, 1):
            name = _name_of(own, number, self._values)
            x = np.asarray(own["x"], dtype=np.float64)
            if len(x) != len(self._x) or not np.allclose(x, self._x, rtol=1e-5, atol=0.0):
                raise ColumnFileError(
                    f"{path}: function {number} ({name}) has other times than the first; expected one time for all. "
                    "Write those with each time into a file of its own"
                )
            self._values[name] = np.real(own["data"]).astype(np.float64)
            unit = str(own.get("ordinate_axis_units_lab", "")).strip()
            columns.append(Column.of(name, "" if unit in _UNKNOWN else unit))
        self.columns = tuple(columns)

    def blocks(self, columns: Sequence[Column]) -> Iterator[RowBlock]:
        """Yield all samples of some functions, at once."""
        values = [self._x if own == TIME else self._values[own.heading] for own in columns]
        yield one_block(self.path, columns, values)


def _name_of(own: dict[str, Any], number: int, taken: dict[str, Any]) -> str:
    """Return what a function is called: by its first line where that is a name, else by node and direction."""
    first = str(own.get("id1", "")).strip()
    place = f"node{int(own['rsp_node'])}{_DIRECTIONS.get(int(own['rsp_dir']), '')}"
    for name in (first if first not in _UNKNOWN else "", place):
        if name and name not in taken:
            return name
    return f"{place}_{number}"
