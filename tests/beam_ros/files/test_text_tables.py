"""Tables of text as people and instruments write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros.files import text_tables
from beam_ros.files.errors import ColumnFileError
from beam_ros.files.text_tables import TextTable

VALUES = [[0.0, 1.5, -2.25], [0.5, 1e-3, 4.0], [1.0, 12.0, 0.125], [1.5, 0.5, 6.0]]


def text_of(separator: str, comma: bool = False, head: tuple[str, ...] = ("t_s", "a_mm", "b_N")) -> str:
    rows = [separator.join(f"{own:.6e}" if own == 1e-3 else f"{own:g}" for own in row) for row in VALUES]
    text = "\n".join((*([separator.join(head)] if head else []), *rows, ""))
    return text.replace(".", ",") if comma else text


def read(path: Path) -> np.ndarray:
    table = TextTable(path)
    return np.concatenate([block.values for block in table.blocks(table.columns)])


@pytest.mark.parametrize(
    "text",
    [
        text_of(","),
        text_of(";"),
        text_of("\t"),
        text_of(" "),
        text_of(" | "),
        text_of(", "),
        text_of(";", comma=True),
        text_of("\t", comma=True),
        text_of(" ", comma=True),
        text_of(",").replace("\n", "\r\n"),
        text_of(",").replace("t_s,a_mm", '"t_s","a_mm"'),
        "# instrument 5\n# made today, in haste\n" + text_of(","),
        "Messung vom 3. Mai;;\n\n" + text_of(";", comma=True),
        text_of(",").replace("t_s,a_mm,b_N", "#t_s,a_mm,b_N"),
        "\ufeff" + text_of(";"),
    ],
    ids=range(15),
)
def test_separator_decimal_mark_headings_and_remarks_are_found(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8", newline="")
    assert [own.heading for own in TextTable(path).columns] == ["t_s", "a_mm", "b_N"]
    np.testing.assert_array_equal(read(path), VALUES)


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_letters_of_other_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text_of(";", head=("t_s", "Weg [µm]", "Größe_N")), encoding=encoding)
    found = TextTable(path).columns[1]
    assert (found.name, found.unit) == ("Weg", "µm")
    np.testing.assert_array_equal(read(path), VALUES)


@pytest.mark.parametrize("units", ["s,mm,N", "[s],[mm],[N]", "(s),(mm),(N)"])
def test_units_may_stand_in_a_row_of_their_own(tmp_path: Path, units: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text_of(",", head=()).join((f"time,a,b\n{units}\n", "")))
    assert [(own.name, own.unit) for own in TextTable(path).columns] == [
        ("time", "s"),
        ("a", "mm"),
        ("b", "N"),
    ]


def test_columns_without_headings_are_numbered_and_words_beside_numbers_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("\n".join(f"{k},point,{2 * k}" for k in range(5)))
    table = TextTable(path)
    assert [own.heading for own in table.columns] == ["column1", "column2", "column3"]
    (block,) = table.blocks([table.columns[2]])
    np.testing.assert_array_equal(block.values[:, 0], 2.0 * np.arange(5))


def test_empty_fields_are_missing_values_and_empty_lines_are_no_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,a\n0,1\n1,\n\n2,n/a\n3,4\n\n")
    table = TextTable(path)
    (block,) = table.blocks(table.columns)
    np.testing.assert_array_equal(block.values[:, 1], [1.0, np.nan, np.nan, 4.0])
    np.testing.assert_array_equal(block.rows, [2, 3, 5, 6])


def test_rows_keep_their_numbers_from_block_to_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_tables, "_BLOCK_LINES", 3)
    path = tmp_path / "run.csv"
    path.write_text("t,a\n" + "".join(f"{k},{k}\n" for k in range(7)) + "7,x\n")
    table = TextTable(path)
    found = []
    with pytest.raises(ColumnFileError, match=r"line 9: 'a' is 'x'"):
        found.extend(table.blocks(table.columns))
    assert [block.rows.tolist() for block in found] == [[2, 3, 4], [5, 6, 7]]


def test_klippers_raw_data_is_known_by_its_headings_and_its_spectra_are_refused(tmp_path: Path) -> None:
    raw = tmp_path / "raw_data_x.csv"
    raw.write_text(
        "#time,accel_x,accel_y,accel_z\n" + "".join(f"{k * 3.125e-4:.6f},1,2,9806\n" for k in range(9))
    )
    found = TextTable(raw).columns
    assert [own.unit for own in found] == ["", "mm/s^2", "mm/s^2", "mm/s^2"]
    spectrum = tmp_path / "calibration_data_x.csv"
    for text in (
        "freq,psd_x,psd_y,psd_z,psd_xyz,mzv:44.8\n5.0,1,1,1,3,0.5\n6.0,1,1,1,3,0.5\n",
        "freq,psd_x\n5.0,1\n6.0,1\n",
    ):
        spectrum.write_text(text)
        with pytest.raises(ColumnFileError, match=r"power spectra.*no phase.*OUTPUT=raw_data"):
            TextTable(spectrum)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no table of numbers"),
        (b"one\ntwo\n", "is no table of numbers"),
        (b"\x00\x01\x02", "is no text"),
        (b"t,a,a\n0,1,2\n1,1,2\n", "2 columns have the heading 'a'"),
        (b"1," * (1 << 20), "longer than"),
    ],
    ids=["empty", "words", "bytes", "twice", "endless"],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(ColumnFileError, match=words):
        TextTable(path)
