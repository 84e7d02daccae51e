"""Lens and scale from the points of a board.

Several pictures of the board at different tilts give camera matrix and distortion; one picture of the board held in
the beam's own plane gives the scale there, without any other sensor. Of the distortion's coefficients (Brown 1966)
only those are fitted that the pictures support: more of them fit better whatever the lens is, and bend the image
where no corner was. The Bayesian information criterion (Schwarz 1978) draws the line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.calibration.boards import Board, BoardView, find_board
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import CalibrationError

MIN_PICTURES = 5
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
"""Names of the distortion's coefficients, in their order."""

_FIXED = {"k1": cv2.CALIB_FIX_K1, "k2": cv2.CALIB_FIX_K2, "k3": cv2.CALIB_FIX_K3}
_CANDIDATES = tuple(
    (*radial, *tangential)
    for radial in ((), ("k1",), ("k1", "k2"), ("k1", "k2", "k3"))
    for tangential in ((), ("p1", "p2"))
)
_N_MATRIX, _N_POSE = 4, 6


@dataclass(frozen=True)
class LensFit:
    """A lens, and how well it explains the pictures.

    Attributes
    ----------
    lens : Lens
    coefficients : tuple of str -- those of the distortion that the pictures support; the others are zero
    focal_sd_px, centre_sd_px : (float, float) -- standard deviations [px]
    distortion_sd : tuple of five floats -- of k1, k2, p1, p2, k3; 0 for those that were not fitted
    residual_rms_px : float -- of all corners [px]
    n_pictures : int -- pictures in which the board was found
    """

    lens: Lens
    coefficients: tuple[str, ...]
    focal_sd_px: tuple[float, float]
    centre_sd_px: tuple[float, float]
    distortion_sd: tuple[float, ...]
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


def fit_lens(images: Sequence[ImageArray], board: Board) -> LensFit:
    """Camera matrix and distortion from pictures of the board at different tilts.

    Parameters
    ----------
    images : sequence of ndarray, shape (height, width) -- all of one size
    board : Board

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
    views = []
    for image in images:
        try:
            views.append(find_board(image, board))
        except CalibrationError:
            continue
    if len(views) < MIN_PICTURES:
        raise CalibrationError(
            f"the {board.pattern} was found in {len(views)} of {len(images)} pictures; expected at least "
            f"{MIN_PICTURES}, tilted in different directions"
        )
    height, width = next(iter(sizes))
    return fit_lens_to_views(views, (width, height))


def fit_lens_to_views(views: Sequence[BoardView], image_size: tuple[int, int]) -> LensFit:
    """Camera matrix and distortion from a board's points.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : (int, int) -- width and height of the pictures [px]
    """
    fits = [_fit(views, image_size, coefficients) for coefficients in _CANDIDATES]
    n_numbers = 2 * sum(len(view.image_px) for view in views)

    def criterion(fit: LensFit) -> float:
        n_fitted = _N_MATRIX + _N_POSE * len(views) + len(fit.coefficients)
        mean_square = max(fit.residual_rms_px**2 / 2, 1e-18)
        return n_numbers * math.log(mean_square) + n_fitted * math.log(n_numbers)

    return min(fits, key=criterion)


def _fit(views: Sequence[BoardView], image_size: tuple[int, int], coefficients: tuple[str, ...]) -> LensFit:
    """Fit of these coefficients, all others zero."""
    flags = sum(flag for name, flag in _FIXED.items() if name not in coefficients)
    if "p1" not in coefficients:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    on_board = [
        np.hstack([view.board_m, np.zeros((len(view.board_m), 1))]).astype(np.float32) for view in views
    ]
    rms, matrix, distortion, _, _, deviations, *_ = cv2.calibrateCameraExtended(
        on_board, [view.image_px.astype(np.float32) for view in views], image_size, None, None, flags=flags
    )
    k1, k2, p1, p2, k3 = (float(value) for value in np.asarray(distortion).ravel()[:5])
    fx_sd, fy_sd, cx_sd, cy_sd, *sds = (float(value) for value in np.asarray(deviations).ravel()[:9])
    return LensFit(
        Lens(
            (float(matrix[0, 0]), float(matrix[1, 1])),
            (float(matrix[0, 2]), float(matrix[1, 2])),
            (k1, k2, p1, p2, k3),
        ),
        tuple(name for name in COEFFICIENTS if name in coefficients),
        (fx_sd, fy_sd),
        (cx_sd, cy_sd),
        tuple(sd if name in coefficients else 0.0 for name, sd in zip(COEFFICIENTS, sds, strict=True)),
        float(rms),
        len(views),
    )


def fit_scale(image: ImageArray, board: Board, lens: Lens | None = None) -> ScaleFit:
    """Scale from one picture of the board in the beam's plane, parallel to the image.

    Parameters
    ----------
    image : ndarray, shape (height, width)
    board : Board
    lens : Lens or None -- corners are undistorted where it is given

    Returns
    -------
    ScaleFit

    Raises
    ------
    CalibrationError -- the board is not in view

    Notes
    -----
    Least squares of a rotation, a scale and a shift: with centred positions p on the board and q in the image
    as complex numbers, q = a p or q = a conj(p), scale |a|.
    """
    view = find_board(image, board)
    u, v = view.image_px.T if lens is None else lens.undistort(*view.image_px.T)
    place = view.board_m
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
