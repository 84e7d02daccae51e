"""Calibrations in YAML files."""

from __future__ import annotations

import os
from pathlib import Path

from ruamel.yaml import YAML

from beam_ros.errors import ParameterFileError
from beam_ros.schema import read_yaml
from beam_ros.vision.calibration import LinearCalibration
from beam_ros.vision.errors import CalibrationError


def load_calibration(path: Path) -> LinearCalibration:
    """Read a calibration file.

    Raises
    ------
    CalibrationError
        The file is missing, no YAML, or no calibration.
    """
    try:
        document = read_yaml(path)
    except ParameterFileError as err:
        raise CalibrationError(f"calibration file {err}") from err
    if not isinstance(document, dict):
        raise CalibrationError(f"{path}: holds no calibration; expected what tracker/fit_calibration writes")
    return LinearCalibration.from_dict(document)


def save_calibration(calibration: LinearCalibration, path: Path) -> None:
    """Write a calibration file whole or not at all.

    Raises
    ------
    CalibrationError
        The file cannot be written.
    """
    yaml = YAML(typ="safe", pure=True)
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("w", encoding="utf-8") as stream:
            yaml.dump(calibration.to_dict(), stream)
        os.replace(partial, path)
    except OSError as err:
        raise CalibrationError(
            f"{path}: cannot be written ({err.strerror}); give tracker.save_calibration a writable path"
        ) from err
