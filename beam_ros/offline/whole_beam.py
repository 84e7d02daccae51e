"""A film of the strip itself becomes displacements at every tenth row, in the place of markers.

What follows knows no difference: every point is an output with a name, a height and a standard deviation, and the rig
of the experiment has these points for markers.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.interfaces.rig_parameters import MarkerSettings
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.perspective import Perspective
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError, VideoError
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.strip.following import REASONS, StripParameters
from beam_ros.vision.strip.moving_line import StripFollower
from beam_ros.vision.timing import FrameTiming

_MIN_SEEN = 0.05
"""A point that is seen in fewer frames is left out: a dot or a holder covers it for good."""


@dataclass(frozen=True)
class FollowedPoints:
    """Markers or points of the strip through a whole film, as the file tells their times.

    Attributes
    ----------
    names : tuple of str, length m -- points, from the clamp upwards
    heights : ndarray, shape (m,) -- above the clamp [m]
    frame_times_ns : ndarray of int64, shape (n,) -- [ns]
    times_ns : ndarray of int64, shape (n, m) -- middle of the exposure of every point's row [ns]
    u_px, v_px, x_m, sigma_m : ndarray, shape (n, m) -- place in the image, displacement u(z, t) and its standard
        deviation; NaN where not seen
    reasons : tuple of mapping of str to int, length m -- how often each point was valid ("ok"), or not and why
    is_repeated : ndarray of bool, shape (n,) -- the image is the one before, noise aside, though what it shows moves
    """

    names: tuple[str, ...]
    heights: FloatArray
    frame_times_ns: StampArray
    times_ns: StampArray
    u_px: FloatArray
    v_px: FloatArray
    x_m: FloatArray
    sigma_m: FloatArray
    reasons: tuple[dict[str, int], ...]
    is_repeated: np.ndarray


def strip_parameters(camera: CameraParameters, length_m: float, row_step: int) -> StripParameters:
    """Return what the follower expects of the rig's strip.

    Parameters
    ----------
    camera : CameraParameters
    length_m : float -- of the strip [m]
    row_step : int -- rows of a point
    """
    tip, clamp = camera.rows([length_m, 0.0])
    return StripParameters(
        first_row=float(tip),
        last_row=float(clamp),
        rest_column=camera.origin_px[0],
        width_px=camera.strip_width_m * camera.pixels_per_metre,
        is_bright=camera.contrast > 0,
        exposure_frames=camera.exposure_s * camera.rate_hz,
        row_step=row_step,
    )


def point_names(heights: Iterable[float]) -> tuple[str, ...]:
    """Names of points of the strip by their heights above the clamp, to a tenth of a millimetre."""
    return tuple(f"z{height * 1e3:05.1f}" for height in heights)


def follow_strip(
    video: VideoFile,
    camera: CameraParameters,
    length_m: float,
    markers: MarkerSettings,
    calibration: LinearCalibration | None = None,
    row_step: int = 10,
    progress: Callable[[float], None] = lambda share: None,
) -> FollowedPoints:
    """Follow the strip through a film.

    Parameters
    ----------
    video : VideoFile
    camera : CameraParameters -- the rig's, at the film's rate
    length_m : float -- of the strip [m]
    markers : MarkerSettings -- those that the calibration was made with
    calibration : LinearCalibration, optional -- interpolated between the markers; where it says in which rows they
        were, heights and scales follow the camera's perspective (``vision.calibration.perspective``); None: the
        nominal scale
    row_step : int -- rows of a point
    progress : callable -- called with the share done

    Raises
    ------
    VideoError
        The strip is in hardly any frame.
    CalibrationError
        The calibration was made for another camera.
    VisionParameterError
        The strip is too short in the image for points of so many rows.
    """
    expected = strip_parameters(camera, length_m, row_step)
    perspective = None if calibration is None else Perspective.of(calibration, markers.height_uncertainties)
    if perspective is not None:
        tip, clamp = perspective.rows([length_m, 0.0])
        expected = replace(expected, first_row=float(tip), last_row=float(clamp))
    follower = StripFollower(expected, (camera.height, camera.width))
    rows = follower.rows_px
    scale = calibration or LinearCalibration.from_camera(camera, len(rows))
    lens = Lens.from_dict(scale.provenance["lens"]) if "lens" in scale.provenance else None
    heights = camera.heights(rows)
    if perspective is not None:
        at_rest = np.full(len(rows), expected.rest_column), rows
        heights = perspective.heights(scale.travel_axes(*(lens.undistort(*at_rest) if lens else at_rest))[1])
    if calibration is not None:
        scale = between_markers(calibration, camera, markers.heights, heights)
        if perspective is not None:
            scale = replace(scale, pixels_per_metre=tuple(perspective.scales(heights).tolist()))
    timing = FrameTiming(camera)
    times, u, sigma, reasons = [], [], [], []
    with contextlib.closing(video.frames()) as frames:
        for time_ns, image in frames:
            frame = follower.process(image)
            times.append(time_ns)
            u.append(frame.u_px)
            sigma.append(frame.sigma_px)
            reasons.append(frame.reasons)
            progress(len(times) / max(video.n_frames, len(times)))
    columns, spread, why = np.array(u), np.array(sigma), np.array(reasons)
    seen = np.isfinite(columns)
    chosen = np.flatnonzero(seen.mean(axis=0) >= _MIN_SEEN)
    if len(chosen) < 12:
        counts = np.bincount(why.ravel(), minlength=len(REASONS))
        words = ", ".join(f"{name} {count}" for name, count in zip(REASONS, counts, strict=True) if count)
        raise VideoError(
            f"{video.path}: {len(chosen)} of {len(rows)} points of the strip are ever seen ({words}); expected it "
            "where the rig file puts it: check beam.length, beam.thickness, camera.origin_u and origin_v, "
            "camera.pixels_per_metre and camera.contrast, light the strip's edge, hide lines like it "
            "(doubtful), or give more rows a point"
        )
    perfect_u, perfect_v = columns, np.broadcast_to(rows, columns.shape)
    if lens is not None:
        (left, perfect_u, right), (_, perfect_v, _) = lens.undistort(
            columns + np.array([-0.5, 0.0, 0.5])[:, None, None], np.stack([perfect_v] * 3)
        )
        spread = spread * np.abs(right - left)
    corrected, _ = scale.travel_axes(perfect_u, perfect_v)
    found = [scale.displacement(at, sd) for at, sd in zip(corrected, spread, strict=True)]
    x, sd = np.array([one.x_m for one in found]), np.array([one.sigma_m for one in found])
    stamps = np.array([[timing.row_middle(0, float(row)) for row in rows]], dtype=np.int64)
    frame_times = np.array(times, dtype=np.int64)
    return FollowedPoints(
        point_names(heights[chosen]),
        heights[chosen],
        frame_times,
        (frame_times[:, None] + stamps)[:, chosen],
        columns[:, chosen],
        np.broadcast_to(rows, columns.shape)[:, chosen],
        x[:, chosen],
        sd[:, chosen],
        tuple(
            {REASONS[k]: int(n) for k, n in enumerate(np.bincount(why[:, j], minlength=len(REASONS))) if n}
            for j in chosen
        ),
        (why == REASONS.index("repeated")).all(axis=1),
    )


def between_markers(
    calibration: LinearCalibration,
    camera: CameraParameters,
    marker_heights: tuple[float, ...],
    heights: FloatArray,
) -> LinearCalibration:
    """Calibration of points between calibrated markers: scale and zero run straight from marker to marker.

    Parameters
    ----------
    calibration : LinearCalibration -- of the markers
    camera : CameraParameters
    marker_heights : tuple of float -- of the calibrated markers, rising [m]
    heights : ndarray, shape (n_points,) -- of the points, rising [m]

    Raises
    ------
    CalibrationError
        It was made for another camera, or for another number of markers.
    """
    calibration.require_camera(camera)
    if calibration.n_markers != len(marker_heights):
        raise CalibrationError(
            f"calibration holds for {calibration.n_markers} markers; expected {len(marker_heights)}, as many as "
            "markers.names has: calibrate this beam"
        )
    # The nearest marker lends its covariance: a straight line between two would pretend to know more in the middle.
    nearest = np.argmin(np.abs(heights[:, None] - np.asarray(marker_heights)[None, :]), axis=1)
    return replace(
        calibration,
        pixels_per_metre=tuple(np.interp(heights, marker_heights, calibration.pixels_per_metre).tolist()),
        zero_px=tuple(np.interp(heights, marker_heights, calibration.zero_px).tolist()),
        covariance=tuple(calibration.covariance[k] for k in nearest),
    )
