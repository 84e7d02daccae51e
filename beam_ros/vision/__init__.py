"""The camera: frames rendered, markers tracked, pixels calibrated. Pure: NumPy and OpenCV only.

The parts that need OpenCV (`images`, `rendering`, `tracking`) are imported from their own modules, so that
parameters, timing and calibration are there without it.
"""

from __future__ import annotations

from beam_ros.vision.calibration import (
    CalibrationFit,
    CalibrationPoint,
    CalibrationProcedure,
    Displacement,
    LinearCalibration,
    LineFit,
    fit_line,
)
from beam_ros.vision.errors import CalibrationError, ImageFormatError, VisionError, VisionParameterError
from beam_ros.vision.parameters import CameraParameters, TrackerParameters
from beam_ros.vision.timing import FrameTiming, exposure_weights

__all__ = [
    "CalibrationError",
    "CalibrationFit",
    "CalibrationPoint",
    "CalibrationProcedure",
    "CameraParameters",
    "Displacement",
    "FrameTiming",
    "ImageFormatError",
    "LineFit",
    "LinearCalibration",
    "TrackerParameters",
    "VisionError",
    "VisionParameterError",
    "exposure_weights",
    "fit_line",
]
