"""Estimators that start from the centre of gravity and come closer to what the image holds.

Radial symmetry: the gradient's line through every pixel of a round spot meets its centre; the point nearest
to all lines is found without iteration (the idea of Parthasarathy, Nature Methods 9 (2012) 724, here with
lines weighted by squared gradient over distance). Disc model: a uniform disc with a Gaussian edge, smeared
along u, is fitted by Gauss-Newton to the grey levels; its error is the Cramer-Rao bound.

Both cost several times the centre of gravity and gain on clean, round markers only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray

_MAX_ITERATIONS = 8
_CONVERGED_PX = 2e-4
_SIGNIFICANT_GRADIENT = 3.0
"""Gradients below so many of their noise standard deviations are left out."""
_SMEAR_PER_POSITION_PX = 1.5
"""A smeared disc is modelled by positions no further apart than this."""


class DiscFit(NamedTuple):
    """A disc fitted to a region.

    Attributes
    ----------
    u, v : float -- centre [px of the region]
    sigma_u : float -- standard deviation of u by the image noise [px]
    radius, edge : float -- radius and standard deviation of the edge's blur [px]
    """

    u: float
    v: float
    sigma_u: float
    radius: float
    edge: float


def radial_symmetry_centre(
    region: ImageArray, u: float, v: float, reach: float, noise: float
) -> tuple[float, float] | None:
    """Point nearest to the gradient lines of a round spot.

    Parameters
    ----------
    region : ndarray, shape (rows, columns), uint8 or uint16
    u, v : float -- approximate centre [px of the region]
    reach : float -- radius within which gradients count [px]
    noise : float -- standard deviation of a pixel [grey levels]

    Returns
    -------
    (float, float) or None -- centre [px of the region]; None where the lines do not cross in one point
    """
    along_u = cv2.Sobel(region, cv2.CV_64F, 1, 0, ksize=3, scale=0.125)
    along_v = cv2.Sobel(region, cv2.CV_64F, 0, 1, ksize=3, scale=0.125)
    x = np.arange(region.shape[1], dtype=np.float64)[None, :] - u
    y = np.arange(region.shape[0], dtype=np.float64)[:, None] - v
    distance = np.sqrt(x * x + y * y)
    squared = along_u * along_u + along_v * along_v
    # The noise of such a derivative: sqrt(2 (1 + 4 + 1)) / 8 of a pixel's.
    least = (_SIGNIFICANT_GRADIENT * 0.433 * noise) ** 2
    weight = np.where((squared > least) & (distance < reach), 1.0 / np.maximum(distance, 1.0), 0.0)
    uu, vv = float(np.sum(weight * along_u * along_u)), float(np.sum(weight * along_v * along_v))
    uv = float(np.sum(weight * along_u * along_v))
    # Distance of the centre c from the line through p along g: g x (c - p) = g_u (c_v - y) - g_v (c_u - x).
    moment = weight * (along_u * y - along_v * x)
    at_u, at_v = float(np.sum(moment * along_v)), float(np.sum(moment * along_u))
    determinant = uu * vv - uv * uv
    if determinant <= 1e-6 * max(uu, vv) ** 2:
        return None
    return u + (at_v * uv - at_u * uu) / determinant, v + (at_v * vv - at_u * uv) / determinant


def fit_disc(
    region: ImageArray,
    u: float,
    v: float,
    *,
    radius: float,
    edge: float,
    background: float,
    contrast: float,
    noise: float,
    smear: float,
) -> DiscFit | None:
    """Fit a blurred disc by Gauss-Newton.

    Parameters
    ----------
    region : ndarray, shape (rows, columns), uint8 or uint16
    u, v : float -- approximate centre [px of the region]
    radius, edge : float -- to begin with [px]
    background, contrast : float -- to begin with, the contrast negative for dark discs [grey levels]
    noise : float -- standard deviation of a pixel [grey levels]
    smear : float -- length of the motion along u [px], not fitted

    Returns
    -------
    DiscFit or None -- None where the fit does not converge near the start

    Notes
    -----
    I = B + A mean_s Phi((R - |p - c - s|) / sigma), Phi the normal distribution's cumulative function.
    """
    grey = region.astype(np.float64).ravel()
    x = np.tile(np.arange(region.shape[1], dtype=np.float64), region.shape[0])
    y = np.repeat(np.arange(region.shape[0], dtype=np.float64), region.shape[1])
    count = max(1, math.ceil(smear / _SMEAR_PER_POSITION_PX))
    shifts = ((np.arange(count) + 0.5) / count - 0.5) * smear
    start_u, start_v, least_contrast = u, v, 0.5 * abs(contrast)
    jacobian = np.empty((grey.size, 6))
    for _ in range(_MAX_ITERATIONS):
        jacobian[:] = 0.0
        jacobian[:, 3] = 1.0
        for shift in shifts:
            dx, dy = x - u - shift, y - v
            distance = np.maximum(np.sqrt(dx * dx + dy * dy), 1e-3)
            depth = (radius - distance) / edge
            slope = contrast * np.exp(-0.5 * depth * depth) / (edge * 2.5066282746 * count)
            jacobian[:, 0] += slope * dx / distance
            jacobian[:, 1] += slope * dy / distance
            jacobian[:, 2] += cumulative_normal(depth) / count
            jacobian[:, 4] += slope
            jacobian[:, 5] -= slope * depth
        residual = grey - background - contrast * jacobian[:, 2]
        normal = jacobian.T @ jacobian
        try:
            step = np.linalg.solve(normal, jacobian.T @ residual)
        except np.linalg.LinAlgError:
            return None
        u, v, contrast, background = u + step[0], v + step[1], contrast + step[2], background + step[3]
        radius, edge = radius + min(max(step[4], -1.0), 1.0), edge + min(max(step[5], -0.3), 0.3)
        is_plausible = abs(contrast) > least_contrast and radius > 1.0 and edge > 0.1
        if not is_plausible or abs(u - start_u) > 1.0 or abs(v - start_v) > 1.0:
            return None
        if abs(step[0]) < _CONVERGED_PX and abs(step[1]) < _CONVERGED_PX:
            sigma_u = noise * math.sqrt(float(np.linalg.inv(normal)[0, 0]))
            return DiscFit(float(u), float(v), sigma_u, float(radius), float(edge))
    return None


def cumulative_normal(t: FloatArray) -> FloatArray:
    """Cumulative normal distribution to 1.5e-4 (a logistic function of a cubic)."""
    clipped = np.clip(t, -6.0, 6.0)
    return np.asarray(1.0 / (1.0 + np.exp(-(1.5976 + 0.07056 * clipped * clipped) * clipped)))
