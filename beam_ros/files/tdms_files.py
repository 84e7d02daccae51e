"""TDMS, the files of LabVIEW and of what is built with it: channels in groups, with a time of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.files.columns import TIME, Column, RowBlock
from beam_ros.files.errors import ColumnFileError, unreadable_here

_BLOCK_ROWS = 100_000


class TdmsFile:
    """Channels of a TDMS file; where they carry a sampling interval, the column ``time`` is made of it.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    columns : tuple of Column

    Raises
    ------
    ColumnFileError
        npTDMS is missing, it is no TDMS file, or holds no channel of numbers.
    """

    row_word = "sample"

    def __init__(self, path: Path) -> None:
        try:
            import nptdms
        except ImportError as err:
            raise unreadable_here(path, "a TDMS file", "npTDMS", "export a table of text") from err
        self.path = path
        self._read: Any = nptdms.TdmsFile
        self._channels: dict[str, tuple[str, str]] = {}
        self._grid: dict[str, tuple[float, float]] = {}
        columns = []
        try:
            with self._read.open(path) as file:
                channels = [own for group in file.groups() for own in group.channels() if len(own)]
                names = [own.name for own in channels]
                for own in channels:
                    if np.dtype(own.dtype).kind not in "fiu":
                        continue
                    heading = own.name if names.count(own.name) == 1 else f"{own.group_name}.{own.name}"
                    self._channels[heading] = own.group_name, own.name
                    columns.append(Column.of(heading, str(own.properties.get("unit_string", "")).strip()))
                    if own.properties.get("wf_increment"):
                        offset = float(own.properties.get("wf_start_offset", 0.0))
                        self._grid[heading] = offset, float(own.properties["wf_increment"])
        except Exception as err:
            # npTDMS raises whatever damaged bytes lead it to.
            raise ColumnFileError(
                f"{path}: is no TDMS file ({type(err).__name__}: {err}); save it again"
            ) from err
        if not columns:
            raise ColumnFileError(f"{path}: holds no channel of numbers; expected one for each signal")
        has_time = self._grid and not any(own.name == TIME.name for own in columns)
        self.columns = ((TIME,) if has_time else ()) + tuple(columns)

    def blocks(self, columns: Sequence[Column]) -> Iterator[RowBlock]:
        """Yield all samples of some channels, a block at a time.

        Raises
        ------
        ColumnFileError
            The channels have different lengths or intervals.
        """
        wanted = [own.heading for own in columns if own.heading in self._channels]
        with self._read.open(self.path) as file:
            channels = [file[group][name] for group, name in (self._channels[own] for own in wanted)]
            grids = {self._grid.get(own) for own in wanted}
            lengths = {len(own) for own in channels}
            if len(lengths) != 1 or (TIME in columns and len(grids) != 1):
                raise ColumnFileError(
                    f"{self.path}: the channels {', '.join(wanted)} have different lengths or intervals; expected "
                    "one time for all. Import them one by one"
                )
            grid, n = grids.pop(), lengths.pop()
            for first in range(0, n, _BLOCK_ROWS):
                rows = np.arange(first, min(first + _BLOCK_ROWS, n))
                read = iter(own[first : first + _BLOCK_ROWS] for own in channels)
                values = [_times(grid, rows) if own == TIME else next(read) for own in columns]
                yield RowBlock(np.column_stack(values).astype(np.float64), 1 + rows, (rows[-1] + 1) / n)


def _times(grid: tuple[float, float] | None, rows: Any) -> FloatArray:
    offset, step = grid or (0.0, 1.0)
    return np.asarray(offset + step * rows, dtype=np.float64)
