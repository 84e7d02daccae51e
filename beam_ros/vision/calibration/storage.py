"""Calibrations in YAML files."""

from __future__ import annotations

import io
from pathlib import Path

from ruamel.yaml import YAML

from beam_ident.report.page import write_whole
from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.parameter_files import read_yaml
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.parameters import CameraParameters


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
        raise CalibrationError(
            f"{path}: holds no calibration; expected one written by `beam calibrate --save`"
        )
    try:
        return LinearCalibration.from_dict(document)
    except CalibrationError as err:
        raise CalibrationError(f"{path}: {err}") from err


def calibration_or_nominal(path: str, camera: CameraParameters, n_markers: int) -> LinearCalibration:
    """Return the calibration that a rig names, or its camera's nominal scale.

    Parameters
    ----------
    path : str -- ``tracker.calibration``; empty: none is named
    camera : CameraParameters
    n_markers : int

    Raises
    ------
    CalibrationError
        The file is missing, no YAML, or no calibration.
    """
    return load_calibration(Path(path)) if path else LinearCalibration.from_camera(camera, n_markers)


def save_calibration(calibration: LinearCalibration, path: Path) -> None:
    """Write a calibration file whole or not at all.

    Raises
    ------
    CalibrationError
        The file cannot be written.
    """
    text = io.StringIO()
    YAML(typ="safe", pure=True).dump(calibration.to_dict(), text)
    try:
        write_whole(path, text.getvalue())
    except OSError as err:
        raise CalibrationError(
            f"{path}: cannot be written ({err.strerror}); give a path of a file that can (--save, or "
            "tracker.save_calibration)"
        ) from err
