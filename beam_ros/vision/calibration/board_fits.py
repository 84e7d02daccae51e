"""Lens and scale from the points of a board.

Several pictures of the board at different tilts give camera matrix and distortion; one picture of the board held in
the beam's own plane gives the scale there, without any other sensor. Of the distortion's coefficients (Brown 1966)
only those are fitted that the pictures support: more of them fit better whatever the lens is, and bend the image
where no corner was. The Bayesian information criterion (Schwarz 1978) draws the line. Pictures that leave the focal
length open, as those of a board that was never tilted, give no lens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray
from beam_ros.vision.calibration.boards import CORNER_WINDOW_PX, Board, BoardView, find_board
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.lens_covariance import (
    N_MATRIX,
    N_POSE,
    Pose,
    is_focal_determined,
    lens_covariance,
)
from beam_ros.vision.errors import CalibrationError, UndeterminedLensError

MIN_PICTURES = 5
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
"""Names of the distortion's coefficients, in their order."""

_FIXED = {"k1": cv2.CALIB_FIX_K1, "k2": cv2.CALIB_FIX_K2, "k3": cv2.CALIB_FIX_K3}
_CANDIDATES = tuple(
    (*radial, *tangential)
    for radial in ((), ("k1",), ("k1", "k2"), ("k1", "k2", "k3"))
    for tangential in ((), ("p1", "p2"))
)
_STEP = 1e-3
"""Part of a lens's standard deviation over which the scale is straight, far from where the lens images nothing."""


@dataclass(frozen=True)
class LensFit:
    """A lens, and how well it explains the pictures.

    Attributes
    ----------
    lens : Lens
    coefficients : tuple of str -- those of the distortion that the pictures support; the others are zero
    covariance : ndarray, shape (9, 9) -- of fx, fy, cx, cy, k1, k2, p1, p2, k3; 0 for those that were not fitted
    residual_rms_px : float -- of all corners [px]
    n_pictures : int -- pictures in which the board was found
    """

    lens: Lens
    coefficients: tuple[str, ...]
    covariance: FloatArray
    residual_rms_px: float
    n_pictures: int

    @property
    def focal_sd_px(self) -> tuple[float, float]:
        """Standard deviations of fx and fy [px]."""
        fx, fy, *_ = self._sds()
        return fx, fy

    @property
    def centre_sd_px(self) -> tuple[float, float]:
        """Standard deviations of cx and cy [px]."""
        _, _, cx, cy, *_ = self._sds()
        return cx, cy

    @property
    def distortion_sd(self) -> tuple[float, ...]:
        """Standard deviations of k1, k2, p1, p2 and k3; 0 for those that were not fitted."""
        return tuple(self._sds()[N_MATRIX:])

    def _sds(self) -> list[float]:
        return [math.sqrt(variance) for variance in np.diag(self.covariance)]


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
    CalibrationError -- sizes differ, or the board was found in fewer than five different pictures
    UndeterminedLensError -- the pictures leave the focal length open
    """
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise CalibrationError(f"pictures have sizes {sorted(sizes)}; expected one size")
    views = []
    # The same picture again brings the same errors, not new ones.
    different = {image.tobytes(): image for image in images}.values()
    for image in different:
        try:
            views.append(find_board(image, board))
        except CalibrationError:
            continue
    if len(views) < MIN_PICTURES:
        raise CalibrationError(
            f"the {board.pattern} was found in {len(views)} of {len(images)} pictures"
            + ("" if len(different) == len(images) else f", of which {len(different)} are different ones")
            + f"; expected at least {MIN_PICTURES}, tilted in different directions"
        )
    height, width = next(iter(sizes))
    return fit_lens_to_views(views, (width, height))


def fit_lens_to_views(views: Sequence[BoardView], image_size: tuple[int, int]) -> LensFit:
    """Camera matrix and distortion from a board's points.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : (int, int) -- width and height of the pictures [px]

    Raises
    ------
    UndeterminedLensError -- the views leave the focal length open
    """
    fits = [fit for wanted in _CANDIDATES if (fit := _fit(views, image_size, wanted)) is not None]
    n_numbers = 2 * sum(len(view.image_px) for view in views)

    def criterion(fit: LensFit) -> float:
        n_fitted = N_MATRIX + N_POSE * len(views) + len(fit.coefficients)
        mean_square = max(fit.residual_rms_px**2 / 2, 1e-18)
        return n_numbers * math.log(mean_square) + n_fitted * math.log(n_numbers)

    best = min(fits, key=criterion, default=None)
    if best is None or not is_focal_determined(best.lens, best.covariance, len(views)):
        found = (
            "no fit ends" if best is None else f"{best.lens.focal_px[0]:.0f} +- {best.focal_sd_px[0]:.0f} px"
        )
        raise UndeterminedLensError(
            f"{len(views)} pictures leave the focal length open ({found}): expected a board that is tilted, as one "
            "parallel to the image looks the same under every focal length; tilt it by 20 to 40 degrees in "
            "different directions"
        )
    return best


def _fit(
    views: Sequence[BoardView], image_size: tuple[int, int], coefficients: tuple[str, ...]
) -> LensFit | None:
    """Fit of these coefficients, all others zero; None where the search runs away from any lens."""
    flags = sum(flag for name, flag in _FIXED.items() if name not in coefficients)
    if "p1" not in coefficients:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    on_board = [
        np.hstack([view.board_m, np.zeros((len(view.board_m), 1))]).astype(np.float32) for view in views
    ]
    try:
        rms, matrix, distortion, rotations, translations = cv2.calibrateCamera(
            on_board,
            [view.image_px.astype(np.float32) for view in views],
            image_size,
            None,
            None,
            flags=flags,
        )
        k1, k2, p1, p2, k3 = (float(value) for value in np.asarray(distortion).ravel()[:5])
        lens = Lens(
            (float(matrix[0, 0]), float(matrix[1, 1])),
            (float(matrix[0, 2]), float(matrix[1, 2])),
            (k1, k2, p1, p2, k3),
        )
    except (cv2.error, CalibrationError):
        return None
    poses: list[Pose] = [
        (np.asarray(rotation), np.asarray(translation))
        for rotation, translation in zip(rotations, translations, strict=True)
    ]
    covariance = lens_covariance(views, poses, lens, [name in coefficients for name in COEFFICIENTS])
    chosen = tuple(name for name in COEFFICIENTS if name in coefficients)
    return LensFit(lens, chosen, covariance, float(rms), len(views))


def fit_scale(
    image: ImageArray, board: Board, lens: Lens | None = None, covariance: FloatArray | None = None
) -> ScaleFit:
    """Scale from one picture of the board in the beam's plane, parallel to the image.

    Parameters
    ----------
    image : ndarray, shape (height, width)
    board : Board
    lens : Lens or None -- corners are undistorted where it is given
    covariance : ndarray, shape (9, 9), optional -- of the lens, as in ``LensFit``; None: the lens is known

    Returns
    -------
    ScaleFit

    Raises
    ------
    CalibrationError -- the board is not in view, or is no plane

    Notes
    -----
    Least squares of a rotation, a scale and a shift: with centred positions p on the board and q in the image
    as complex numbers, q = a p or q = a conj(p), scale |a|. What the lens adds to its variance are the squared slopes
    of the scale along the main directions of the lens's covariance, for one standard deviation each.
    """
    view = find_board(image, board)
    off_px = _off_plane(view, lens)
    if off_px > CORNER_WINDOW_PX:
        raise CalibrationError(
            f"the corners of the {board.pattern} lie {off_px:.0f} px (RMS) off the image of any plane; expected less "
            f"than {CORNER_WINDOW_PX} px, the window in which a corner is looked for: hold the board flat, and check "
            f"that it has {board.columns} x {board.rows} {board.counted}"
        )
    scale, sd, tilt, residual_rms_px = _similarity(view, lens)
    of_lens = 0.0
    if lens is not None and covariance is not None:
        for step in _main_steps(covariance):
            ahead, back = (_similarity(view, _moved(lens, share * step))[0] for share in (_STEP, -_STEP))
            of_lens = math.hypot(of_lens, (ahead - back) / (2.0 * _STEP))
    relative = board.square_sd_m / board.square_m
    return ScaleFit(scale, math.hypot(sd, of_lens, scale * relative), tilt, residual_rms_px)


def _off_plane(view: BoardView, lens: Lens | None) -> float:
    """How far a board's points lie off the image of a plane, whatever its tilt (RMS) [px]."""
    seen = view.image_px if lens is None else np.stack(lens.undistort(*view.image_px.T), axis=1)
    plane, _ = cv2.findHomography(view.board_m, seen)
    if plane is None:
        return math.inf
    shown = cv2.perspectiveTransform(view.board_m[:, None, :], plane)[:, 0]
    return float(np.sqrt(np.mean(np.sum((shown - seen) ** 2, axis=1))))


def _main_steps(covariance: FloatArray) -> FloatArray:
    """One standard deviation along each main direction of a covariance, shape (n, n), one in a row."""
    sds = np.sqrt(np.diag(covariance))
    unit = np.where(sds > 0.0, sds, 1.0)
    variances, directions = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray((directions * np.sqrt(np.maximum(variances, 0.0))).T * unit)


def _moved(lens: Lens, step: FloatArray) -> Lens:
    """Return a lens with all its numbers changed by a little."""
    numbers = np.array([*lens.focal_px, *lens.centre_px, *lens.distortion]) + step
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(number) for number in numbers)
    return Lens((fx, fy), (cx, cy), (k1, k2, p1, p2, k3))


def _similarity(view: BoardView, lens: Lens | None) -> tuple[float, float, float, float]:
    """Scale, its standard deviation by the corners [px/m], tilt, and what the corners leave (RMS) [px]."""
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
    # A tilted board's scale changes across it: the second-order term of q over p, at the board's rim.
    residual = (image_plane - factor * plane) / factor
    design = np.stack([plane.real**2, plane.real * plane.imag, plane.imag**2], axis=1)
    design = design - design.mean(axis=0)
    bend, *_ = np.linalg.lstsq(design, np.stack([residual.real, residual.imag], axis=1), rcond=None)
    rim = float(np.max(np.abs(plane)))
    tilt = float(2 * np.max(np.abs(bend)) * 2 * rim)
    return float(scale), math.sqrt(variance / power), tilt, math.sqrt(squares / image_plane.size)
