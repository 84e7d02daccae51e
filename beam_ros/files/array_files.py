"""Files of named arrays: NumPy's archives and MATLAB's files, old and new (HDF5).

An array of one dimension is a column; of a matrix every column is one, numbered from 1. Structures are looked into,
with dots between the names. Only arrays that are asked for are turned into numbers.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.files.columns import Column, RowBlock
from beam_ros.files.errors import ColumnFileError, unreadable_here

_MIN_LENGTH = 2
"""Shorter arrays are settings, and no columns."""
_MAX_COLUMNS = 64
"""A matrix with more columns is a picture, or lies on its side."""
_HDF5_MARK = b"MATLAB 7.3"


class ArrayFile:
    """Arrays by their names, as columns.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to array -- of one dimension, or of two with a column for each signal
    """

    row_word = "row"

    def __init__(self, path: Path, arrays: dict[str, Any]) -> None:
        self.path = path
        self._arrays: dict[str, Callable[[], Any]] = {}
        for name, values in arrays.items():
            self._arrays.update(_columns_of(name, values))
        if not self._arrays:
            raise ColumnFileError(f"{path}: holds no arrays of real numbers; expected one for each signal")
        self.columns = tuple(Column.of(name) for name in self._arrays)

    def blocks(self, columns: Sequence[Column]) -> Iterator[RowBlock]:
        """Yield all rows of some columns, at once.

        Raises
        ------
        ColumnFileError
            The columns have different lengths.
        """
        values = [np.asarray(self._arrays[own.heading](), dtype=np.float64) for own in columns]
        yield one_block(self.path, columns, values)


def one_block(path: Path, columns: Sequence[Column], values: Sequence[FloatArray]) -> RowBlock:
    """Return columns as one block; refuse those of different lengths."""
    lengths = {own.heading: len(column) for own, column in zip(columns, values, strict=True)}
    if len(set(lengths.values())) > 1:
        raise ColumnFileError(
            f"{path}: the columns have different lengths ({', '.join(f'{k} {n}' for k, n in lengths.items())}); "
            "expected one time for all. Import the file in parts, one with each time"
        )
    return RowBlock(np.column_stack(values), 1 + np.arange(len(values[0])))


def _columns_of(name: str, values: Any) -> dict[str, Callable[[], Any]]:
    """Return how to get at each column of an array; none of a setting."""
    if values.dtype.kind not in "fiu" or max(values.shape, default=0) < _MIN_LENGTH:
        return {}
    if values.ndim == 1:
        return {name: lambda: values[...]}
    if values.ndim != 2:
        return {}
    if 1 in values.shape:
        return {name: lambda: np.ravel(values[...])}
    if values.shape[1] > min(_MAX_COLUMNS, values.shape[0]):
        return {}
    return {f"{name}_{k + 1}": lambda k=k: values[:, k] for k in range(values.shape[1])}  # type: ignore[misc]


class NumpyArchive(ArrayFile):
    """An ``.npz`` file."""

    def __init__(self, path: Path) -> None:
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, zipfile.BadZipFile, EOFError) as err:
            raise ColumnFileError(
                f"{path}: is no archive of arrays ({err}); expected what np.savez writes of numbers"
            ) from err
        super().__init__(path, arrays)


class MatFile(ArrayFile):
    """A ``.mat`` file: of MATLAB up to 7.2 by SciPy, of 7.3, which is HDF5, by h5py."""

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as stream:
                is_hdf5 = stream.read(len(_HDF5_MARK)) == _HDF5_MARK
        except OSError as err:
            raise ColumnFileError(f"{path}: cannot be read ({err.strerror}); mend its permissions") from err
        super().__init__(path, dict(_hdf5_arrays(path) if is_hdf5 else _mat_arrays(path)))


def _mat_arrays(path: Path) -> Iterator[tuple[str, Any]]:
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as err:
        # SciPy raises whatever damaged bytes lead it to.
        raise ColumnFileError(f"{path}: is no MATLAB file ({err}); expected what `save` writes") from err
    yield from _looked_into({name: own for name, own in content.items() if not name.startswith("__")})


def _looked_into(content: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, own in content.items():
        if isinstance(own, dict):
            yield from _looked_into(own, f"{above}{name}.")
        elif isinstance(own, np.ndarray):
            yield f"{above}{name}", own


def _hdf5_arrays(path: Path) -> Iterator[tuple[str, Any]]:
    try:
        import h5py
    except ImportError as err:
        raise unreadable_here(path, "a MATLAB file of version 7.3", "h5py", "save with -v7") from err
    try:
        file = h5py.File(path, "r")
    except OSError as err:
        raise ColumnFileError(f"{path}: is damaged ({err}); save it again") from err
    found: list[tuple[str, Any]] = []

    def visit(name: str, own: Any) -> None:
        if isinstance(own, h5py.Dataset) and not name.startswith("#"):
            # MATLAB's columns are HDF5's rows.
            found.append((name.replace("/", "."), own[...].T))

    file.visititems(visit)
    file.close()
    yield from found
