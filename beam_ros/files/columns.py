"""A file as named columns with one time: what every format becomes, and how its times and values are checked.

A reader yields blocks of rows, so that the length of a file does not matter to those who go through it once.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from beam_ros.arrays import BoolArray, FloatArray, IndexArray
from beam_ros.errors import likeliest
from beam_ros.files.errors import ColumnFileError
from beam_ros.files.units import Unit, find_unit, known_units, split_heading

MAX_ROWS = 20_000_000
"""As many rows are held at once, a gigabyte with four columns: no estimator takes more."""
_TIME_NAMES = ("t", "time", "times", "timestamp", "stamp", "zeit", "temps", "sec", "seconds")
_UNEVEN = 0.25  # of an interval, beyond what is a whole number of them: half of what would be one more


@dataclass(frozen=True)
class Column:
    """A column of a file.

    Attributes
    ----------
    heading : str -- as the file has it
    unit : str -- as the file has it; empty where it says none
    name : str -- without the unit
    """

    heading: str
    unit: str
    name: str

    @staticmethod
    def of(heading: str, unit: str = "") -> Column:
        """Return the column of a heading, with the unit that stands in it unless the file says one elsewhere."""
        name, own = split_heading(heading)
        return Column(heading.strip(), unit or own, name)


TIME = Column("time", "s", "time")
"""The column of a format that states times beside its channels, and gives them no name."""


@dataclass(frozen=True)
class RowBlock:
    """Some rows of a file.

    Attributes
    ----------
    values : ndarray, shape (n_rows, n_columns) -- NaN where a field is empty
    rows : ndarray of int, shape (n_rows,) -- their numbers, from 1, as a person finds them
    share : float -- of the file that is read behind them, from 0 to 1
    """

    values: FloatArray
    rows: IndexArray
    share: float = 1.0


class ColumnFile(Protocol):
    """What a reader of a format offers.

    Attributes
    ----------
    path : Path
    columns : tuple of Column
    row_word : str -- what a row is called there: "line", "sample"
    """

    path: Path
    columns: tuple[Column, ...]
    row_word: str

    def blocks(self, columns: Sequence[Column]) -> Iterator[RowBlock]:
        """Yield all rows of some columns, a block at a time."""


@dataclass(frozen=True)
class ColumnChoice:
    """One column as it was asked for.

    Attributes
    ----------
    column : Column
    unit : Unit -- what its values are in
    """

    column: Column
    unit: Unit


def find_column(file: ColumnFile, wanted: str) -> Column:
    """Return the column of a heading, or of a name without its unit that no other column has.

    Raises
    ------
    ColumnFileError
        There is none.
    """
    headings = [own.heading for own in file.columns]
    if wanted in headings:
        return file.columns[headings.index(wanted)]
    named = [own for own in file.columns if own.name == wanted]
    if len(named) == 1:
        return named[0]
    near = likeliest(wanted, [*headings, *(own.name for own in file.columns)])
    raise ColumnFileError(
        f"{file.path}: there is no column {wanted!r}; "
        + (f"did you mean {near}?" if near else f"expected one of {', '.join(headings)}")
    )


def choose_column(file: ColumnFile, wanted: str, unit: str = "") -> ColumnChoice:
    """Return a column with the unit of its values.

    Parameters
    ----------
    file : ColumnFile
    wanted : str -- its heading, or its name without the unit
    unit : str -- what its values are in; empty: as the file says

    Raises
    ------
    ColumnFileError
        There is no such column, nobody says its unit, or the file says another one of the same quantity.
    """
    column = find_column(file, wanted)
    said = unit or column.unit
    found = find_unit(said)
    if found is None:
        what = f"has the unit {said!r}, which is not known" if said else "has no unit"
        raise ColumnFileError(
            f"{file.path}: column {column.heading!r} {what}; say it behind the column's name, as {wanted},unit=mm. "
            f"Known are {known_units()}"
        )
    own = find_unit(column.unit)
    # Of another quantity, what stands in the heading is no unit: sensor_A is not in ampere.
    if unit and own is not None and own.si == found.si and own != found:
        raise ColumnFileError(
            f"{file.path}: column {column.heading!r} is in {column.unit} by its heading and in {unit} by what was "
            f"given, {found.factor / own.factor:.6g} times as much; mend one of them"
        )
    return ColumnChoice(column, found)


@dataclass(frozen=True)
class TimeBase:
    """Where the times of the rows come from.

    Attributes
    ----------
    choice : ColumnChoice or None -- a column; None: the rows come at a rate
    rate : float -- of the rows [Hz]; 0 where a column has the times
    may_be_uneven : bool -- whether intervals of any length are right
    note : str -- what was assumed
    """

    choice: ColumnChoice | None
    rate: float = 0.0
    may_be_uneven: bool = False
    note: str = ""


def time_base(file: ColumnFile, text: str = "") -> TimeBase:
    """Return where a file's times come from.

    Parameters
    ----------
    file : ColumnFile
    text : str
        A column, with options behind commas, as ``t,unit=ms`` or ``t,uneven=yes``; or the rate of the rows in Hz,
        ``rate=3200``; empty: the column that is called a time, or the only one with a unit of time

    Raises
    ------
    ColumnFileError
        There is none, or several might be it.
    """
    place, *options = (part.strip() for part in text.split(","))
    given = dict.fromkeys(("unit", "uneven"), "")
    for option in options:
        word, _, value = option.partition("=")
        if word not in given or not value:
            raise ColumnFileError(
                f"time {text!r}: {option!r} is no option of it; expected unit=ms or uneven=yes behind the column"
            )
        given[word] = value
    if rate := re.fullmatch(r"rate=(.*)", place):
        return TimeBase(None, _rate(text, rate[1]))
    if not place:
        place = _likely_time(file)
    note, unit = "", given["unit"]
    column = find_column(file, place)
    if not (unit or column.unit):
        unit, note = "s", f"{column.heading!r} has no unit and is taken for seconds"
    choice = choose_column(file, column.heading, unit)
    if choice.unit.si != "s":
        raise ColumnFileError(
            f"{file.path}: column {column.heading!r} is in {unit or column.unit}, not a unit of time; expected "
            "s, ms, us or ns: name another column with --time, or the rate of the rows as rate=1000"
        )
    return TimeBase(choice, 0.0, given["uneven"] == "yes", note)


def _rate(text: str, number: str) -> float:
    try:
        rate = float(number)
    except ValueError:
        rate = math.nan
    if not (math.isfinite(rate) and rate > 0.0):
        raise ColumnFileError(f"time {text!r}: the rate is {number!r}; expected rows a second, as rate=3200")
    return rate


def _likely_time(file: ColumnFile) -> str:
    called = [own for own in file.columns if own.name.strip("#").lower() in _TIME_NAMES]
    in_time = [own for own in file.columns if (unit := find_unit(own.unit)) and unit.si == "s"]
    for found in (called, in_time):
        if len(found) == 1:
            return found[0].heading
    raise ColumnFileError(
        f"{file.path}: {len(called or in_time) or 'no'} columns may be the time; name it with --time, as --time t_s, "
        f"or the rate of the rows, as --time rate=1000. The columns are "
        f"{', '.join(own.heading for own in file.columns)}"
    )


class RowTimes:
    """The times of rows that come block by block, checked.

    Parameters
    ----------
    file : ColumnFile
    base : TimeBase

    Attributes
    ----------
    missing : int -- rows that a regular grid would have besides
    share : float -- of the file that is read so far
    """

    def __init__(self, file: ColumnFile, base: TimeBase) -> None:
        self._file, self._base = file, base
        self._last = math.nan
        self._count = 0
        self._period = math.nan
        self.missing = 0
        self.share = 0.0

    def of(self, block: RowBlock, column: FloatArray | None) -> FloatArray:
        """Return the times of a block's rows [s].

        Parameters
        ----------
        block : RowBlock
        column : ndarray, shape (n_rows,) or None -- what the time's column has, where there is one

        Raises
        ------
        ColumnFileError
            A time is missing, does not come after the one before, or comes unevenly.
        """
        n, self.share = len(block.rows), block.share
        if column is None or self._base.choice is None:
            times = (self._count + np.arange(n)) / self._base.rate
            self._count += n
            return np.asarray(times, dtype=np.float64)
        times = column * self._base.choice.unit.factor
        self._refuse(~np.isfinite(times), block, "has no time", "fill it in, or take the row out")
        steps = np.diff(times, prepend=self._last)
        is_step = np.isfinite(steps)
        self._refuse(
            is_step & ~(steps > 0.0),
            block,
            "does not come after the row before it",
            "sort the rows, and give rate=.. in place of the column where it has too few digits",
            times,
        )
        if not self._base.may_be_uneven:
            self._require_even(block, times, steps, is_step)
        self._last = float(times[-1])
        return np.asarray(times, dtype=np.float64)

    def _require_even(
        self, block: RowBlock, times: FloatArray, steps: FloatArray, is_step: BoolArray
    ) -> None:
        if not math.isfinite(self._period):
            if not np.any(is_step):
                return
            self._period = float(np.median(steps[is_step]))
        ratios = np.where(is_step, steps, self._period) / self._period
        whole = np.maximum(np.rint(ratios), 1.0)
        self._refuse(
            np.abs(ratios - whole) > _UNEVEN,
            block,
            f"comes unevenly: rows are {self._period:.6g} s apart, or whole multiples of that where some are missing",
            "mend the times, give rate=.. in place of the column where it has too few digits, or say uneven=yes "
            "behind the time's column where the samples were really taken then",
            times,
        )
        self.missing += int(np.sum(whole) - len(whole))

    def _refuse(
        self, is_bad: BoolArray, block: RowBlock, what: str, remedy: str, times: FloatArray | None = None
    ) -> None:
        if not np.any(is_bad):
            return
        k = int(np.argmax(is_bad))
        assert self._base.choice is not None
        seen = "" if times is None else f" ({float(times[k]):.9g} s)"
        raise ColumnFileError(
            f"{self._file.path}, {self._file.row_word} {block.rows[k]}: {self._base.choice.column.heading!r}{seen} "
            f"{what}; {remedy}"
        )


@dataclass(frozen=True)
class ColumnData:
    """Columns of a file in memory.

    Attributes
    ----------
    times_s : ndarray, shape (n,) -- as the file has them [s]
    values : tuple of ndarray, each of shape (n,) -- in SI units, in the order that was asked for
    notes : tuple of str
    """

    times_s: FloatArray
    values: tuple[FloatArray, ...]
    notes: tuple[str, ...]


def timed_blocks(
    file: ColumnFile, base: TimeBase, choices: Sequence[ColumnChoice], needed: Sequence[bool]
) -> Iterator[tuple[FloatArray, FloatArray, RowTimes]]:
    """Yield the times [s] and the values in SI units, shape (n_rows, n_columns), of all rows, block by block.

    Parameters
    ----------
    file : ColumnFile
    base : TimeBase
    choices : sequence of ColumnChoice
    needed : sequence of bool -- whether a value of the column may not be missing

    Raises
    ------
    ColumnFileError
        A row has no time, or none of a value that is needed, or an infinite one.
    """
    asked = [*([base.choice] if base.choice else []), *choices]
    factors = np.array([own.unit.factor for own in choices])
    times = RowTimes(file, base)
    is_needed = np.asarray(needed, dtype=bool)
    for block in file.blocks([own.column for own in asked]):
        if not len(block.rows):
            continue
        own_times = times.of(block, block.values[:, 0] if base.choice else None)
        values = block.values[:, 1:] if base.choice else block.values
        is_bad = np.isinf(values) | (np.isnan(values) & is_needed)
        if np.any(is_bad):
            row, place = (int(found[0]) for found in np.nonzero(is_bad))
            seen = "nothing, or NaN" if np.isnan(values[row, place]) else f"{values[row, place]}"
            raise ColumnFileError(
                f"{file.path}, {file.row_word} {block.rows[row]}: {choices[place].column.heading!r} has {seen}; "
                "expected a finite number. Mend the row, or take it out"
            )
        yield own_times, values * factors, times


def read_columns(
    file: ColumnFile,
    base: TimeBase,
    choices: Sequence[ColumnChoice],
    needed: Sequence[bool],
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> ColumnData:
    """Read columns, or what they have between two times after the first row [s].

    Raises
    ------
    ColumnFileError
        What ``timed_blocks`` refuses, fewer than two rows, or more than can be held.
    """
    kept = [array("d") for _ in range(1 + len(choices))]
    first, missing = math.nan, 0
    for times, values, state in timed_blocks(file, base, choices, needed):
        first = float(times[0]) if math.isnan(first) else first
        keep = (times - first >= (start_s or 0.0)) & (times - first < (math.inf if end_s is None else end_s))
        missing = state.missing
        for into, column in zip(kept, (times, *values.T), strict=True):
            into.frombytes(np.ascontiguousarray(column[keep]).tobytes())
        if len(kept[0]) > MAX_ROWS:
            raise ColumnFileError(
                f"{file.path}: more than {MAX_ROWS:,} rows; expected a part of them with --from and --to (in seconds "
                "after the first row), or a bag, which `beam import` makes of files of any length"
            )
        if end_s is not None and times[-1] - first >= end_s:
            break
    found = [np.frombuffer(column, dtype=np.float64) for column in kept]
    if len(found[0]) < 2:
        raise ColumnFileError(f"{file.path}: {len(found[0])} rows are read; expected at least two")
    notes = [base.note] if base.note else []
    if missing:
        notes.append(f"{file.path.name}: {missing} rows are missing on the grid of its times")
    for choice, column in zip(choices, found[1:], strict=True):
        if unseen := int(np.count_nonzero(np.isnan(column))):
            notes.append(f"{choice.column.heading!r} has no value in {unseen} of {len(column)} rows")
    return ColumnData(found[0], tuple(found[1:]), tuple(notes))


def named_apart(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return the columns with names that no two share: their headings where names without units are the same."""
    names = [own.name for own in columns]
    return tuple(own if names.count(own.name) == 1 else replace(own, name=own.heading) for own in columns)
