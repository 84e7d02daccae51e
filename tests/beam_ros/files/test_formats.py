"""Every format there and back, and what is no file of a format."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from beam_ros.files.errors import ColumnFileError
from beam_ros.files.formats import FORMATS, is_column_file, open_columns
from tests.beam_ros.files.tables import FORCE, TIMES, TIP, WRITERS, read_table


@pytest.mark.parametrize("kind", WRITERS)
def test_what_another_library_wrote_comes_back_in_si_units(tmp_path: Path, kind: str) -> None:
    name, write = WRITERS[kind]
    write(tmp_path / name)
    assert is_column_file(tmp_path / name)
    found = read_table(tmp_path / name)
    np.testing.assert_allclose(found.times_s, TIMES, rtol=1e-12)
    np.testing.assert_allclose(found.values[0], FORCE, rtol=1e-12)
    np.testing.assert_allclose(found.values[1], 1e-3 * TIP, rtol=1e-12)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_of_no_such_format_is_refused_by_its_name(tmp_path: Path, kind: str) -> None:
    name, _ = WRITERS[kind]
    pytest.importorskip({"uff": "pyuff", "tdms": "nptdms", "mat73": "h5py"}.get(kind, "numpy"))
    path = tmp_path / name
    path.write_bytes(b"MATLAB 7.3 nothing" if kind == "mat73" else b"nothing of that kind\n" * 3)
    with pytest.raises(
        ColumnFileError, match=rf"{re.escape(name)}: .*; |{re.escape(name)}: .*expected|is damaged"
    ):
        open_columns(path)


def test_a_name_that_ends_otherwise_is_refused_with_all_that_would_do(tmp_path: Path) -> None:
    path = tmp_path / "run.xlsx"
    path.write_text("1,2\n")
    assert not is_column_file(path)
    with pytest.raises(ColumnFileError, match=r"ends with '\.xlsx'.*\.csv.*\.npz.*\.mat.*\.uff.*\.tdms"):
        open_columns(path)
    assert is_column_file(tmp_path / "none.csv")
    with pytest.raises(ColumnFileError, match="is no file"):
        open_columns(tmp_path / "none.csv")
    (tmp_path / "bag.csv").mkdir()
    assert not is_column_file(tmp_path / "bag.csv")


def test_no_two_formats_end_alike() -> None:
    suffixes = [suffix for own in FORMATS for suffix in own.suffixes]
    assert sorted(set(suffixes)) == sorted(suffixes)


def test_columns_of_a_matrix_are_numbered_and_settings_are_none(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "a.npz", t=np.arange(4.0), y_mm=np.arange(8.0).reshape(4, 2), rate=3.0, words=["a", "b"]
    )
    file = open_columns(tmp_path / "a.npz")
    assert [own.heading for own in file.columns] == ["t", "y_mm_1", "y_mm_2"]
    (block,) = file.blocks(file.columns[::2])
    np.testing.assert_array_equal(block.values, [[0.0, 1.0], [1.0, 3.0], [2.0, 5.0], [3.0, 7.0]])


def test_arrays_of_different_lengths_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=np.arange(4.0), y=np.arange(5.0))
    file = open_columns(tmp_path / "a.npz")
    with pytest.raises(ColumnFileError, match=r"different lengths \(t 4, y 5\)"):
        list(file.blocks(file.columns))


def test_spectra_are_no_samples(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff", reason="universal files need pyuff")
    spectrum = pyuff.prepare_58(
        func_type=4,
        orddenom_spec_data_type=0,
        rsp_node=1,
        rsp_dir=1,
        ref_node=1,
        ref_dir=1,
        data=np.ones(3) * 1j,
        x=np.arange(3.0),
    )
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets(spectrum, "add")
    with pytest.raises(ColumnFileError, match="none of them is a function of time"):
        open_columns(tmp_path / "a.uff")
