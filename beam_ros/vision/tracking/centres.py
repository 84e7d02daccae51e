"""Two centres of a spot: of gravity in a smooth aperture, and the one of radial symmetry.

The first is linear in the grey levels and free of a bias by the pixel grid.
A level that is subtracted with saturation bends the marker's rim where it meets the level; sampled by pixels,
that bend pulls the centre of gravity back and forth once per pixel, by some thousandths of one. Here nothing
is bent. Every pixel counts with a weight that depends on its distance from a point close to the centre,

    u = c + sum w(p - c) (p_u - c) (I(p) - B) / (k sum w(p - c) (I(p) - B))

with w = 1 over the marker and its blurred rim and a fall so soft that the pixel grid cannot see it. The point c
lies on a grid of 1/32 px, for which the weights are tabulated; k, a little below 1, is how far the aperture lets
the centre follow, and what it is wrong by acts on the distance from c only, which is below 1/64 px. The
aperture is as long as the smear, so that the centre is the mean position over the exposure.

The second knows nothing of the spot but that it is round: the gradient's line through every pixel meets its centre.
The point nearest to all lines is found without iteration (the idea of Parthasarathy, Nature Methods 9 (2012) 724,
here with lines weighted by squared gradient over distance).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, ImageArray

_SIGNIFICANT_GRADIENT = 3.0
"""Gradients below so many of their noise standard deviations are left out."""
_PHASES_U = 32
"""Positions of the aperture per pixel along u, along which the marker moves."""
_PHASES_V = 8
"""The same along v, where a marker stays in its row."""
_SMEAR_STEP_PX = 1.5
"""Steps in which the aperture's length follows the smear [px]."""
_SLACK = 1.1
"""The aperture is this much longer than the smear, because a marker that turns during the exposure has its mean
position off the middle of its way."""
RADIUS_STEP_PX = 0.25
EDGE_STEP_PX = 0.125
"""Steps of the marker's radius and edge for which weights are tabulated [px]."""
_RIM = 2.0
"""The weight falls to one half at so many standard deviations of the rim's blur beyond the radius, ..."""
_MIN_RIM_PX = 1.25
"""... or at least so far beyond it [px]."""
_SOFTNESS_PX = 0.8
"""Standard deviation of the weight's fall [px]: less lets the pixel grid through, more lets noise in."""
_REACH = 2.5
"""Weights end at so many of these standard deviations beyond their half."""


class Aperture(NamedTuple):
    """Tabulated weights about one point.

    Attributes
    ----------
    left, top, width, height : int -- the pixels that carry weight, relative to the whole pixel of the point [px]
    weights : ndarray of float32, shape (3, height * width) -- w, w (p_u - c_u) and w (p_v - c_v)
    beyond : ndarray of float32, shape (height * width,) -- 0: all of it counts as beyond the rim
    sums : tuple of 3 float -- of the weights
    gain_u, gain_v : float -- k
    noise : float -- square root of sum (w (p_u - c_u))^2, over k
    """

    left: int
    top: int
    width: int
    height: int
    weights: Float32Array
    beyond: Float32Array
    sums: tuple[float, float, float]
    gain_u: float
    gain_v: float
    noise: float


def disc_steps(radius: float, edge: float, before: tuple[int, int] = (0, 0)) -> tuple[int, int]:
    """Return the tabulated size nearest to a disc's radius and the standard deviation of its rim's blur [px].

    Where it lies within three quarters of a step of the size ``before``, that is kept: an average that wavers
    between two sizes would tabulate both.
    """
    steps = radius / RADIUS_STEP_PX, edge / EDGE_STEP_PX
    if max(abs(steps[0] - before[0]), abs(steps[1] - before[1])) < 0.75:
        return before
    return round(steps[0]), max(2, round(steps[1]))


def aperture_at(
    u: float, v: float, disc: tuple[int, int], smear: float
) -> tuple[Aperture, int, int, float, float]:
    """Return the aperture for a marker near a point.

    Parameters
    ----------
    u, v : float -- where the marker is, to a few hundredths [px]
    disc : tuple of int -- its ``disc_steps``
    smear : float -- length of its motion during the exposure, along u [px]

    Returns
    -------
    aperture : Aperture
    left, top : int -- the first column and row that carry weight [px]
    u, v : float -- the aperture's centre [px]
    """
    at_u, at_v = round(u * _PHASES_U), round(v * _PHASES_V)
    smear_steps = round(smear / _SMEAR_STEP_PX) if smear > 0.0 else 0
    aperture = _tabulated(at_u % _PHASES_U, at_v % _PHASES_V, disc[0], disc[1], smear_steps)
    left, top = at_u // _PHASES_U + aperture.left, at_v // _PHASES_V + aperture.top
    return aperture, left, top, at_u / _PHASES_U, at_v / _PHASES_V


def has_flat_top(image: ImageArray | Float32Array, column: int, row: int, *, is_dark: bool) -> bool:
    """True when the pixels about one are all of the one grey level that no pixel of the image exceeds."""
    inside = image[row - 1 : row + 2, column - 1 : column + 2]
    return bool(np.all(inside == (image.min() if is_dark else image.max())))


def clipped(
    image: ImageArray,
    left: int,
    top: int,
    right: int,
    bottom: int,
    beyond: Float32Array,
    low: float,
    high: float,
    is_dark: bool,
) -> Float32Array:
    """Grey levels of a region, those of the background between bounds, shape (pixels of the region,)."""
    grey = image[top:bottom, left:right].astype(np.float32).ravel()
    if is_dark:
        np.minimum(grey, high, out=grey)
        if low > -math.inf:
            np.maximum(grey, np.float32(low) - beyond, out=grey)
    else:
        np.maximum(grey, low, out=grey)
        if high < math.inf:
            np.minimum(grey, beyond + np.float32(high), out=grey)
    return grey


def clipped_sums(
    image: ImageArray,
    left: int,
    top: int,
    right: int,
    bottom: int,
    weights: Float32Array,
    beyond: Float32Array,
    low: float,
    high: float,
    is_dark: bool,
    sums: Float32Array,
) -> None:
    """Sums of a region's grey levels with weights.

    Parameters
    ----------
    image : ndarray, shape (height, width), uint8 or uint16
    left, top, right, bottom : int -- the region, the last two exclusive [px]
    weights : ndarray of float32, shape (n, pixels of the region)
    beyond : ndarray of float32, shape (pixels of the region,) -- 0 beyond the rim, infinity within
    low, high : float -- bounds of the background: what lies outside of them, away from the disc's side or beyond
        its rim, counts as the nearer one [grey levels]
    is_dark : bool -- the disc lies towards black
    sums : ndarray of float32, shape (n,) -- takes them: an array that Numba makes takes longer than its sums
    """
    weights.dot(clipped(image, left, top, right, bottom, beyond, low, high, is_dark), out=sums)


def clipped_sums_in_loops(
    image: ImageArray,
    left: int,
    top: int,
    right: int,
    bottom: int,
    weights: Float32Array,
    beyond: Float32Array,
    low: float,
    high: float,
    is_dark: bool,
    sums: Float32Array,
) -> None:
    """Do what ``clipped_sums`` does, by loops that Numba compiles."""
    count, width = weights.shape[1], right - left
    grey = np.empty(count, np.float32)
    lower, upper = np.float32(low), np.float32(high)
    for y in range(bottom - top):
        row = image[top + y, left:right]
        for x in range(width):
            at, level = y * width + x, np.float32(row[x])
            if is_dark:
                grey[at] = max(min(level, upper), lower - beyond[at])
            else:
                grey[at] = min(max(level, lower), beyond[at] + upper)
    for k in range(len(sums)):
        total = np.float32(0.0)
        for at in range(count):
            total += weights[k, at] * grey[at]
        sums[k] = total


@cache
def compiled_clipped_sums() -> Callable[..., None] | None:
    """Return ``clipped_sums`` as machine code, or None without Numba."""
    try:
        from numba import njit, types
    except ImportError:
        return None
    whole, real = types.int64, types.float64
    table, row = (types.Array(types.float32, n, "C", readonly=True) for n in (2, 1))
    found = types.float32[::1]
    images = [types.Array(grey, 2, "A", readonly=True) for grey in (types.uint8, types.uint16)]
    compiled: Callable[..., None] = njit(
        [types.void(image, *[whole] * 4, table, row, real, real, types.boolean, found) for image in images],
        cache=True,
        nogil=True,
        fastmath={"reassoc", "contract"},  # sums in whatever order, as those of a BLAS
    )(clipped_sums_in_loops)
    return compiled


@lru_cache(maxsize=4096)
def _tabulated(phase_u: int, phase_v: int, radius_steps: int, edge_steps: int, smear_steps: int) -> Aperture:
    """Compute the weights about one point."""
    left, top, x, y, weight = _weights(
        phase_u / _PHASES_U, phase_v / _PHASES_V, radius_steps, edge_steps, smear_steps
    )
    gain_u, gain_v = _gains(radius_steps, edge_steps, smear_steps)
    along_u, along_v = weight * x, weight * y
    return Aperture(
        left,
        top,
        x.size,
        y.size,
        np.stack([weight.ravel(), along_u.ravel(), along_v.ravel()]).astype(np.float32),
        np.zeros(weight.size, np.float32),
        (float(weight.sum()), float(along_u.sum()), float(along_v.sum())),
        gain_u,
        gain_v,
        math.sqrt(float(np.sum(along_u**2))) / gain_u,
    )


def _weights(
    u: float, v: float, radius_steps: int, edge_steps: int, smear_steps: int
) -> tuple[int, int, FloatArray, FloatArray, FloatArray]:
    """First column and row, distances (1, width) and (height, 1) from the point, weights (height, width)."""
    half_weight = radius_steps * RADIUS_STEP_PX + max(_RIM * edge_steps * EDGE_STEP_PX, _MIN_RIM_PX)
    reach = half_weight + _REACH * _SOFTNESS_PX
    half_length = _SLACK * smear_steps * _SMEAR_STEP_PX / 2
    left, right = math.ceil(u - half_length - reach), math.floor(u + half_length + reach)
    top, bottom = math.ceil(v - reach), math.floor(v + reach)
    x = np.arange(left, right + 1, dtype=np.float64)[None, :] - u
    y = np.arange(top, bottom + 1, dtype=np.float64)[:, None] - v
    beyond = np.hypot(np.maximum(np.abs(x) - half_length, 0.0), y)
    weight = np.where(beyond < reach, cumulative_normal((half_weight - beyond) / _SOFTNESS_PX), 0.0)
    return left, top, x, y, weight


@lru_cache(maxsize=256)
def _gains(radius_steps: int, edge_steps: int, smear_steps: int) -> tuple[float, float]:
    """How far the aperture lets the centre of a blurred, smeared disc follow when that is moved a little."""
    radius, edge = radius_steps * RADIUS_STEP_PX, edge_steps * EDGE_STEP_PX
    _, _, x, y, weight = _weights(0.0, 0.0, radius_steps, edge_steps, smear_steps)
    count = 2 * smear_steps + 1
    shifts = ((np.arange(count) + 0.5) / count - 0.5) * smear_steps * _SMEAR_STEP_PX

    def centre(move_u: float, move_v: float) -> tuple[float, float]:
        disc = np.zeros_like(weight)
        for shift in shifts:
            disc += cumulative_normal((radius - np.hypot(x - move_u - shift, y - move_v)) / edge)
        disc *= weight
        return float(np.sum(disc * x) / np.sum(disc)), float(np.sum(disc * y) / np.sum(disc))

    # By symmetry the centre of a disc at the point itself is the point.
    step = 1.0 / _PHASES_U
    return centre(step, 0.0)[0] / step, centre(0.0, step)[1] / step


def cumulative_normal(t: FloatArray) -> FloatArray:
    """Cumulative normal distribution to 1.5e-4 (a logistic function of a cubic)."""
    clipped = np.clip(t, -6.0, 6.0)
    return np.asarray(1.0 / (1.0 + np.exp(-(1.5976 + 0.07056 * clipped * clipped) * clipped)))


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
