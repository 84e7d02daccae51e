"""A calibration against a reference sensor: a laser, or the hub's own encoder.

Positions of the image against positions of the reference, captured at rest, both with standard deviations, and a
straight line through them that respects both (Deming's line, York's equations), with the tests that a straight line
deserves: residuals, hysteresis, curvature. Where the markers' rows are given, too, they tell the angle at which the
hub travels, and the line counts along that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray
from beam_ros.vision.calibration.linear import LinearCalibration, matrix_of_two, mean_position
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.parameters import CameraParameters

MIN_POINTS = 3
RECOMMENDED_POINTS = 20
SWING_NOISES = 10.0
"""A beam whose markers scatter by more than so many standard deviations of the noise is not at rest, ..."""
SWING_PX = 0.5
"""... unless it is by less than this [px]."""


@dataclass(frozen=True)
class CalibrationPoint:
    """A marker at rest: image against reference.

    Attributes
    ----------
    reference_m, reference_sd_m : float -- position by the reference sensor and its standard deviation [m]
    u_px, u_sd_px : float -- mean column in the image and the standard deviation of that mean [px]
    n_frames : int -- frames averaged
    across_px : float -- mean place across the line on which ``u_px`` counts [px]; NaN where it was not given
    """

    reference_m: float
    reference_sd_m: float
    u_px: float
    u_sd_px: float
    n_frames: int
    across_px: float = math.nan


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
    covariance: FloatArray
    residual_px: FloatArray
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
    if len(points) < MIN_POINTS:
        raise CalibrationError(
            f"calibration has {len(points)} points; expected at least {MIN_POINTS}, better "
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
            "expected a span of at least ten standard deviations: move the hub further"
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


def _hysteresis(
    x: FloatArray, residual: FloatArray, weight: FloatArray, inflation: float
) -> tuple[float, float]:
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


def _curvature(t: FloatArray, y: FloatArray, weight: FloatArray, unit: float) -> tuple[float, float]:
    """Coefficient of an added quadratic term and its sd [px/m^2]."""
    if t.size < 4 or np.unique(t).size < 3:
        return math.nan, math.nan
    design = np.stack([np.ones_like(t), t, t * t], axis=1) * np.sqrt(weight)[:, None]
    inverse = np.linalg.pinv(design.T @ design)
    estimate = inverse @ design.T @ (y * np.sqrt(weight))
    chi_squared = float(np.sum((y * np.sqrt(weight) - design @ estimate) ** 2))
    inflation = max(1.0, chi_squared / (t.size - 3))
    return float(estimate[2]) / unit**2, math.sqrt(float(inverse[2, 2]) * inflation) / unit**2


def fit_angle(markers: Sequence[Sequence[CalibrationPoint]]) -> tuple[float, float]:
    """Angle between the line on which ``u_px`` counts and the markers' way, and its standard deviation [rad].

    Parameters
    ----------
    markers : sequence of sequences of CalibrationPoint -- the points of every marker

    Returns
    -------
    angle, sd : float -- 0, 0 where the points do not say where they lie across

    Notes
    -----
    Both places follow the reference on a straight line, and the angle's tangent is the slopes' ratio. All markers
    move alike: their weighted mean counts, its standard deviation enlarged where they scatter more than they should.
    """
    angles, weights = [], []
    for points in markers:
        x = np.array([point.reference_m for point in points])
        u, v, sd = np.array([(point.u_px, point.across_px, point.u_sd_px) for point in points]).T
        x = x - np.mean(x)
        power = float(np.sum(x**2))
        if not np.all(np.isfinite(v)) or power == 0:
            return 0.0, 0.0
        slope_u, slope_v = float(np.sum(x * u)) / power, float(np.sum(x * v)) / power
        if slope_u == 0:
            return 0.0, 0.0  # the line's own fit says so better
        left = v - np.mean(v) - slope_v * x
        scatter = float(np.sum(left**2)) / (len(x) - 2)
        variance = max(scatter, float(np.mean(sd**2))) / power / slope_u**2
        angles.append(math.atan(slope_v / slope_u))
        weights.append(1.0 / max(variance, 1e-18))
    mean = float(np.average(angles, weights=weights))
    excess = float(np.sum(np.array(weights) * (np.array(angles) - mean) ** 2)) / max(1, len(angles) - 1)
    return mean, math.sqrt(max(1.0, excess) / float(np.sum(weights)))


def _turned(point: CalibrationPoint, angle: float) -> CalibrationPoint:
    """Return the point with its place along a line that is turned by an angle."""
    if angle == 0:
        return point
    along = math.cos(angle) * point.u_px + math.sin(angle) * point.across_px
    across = math.cos(angle) * point.across_px - math.sin(angle) * point.u_px
    return replace(point, u_px=along, across_px=across)


@dataclass(frozen=True)
class CalibrationFit:
    """A fitted calibration and, per marker, the line it comes from.

    Attributes
    ----------
    calibration : LinearCalibration
    lines : tuple of LineFit -- one per marker
    points : tuple of (tuple of CalibrationPoint) -- those of every marker's line, in the order of capture
    warnings : tuple of str -- what a reader should know: few points, curvature, hysteresis, scatter
    """

    calibration: LinearCalibration
    lines: tuple[LineFit, ...]
    points: tuple[tuple[CalibrationPoint, ...], ...]
    warnings: tuple[str, ...]


class CalibrationProcedure:
    """Collects points at rest and fits a line per marker.

    Parameters
    ----------
    n_markers : int -- number of markers
    camera : CameraParameters -- the camera that the calibration is to hold for
    """

    def __init__(self, n_markers: int, camera: CameraParameters) -> None:
        if n_markers < 1:
            raise CalibrationError(f"n_markers is {n_markers}; expected at least one marker")
        self.n_markers = n_markers
        self._camera = camera
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
        across_px: npt.ArrayLike | None = None,
    ) -> tuple[CalibrationPoint, ...]:
        """Average frames at one position of the reference.

        Parameters
        ----------
        u_px : array_like, shape (n_frames, n_markers) -- image columns; NaN where a marker was not seen [px]
        sigma_px : array_like, same shape -- their standard deviations [px]
        reference_m, reference_sd_m : float -- position by the reference sensor and its sd [m]
        across_px : array_like, shape (n_frames, n_markers), optional -- image rows: with them the angle of the hub's
            travel is fitted, too [px]

        Returns
        -------
        tuple of CalibrationPoint -- one per marker

        Raises
        ------
        CalibrationError -- a marker was not seen, the beam was not at rest, or the reference is no number
        """
        positions = np.atleast_2d(np.asarray(u_px, dtype=np.float64))
        sigmas = np.atleast_2d(np.asarray(sigma_px, dtype=np.float64))
        rows = None if across_px is None else np.atleast_2d(np.asarray(across_px, dtype=np.float64))
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
            mean, sd, count = mean_position(positions[:, k], sigmas[:, k], what)
            seen = np.isfinite(positions[:, k])
            scatter = float(np.std(positions[seen, k], ddof=1)) if count > 1 else 0.0
            stated = float(np.sqrt(np.mean(sigmas[seen, k] ** 2)))
            if count >= 10 and scatter > max(SWING_NOISES * stated, SWING_PX):
                raise CalibrationError(
                    f"{what}: it moves by {scatter:.3g} px (sd) where the noise is {stated:.3g} px; expected "
                    "a beam at rest: wait until it has come to rest and capture again"
                )
            across = math.nan if rows is None else float(np.mean(rows[seen, k]))
            captured.append(
                CalibrationPoint(float(reference_m), float(reference_sd_m), mean, sd, count, across)
            )
        self._points.append(tuple(captured))
        return self._points[-1]

    def fit(self, provenance: Mapping[str, Any] | None = None, angle: float = 0.0) -> CalibrationFit:
        """Fit all markers, and the angle of the hub's travel where the points say how it runs.

        Parameters
        ----------
        provenance : mapping or None -- what to keep beside the numbers: date, reference sensor, bag
        angle : float -- of the line on which the points' ``u_px`` counts, to the image's rows [rad]

        Returns
        -------
        CalibrationFit

        Raises
        ------
        CalibrationError -- too few points or no straight line, as ``fit_line``; or markers that move in
            opposite directions
        """
        if len(self._points) < MIN_POINTS:
            raise CalibrationError(
                f"calibration has {len(self._points)} points; expected at least {MIN_POINTS}, better "
                f"{RECOMMENDED_POINTS} in both directions: capture more positions"
            )
        by_marker = tuple(tuple(point[k] for point in self._points) for k in range(self.n_markers))
        turn, turn_sd = fit_angle(by_marker)
        by_marker = tuple(tuple(_turned(point, turn) for point in points) for points in by_marker)
        lines = tuple(fit_line(points) for points in by_marker)
        signs = {math.copysign(1.0, line.slope) for line in lines}
        if len(signs) != 1:
            raise CalibrationError(
                f"slopes are {[round(line.slope, 3) for line in lines]} px/m; expected one sign for all "
                "markers: check which spots the tracker follows"
            )
        flip = signs == {-1.0}
        direction = -1.0 if flip else 1.0
        rows = [float(np.mean([point.across_px for point in points])) for points in by_marker]
        sign = np.diag([direction, 1.0])
        calibration = LinearCalibration(
            pixels_per_metre=tuple(abs(line.slope) for line in lines),
            zero_px=tuple(line.intercept for line in lines),
            flip=flip,
            covariance=tuple(matrix_of_two((sign @ line.covariance @ sign).tolist()) for line in lines),
            image_size=(self._camera.width, self._camera.height),
            camera_name=self._camera.name,
            focus=self._camera.focus,
            provenance={
                **(provenance or {}),
                "method": "weighted line through captured points",
                "n_points": len(self._points),
                "reference_m": [point[0].reference_m for point in self._points],
                "residual_rms_px": [line.residual_rms_px for line in lines],
                "reduced_chi_squared": [line.chi_squared / line.degrees_of_freedom for line in lines],
                "is_curved": [line.is_curved for line in lines],
                "has_hysteresis": [line.has_hysteresis for line in lines],
                **({"rows_px": rows} if np.all(np.isfinite(rows)) else {}),
            },
            angle=angle + turn,
            angle_sd=turn_sd,
        )
        return CalibrationFit(calibration, lines, by_marker, tuple(self._warnings(lines)))

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
                    "straight line is not enough: correct the lens's distortion or the camera's tilt"
                )
            reduced = line.chi_squared / line.degrees_of_freedom
            if reduced > 1 + 4 * math.sqrt(2 / line.degrees_of_freedom):
                warnings.append(
                    f"marker {k}: scatter is {math.sqrt(reduced):.2g} times the stated standard deviations; "
                    "the covariance is enlarged accordingly"
                )
        return warnings
