"""How well pictures of a board determine a lens: covariance of its numbers, the board's poses being unknown, too.

With r the corners' residuals and J their derivatives by the lens's numbers, every picture lets its own pose move what
it moves best, so that only what no pose can do counts for the lens,

    J' = J - Q Q^T J,      C = s^2 (sum of J'^T J')^-1,      s^2 = |r|^2 / (n - p)

(Q: an orthonormal basis of the derivatives by the picture's pose). This is the lens's part of the inverse of the
normal matrix of everything. The columns are scaled to one length before, and no direction is left out where the
pictures say nothing of it: there the standard deviation is large or infinite, as it is.

A focal length is seen by the perspective of a tilted board, which makes its far side smaller, together with its
foreshortening. A board that is parallel to the image has neither: farther away under a longer lens it looks the same.
Noise of the corners feigns small tilts, two in every picture, and an estimate that is made of them is as many of its
standard deviations away from zero as these make by chance. Hence the bound of ``is_focal_determined``: half the focal
length must be refuted by more than so many tilts of pure noise would.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ros.arrays import FloatArray
from beam_ros.vision.calibration.boards import BoardView
from beam_ros.vision.calibration.lens import Lens

N_MATRIX, N_POSE = 4, 6
"""Numbers of the camera's matrix, and of a board's pose."""
_TILTS = 2
_CHANCE = 1e-3
"""Of so many sets of pictures without a tilt may one pass for a set with."""

Pose = tuple[FloatArray, FloatArray]
"""Rotation vector and translation of a board."""


def lens_covariance(
    views: Sequence[BoardView], poses: Sequence[Pose], lens: Lens, is_fitted: Sequence[bool]
) -> FloatArray:
    """Covariance of fx, fy, cx, cy, k1, k2, p1, p2, k3.

    Parameters
    ----------
    views : sequence of BoardView
    poses : sequence of Pose -- of the board in each
    lens : Lens -- of the least squares
    is_fitted : sequence of bool -- for each of the five coefficients; the others are known to be zero

    Returns
    -------
    ndarray, shape (9, 9) -- 0 for what was not fitted; infinite on the diagonal where a direction is open
    """
    matrix = np.array(
        [
            [lens.focal_px[0], 0.0, lens.centre_px[0]],
            [0.0, lens.focal_px[1], lens.centre_px[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    free = np.array([*range(N_MATRIX), *(N_MATRIX + k for k, fitted in enumerate(is_fitted) if fitted)])
    distortion = np.array(lens.distortion)
    lengths, squares, own = np.zeros(len(free)), 0.0, []
    for view, (rotation, translation) in zip(views, poses, strict=True):
        on_board = np.hstack([view.board_m, np.zeros((len(view.board_m), 1))])
        seen, derivatives = cv2.projectPoints(on_board, rotation, translation, matrix, distortion)
        by_lens = np.asarray(derivatives)[:, N_POSE:][:, free]
        basis, _ = np.linalg.qr(np.asarray(derivatives)[:, :N_POSE])
        own.append(by_lens - basis @ (basis.T @ by_lens))
        lengths += np.sum(by_lens**2, axis=0)
        squares += float(np.sum((view.image_px - np.asarray(seen).reshape(-1, 2)) ** 2))
    lengths = np.sqrt(np.where(lengths > 0.0, lengths, 1.0))
    design = np.vstack(own) / lengths
    freedom = len(design) - N_POSE * len(views) - len(free)
    _, singular, directions = np.linalg.svd(design, full_matrices=False)
    covariance = np.zeros((N_MATRIX + len(is_fitted),) * 2)
    if freedom <= 0 or singular[-1] <= np.finfo(float).eps * len(design):
        covariance[free, free] = np.inf
        return covariance
    root = directions.T / singular / lengths[:, None]
    covariance[np.ix_(free, free)] = squares / freedom * (root @ root.T)
    return covariance


def is_focal_determined(lens: Lens, covariance: FloatArray, n_views: int) -> bool:
    """Whether pictures tell the focal lengths from tilts that noise feigns.

    Parameters
    ----------
    lens : Lens
    covariance : ndarray, shape (9, 9) -- as of ``lens_covariance``
    n_views : int -- pictures that it comes from
    """
    bound = np.sqrt(chi_squared_isf(_TILTS * n_views, _CHANCE))
    return all(bool(0.5 * focal > bound * np.sqrt(covariance[k, k])) for k, focal in enumerate(lens.focal_px))
