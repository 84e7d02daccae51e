"""From pixels to metres, with the uncertainty that this costs.

The image of a marker at position x is u = zero + d s x, with the scale s [px/m], the marker's zero [px] and
the direction d (-1 for a camera that looks from behind). `LinearCalibration` inverts that and carries the
uncertainty of scale and zero into every displacement. It comes from the rig's nominal scale, or from a
`CalibrationProcedure`: positions of the image against a reference sensor (a laser, or the hub's own encoder),
captured at rest, both with standard deviations, and a straight line through them that respects both (Deming's
line, York's equations), with the tests that a straight line deserves: residuals, hysteresis, curvature.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.parameters import CameraParameters

SCHEMA = 1
"""Number of the dictionary's layout."""
MINIMUM_POINTS = 3
RECOMMENDED_POINTS = 20

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Displacement:
    """Displacements of the markers in one frame.

    Attributes
    ----------
    x_m : ndarray, shape (n_markers,) -- absolute displacement u(z, t) [m]; NaN where a marker was not seen
    sigma_m : ndarray, shape (n_markers,) -- its standard deviation, measurement and calibration together [m]
    """

    x_m: Floats
    sigma_m: Floats


@dataclass(frozen=True)
class LinearCalibration:
    """A straight line per marker: u = zero + direction * scale * x.

    Attributes
    ----------
    pixels_per_metre : tuple of float -- scale of each marker, positive [px/m]
    zero_px : tuple of float -- column u of each marker at x = 0 [px]
    flip : bool -- True when +x points to the left in the image
    covariance : tuple of 2x2 tuples -- of (scale [px/m], zero [px]) for each marker
    image_size : (int, int) -- width and height of the images that it holds for [px]
    camera_name : str -- camera and lens setting that it holds for; "" holds for any
    provenance : mapping of str to JSON value -- where the numbers come from: method, date, points, tests
    """

    pixels_per_metre: tuple[float, ...]
    zero_px: tuple[float, ...]
    flip: bool
    covariance: tuple[tuple[tuple[float, float], tuple[float, float]], ...]
    image_size: tuple[int, int]
    camera_name: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

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
                    f"covariance of marker {k} is {matrix!r}; expected a symmetric, non-negative 2x2 "
                    "matrix of "
                    "(scale, zero)"
                )
        width, height = self.image_size
        if width < 1 or height < 1:
            raise CalibrationError(f"image size of the calibration is {self.image_size}; expected pixels")

    @classmethod
    def from_camera(
        cls,
        camera: CameraParameters,
        n_markers: int,
        *,
        relative_scale_sd: float = 0.0,
        zero_sd_px: float = 0.0,
        camera_name: str = "",
    ) -> LinearCalibration:
        """Calibration from the rig file's nominal scale and origin.

        Parameters
        ----------
        camera : CameraParameters -- pixels_per_metre, origin_px, flip and image size
        n_markers : int -- number of markers
        relative_scale_sd : float -- relative standard deviation of the scale
        zero_sd_px : float -- standard deviation of the zeros [px]
        camera_name : str -- camera that it holds for

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
            camera_name=camera_name,
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

    def displacement(self, u_px: npt.ArrayLike, sigma_px: npt.ArrayLike) -> Displacement:
        """Displacements of all markers.

        Parameters
        ----------
        u_px : array_like, shape (n_markers,) -- image columns; NaN where a marker was not seen [px]
        sigma_px : array_like, shape (n_markers,) -- their standard deviations [px]

        Returns
        -------
        Displacement -- NaN stays NaN

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
        scale, zero = np.asarray(self.pixels_per_metre), np.asarray(self.zero_px)
        matrices = np.asarray(self.covariance)
        x = self.direction * (u - zero) / scale
        variance = (
            sigma**2
            + x**2 * matrices[:, 0, 0]
            + 2 * self.direction * x * matrices[:, 0, 1]
            + matrices[:, 1, 1]
        )
        return Displacement(x, np.sqrt(np.maximum(variance, 0.0)) / scale)

    def tare(self, u_px: npt.ArrayLike, sigma_px: npt.ArrayLike) -> LinearCalibration:
        """Make the mean of positions at rest the zero of every marker.

        Parameters
        ----------
        u_px : array_like, shape (n_frames, n_markers) -- image columns at rest; NaN where not seen [px]
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
            mean, sd, _ = _mean_position(positions[:, k], sigmas[:, k], f"tare of marker {k}")
            zeros.append(mean)
            covariances.append(((float(self.covariance[k][0][0]), 0.0), (0.0, sd * sd)))
        provenance = {**self.provenance, "tare_frames": int(positions.shape[0])}
        return replace(self, zero_px=tuple(zeros), covariance=tuple(covariances), provenance=provenance)

    def require_camera(self, width: int, height: int, camera_name: str = "") -> None:
        """Refuse images of another camera.

        Parameters
        ----------
        width, height : int -- image size [px]
        camera_name : str -- name of camera and lens setting; "" when unknown

        Raises
        ------
        CalibrationError -- the size or the name differ from the calibrated ones
        """
        if (width, height) != tuple(self.image_size):
            raise CalibrationError(
                f"images are {width} x {height}; expected {self.image_size[0]} x {self.image_size[1]}, for "
                "which "
                "this calibration was made: calibrate this image size"
            )
        if camera_name and self.camera_name and camera_name != self.camera_name:
            raise CalibrationError(
                f"camera is {camera_name!r}; expected {self.camera_name!r}, for which this calibration was "
                "made: "
                "calibrate this camera and focus"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionary for a YAML or JSON file; `from_dict` reads it back exactly."""
        return {
            "schema": SCHEMA,
            "kind": "linear_calibration",
            "camera_name": self.camera_name,
            "image_width_px": int(self.image_size[0]),
            "image_height_px": int(self.image_size[1]),
            "flip": bool(self.flip),
            "pixels_per_metre": [float(value) for value in self.pixels_per_metre],
            "zero_px": [float(value) for value in self.zero_px],
            "covariance": [[[float(c) for c in row] for row in matrix] for matrix in self.covariance],
            "provenance": dict(self.provenance),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> LinearCalibration:
        """Read what `to_dict` wrote.

        Raises
        ------
        CalibrationError -- another layout, a missing or unknown key, a value of the wrong type
        """
        keys = {
            "schema",
            "kind",
            "camera_name",
            "image_width_px",
            "image_height_px",
            "flip",
            "pixels_per_metre",
            "zero_px",
            "covariance",
            "provenance",
        }
        if not isinstance(data, Mapping) or data.get("kind") != "linear_calibration":
            raise CalibrationError(
                "file holds no linear calibration (its kind is "
                f"{data.get('kind')!r}); expected one written by `beam calibrate`"
                if isinstance(data, Mapping)
                else f"calibration is a {type(data).__name__}; expected a mapping written by `beam calibrate`"
            )
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
                covariance=tuple(_matrix(matrix) for matrix in data["covariance"]),
                image_size=(int(data["image_width_px"]), int(data["image_height_px"])),
                camera_name=str(data["camera_name"]),
                provenance=dict(data["provenance"]),
            )
        except (TypeError, ValueError, IndexError) as err:
            if isinstance(err, CalibrationError):
                raise
            raise CalibrationError(f"calibration cannot be read: {err}; calibrate again") from err


def _matrix(values: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    (a, b), (c, d) = values
    return ((float(a), float(b)), (float(c), float(d)))


def _mean_position(positions: Floats, sigmas: Floats, what: str) -> tuple[float, float, int]:
    """Mean of what was seen, its standard deviation, number of frames."""
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


@dataclass(frozen=True)
class CalibrationPoint:
    """A marker at rest: image against reference.

    Attributes
    ----------
    reference_m, reference_sd_m : float -- position by the reference sensor and its standard deviation [m]
    u_px, u_sd_px : float -- mean column in the image and the standard deviation of that mean [px]
    n_frames : int -- frames averaged
    """

    reference_m: float
    reference_sd_m: float
    u_px: float
    u_sd_px: float
    n_frames: int


@dataclass(frozen=True)
class LineFit:
    """Deming's line u = intercept + slope * x through the points of one marker, and its tests.

    Attributes
    ----------
    slope, intercept : float -- [px/m] (negative for a flipped camera), [px]
    covariance : ndarray, shape (2, 2) -- of (slope, intercept), by the stated standard deviations, times
        max(1, reduced chi-squared)
    residual_px : ndarray, shape (n_points,) -- u - line, in the order of capture [px]
    residual_rms_px : float -- root mean square with n - 2 degrees of freedom [px]
    chi_squared, degrees_of_freedom : float, int -- of the weighted residuals
    hysteresis_px, hysteresis_sd_px : float -- mean residual of points reached in +x minus that of points
        reached in -x; NaN when all were reached from one side [px]
    curvature, curvature_sd : float -- coefficient of an added x^2 (about the mean) [px/m^2]; NaN below four
        points
    has_hysteresis, is_curved : bool -- beyond three standard deviations
    """

    slope: float
    intercept: float
    covariance: Floats
    residual_px: Floats
    residual_rms_px: float
    chi_squared: float
    degrees_of_freedom: int
    hysteresis_px: float
    hysteresis_sd_px: float
    curvature: float
    curvature_sd: float
    has_hysteresis: bool
    is_curved: bool


def fit_line(points: Sequence[CalibrationPoint]) -> LineFit:
    """Fit a straight line to points with errors on both axes.

    Parameters
    ----------
    points : sequence of CalibrationPoint -- in the order of capture

    Returns
    -------
    LineFit

    Raises
    ------
    CalibrationError -- fewer than three points, no spread, or standard deviations that leave no weight

    Notes
    -----
    York et al., "Unified equations for the slope, intercept, and standard errors of the best straight line",
    American Journal of Physics 72 (2004) 367, eq. (13), uncorrelated errors; Deming's line where the ratio of
    the two standard deviations is the same for all points.
    """
    if len(points) < MINIMUM_POINTS:
        raise CalibrationError(
            f"calibration has {len(points)} points; expected at least {MINIMUM_POINTS}, better "
            f"{RECOMMENDED_POINTS} in both directions: capture more positions"
        )
    x = np.array([point.reference_m for point in points])
    u = np.array([point.u_px for point in points])
    sd_x = np.array([point.reference_sd_m for point in points])
    sd_u = np.array([point.u_sd_px for point in points])
    if not (np.all(np.isfinite([x, u, sd_x, sd_u])) and np.all(sd_x >= 0) and np.all(sd_u >= 0)):
        raise CalibrationError("calibration points are not all finite with standard deviations >= 0")
    if np.any((sd_u == 0) & (sd_x == 0)):
        raise CalibrationError(
            "a calibration point states no uncertainty on either axis; expected a standard deviation"
        )
    span = float(np.ptp(x))
    if span <= 0 or span < 10 * float(np.max(sd_x)):
        raise CalibrationError(
            f"calibration positions span {span:.3g} m with a reference sd of {float(np.max(sd_x)):.3g} m; "
            "expected "
            "a span of at least ten standard deviations: move the hub further"
        )
    # Centre and scale: the equations then hold numbers of order one.
    x0, u0 = float(np.mean(x)), float(np.mean(u))
    unit = span / 2
    t, y, sd_t = (x - x0) / unit, u - u0, sd_x / unit
    slope = float(np.sum(t * y) / np.sum(t * t))
    for _ in range(100):
        weight = 1.0 / (sd_u**2 + slope**2 * sd_t**2)
        t_bar, y_bar = np.sum(weight * t) / np.sum(weight), np.sum(weight * y) / np.sum(weight)
        dt, dy = t - t_bar, y - y_bar
        beta = weight * (dt * sd_u**2 + slope * dy * sd_t**2)
        updated = float(np.sum(weight * beta * dy) / np.sum(weight * beta * dt))
        is_converged = abs(updated - slope) <= 1e-14 * abs(updated)
        slope = updated
        if is_converged:
            break
    if slope == 0 or not math.isfinite(slope):
        raise CalibrationError(
            "the markers did not move in the image while the reference did: check the camera and the "
            "reference"
        )
    intercept = float(y_bar - slope * t_bar)
    adjusted = t_bar + beta
    adjusted_bar = float(np.sum(weight * adjusted) / np.sum(weight))
    slope_variance = 1.0 / float(np.sum(weight * (adjusted - adjusted_bar) ** 2))
    intercept_variance = 1.0 / float(np.sum(weight)) + adjusted_bar**2 * slope_variance
    matrix = np.array(
        [
            [slope_variance, -adjusted_bar * slope_variance],
            [-adjusted_bar * slope_variance, intercept_variance],
        ]
    )
    residual = y - intercept - slope * t
    chi_squared = float(np.sum(weight * residual**2))
    degrees = len(points) - 2
    inflation = max(1.0, chi_squared / degrees)
    # Back to metres: slope / unit, and the intercept at x = 0.
    back = np.array([[1 / unit, 0.0], [-x0 / unit, 1.0]])
    covariance = inflation * back @ matrix @ back.T
    hysteresis, hysteresis_sd = _hysteresis(x, residual, weight, inflation)
    curvature, curvature_sd = _curvature(t, y, weight, unit)
    return LineFit(
        slope=slope / unit,
        intercept=u0 + intercept - slope * x0 / unit,
        covariance=covariance,
        residual_px=residual,
        residual_rms_px=float(np.sqrt(np.sum(residual**2) / degrees)),
        chi_squared=chi_squared,
        degrees_of_freedom=degrees,
        hysteresis_px=hysteresis,
        hysteresis_sd_px=hysteresis_sd,
        curvature=curvature,
        curvature_sd=curvature_sd,
        has_hysteresis=bool(abs(hysteresis) > 3 * hysteresis_sd),
        is_curved=bool(abs(curvature) > 3 * curvature_sd),
    )


def _hysteresis(x: Floats, residual: Floats, weight: Floats, inflation: float) -> tuple[float, float]:
    """Weighted mean residual after moves in +x minus that after moves in -x, with its sd [px]."""
    move = np.diff(x)
    up, down = np.flatnonzero(move > 0) + 1, np.flatnonzero(move < 0) + 1
    if up.size == 0 or down.size == 0:
        return math.nan, math.nan
    difference = np.average(residual[up], weights=weight[up]) - np.average(
        residual[down], weights=weight[down]
    )
    # The offset itself inflates chi-squared: its sd is stated without it.
    sd = math.sqrt(1 / float(np.sum(weight[up])) + 1 / float(np.sum(weight[down])))
    half = np.zeros_like(residual)
    half[up], half[down] = difference / 2, -difference / 2
    rest = float(np.sum(weight * (residual - half) ** 2)) / max(1, residual.size - 3)
    return float(difference), sd * math.sqrt(max(1.0, min(rest, inflation)))


def _curvature(t: Floats, y: Floats, weight: Floats, unit: float) -> tuple[float, float]:
    """Coefficient of an added quadratic term and its sd [px/m^2]."""
    if t.size < 4 or np.unique(t).size < 3:
        return math.nan, math.nan
    design = np.stack([np.ones_like(t), t, t * t], axis=1) * np.sqrt(weight)[:, None]
    inverse = np.linalg.pinv(design.T @ design)
    estimate = inverse @ design.T @ (y * np.sqrt(weight))
    chi_squared = float(np.sum((y * np.sqrt(weight) - design @ estimate) ** 2))
    inflation = max(1.0, chi_squared / (t.size - 3))
    return float(estimate[2]) / unit**2, math.sqrt(float(inverse[2, 2]) * inflation) / unit**2


@dataclass(frozen=True)
class CalibrationFit:
    """A fitted calibration and, per marker, the line it comes from.

    Attributes
    ----------
    calibration : LinearCalibration
    lines : tuple of LineFit -- one per marker
    warnings : tuple of str -- what a reader should know: few points, curvature, hysteresis, scatter
    """

    calibration: LinearCalibration
    lines: tuple[LineFit, ...]
    warnings: tuple[str, ...]


class CalibrationProcedure:
    """Collects points at rest and fits a line per marker.

    Parameters
    ----------
    n_markers : int -- number of markers
    image_size : (int, int) -- width and height [px]
    camera_name : str -- camera and lens setting
    """

    def __init__(self, n_markers: int, image_size: tuple[int, int], camera_name: str = "") -> None:
        if n_markers < 1:
            raise CalibrationError(f"n_markers is {n_markers}; expected at least one marker")
        self.n_markers = n_markers
        self.image_size = image_size
        self.camera_name = camera_name
        self._points: list[tuple[CalibrationPoint, ...]] = []

    @property
    def points(self) -> tuple[tuple[CalibrationPoint, ...], ...]:
        """Captured points: one tuple of markers per position."""
        return tuple(self._points)

    def clear(self) -> None:
        """Forget every point."""
        self._points.clear()

    def capture_point(
        self,
        u_px: npt.ArrayLike,
        sigma_px: npt.ArrayLike,
        reference_m: float,
        reference_sd_m: float,
    ) -> tuple[CalibrationPoint, ...]:
        """Average frames at one position of the reference.

        Parameters
        ----------
        u_px : array_like, shape (n_frames, n_markers) -- image columns; NaN where a marker was not seen [px]
        sigma_px : array_like, same shape -- their standard deviations [px]
        reference_m, reference_sd_m : float -- position by the reference sensor and its sd [m]

        Returns
        -------
        tuple of CalibrationPoint -- one per marker

        Raises
        ------
        CalibrationError -- a marker was not seen, the beam was not at rest, or the reference is no number
        """
        positions = np.atleast_2d(np.asarray(u_px, dtype=np.float64))
        sigmas = np.atleast_2d(np.asarray(sigma_px, dtype=np.float64))
        if positions.shape != sigmas.shape or positions.shape[1] != self.n_markers:
            raise CalibrationError(
                f"positions have shape {positions.shape}, standard deviations {sigmas.shape}; expected "
                f"(n_frames, {self.n_markers}) for both"
            )
        if not (math.isfinite(reference_m) and math.isfinite(reference_sd_m) and reference_sd_m >= 0):
            raise CalibrationError(
                f"reference is {reference_m!r} m with sd {reference_sd_m!r} m; expected a position and sd "
                ">= 0"
            )
        captured = []
        for k in range(self.n_markers):
            what = f"calibration point at {reference_m:.6g} m, marker {k}"
            mean, sd, count = _mean_position(positions[:, k], sigmas[:, k], what)
            seen = np.isfinite(positions[:, k])
            scatter = float(np.std(positions[seen, k], ddof=1)) if count > 1 else 0.0
            stated = float(np.sqrt(np.mean(sigmas[seen, k] ** 2)))
            if count >= 10 and scatter > max(10 * stated, 0.5):
                raise CalibrationError(
                    f"{what}: it moves by {scatter:.3g} px (sd) where the noise is {stated:.3g} px; "
                    "expected a beam "
                    "at rest: wait until it has come to rest and capture again"
                )
            captured.append(CalibrationPoint(float(reference_m), float(reference_sd_m), mean, sd, count))
        self._points.append(tuple(captured))
        return self._points[-1]

    def fit(self, provenance: Mapping[str, Any] | None = None) -> CalibrationFit:
        """Fit all markers.

        Parameters
        ----------
        provenance : mapping or None -- what to keep beside the numbers: date, reference sensor, bag

        Returns
        -------
        CalibrationFit

        Raises
        ------
        CalibrationError -- too few points or no straight line, as `fit_line`; or markers that move in
            opposite directions
        """
        if len(self._points) < MINIMUM_POINTS:
            raise CalibrationError(
                f"calibration has {len(self._points)} points; expected at least {MINIMUM_POINTS}, better "
                f"{RECOMMENDED_POINTS} in both directions: capture more positions"
            )
        lines = tuple(fit_line([point[k] for point in self._points]) for k in range(self.n_markers))
        signs = {math.copysign(1.0, line.slope) for line in lines}
        if len(signs) != 1:
            raise CalibrationError(
                f"slopes are {[round(line.slope, 3) for line in lines]} px/m; expected one sign for all "
                "markers: "
                "check which spots the tracker follows"
            )
        flip = signs == {-1.0}
        direction = -1.0 if flip else 1.0
        turn = np.diag([direction, 1.0])
        calibration = LinearCalibration(
            pixels_per_metre=tuple(abs(line.slope) for line in lines),
            zero_px=tuple(line.intercept for line in lines),
            flip=flip,
            covariance=tuple(_matrix((turn @ line.covariance @ turn).tolist()) for line in lines),
            image_size=self.image_size,
            camera_name=self.camera_name,
            provenance={
                **(provenance or {}),
                "method": "weighted line through captured points",
                "n_points": len(self._points),
                "reference_m": [point[0].reference_m for point in self._points],
                "residual_rms_px": [line.residual_rms_px for line in lines],
                "reduced_chi_squared": [line.chi_squared / line.degrees_of_freedom for line in lines],
                "is_curved": [line.is_curved for line in lines],
                "has_hysteresis": [line.has_hysteresis for line in lines],
            },
        )
        return CalibrationFit(calibration, lines, tuple(self._warnings(lines)))

    def _warnings(self, lines: Sequence[LineFit]) -> list[str]:
        warnings = []
        if len(self._points) < RECOMMENDED_POINTS:
            warnings.append(
                f"{len(self._points)} points; {RECOMMENDED_POINTS} in both directions are recommended"
            )
        for k, line in enumerate(lines):
            if math.isnan(line.hysteresis_px):
                warnings.append(
                    f"marker {k}: all positions were reached from one side; hysteresis is not known"
                )
            elif line.has_hysteresis:
                warnings.append(
                    f"marker {k}: hysteresis of {line.hysteresis_px:.3g} +- {line.hysteresis_sd_px:.2g} px"
                )
            if line.is_curved:
                warnings.append(
                    f"marker {k}: curved by {line.curvature:.3g} +- {line.curvature_sd:.2g} px/m^2; a "
                    "straight line "
                    "is not enough: correct the lens's distortion or the camera's tilt"
                )
            reduced = line.chi_squared / line.degrees_of_freedom
            if reduced > 1 + 4 * math.sqrt(2 / line.degrees_of_freedom):
                warnings.append(
                    f"marker {k}: scatter is {math.sqrt(reduced):.2g} times the stated standard "
                    "deviations; the "
                    "covariance is enlarged accordingly"
                )
        return warnings
