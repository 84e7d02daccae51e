"""The lens's distortion, as a camera_info message states it (model ``plumb_bob``).

With x = (u - cx) / fx, y = (v - cy) / fy and r^2 = x^2 + y^2 of the undistorted position,

    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

(Brown 1966, in the form and order k1, k2, p1, p2, k3 of OpenCV and of sensor_msgs/CameraInfo). Images are
never undistorted: the few positions that matter are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray
from beam_ros.vision.errors import CalibrationError

_ITERATIONS = 50
_CONVERGED_PX = 1e-9
_FOUND_PX = 1e-6


class RegionOfInterest(Protocol):
    """Part of the sensor that is read out [px of the full sensor]; a height or width of 0: all of it."""

    x_offset: int
    y_offset: int
    height: int
    width: int


class CameraInfo(Protocol):
    """The fields of sensor_msgs/CameraInfo that are read here, from any deserialiser."""

    height: int
    width: int
    distortion_model: str
    d: Sequence[float]
    k: Sequence[float]
    binning_x: int
    binning_y: int
    roi: RegionOfInterest


@dataclass(frozen=True)
class Lens:
    """Camera matrix and distortion.

    Attributes
    ----------
    focal_px : (float, float) -- fx, fy [px]
    centre_px : (float, float) -- cx, cy, integer coordinates at pixel centres [px]
    distortion : tuple of five floats -- k1, k2, p1, p2, k3
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = np.array([*self.focal_px, *self.centre_px, *self.distortion], dtype=np.float64)
        if values.shape != (9,) or not np.all(np.isfinite(values)) or min(self.focal_px) <= 0:
            raise CalibrationError(
                f"lens has focal lengths {self.focal_px}, centre {self.centre_px} and distortion "
                f"{self.distortion}; expected positive focal lengths and k1, k2, p1, p2, k3: calibrate the "
                "camera"
            )

    @classmethod
    def from_camera_info(cls, info: CameraInfo, image_size: tuple[int, int]) -> Lens | None:
        """Lens in the coordinates of a camera's images, from its camera_info message.

        Parameters
        ----------
        info : CameraInfo -- distortion model "plumb_bob" or "" with k1, k2, p1, p2 and k3, of which the last ones
            may be missing; matrix of the full sensor; region of interest and binning
        image_size : (int, int) -- width and height of the images that the lens is wanted for [px]

        Returns
        -------
        Lens or None -- None for a camera that is not calibrated (no focal length) or has no distortion

        Raises
        ------
        CalibrationError -- another distortion model, fields of another length, or images of another size (0 x 0, as
            cameras that are not calibrated say, is any)
        """
        binning = max(1, int(info.binning_x)), max(1, int(info.binning_y))
        size = (
            (info.roi.width or info.width) // binning[0],
            (info.roi.height or info.height) // binning[1],
        )
        lens = cls._from_model(info.distortion_model, info.d, info.k)
        if size != image_size and (lens is not None or size != (0, 0)):
            raise CalibrationError(
                f"camera_info is for images of {size[0]} x {size[1]}; expected {image_size[0]} x {image_size[1]}: "
                "calibrate the lens at this size, or set camera.width and camera.height to the camera's"
            )
        if lens is None:
            return None
        return lens.seen_through((int(info.roi.x_offset), int(info.roi.y_offset)), binning)

    @classmethod
    def _from_model(cls, distortion_model: str, d: Sequence[float], k: Sequence[float]) -> Lens | None:
        coefficients = [float(value) for value in d]
        matrix = [float(value) for value in k]
        if len(matrix) != 9:
            raise CalibrationError(f"camera_info has a matrix of {len(matrix)} numbers; expected nine")
        if matrix[0] == 0 or not any(coefficients):
            return None
        if distortion_model not in ("plumb_bob", "") or len(coefficients) > 5:
            raise CalibrationError(
                f"camera_info states distortion {distortion_model!r} with {len(coefficients)} coefficients; "
                "expected plumb_bob with at most five: calibrate the camera with that model"
            )
        coefficients += [0.0] * (5 - len(coefficients))
        k1, k2, p1, p2, k3 = coefficients
        return cls((matrix[0], matrix[4]), (matrix[2], matrix[5]), (k1, k2, p1, p2, k3))

    @classmethod
    def from_dict(cls, data: Any) -> Lens | None:
        """Read what ``lens_to_dict`` wrote.

        Raises
        ------
        CalibrationError -- it is neither None nor a lens
        """
        if data is None:
            return None
        try:
            fx, fy = (float(value) for value in data["focal_px"])
            cx, cy = (float(value) for value in data["centre_px"])
            k1, k2, p1, p2, k3 = (float(value) for value in data["distortion"])
        except (KeyError, TypeError, ValueError) as err:
            raise CalibrationError(
                f"lens of the calibration is {data!r}: expected focal_px, centre_px and five numbers of "
                "distortion; calibrate again"
            ) from err
        return cls((fx, fy), (cx, cy), (k1, k2, p1, p2, k3))

    def seen_through(self, offset_px: tuple[int, int], binning: tuple[int, int]) -> Lens:
        """Return the lens in the coordinates of an image that is a part of the sensor, or binned.

        Parameters
        ----------
        offset_px : (int, int) -- first column and row of the part that is read out [px of the full sensor]
        binning : (int, int) -- columns and rows of the sensor that make one pixel
        """
        (bx, by), (x, y) = binning, offset_px
        return Lens(
            (self.focal_px[0] / bx, self.focal_px[1] / by),
            # Integer coordinates lie at pixel centres: the middle of a group of b pixels is at (b - 1) / 2.
            ((self.centre_px[0] - x - (bx - 1) / 2) / bx, (self.centre_px[1] - y - (by - 1) / 2) / by),
            self.distortion,
        )

    def distort(self, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Where the lens images what a perfect lens would image at (u, v), any shape [px]."""
        x = (np.asarray(u, dtype=np.float64) - self.centre_px[0]) / self.focal_px[0]
        y = (np.asarray(v, dtype=np.float64) - self.centre_px[1]) / self.focal_px[1]
        dx, dy = self._displacement(x, y)
        return (
            np.asarray((x + dx) * self.focal_px[0] + self.centre_px[0]),
            np.asarray((y + dy) * self.focal_px[1] + self.centre_px[1]),
        )

    def undistort(self, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Where a perfect lens would image what this one images at (u, v), any shape [px].

        Positions that no undistorted point is imaged to (outside the model's range) come back as NaN, and
        so does NaN.
        """
        x_d = (np.asarray(u, dtype=np.float64) - self.centre_px[0]) / self.focal_px[0]
        y_d = (np.asarray(v, dtype=np.float64) - self.centre_px[1]) / self.focal_px[1]
        x, y = x_d, y_d
        step = np.full(x.shape, np.inf)
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_ITERATIONS):
                dx, dy = self._displacement(x, y)
                x_next, y_next = x_d - dx, y_d - dy
                moved_u, moved_v = (
                    np.abs(x_next - x) * self.focal_px[0],
                    np.abs(y_next - y) * self.focal_px[1],
                )
                step = np.asarray(np.maximum(moved_u, moved_v))
                x, y = x_next, y_next
                if not np.any(step > _CONVERGED_PX):
                    break
            is_found = step <= _FOUND_PX
        return (
            np.where(is_found, x * self.focal_px[0] + self.centre_px[0], np.nan),
            np.where(is_found, y * self.focal_px[1] + self.centre_px[1], np.nan),
        )

    def _displacement(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distortion of normalised coordinates."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = r2 * (k1 + r2 * (k2 + r2 * k3))
        dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.asarray(dx), np.asarray(dy)


def lens_to_dict(lens: Lens | None) -> dict[str, list[float]] | None:
    """Plain dictionary of a lens for a file; None for a camera without distortion."""
    if lens is None:
        return None
    return {
        "focal_px": list(lens.focal_px),
        "centre_px": list(lens.centre_px),
        "distortion": list(lens.distortion),
    }
