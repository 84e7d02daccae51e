"""Columns, their units and the times of rows: what is read, and what is refused with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros.files import columns as columns_module
from beam_ros.files.columns import Column, choose_column, find_column, named_apart, read_columns, time_base
from beam_ros.files.errors import ColumnFileError
from beam_ros.files.formats import open_columns
from tests.beam_ros.files.tables import WRITERS, read_table


def table(tmp_path: Path, *rows: str, head: str = "time_s,force_N,tip_mm") -> Path:
    path = tmp_path / "run.csv"
    path.write_text("\n".join((head, *rows, "")))
    return path


GOOD = [f"{0.1 * k:.1f},{k},{2 * k}" for k in range(6)]


@pytest.mark.parametrize(
    ("place", "row", "words"),
    [
        (3, "nan,3,6", "line 5: 'time_s' has no time; fill it in"),
        (3, ",3,6", "line 5: 'time_s' has no time"),
        (3, "0.1,3,6", r"line 5: 'time_s' \(0.1 s\) does not come after the row before it; sort"),
        (3, "0.2,3,6", r"line 5: 'time_s' \(0.2 s\) does not come after"),
        (3, "0.35,3,6", r"line 5: 'time_s' \(0.35 s\) comes unevenly: rows are 0.1 s apart"),
        (3, "0.3,nan,6", "line 5: 'force_N' has nothing, or NaN; expected a finite number"),
        (3, "0.3,inf,6", "line 5: 'force_N' has inf"),
        (3, "0.3,3,-inf", "line 5: 'tip_mm' has -inf"),
        (3, "0.3,three,6", "line 5: 'force_N' is 'three'; expected a number"),
        (3, "0.3,3", "line 5: 2 fields; expected 3"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(tmp_path: Path, place: int, row: str, words: str) -> None:
    rows = [*GOOD[:place], row, *GOOD[place + 1 :]]
    with pytest.raises(ColumnFileError, match=words):
        read_table(table(tmp_path, *rows))


def test_rows_that_are_missing_on_a_grid_are_counted_and_values_that_are_missing_are_nan(
    tmp_path: Path,
) -> None:
    found = read_table(table(tmp_path, *GOOD[:2], "0.2,2,", "", *GOOD[5:]))
    np.testing.assert_allclose(found.times_s, [0.0, 0.1, 0.2, 0.5], rtol=1e-12)
    np.testing.assert_array_equal(np.isnan(found.values[1]), [False, False, True, False])
    assert found.notes == (
        "run.csv: 2 rows are missing on the grid of its times",
        "'tip_mm' has no value in 1 of 4 rows",
    )


def test_rows_that_were_taken_unevenly_are_read_where_that_is_said(tmp_path: Path) -> None:
    path = table(tmp_path, *GOOD[:3], "0.35,3,6", *GOOD[4:])
    np.testing.assert_allclose(read_table(path, "time,uneven=yes").times_s[3], 0.35)


def test_rows_at_a_rate_need_no_column_of_time(tmp_path: Path) -> None:
    path = table(tmp_path, *(f"{k},{k}" for k in range(5)), head="force_N,tip_mm")
    np.testing.assert_allclose(read_table(path, "rate=400").times_s, 0.0025 * np.arange(5), rtol=1e-14)


def test_only_the_rows_between_two_times_are_kept(tmp_path: Path) -> None:
    path = table(tmp_path, *(f"{5 + 0.1 * k:.1f},{k},{k}" for k in range(9)))
    np.testing.assert_array_equal(read_table(path, start_s=0.15, end_s=0.45).values[0], [2.0, 3.0, 4.0])


def test_more_rows_than_can_be_held_are_refused_and_a_part_of_them_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(columns_module, "MAX_ROWS", 5)
    path = table(tmp_path, *GOOD)
    with pytest.raises(
        ColumnFileError, match=r"more than 5 rows; expected a part of them with --from and --to"
    ):
        read_table(path)
    assert len(read_table(path, end_s=0.35).times_s) == 4


@pytest.mark.parametrize(
    ("wanted", "unit", "words"),
    [
        ("tp_mm", "", "there is no column 'tp_mm'; did you mean tip_mm"),
        ("raw", "", "column 'raw' has no unit; say it behind the column's name, as raw,unit=mm"),
        ("odd", "", r"column 'odd \[ell\]' has the unit 'ell', which is not known"),
        ("tip", "m", "in mm by its heading and in m by what was given, 1000 times as much; mend one of them"),
        ("tip", "um", "in mm by its heading and in um by what was given, 0.001 times as much"),
        ("tip", "in", "in mm by its heading and in in by what was given, 25.4 times as much"),
    ],
)
def test_a_column_or_unit_that_cannot_be_meant_is_refused(
    tmp_path: Path, wanted: str, unit: str, words: str
) -> None:
    file = open_columns(table(tmp_path, "0,1,2,3", "1,1,2,3", head="time_s,tip_mm,raw,odd [ell]"))
    with pytest.raises(ColumnFileError, match=words):
        choose_column(file, wanted, unit)
    assert choose_column(file, "raw", "mm").unit.factor == 1e-3


def test_a_unit_that_is_given_stands_over_a_letter_that_only_looks_like_one(tmp_path: Path) -> None:
    file = open_columns(table(tmp_path, "0,1,2", "1,1,2", head="time_s,sensor_A,sensor_B"))
    assert choose_column(file, "sensor_A", "mm").unit.si == "m"


@pytest.mark.parametrize(
    ("head", "time", "words"),
    [
        ("a,b,c", "", "no columns may be the time; name it with --time.*a, b, c"),
        ("t,time,c", "", "2 columns may be the time"),
        ("a_mm,b,c", "a_mm", "in mm, not a unit of time"),
        ("a,b,c", "rate=fast", "the rate is 'fast'; expected rows a second"),
        ("a,b,c", "rate=0", "the rate is '0'"),
        ("a,b,c", "a,hold=zoh", "'hold=zoh' is no option of it"),
    ],
)
def test_a_time_that_nobody_knows_is_refused(tmp_path: Path, head: str, time: str, words: str) -> None:
    file = open_columns(table(tmp_path, "0,1,2", "1,1,2", head=head))
    with pytest.raises(ColumnFileError, match=words):
        time_base(file, time)


@pytest.mark.parametrize(
    ("head", "factor", "note"),
    [
        ("Zeit [ms],u,y", 1e-3, ""),
        ("u,y,elapsed_us", 1e-6, ""),
        ("t,u,y", 1.0, "'t' has no unit and is taken for seconds"),
    ],
)
def test_the_time_is_found_by_its_name_or_its_unit(
    tmp_path: Path, head: str, factor: float, note: str
) -> None:
    base = time_base(open_columns(table(tmp_path, "0,1,2", "1,1,2", head=head)))
    assert base.choice is not None
    assert (base.choice.unit.factor, base.note) == (factor, note)


def test_names_that_two_columns_share_keep_their_units() -> None:
    found = named_apart([Column.of("x_mm"), Column.of("x_m"), Column.of("y_m")])
    assert [own.name for own in found] == ["x_mm", "x_m", "y"]


def test_a_name_without_its_unit_is_enough(tmp_path: Path) -> None:
    name, write = WRITERS["csv"]
    write(tmp_path / name)
    file = open_columns(tmp_path / name)
    assert find_column(file, "tip").heading == find_column(file, "tip [mm]").heading == "tip [mm]"


def test_fewer_than_two_rows_are_no_record(tmp_path: Path) -> None:
    file = open_columns(table(tmp_path, *GOOD[:1]))
    with pytest.raises(ColumnFileError, match="1 rows are read; expected at least two"):
        read_columns(file, time_base(file), [choose_column(file, "tip")], [True])
