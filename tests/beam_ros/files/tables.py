"""One small table in every format that is read, and what must come back of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beam_ros.files.columns import ColumnData, choose_column, read_columns, time_base
from beam_ros.files.formats import open_columns

PERIOD = 0.02
TIMES = 0.25 + PERIOD * np.arange(7)
FORCE = np.array([0.1, -2.5, 1 / 3, 4e-7, 0.0, 1e5, -7.25])  # N
TIP = np.array([1.5, 2.0, -1 / 7, 3.25e-5, 12.0, 0.5, 1e-3])  # mm
HEADINGS = ("time", "force_N", "tip [mm]")
TABLE = np.column_stack([TIMES, FORCE, TIP])


def write_csv(path: Path) -> None:
    rows = [",".join(map(repr, row)) for row in TABLE.tolist()]
    path.write_text("\n".join([",".join(HEADINGS), *rows, ""]))


def write_npz(path: Path) -> None:
    np.savez(path, **dict(zip(HEADINGS, TABLE.T, strict=True)), rate=500.0)


def write_mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(
        path,
        {"run": {"time": TIMES, "force_N": FORCE[:, None], "tip_mm": TIP}, "note": "text", "rate": 500.0},
    )


def write_mat73(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="MATLAB files of version 7.3 need h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("time", TIMES), ("force_N", FORCE), ("tip_mm", TIP)):
            file[name] = values[None, :]  # a column of MATLAB
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def write_uff(path: Path) -> None:
    pyuff = pytest.importorskip("pyuff", reason="universal files need pyuff")
    for place, (name, unit, values) in enumerate((("force", "N", FORCE), ("tip", "mm", TIP))):
        pyuff.UFF(str(path)).write_sets(
            pyuff.prepare_58(
                func_type=1,
                rsp_node=3,
                rsp_dir=1 + place,
                ref_node=1,
                ref_dir=1,
                data=values,
                x=TIMES,
                id1=name,
                ordinate_axis_units_lab=unit,
                orddenom_spec_data_type=0,
                abscissa_spacing=1,
                binary=1,
            ),
            "add",
        )


def write_tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms", reason="TDMS files need npTDMS")
    grid = {"wf_increment": PERIOD, "wf_start_offset": 0.25}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("run", "force", FORCE, {"unit_string": "N", **grid}),
                nptdms.ChannelObject("run", "tip", TIP, {"unit_string": "mm", **grid}),
            ]
        )


WRITERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "csv": ("run.csv", write_csv),
    "npz": ("run.npz", write_npz),
    "mat": ("run.mat", write_mat),
    "mat73": ("run73.mat", write_mat73),
    "uff": ("run.uff", write_uff),
    "tdms": ("run.tdms", write_tdms),
}
"""From a format to the name of a file in it, and its writer, which is another library's."""


def read_table(path: Path, time: str = "", **part: float) -> ColumnData:
    """Read force and tip of a file by the names that they have without units."""
    file = open_columns(path)
    prefix = "run." if any(own.heading.startswith("run.") for own in file.columns) else ""
    choices = [choose_column(file, f"{prefix}{name}") for name in ("force", "tip")]
    return read_columns(file, time_base(file, time or f"{prefix}time"), choices, [True, False], **part)
