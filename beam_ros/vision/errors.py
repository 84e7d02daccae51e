"""Errors of the camera's room: each says what was wrong, the value seen, what was expected and the remedy."""

from __future__ import annotations

from beam_ros.errors import RigError


class VisionError(RigError):
    """Base of everything that the camera's room raises."""


class VisionParameterError(VisionError, ValueError):
    """A parameter of the camera, the tracker or the renderer is out of range or contradicts another one."""


class ImageFormatError(VisionError, ValueError):
    """An image's encoding is unknown, or its bytes do not fit its height, width and step."""


class CalibrationError(VisionError, ValueError):
    """A calibration cannot be fitted, read, or used with this camera."""


class UndeterminedLensError(CalibrationError):
    """Pictures of a board leave the lens open, as those of a board that was never tilted."""


class SynchronisationError(VisionError, ValueError):
    """A camera's record cannot be laid over the hub's."""


class VideoError(VisionError, OSError):
    """A video file cannot be opened or read, or says nothing about its times."""


class CaptureError(VisionError, OSError):
    """A camera cannot be opened, or gives no more frames."""
