"""Radial symmetry: the gradient's line through every pixel of a round spot meets its centre.

The point nearest to all lines is found without iteration (the idea of Parthasarathy, Nature Methods 9 (2012) 724,
here with lines weighted by squared gradient over distance). It knows nothing of the spot but that it is round.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray

_SIGNIFICANT_GRADIENT = 3.0
"""Gradients below so many of their noise standard deviations are left out."""


def radial_symmetry_centre(
    region: ImageArray, u: float, v: float, reach: float, variance: FloatArray
) -> tuple[float, float, float] | None:
    """Point nearest to the gradient lines of a round spot.

    Parameters
    ----------
    region : ndarray, shape (rows, columns), uint8 or uint16
    u, v : float -- approximate centre [px of the region]
    reach : float -- radius within which gradients count [px]
    variance : ndarray, shape (rows, columns) -- of the pixels' noise [grey levels^2]

    Returns
    -------
    (float, float, float) or None -- centre [px of the region] and standard deviation of u [px]; None where the lines
        do not cross in one point
    """
    along_u = cv2.Sobel(region, cv2.CV_64F, 1, 0, ksize=3, scale=0.125)
    along_v = cv2.Sobel(region, cv2.CV_64F, 0, 1, ksize=3, scale=0.125)
    x = np.arange(region.shape[1], dtype=np.float64)[None, :] - u
    y = np.arange(region.shape[0], dtype=np.float64)[:, None] - v
    distance = np.sqrt(x * x + y * y)
    squared = along_u * along_u + along_v * along_v
    # The noise of such a derivative: sqrt(2 (1 + 4 + 1)) / 8 of a pixel's.
    least = (_SIGNIFICANT_GRADIENT * 0.433) ** 2 * variance
    weight = np.where((squared > least) & (distance < reach), 1.0 / np.maximum(distance, 1.0), 0.0)
    uu, vv = float(np.sum(weight * along_u * along_u)), float(np.sum(weight * along_v * along_v))
    uv = float(np.sum(weight * along_u * along_v))
    # Distance of the centre c from the line through p along g: g x (c - p) = g_u (c_v - y) - g_v (c_u - x).
    moment = weight * (along_u * y - along_v * x)
    at_u, at_v = float(np.sum(moment * along_v)), float(np.sum(moment * along_u))
    determinant = uu * vv - uv * uv
    if determinant <= 1e-6 * max(uu, vv) ** 2:
        return None
    to_u, to_v = (at_v * uv - at_u * uu) / determinant, (at_v * vv - at_u * uv) / determinant
    # Seen from the point found, du = sum w ((uv g_u - uu g_v) dm + m (uv dg_u - uu dg_v)) / det, where noise n of
    # the pixels gives dg = Sobel(n), and m = g_u y - g_v x. Each pixel counts with what the transposed Sobel makes of
    # that.
    x, y = x - to_u, y - to_v
    share = weight * (uv * along_u - uu * along_v) / determinant
    rest = weight * (along_u * y - along_v * x) / determinant
    counts = cv2.Sobel(share * x + uu * rest, cv2.CV_64F, 0, 1, ksize=3, scale=0.125)
    counts -= cv2.Sobel(share * y + uv * rest, cv2.CV_64F, 1, 0, ksize=3, scale=0.125)
    return u + to_u, v + to_v, math.sqrt(float(np.sum(counts * counts * variance)))
