"""Lens and scale from pictures of a checkerboard.

Several pictures of the board at different tilts give camera matrix and distortion; one picture of the board
held in the beam's own plane gives the scale there, without any other sensor. The board is described by its
inner corners, as everywhere in ROS: a board of 9 x 7 squares has 8 x 6 of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import CalibrationError

MIN_PICTURES = 5
_CORNER_WINDOW_PX = 5


@dataclass(frozen=True)
class Checkerboard:
    """A printed board.

    Attributes
    ----------
    columns, rows : int -- inner corners
    square_m : float -- edge of a square [m]
    square_sd_m : float -- its standard deviation, by the ruler that measured it [m]
    """

    columns: int
    rows: int
    square_m: float
    square_sd_m: float = 0.0

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise CalibrationError(
                f"checkerboard has {self.columns} x {self.rows} inner corners; expected at least 3 x 3"
            )
        if not (math.isfinite(self.square_m) and self.square_m > 0 and self.square_sd_m >= 0):
            raise CalibrationError(
                f"checkerboard has squares of {self.square_m!r} +- {self.square_sd_m!r} m; expected metres > 0"
            )

    def corners(self) -> FloatArray:
        """Positions of the inner corners on the board, shape (columns * rows, 2) [m]."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel()], axis=1) * self.square_m


@dataclass(frozen=True)
class LensFit:
    """A lens, and how well it explains the pictures.

    Attributes
    ----------
    lens : Lens
    residual_rms_px : float -- of all corners [px]
    n_pictures : int -- pictures in which the board was found
    """

    lens: Lens
    residual_rms_px: float
    n_pictures: int


@dataclass(frozen=True)
class ScaleFit:
    """The scale in the board's plane.

    Attributes
    ----------
    pixels_per_metre, sd : float -- scale and its standard deviation [px/m]
    tilt : float -- largest relative difference of scale over the board; a board parallel to the image has none
    residual_rms_px : float -- of the corners about a plane similarity [px]
    """

    pixels_per_metre: float
    sd: float
    tilt: float
    residual_rms_px: float


def find_corners(image: ImageArray, board: Checkerboard) -> FloatArray:
    """Find the inner corners.

    Parameters
    ----------
    image : ndarray, shape (height, width), uint8 or uint16
    board : Checkerboard

    Returns
    -------
    ndarray, shape (columns * rows, 2) -- u, v of the corners in the order of ``Checkerboard.corners`` [px]

    Raises
    ------
    CalibrationError -- the board is not wholly in view
    """
    grey = image
    if image.dtype == np.uint16:
        grey = np.asarray(image.astype(np.float32) * (255.0 / max(int(image.max()), 1)), dtype=np.uint8)
    size = (board.columns, board.rows)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners = cv2.findChessboardCorners(np.ascontiguousarray(grey), size, flags=flags)
    if not is_found:
        raise CalibrationError(
            f"no checkerboard of {board.columns} x {board.rows} inner corners in the image of {image.shape[1]} x "
            f"{image.shape[0]}; expected all of it in view, sharp and evenly lit"
        )
    window = (_CORNER_WINDOW_PX, _CORNER_WINDOW_PX)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    refined = cv2.cornerSubPix(np.ascontiguousarray(grey), corners, window, (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def fit_lens(images: Sequence[ImageArray], board: Checkerboard) -> LensFit:
    """Camera matrix and distortion from pictures of the board at different tilts.

    Parameters
    ----------
    images : sequence of ndarray, shape (height, width) -- all of one size
    board : Checkerboard

    Returns
    -------
    LensFit

    Raises
    ------
    CalibrationError -- sizes differ, or the board was found in fewer than five pictures
    """
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise CalibrationError(f"pictures have sizes {sorted(sizes)}; expected one size")
    found = []
    for image in images:
        try:
            found.append(find_corners(image, board))
        except CalibrationError:
            continue
    if len(found) < MIN_PICTURES:
        raise CalibrationError(
            f"the checkerboard was found in {len(found)} of {len(images)} pictures; expected at least "
            f"{MIN_PICTURES}, tilted in different directions"
        )
    flat = np.hstack([board.corners(), np.zeros((board.columns * board.rows, 1))]).astype(np.float32)
    height, width = next(iter(sizes))
    rms, matrix, coefficients, _, _ = cv2.calibrateCamera(
        [flat] * len(found), [corners.astype(np.float32) for corners in found], (width, height), None, None
    )
    k1, k2, p1, p2, k3 = (float(value) for value in np.asarray(coefficients).ravel()[:5])
    lens = Lens(
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        (k1, k2, p1, p2, k3),
    )
    return LensFit(lens, float(rms), len(found))


def fit_scale(image: ImageArray, board: Checkerboard, lens: Lens | None = None) -> ScaleFit:
    """Scale from one picture of the board in the beam's plane, parallel to the image.

    Parameters
    ----------
    image : ndarray, shape (height, width)
    board : Checkerboard
    lens : Lens or None -- corners are undistorted where it is given

    Returns
    -------
    ScaleFit

    Raises
    ------
    CalibrationError -- the board is not wholly in view

    Notes
    -----
    Least squares of a rotation, a scale and a shift: with centred positions p on the board and q in the image
    as complex numbers, q = a p or q = a conj(p), scale |a|.
    """
    corners = find_corners(image, board)
    u, v = (corners[:, 0], corners[:, 1]) if lens is None else lens.undistort(corners[:, 0], corners[:, 1])
    place = board.corners()
    image_plane = (u - np.mean(u)) + 1j * (v - np.mean(v))
    board_plane = (place[:, 0] - np.mean(place[:, 0])) + 1j * (place[:, 1] - np.mean(place[:, 1]))
    power = float(np.sum(np.abs(board_plane) ** 2))
    fits = []
    for plane in (board_plane, np.conj(board_plane)):
        factor = np.sum(np.conj(plane) * image_plane) / power
        fits.append((float(np.sum(np.abs(image_plane - factor * plane) ** 2)), abs(factor), factor, plane))
    squares, scale, factor, plane = min(fits, key=lambda fit: fit[0])
    variance = squares / (2 * image_plane.size - 4)
    statistical = math.sqrt(variance / power)
    # A tilted board's scale changes across it: the second-order term of q over p, at the board's rim.
    residual = (image_plane - factor * plane) / factor
    design = np.stack([plane.real**2, plane.real * plane.imag, plane.imag**2], axis=1)
    design = design - design.mean(axis=0)
    bend, *_ = np.linalg.lstsq(design, np.stack([residual.real, residual.imag], axis=1), rcond=None)
    rim = float(np.max(np.abs(plane)))
    tilt = float(2 * np.max(np.abs(bend)) * 2 * rim)
    relative = board.square_sd_m / board.square_m
    return ScaleFit(
        float(scale),
        math.hypot(statistical, float(scale) * relative),
        tilt,
        math.sqrt(squares / image_plane.size),
    )
