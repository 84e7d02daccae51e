"""Calibrations from pictures of a checkerboard: one in the beam's plane for the scale, tilted ones for the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.checkerboard import (
    MIN_PICTURES,
    Checkerboard,
    LensFit,
    ScaleFit,
    fit_lens,
    fit_scale,
)
from beam_ros.vision.calibration.lens import Lens, lens_to_dict
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError, VideoError

FRAMES_OF_A_VIDEO = 25
"""So many frames of a video are looked at, evenly over its length."""
_ZERO_SD_PX = 1.0
"""Standard deviation of a zero that only the rig file states [px]: ``tracker/tare`` measures it."""
_LARGE_TILT = 0.01
_LARGE_RESIDUAL_PX = 0.3


@dataclass(frozen=True)
class BoardCalibration:
    """A calibration from a board, and what it comes from.

    Attributes
    ----------
    calibration : LinearCalibration
    scale : ScaleFit
    lens : LensFit or None -- None where there were too few pictures for one
    warnings : tuple of str -- what a reader should know
    """

    calibration: LinearCalibration
    scale: ScaleFit
    lens: LensFit | None
    warnings: tuple[str, ...]


def calibrate_from_board(
    plane: Path, tilted: Sequence[Path], board: Checkerboard, rig: Rig, date: str = ""
) -> BoardCalibration:
    """Calibrate a rig's camera by pictures of a board.

    Parameters
    ----------
    plane : Path -- picture, or video, of the board held in the beam's plane
    tilted : sequence of Path -- pictures or videos of it in other places, tilted: the lens is fitted to them
    board : Checkerboard
    rig : Rig -- whose camera it is
    date : str -- for the provenance

    Returns
    -------
    BoardCalibration

    Raises
    ------
    CalibrationError
        No board in view, or pictures of another size than the rig's camera.
    VideoError
        A file is neither a picture nor a video.
    """
    camera = rig.camera_parameters()
    pictures = _pictures(plane)
    for path, picture in [(plane, pictures[0]), *((path, _pictures(path)[0]) for path in tilted)]:
        if picture.shape != (camera.height, camera.width):
            raise CalibrationError(
                f"{path}: is {picture.shape[1]} x {picture.shape[0]}; expected {camera.width} x {camera.height}, the "
                "rig's camera: take pictures with it, or give its rig file with --rig-file"
            )
    lens_fit: LensFit | None = None
    lens: Lens | None = None
    warnings = []
    if tilted:
        lens_fit = fit_lens([picture for path in (plane, *tilted) for picture in _pictures(path)], board)
        lens = lens_fit.lens
    else:
        warnings.append(
            f"no tilted pictures: the lens is taken for perfect; {MIN_PICTURES} or more give its distortion"
        )
    scale = _scale(pictures, board, lens, plane)
    if scale.tilt > _LARGE_TILT:
        warnings.append(
            f"the scale changes by {100 * scale.tilt:.1f} % over the board: hold it parallel to the image"
        )
    if scale.residual_rms_px > _LARGE_RESIDUAL_PX:
        warnings.append(
            f"the corners lie {scale.residual_rms_px:.2f} px (RMS) off a plane board: is it flat, sharp and still?"
        )
    if lens_fit is not None and lens_fit.residual_rms_px > _LARGE_RESIDUAL_PX:
        warnings.append(
            f"the lens leaves the corners {lens_fit.residual_rms_px:.2f} px (RMS) off: expected less than "
            f"{_LARGE_RESIDUAL_PX:g}; take sharper pictures, of a flat board held still"
        )
    warnings.append(
        "the zeros are the rig file's origin, +- 1 px; call tracker/tare at rest at home to measure them"
    )
    n_markers = len(rig.markers.names)
    covariance = ((scale.sd**2, 0.0), (0.0, _ZERO_SD_PX**2))
    calibration = LinearCalibration(
        pixels_per_metre=(scale.pixels_per_metre,) * n_markers,
        zero_px=(camera.origin_px[0],) * n_markers,
        flip=camera.flip,
        covariance=(covariance,) * n_markers,
        image_size=(camera.width, camera.height),
        camera_name=camera.name,
        focus=camera.focus,
        provenance={
            "method": "checkerboard in the beam's plane",
            "date": date,
            "pictures": [str(plane), *(str(path) for path in tilted)],
            "board": [board.columns, board.rows],
            "square_m": board.square_m,
            "square_sd_m": board.square_sd_m,
            "residual_rms_px": scale.residual_rms_px,
            "tilt": scale.tilt,
            "markers": list(rig.markers.names),
            "lens": lens_to_dict(lens),
        },
    )
    return BoardCalibration(calibration, scale, lens_fit, tuple(warnings))


def _scale(pictures: list[ImageArray], board: Checkerboard, lens: Lens | None, path: Path) -> ScaleFit:
    """Scale of the picture, or of the frame of a video, in which the corners fit best."""
    fits = []
    fault: CalibrationError | None = None
    for picture in pictures:
        try:
            fits.append(fit_scale(picture, board, lens))
        except CalibrationError as err:
            fault = err
    if not fits:
        raise CalibrationError(f"{path}: {fault}") from fault
    return min(fits, key=lambda fit: fit.residual_rms_px)


def _pictures(path: Path) -> list[ImageArray]:
    """A picture, or frames of a video."""
    if not path.is_file():
        raise VideoError(f"{path}: no such picture or video; check the path")
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is not None:
        return [np.asarray(picture)]
    video = VideoFile(path, rate_hz=1.0)
    step = max(1, video.n_frames // FRAMES_OF_A_VIDEO)
    return [image for k, (_, image) in enumerate(video.frames()) if k % step == 0]
