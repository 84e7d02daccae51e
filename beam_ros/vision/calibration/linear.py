"""From pixels to metres, with the uncertainty that this costs.

The image of a marker at position x is c = zero + d s x, with the scale s [px/m], the marker's zero [px] and
the direction d (-1 for a camera that looks from behind), where c = u cos(a) + v sin(a) is the place along the hub's
travel, which the camera sees at the angle a to its rows. ``LinearCalibration`` inverts that and carries the
uncertainty of scale and zero into every displacement. It comes from the rig's nominal scale, from a board held in
the beam's plane, or from ``vision.calibration.procedure``, and it holds for one camera at one focus.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.parameters import CameraParameters

SCHEMA = 3
"""Number of the dictionary's layout."""
_SCHEMA_WITHOUT_ANGLE = 2


_LARGEST_ANGLE = math.pi / 4
"""Beyond this the hub moves across the rows more than along them."""
_NAMED_BY = {"camera": "camera.name", "focus": "camera.focus"}
"""Parameters of the rig that say what is in use."""


@dataclass(frozen=True)
class MarkerDisplacements:
    """Displacements of the markers in one frame.

    Attributes
    ----------
    x_m : ndarray, shape (n_markers,) -- absolute displacement u(z, t) [m]; NaN where a marker was not seen
    sigma_m : ndarray, shape (n_markers,) -- its standard deviation, measurement and calibration together [m]
    """

    x_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True)
class LinearCalibration:
    """A straight line per marker: c = zero + direction * scale * x, with c = u cos(angle) + v sin(angle).

    Attributes
    ----------
    pixels_per_metre : tuple of float -- scale of each marker, positive [px/m]
    zero_px : tuple of float -- place c of each marker at x = 0 [px]
    flip : bool -- True when +x points to the left in the image
    covariance : tuple of 2x2 tuples -- of (scale [px/m], zero [px]) for each marker
    image_size : (int, int) -- width and height of the images that it holds for [px]
    camera_name : str -- camera that it holds for; "" leaves it open
    focus : str -- setting of the lens that it holds for; "" leaves it open
    provenance : mapping of str to JSON value -- where the numbers come from: method, date, points, tests
    angle, angle_sd : float -- between the image's rows and the hub's travel, positive where +u goes down (+v), and
        its standard deviation; 0, 0 where it was not measured [rad]
    """

    pixels_per_metre: tuple[float, ...]
    zero_px: tuple[float, ...]
    flip: bool
    covariance: tuple[tuple[tuple[float, float], tuple[float, float]], ...]
    image_size: tuple[int, int]
    camera_name: str
    focus: str
    provenance: Mapping[str, Any] = field(default_factory=dict)
    angle: float = 0.0
    angle_sd: float = 0.0

    def __post_init__(self) -> None:
        n_markers = len(self.pixels_per_metre)
        if n_markers == 0 or len(self.zero_px) != n_markers or len(self.covariance) != n_markers:
            raise CalibrationError(
                f"calibration has {n_markers} scales, {len(self.zero_px)} zeros and {len(self.covariance)} "
                "covariances; expected one of each per marker: calibrate again"
            )
        for k, (scale, zero, matrix) in enumerate(
            zip(self.pixels_per_metre, self.zero_px, self.covariance, strict=True)
        ):
            if not (math.isfinite(scale) and scale > 0):
                raise CalibrationError(f"scale of marker {k} is {scale!r} px/m; expected a positive number")
            if not math.isfinite(zero):
                raise CalibrationError(f"zero of marker {k} is {zero!r} px; expected a number")
            values = np.asarray(matrix, dtype=np.float64)
            is_covariance = (
                values.shape == (2, 2)
                and bool(np.all(np.isfinite(values)))
                and abs(values[0, 1] - values[1, 0]) <= 1e-9 * max(1.0, abs(float(values[0, 1])))
                and values[0, 0] >= 0
                and values[1, 1] >= 0
                and values[0, 1] ** 2 <= values[0, 0] * values[1, 1] * (1 + 1e-6) + 1e-300
            )
            if not is_covariance:
                raise CalibrationError(
                    f"covariance of marker {k} is {matrix!r}; expected a symmetric, non-negative 2x2 matrix "
                    "of (scale, zero)"
                )
        width, height = self.image_size
        if width < 1 or height < 1:
            raise CalibrationError(f"image size of the calibration is {self.image_size}; expected pixels")
        if not (abs(self.angle) < _LARGEST_ANGLE and self.angle_sd >= 0):
            raise CalibrationError(
                f"angle between rows and travel is {self.angle!r} +- {self.angle_sd!r} rad; expected less than "
                f"{_LARGEST_ANGLE:.2g} rad either way: turn the camera so that the hub moves along the rows"
            )

    @classmethod
    def from_camera(
        cls,
        camera: CameraParameters,
        n_markers: int,
        *,
        relative_scale_sd: float = 0.0,
        zero_sd_px: float = 0.0,
    ) -> LinearCalibration:
        """Calibration from the rig file's nominal scale and origin.

        Parameters
        ----------
        camera : CameraParameters -- scale, origin, direction, image size, names
        n_markers : int -- number of markers
        relative_scale_sd : float -- relative standard deviation of the scale
        zero_sd_px : float -- standard deviation of the zeros [px]

        Returns
        -------
        LinearCalibration
        """
        variance = ((camera.pixels_per_metre * relative_scale_sd) ** 2, zero_sd_px**2)
        return cls(
            pixels_per_metre=(camera.pixels_per_metre,) * n_markers,
            zero_px=(camera.origin_px[0],) * n_markers,
            flip=camera.flip,
            covariance=(((variance[0], 0.0), (0.0, variance[1])),) * n_markers,
            image_size=(camera.width, camera.height),
            camera_name=camera.name,
            focus=camera.focus,
            provenance={"method": "nominal scale of the rig file"},
        )

    @property
    def n_markers(self) -> int:
        """Number of markers."""
        return len(self.pixels_per_metre)

    @property
    def direction(self) -> int:
        """Sign of du/dx."""
        return -1 if self.flip else 1

    @property
    def scales(self) -> FloatArray:
        """Scale of each marker, negative where +x points to the left, shape (n_markers,) [px/m]."""
        return np.asarray(self.pixels_per_metre, dtype=np.float64) * self.direction

    def travel_axes(self, u_px: npt.ArrayLike, v_px: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Turn places in the image, any shape [px], to places along and across the hub's travel [px].

        A beam that bends also sinks: across the travel, which a turned camera would take for motion along it.
        """
        u, v = np.asarray(u_px, dtype=np.float64), np.asarray(v_px, dtype=np.float64)
        if self.angle == 0:
            return u, v
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        return np.asarray(cosine * u + sine * v), np.asarray(cosine * v - sine * u)

    def displacement(self, u_px: npt.ArrayLike, sigma_px: npt.ArrayLike) -> MarkerDisplacements:
        """Displacements of all markers.

        Parameters
        ----------
        u_px : array_like, shape (n_markers,) -- places along the travel; NaN where a marker was not seen [px]
        sigma_px : array_like, shape (n_markers,) -- their standard deviations [px]

        Returns
        -------
        MarkerDisplacements -- NaN stays NaN

        Notes
        -----
        x = d (u - zero) / s, hence sigma_x^2 = (sigma_u^2 + x^2 V_ss + 2 d x V_sz + V_zz) / s^2.
        """
        u = np.asarray(u_px, dtype=np.float64)
        sigma = np.asarray(sigma_px, dtype=np.float64)
        if u.shape != (self.n_markers,) or sigma.shape != (self.n_markers,):
            raise CalibrationError(
                f"positions have shape {u.shape} and {sigma.shape}; expected ({self.n_markers},), one per "
                "calibrated marker"
            )
        scale, zero, scale_variance, twice_covariance, zero_variance = self._arrays
        x = self.direction * (u - zero) / scale
        variance = sigma**2 + x**2 * scale_variance + x * twice_covariance + zero_variance
        return MarkerDisplacements(x, np.sqrt(np.maximum(variance, 0.0)) / scale)

    @cached_property
    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Scale, zero, and the terms of the displacement's variance, for every marker."""
        matrices = np.asarray(self.covariance, dtype=np.float64)
        return (
            np.asarray(self.pixels_per_metre, dtype=np.float64),
            np.asarray(self.zero_px, dtype=np.float64),
            matrices[:, 0, 0],
            2 * self.direction * matrices[:, 0, 1],
            matrices[:, 1, 1],
        )

    def tare(self, u_px: npt.ArrayLike, sigma_px: npt.ArrayLike) -> LinearCalibration:
        """Make the mean of positions at rest the zero of every marker.

        Parameters
        ----------
        u_px : array_like, shape (n_frames, n_markers) -- places along the travel at rest; NaN where not seen [px]
        sigma_px : array_like, same shape -- their standard deviations [px]

        Returns
        -------
        LinearCalibration -- with new zeros, whose variance is that of the mean: by scatter or by the stated
            standard deviations, whichever is larger

        Raises
        ------
        CalibrationError -- a marker was not seen in any frame
        """
        positions = np.atleast_2d(np.asarray(u_px, dtype=np.float64))
        sigmas = np.atleast_2d(np.asarray(sigma_px, dtype=np.float64))
        zeros, covariances = [], []
        for k in range(self.n_markers):
            mean, sd, _ = mean_position(positions[:, k], sigmas[:, k], f"tare of marker {k}")
            zeros.append(mean)
            covariances.append(((float(self.covariance[k][0][0]), 0.0), (0.0, sd * sd)))
        provenance = {**self.provenance, "tare_frames": int(positions.shape[0])}
        return replace(self, zero_px=tuple(zeros), covariance=tuple(covariances), provenance=provenance)

    def _names(self, camera: CameraParameters) -> tuple[tuple[str, str, str], ...]:
        """What is named, its name in use and that of the calibration."""
        return ("camera", camera.name, self.camera_name), ("focus", camera.focus, self.focus)

    def require_camera(self, camera: CameraParameters) -> None:
        """Refuse images of another camera.

        Raises
        ------
        CalibrationError -- the size, the camera or the focus differ from the calibrated ones, or the calibration
            was made for a camera or focus and the rig does not name its own
        """
        width, height = self.image_size
        if (camera.width, camera.height) != (width, height):
            raise CalibrationError(
                f"images are {camera.width} x {camera.height}; expected {width} x {height}, for which "
                "this calibration was made: calibrate this image size"
            )
        for what, used, calibrated in self._names(camera):
            if calibrated and not used:
                raise CalibrationError(
                    f"the rig names no {what}; expected {calibrated!r}, for which this calibration was made: set "
                    f"{_NAMED_BY[what]} to it where it is so, else calibrate this camera and focus"
                )
            if calibrated and used != calibrated:
                raise CalibrationError(
                    f"{what} is {used!r}; expected {calibrated!r}, for which this calibration was made: calibrate "
                    "this camera and focus"
                )

    def doubt(self, camera: CameraParameters) -> str:
        """Say what the calibration leaves open of what is in use, which may then differ.

        Returns
        -------
        str -- a sentence, or ""
        """
        unknown = [
            f"{what} ({used!r})" for what, used, calibrated in self._names(camera) if used and not calibrated
        ]
        if not unknown:
            return ""
        return (
            f"the calibration does not say for which camera and focus it was made: expected the rig's "
            f"{' and '.join(unknown)}; calibrate again with these names, or make sure that they are the same"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionary for a YAML or JSON file; ``from_dict`` reads it back exactly."""
        return {
            "schema": SCHEMA,
            "kind": "linear_calibration",
            "camera_name": self.camera_name,
            "focus": self.focus,
            "image_width_px": int(self.image_size[0]),
            "image_height_px": int(self.image_size[1]),
            "flip": bool(self.flip),
            "pixels_per_metre": [float(value) for value in self.pixels_per_metre],
            "zero_px": [float(value) for value in self.zero_px],
            "covariance": [[[float(c) for c in row] for row in matrix] for matrix in self.covariance],
            "provenance": dict(self.provenance),
            "angle": float(self.angle),
            "angle_sd": float(self.angle_sd),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> LinearCalibration:
        """Read what ``to_dict`` wrote.

        Raises
        ------
        CalibrationError -- another layout, a missing or unknown key, a value of the wrong type
        """
        keys = {
            "schema",
            "kind",
            "camera_name",
            "focus",
            "image_width_px",
            "image_height_px",
            "flip",
            "pixels_per_metre",
            "zero_px",
            "covariance",
            "provenance",
            "angle",
            "angle_sd",
        }
        if not isinstance(data, Mapping) or data.get("kind") != "linear_calibration":
            raise CalibrationError(
                f"file holds no linear calibration (its kind is {data.get('kind')!r}); expected one written "
                "by `beam calibrate`"
                if isinstance(data, Mapping)
                else f"calibration is a {type(data).__name__}; expected a mapping written by `beam calibrate`"
            )
        if data.get("schema") == _SCHEMA_WITHOUT_ANGLE:
            data = {**data, "schema": SCHEMA, "angle": 0.0, "angle_sd": 0.0}
        if data.get("schema") != SCHEMA:
            raise CalibrationError(
                f"calibration has schema {data.get('schema')!r}; expected {SCHEMA}: calibrate again"
            )
        if set(data) != keys:
            odd = sorted(set(data) ^ keys)
            raise CalibrationError(f"calibration has missing or unknown keys {odd}; expected {sorted(keys)}")
        try:
            return cls(
                pixels_per_metre=tuple(float(value) for value in data["pixels_per_metre"]),
                zero_px=tuple(float(value) for value in data["zero_px"]),
                flip=bool(data["flip"]),
                covariance=tuple(matrix_of_two(matrix) for matrix in data["covariance"]),
                image_size=(int(data["image_width_px"]), int(data["image_height_px"])),
                camera_name=str(data["camera_name"]),
                focus=str(data["focus"]),
                provenance=dict(data["provenance"]),
                angle=float(data["angle"]),
                angle_sd=float(data["angle_sd"]),
            )
        except (TypeError, ValueError, IndexError) as err:
            if isinstance(err, CalibrationError):
                raise
            raise CalibrationError(f"calibration cannot be read: {err}; calibrate again") from err


def matrix_of_two(values: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Two rows of two numbers as plain tuples."""
    (a, b), (c, d) = values
    return ((float(a), float(b)), (float(c), float(d)))


def mean_position(positions: FloatArray, sigmas: FloatArray, what: str) -> tuple[float, float, int]:
    """Mean of what was seen, its standard deviation, number of frames.

    Raises
    ------
    CalibrationError -- nothing was seen; ``what`` says of what
    """
    seen = np.isfinite(positions)
    count = int(seen.sum())
    if count == 0:
        raise CalibrationError(
            f"{what}: it was not seen in any of {positions.size} frames; expected to see it"
        )
    values = positions[seen]
    stated = float(np.sqrt(np.mean(sigmas[seen] ** 2) / count))
    scatter = float(np.std(values, ddof=1) / math.sqrt(count)) if count > 1 else 0.0
    return float(np.mean(values)), max(stated, scatter), count
