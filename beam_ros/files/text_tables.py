"""Tables of text: CSV with any separator, a decimal point or comma, headings with units, and remarks before them.

The first rows show what kind of table it is. Then a block of lines at a time is parsed by NumPy, and row by row where
that fails, so that a fault is found with its line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from beam_ros.files.columns import Column, RowBlock
from beam_ros.files.errors import ColumnFileError
from beam_ros.files.units import find_unit, split_heading

_LOOK_LINES = 200
_BLOCK_LINES = 50_000
_MAX_LINE = 1 << 20
"""A longer line [characters] is no table."""
_SEPARATORS = ("\t", ";", ",", "|", " ")
_EMPTY = ("", "nan", "na", "n/a", "null", "none", "-")
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_COMMA = re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?$")
_WORDS_OF_KLIPPER = {"accel_x": "mm/s^2", "accel_y": "mm/s^2", "accel_z": "mm/s^2"}
"""Columns of Klipper's raw accelerometer data, which has no units in its headings, and what they are in."""
_SPECTRUM_OF_KLIPPER = "psd_"


@dataclass(frozen=True)
class _Dialect:
    """How a table is written.

    Attributes
    ----------
    separator : str -- a blank stands for any white space
    has_decimal_comma : bool
    first_row : int -- number of lines before the first row of numbers
    """

    separator: str
    has_decimal_comma: bool
    first_row: int

    def fields(self, line: str) -> list[str]:
        """Return the fields of a line, without quotes around them."""
        parts = line.split() if self.separator == " " else line.rstrip("\r\n").split(self.separator)
        return [part.strip().strip('"').strip() for part in parts]

    def number_count(self, fields: list[str]) -> int:
        """Return how many fields are numbers, or empty."""
        pattern = _COMMA if self.has_decimal_comma else _POINT
        return sum(field.lower() in _EMPTY or pattern.match(field) is not None for field in fields)

    def is_row(self, fields: list[str]) -> bool:
        """Return whether at least two fields are numbers or empty, one of them a number; words may stand beside."""
        pattern = _COMMA if self.has_decimal_comma else _POINT
        return self.number_count(fields) >= 2 and any(pattern.match(field) for field in fields)


class TextTable:
    """A table of text.

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
        It is no table of numbers.
    """

    row_word = "line"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._encoding = _encoding_of(path)
        with self._open() as stream:
            lines = [line for _, line in zip(range(_LOOK_LINES), _lines(stream, path), strict=False)]
        self._dialect = _dialect_of(path, lines)
        self.columns = self._columns(lines)

    def _open(self) -> TextIO:
        try:
            return self.path.open(encoding=self._encoding, errors="replace", newline="")
        except OSError as err:
            raise ColumnFileError(
                f"{self.path}: cannot be read ({err.strerror}); mend its permissions"
            ) from err

    def _columns(self, lines: list[str]) -> tuple[Column, ...]:
        dialect = self._dialect
        width = len(dialect.fields(lines[dialect.first_row]))
        above = [
            fields
            for line in lines[: dialect.first_row]
            if len(fields := dialect.fields(line.lstrip("#%").strip("\r\n"))) == width
        ]
        if not above:
            return tuple(Column.of(f"column{k}") for k in range(1, width + 1))
        headings, units = above[-1], [""] * width
        if len(above) > 1 and all(_is_unit_field(field) for field in headings):
            units = [_bare_unit(field) for field in headings]
            headings = above[-2]
        if any(heading.startswith(_SPECTRUM_OF_KLIPPER) for heading in headings):
            raise ColumnFileError(
                f"{self.path}: holds power spectra, as Klipper makes them of a test: they have no phase, and their "
                "peaks are as wide as windows of half a second make them; expected samples, as "
                "TEST_RESONANCES AXIS=X OUTPUT=raw_data writes raw_data_x_*.csv"
            )
        named = [heading or f"column{k}" for k, heading in enumerate(headings, 1)]
        for heading, count in Counter(named).items():
            if count > 1:
                raise ColumnFileError(
                    f"{self.path}: {count} columns have the heading {heading!r}; expected a name of its own for each"
                )
        if set(_WORDS_OF_KLIPPER) <= set(named):
            units = [
                unit or _WORDS_OF_KLIPPER.get(heading, "") for heading, unit in zip(named, units, strict=True)
            ]
        return tuple(Column.of(heading, unit) for heading, unit in zip(named, units, strict=True))

    def blocks(self, columns: Sequence[Column]) -> Iterator[RowBlock]:
        """Yield all rows of some columns, a block of lines at a time.

        Raises
        ------
        ColumnFileError
            A field is no number, or a row is too short.
        """
        places = [self.columns.index(column) for column in columns]
        size = max(self.path.stat().st_size, 1)
        with self._open() as stream:
            lines = _lines(stream, self.path)
            row = 1 + sum(1 for _ in islice(lines, self._dialect.first_row))
            while block := list(islice(lines, _BLOCK_LINES)):
                yield replace(self._block(block, places, row), share=stream.buffer.tell() / size)
                row += len(block)

    def _block(self, lines: list[str], places: list[int], row: int) -> RowBlock:
        dialect = self._dialect
        text = [line.replace(",", ".") for line in lines] if dialect.has_decimal_comma else lines
        try:
            values = np.loadtxt(
                text,
                delimiter=None if dialect.separator == " " else dialect.separator,
                usecols=places,
                ndmin=2,
                comments=None,
                quotechar='"',
            )
        except ValueError:
            values = None
        if values is not None and len(values) == len(lines):
            return RowBlock(values, row + np.arange(len(lines)))
        found = [
            (row + k, self._numbers(line, places, row + k))
            for k, line in enumerate(lines)
            if line.strip("\r\n ,;\t")
        ]
        return RowBlock(
            np.array([numbers for _, numbers in found], dtype=np.float64).reshape(len(found), len(places)),
            np.array([number for number, _ in found], dtype=np.intp),
        )

    def _numbers(self, line: str, places: list[int], row: int) -> list[float]:
        fields = self._dialect.fields(line)
        if len(fields) <= max(places, default=0):
            raise ColumnFileError(
                f"{self.path}, line {row}: {len(fields)} fields; expected {len(self.columns)}. Is the file cut off "
                "there? Take the line out"
            )
        numbers = []
        for place in places:
            field = fields[place]
            if field.lower() in _EMPTY:
                numbers.append(np.nan)
                continue
            try:
                numbers.append(float(field.replace(",", ".") if self._dialect.has_decimal_comma else field))
            except ValueError as err:
                raise ColumnFileError(
                    f"{self.path}, line {row}: {self.columns[place].heading!r} is {field!r}; expected a number. Mend "
                    "the line, or take it out"
                ) from err
        return numbers


def _lines(stream: TextIO, path: Path) -> Iterator[str]:
    """Yield lines; one without an end is refused before it fills the memory."""
    while line := stream.readline(_MAX_LINE):
        if len(line) == _MAX_LINE:
            raise ColumnFileError(
                f"{path}: a line is longer than {_MAX_LINE} characters; expected a table of text, a row on each line"
            )
        yield line


def _encoding_of(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            start = stream.read(1 << 16)
    except OSError as err:
        raise ColumnFileError(
            f"{path}: cannot be read ({err.strerror}); give a file that you may read"
        ) from err
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in start:
        raise ColumnFileError(
            f"{path}: is no text; expected a table of text, or a name that ends as its format does"
        )
    try:
        start.decode("utf-8")
    except UnicodeDecodeError as err:
        if err.start < len(start) - 4:  # else the look ended within a character
            return "latin-1"
    return "utf-8-sig"


def _dialect_of(path: Path, lines: list[str]) -> _Dialect:
    """Return how a table is written: the way in which the largest share of the fields of its rows are numbers."""
    rows = [line for line in lines if line.strip()]
    tail = rows[len(rows) // 2 :]
    best, found, width = 0.0, None, 0
    for has_comma in (False, True):
        for separator in _SEPARATORS:
            dialect = _Dialect(separator, has_comma and separator != ",", 0)
            split = [dialect.fields(line) for line in tail]
            own = Counter(map(len, split)).most_common(1)[0][0] if split else 0
            good = [fields for fields in split if len(fields) == own and dialect.is_row(fields)]
            # A row that is damaged is found, with its line, when it is read.
            if len(good) <= len(tail) // 2:
                continue
            share = sum(map(dialect.number_count, good)) / (own * len(split))
            if share > best:
                best, found, width = share, dialect, own
    if found is None:
        raise ColumnFileError(
            f"{path}: is no table of numbers; expected rows of two columns or more with tab, semicolon, comma, "
            "| or blanks between, below a row of headings"
        )
    is_row = [len(fields := found.fields(line)) == width and found.is_row(fields) for line in lines]
    return _Dialect(found.separator, found.has_decimal_comma, is_row.index(True))


def _bare_unit(field: str) -> str:
    """Return a unit that stands alone in a field, with or without brackets."""
    return split_heading(f"x {field}" if field[:1] in ("[", "(") else f"x [{field}]")[1]


def _is_unit_field(field: str) -> bool:
    unit = _bare_unit(field)
    return unit in ("", "-", "1") or find_unit(unit) is not None
