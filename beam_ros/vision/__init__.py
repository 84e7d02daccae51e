"""The camera: frames rendered, markers tracked, pixels calibrated. Pure: NumPy and OpenCV only.

What needs OpenCV (`images`, `rendering`, `tracking`, `refinement`, `overlay`, `checkerboard`, `video`) is imported
from its own module, so that parameters, timing and calibration are there without it.
"""

from __future__ import annotations

from beam_ros.vision.beam_shape import BeamShape, BeamShapeFitter
from beam_ros.vision.calibration import Displacement, LinearCalibration
from beam_ros.vision.calibration_procedure import (
    CalibrationFit,
    CalibrationPoint,
    CalibrationProcedure,
    LineFit,
    fit_line,
)
from beam_ros.vision.continuity import FrameContinuity, FrameStep
from beam_ros.vision.disturbances import Disturbances, Glare, Occluder, SecondSpot
from beam_ros.vision.errors import (
    CalibrationError,
    ImageFormatError,
    SynchronisationError,
    VideoError,
    VisionError,
    VisionParameterError,
)
from beam_ros.vision.lens import Lens
from beam_ros.vision.parameters import CameraParameters, TrackerParameters
from beam_ros.vision.synchronisation import Synchronisation, synchronise
from beam_ros.vision.timing import FrameTiming, exposure_weights

__all__ = [
    "BeamShape",
    "BeamShapeFitter",
    "CalibrationError",
    "CalibrationFit",
    "CalibrationPoint",
    "CalibrationProcedure",
    "CameraParameters",
    "Displacement",
    "Disturbances",
    "FrameContinuity",
    "FrameStep",
    "FrameTiming",
    "Glare",
    "ImageFormatError",
    "Lens",
    "LineFit",
    "LinearCalibration",
    "Occluder",
    "SecondSpot",
    "Synchronisation",
    "SynchronisationError",
    "TrackerParameters",
    "VideoError",
    "VisionError",
    "VisionParameterError",
    "exposure_weights",
    "fit_line",
    "synchronise",
]
