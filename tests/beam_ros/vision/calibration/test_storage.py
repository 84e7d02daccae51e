"""A calibration's file is whole or not there, and a fault of it names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.storage import load_calibration, save_calibration
from beam_ros.vision.errors import CalibrationError
from tests.beam_ros.vision.packaged_rig import packaged_camera

CALIBRATION = LinearCalibration.from_camera(packaged_camera(), 2, relative_scale_sd=1e-4, zero_sd_px=0.1)


def test_what_is_saved_is_read_back_exactly(tmp_path: Path) -> None:
    save_calibration(CALIBRATION, tmp_path / "calibration.yaml")
    assert load_calibration(tmp_path / "calibration.yaml") == CALIBRATION
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.yaml"]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").touch()
    for path in (tmp_path / "folder", tmp_path / "folder" / "file" / "calibration.yaml"):
        with pytest.raises(CalibrationError, match="cannot be written"):
            save_calibration(CALIBRATION, path)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize("text", ["", "words", "a: 1", "- 1", "kind: linear_calibration\nschema: 1"])
def test_a_file_that_is_no_calibration_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"mine\.yaml"):
        load_calibration(path)
