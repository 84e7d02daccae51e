"""Calibrations from pictures of a board: one in the beam's plane for the scale, tilted ones for the lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beam_ros.arrays import ImageArray
from beam_ros.calibration.pictures import some_frames
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.board_fits import MIN_PICTURES, LensFit, ScaleFit, fit_lens, fit_scale
from beam_ros.vision.calibration.boards import Board
from beam_ros.vision.calibration.lens import Lens, lens_to_dict
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.errors import CalibrationError, UndeterminedLensError

FRAMES_OF_A_VIDEO = 25
"""So many frames of a video are looked at, evenly over its length."""
_ZERO_SD_PX = 1.0
"""Standard deviation of a zero that only the rig file states [px]: ``tracker/tare`` measures it."""
_LARGE_TILT = 0.01
_OTHER_UNIT = 10.0
"""A scale so many times the rig's is one in another unit: inches, the nearest to metres, are 39 times off."""
_LARGE_RESIDUAL_PX = 0.3


@dataclass(frozen=True)
class BoardCalibration:
    """A calibration from a board, and what it comes from.

    Attributes
    ----------
    calibration : LinearCalibration
    scale : ScaleFit
    lens : LensFit or None -- None where no pictures were given for one, or they do not determine it
    warnings : tuple of str -- what a reader should know
    """

    calibration: LinearCalibration
    scale: ScaleFit
    lens: LensFit | None
    warnings: tuple[str, ...]


def calibrate_from_board(
    plane: Path,
    tilted: Sequence[Path],
    board: Board,
    rig: Rig,
    circumstances: Mapping[str, Any] | None = None,
) -> BoardCalibration:
    """Calibrate a rig's camera by pictures of a board.

    Parameters
    ----------
    plane : Path -- picture, or video, of the board held in the beam's plane
    tilted : sequence of Path -- pictures or videos of it in other places, tilted: the lens is fitted to them
    board : Board
    rig : Rig -- whose camera it is
    circumstances : mapping, optional -- date, temperature: for the provenance

    Returns
    -------
    BoardCalibration

    Raises
    ------
    CalibrationError
        No board in view, no plane one, or the picture in the beam's plane of another size than the rig's camera.
    VideoError
        A file is neither a picture nor a video.
    """
    camera = rig.camera_parameters()
    shown = {path: some_frames(path, FRAMES_OF_A_VIDEO) for path in dict.fromkeys((plane, *tilted))}
    warnings = []
    for path, pictures in shown.items():
        own = [picture for picture in pictures if picture.shape == (camera.height, camera.width)]
        if len(own) == len(pictures):
            continue
        height, width = min({picture.shape for picture in pictures} - {(camera.height, camera.width)})
        is_one = "is" if len(pictures) == 1 else "holds one of"
        fault = f"{path}: {is_one} {width} x {height}; expected {camera.width} x {camera.height}, the rig's camera"
        if path == plane and not own:
            raise CalibrationError(f"{fault}: take pictures with it, or give its rig file with --rig-file")
        warnings.append(f"{fault}: {len(pictures) - len(own)} of {len(pictures)} left out")
        shown[path] = own
    lens_fit: LensFit | None = None
    lens: Lens | None = None
    if tilted:
        given = [picture for path in (plane, *tilted) for picture in shown[path]]
        try:
            lens_fit = fit_lens(given, board)
            lens = lens_fit.lens
            if lens_fit.n_pictures < len(given):
                warnings.append(
                    f"the {board.pattern} was found in {lens_fit.n_pictures} of {len(given)} pictures; the others, "
                    "without it or the same again, are left out: take them anew, with all of it, sharp and evenly lit"
                )
        except UndeterminedLensError as err:
            warnings.append(f"no lens, it is taken for perfect: {err}")
    else:
        warnings.append(
            f"no tilted pictures: the lens is taken for perfect; {MIN_PICTURES} or more give its distortion"
        )
    scale = _scale(shown[plane], board, lens_fit, plane)
    if scale.tilt > _LARGE_TILT:
        warnings.append(
            f"the scale changes by {100 * scale.tilt:.1f} % over the board: hold it parallel to the image"
        )
    factor = scale.pixels_per_metre / camera.pixels_per_metre
    if not 1.0 / _OTHER_UNIT < factor < _OTHER_UNIT:
        warnings.append(
            f"the scale is {scale.pixels_per_metre:.4g} px/m by squares of {board.square_m:g} m, and the rig's "
            f"camera.pixels_per_metre is {camera.pixels_per_metre:.4g}: is --square in metres? If it is, set "
            "camera.pixels_per_metre"
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
            "method": f"{board.pattern} in the beam's plane",
            **(circumstances or {}),
            "pictures": [str(plane), *(str(path) for path in tilted)],
            "board": [board.columns, board.rows],
            "square_m": board.square_m,
            "square_sd_m": board.square_sd_m,
            "residual_rms_px": scale.residual_rms_px,
            "tilt": scale.tilt,
            "markers": list(rig.markers.names),
            "lens": lens_to_dict(lens),
            **({} if lens_fit is None else {"lens_sd": _lens_sd(lens_fit)}),
        },
    )
    return BoardCalibration(calibration, scale, lens_fit, tuple(warnings))


def _lens_sd(fit: LensFit) -> dict[str, list[float]]:
    """Standard deviations of a lens, under the names that it has in the file."""
    return {
        "focal_px": list(fit.focal_sd_px),
        "centre_px": list(fit.centre_sd_px),
        "distortion": list(fit.distortion_sd),
    }


def _scale(pictures: list[ImageArray], board: Board, lens_fit: LensFit | None, path: Path) -> ScaleFit:
    """Scale of the picture, or of the frame of a video, in which the corners fit best."""
    lens, covariance = (None, None) if lens_fit is None else (lens_fit.lens, lens_fit.covariance)
    fits = []
    fault: CalibrationError | None = None
    for picture in pictures:
        try:
            fits.append(fit_scale(picture, board, lens, covariance))
        except CalibrationError as err:
            fault = err
    if not fits:
        raise CalibrationError(f"{path}: {fault}") from fault
    return min(fits, key=lambda fit: fit.residual_rms_px)
