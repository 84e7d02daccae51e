"""The one table of formats that measurements are read from: a new one is a module with a reader, and a row here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from beam_ros.files.columns import ColumnFile
from beam_ros.files.errors import ColumnFileError


@dataclass(frozen=True)
class FileFormat:
    """A format of files of columns.

    Attributes
    ----------
    name : str -- as people call it
    suffixes : tuple of str -- how names of such files end, in small letters
    module, reader : str -- the reader's class, which is made of a path, and where it stands
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    reader: str


FORMATS = (
    FileFormat("table of text", (".csv", ".tsv", ".txt", ".dat", ".asc"), "text_tables", "TextTable"),
    FileFormat("NumPy archive", (".npz",), "array_files", "NumpyArchive"),
    FileFormat("MATLAB file", (".mat",), "array_files", "MatFile"),
    FileFormat("universal file (data set 58)", (".uff", ".unv", ".58"), "universal_files", "UniversalFile"),
    FileFormat("TDMS file", (".tdms",), "tdms_files", "TdmsFile"),
)
"""Formats in the order in which they are listed for people."""


def is_column_file(path: object) -> bool:
    """Return whether a path names a file in one of the formats; whether it is there, ``open_columns`` says."""
    return isinstance(path, Path) and _format_of(path) is not None and not path.is_dir()


def open_columns(path: Path) -> ColumnFile:
    """Open a file of columns.

    Raises
    ------
    ColumnFileError
        There is no such file, its format is not known, or it is no file of that format.
    """
    if not path.is_file():
        raise ColumnFileError(f"{path}: is no file; expected one of {_listed()}")
    found = _format_of(path)
    if found is None:
        raise ColumnFileError(
            f"{path}: ends with {path.suffix!r}; expected {_listed()}. Rename it where it is one"
        )
    reader: Callable[[Path], ColumnFile] = getattr(
        importlib.import_module(f"beam_ros.files.{found.module}"), found.reader
    )
    return reader(path)


def _format_of(path: Path) -> FileFormat | None:
    return next((own for own in FORMATS if path.suffix.lower() in own.suffixes), None)


def _listed() -> str:
    return "; ".join(f"{own.name}: {' '.join(own.suffixes)}" for own in FORMATS)
