"""What of a small region lies beyond a level, its moments, and the spot that they describe.

The sums

    m_pq = sum x^p y^q g(x, y)

are one product of tabulated powers with the grey levels: for a region of some thirty pixels a side that takes half
the time of OpenCV's general routine, of whose 24 numbers eight are of use here. All are whole numbers below 2^53, so
that the sums are exact whatever the order in which they are made: where Numba is installed (the extra ``compiled``)
loops take the place of the table, and give the same numbers in a fifth of the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from types import FunctionType
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray

SEEN, HIDDEN, BORDER = range(3)
"""What comes of looking for a spot."""
_MIN_VARIANCE = 1e-3
"""No spot is narrower: its asymmetry is finite [px^2]."""
_MAX_PASSES = 4
"""The region is centred anew on what it shows at most this often."""
_CENTRED_PX = 1.5
"""A spot this close to its region's centre needs no further pass [px]."""
UNKNOWN = (-1.0,) * 8
"""Moments that have not been summed yet."""
_NOTHING = *(0.0,) * 10, (0, 0, 0, 0)
_ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (0, 3))

Region = tuple[int, int, int, int]
"""Left, top, right and bottom of a part of an image, the last two exclusive [px]."""


def beyond(regions: ImageArray, levels: tuple[float, ...], *, is_dark: bool = False) -> ImageArray:
    """Grey levels beyond levels, with saturation.

    Parameters
    ----------
    regions : ndarray, shape (n * height, width), uint8 or uint16 -- regions of one size, one below the other
    levels : tuple of n float -- a whole grey level for each
    is_dark : bool -- beyond it towards black

    Returns
    -------
    ndarray, of the regions' shape and type -- contiguous
    """
    planes = _even(levels, regions.shape, regions.itemsize)
    found: ImageArray = cv2.subtract(planes, regions) if is_dark else cv2.subtract(regions, planes)
    return found


@lru_cache(maxsize=1024)
def _even(levels: tuple[float, ...], shape: tuple[int, ...], itemsize: int) -> ImageArray:
    """Return regions of one grey level each, which are subtracted in half the time that numbers take."""
    dtype = np.dtype(np.uint8 if itemsize == 1 else np.uint16)
    values = np.clip(levels, 0, np.iinfo(dtype).max).astype(dtype)
    planes = np.ascontiguousarray(np.broadcast_to(np.repeat(values, shape[0] // len(levels))[:, None], shape))
    planes.flags.writeable = False
    return planes


def moments_of(regions: Sequence[ImageArray], levels: Sequence[float], is_dark: bool) -> list[list[float]]:
    """Sums of grey levels beyond a level times powers of the distance from a region's first column and row.

    Parameters
    ----------
    regions : sequence of ndarray, uint8 or uint16 -- of one shape
    levels : sequence of float -- a whole grey level for each
    is_dark : bool -- beyond it towards black

    Returns
    -------
    list of 8 float for each -- m_00, m_10, m_01, m_20, m_11, m_02, m_30, m_03
    """
    light = beyond(np.concatenate(regions), tuple(levels), is_dark=is_dark).reshape(len(regions), -1)
    sums: list[list[float]] = light.astype(np.float64).dot(_powers(regions[0].shape)).tolist()
    return sums


def moments_beyond(
    image: ImageArray, left: int, top: int, right: int, bottom: int, level: float, is_dark: bool
) -> Sequence[float]:
    """Return ``moments_of`` of one region."""
    return moments_of([image[top:bottom, left:right]], [level], is_dark)[0]


@lru_cache(maxsize=64)
def _powers(shape: tuple[int, int]) -> FloatArray:
    """Return x^p y^q for every pixel of a region, shape (height * width, 8)."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([(x**p * y**q).ravel() for p, q in _ORDERS], axis=1)


def first_moments(
    image: ImageArray,
    places: Sequence[tuple[float, float, float]],
    half: int,
    is_dark: bool,
) -> Sequence[Sequence[float]]:
    """Moments beyond a level of the squares about some places (u, v, level) [px, px, grey levels], in one product.

    Where the edge of the image cuts one of them, all are ``UNKNOWN``.
    """
    height, width = image.shape
    regions, levels, side = [], [], 2 * half + 1
    for u, v, level in places:
        left, top = round(u) - half, round(v) - half
        if left < 0 or top < 0 or left + side > width or top + side > height:
            return [UNKNOWN] * len(places)
        regions.append(image[top : top + side, left : left + side])
        levels.append(level)
    return moments_of(regions, levels, is_dark)


def spot_numbers(
    image: ImageArray,
    u: float,
    v: float,
    half: int,
    level: float,
    speck: float,
    least: float,
    reach: float,
    is_dark: bool,
    sums: Sequence[float] = UNKNOWN,
) -> tuple[int, tuple[Any, ...]]:
    """Look for a spot in a square about a point, which moves with what it shows.

    Parameters
    ----------
    image : ndarray, shape (height, width), uint8 or uint16
    u, v : float -- where to look [px]
    half : int -- half the side of the square [px]
    level : float -- what lies beyond it counts, a whole grey level
    speck : float -- mean of what noise leaves of every pixel beyond the level [grey levels]
    least : float -- sum of grey levels that a spot has at least
    reach : float -- how far a spot reaches from its centre [px]
    is_dark : bool -- beyond the level towards black
    sums : 8 float -- moments of the first square, or ``UNKNOWN``

    Returns
    -------
    int -- SEEN, HIDDEN or BORDER
    tuple of 10 float and a Region -- with SEEN: the fields of a ``Spot``
    """
    height, width = image.shape
    for n in range(_MAX_PASSES):
        column, row = round(u), round(v)
        left, top, right, bottom = column - half, row - half, column + half + 1, row + half + 1
        if n > 0 or sums[0] < 0.0:
            left, top, right, bottom = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
            if right - left <= half or bottom - top <= half:
                return BORDER, _NOTHING
            sums = moments_beyond(image, left, top, right, bottom, level, is_dark)
        m00, m10, m01, m20, m11, m02, m30, m03 = sums
        mass, u, v = m00, m10, m01
        if speck > 0.0:
            # Noise beyond the level everywhere pulls towards the region's centre; its mean is known.
            grey = speck * ((right - left) * (bottom - top))
            mass, u, v = m00 - grey, m10 - grey * (right - left - 1) / 2, m01 - grey * (bottom - top - 1) / 2
        if mass < least:
            return HIDDEN, _NOTHING
        u, v = left + u / mass, top + v / mass
        if abs(u - column) <= _CENTRED_PX and abs(v - row) <= _CENTRED_PX:
            break
    if u - reach < 0 or v - reach < 0 or u + reach > width - 1 or v + reach > height - 1:
        return BORDER, _NOTHING
    plateau = 0.2 * _cross(image, round(v), round(u))
    above = level - plateau if is_dark else plateau - level
    # About the centre of gravity of all that lies beyond the level.
    x, y = m10 / m00, m01 / m00
    mu20, mu02 = m20 - x * m10, m02 - y * m01
    mu30, mu03 = m30 - x * (3 * mu20 + x * m10), m03 - y * (3 * mu02 + y * m01)
    variance_u, variance_v = mu20 / mass, mu02 / mass
    variance_u = variance_u if variance_u > _MIN_VARIANCE else _MIN_VARIANCE
    variance_v = variance_v if variance_v > _MIN_VARIANCE else _MIN_VARIANCE
    return SEEN, (
        u,
        v,
        mass,
        mass / above if above > 1.0 else mass,
        variance_u,
        variance_v,
        (m11 - y * m10) / mass,
        mu30 / (mass * variance_u * math.sqrt(variance_u)),
        mu03 / (mass * variance_v * math.sqrt(variance_v)),
        plateau,
        (left, top, right, bottom),
    )


def _cross(image: ImageArray, y: int, x: int) -> float:
    """Return the sum of a pixel and the four beside it."""
    grey = image.data  # numbers come from there in half the time
    return grey[y, x] + grey[y - 1, x] + grey[y + 1, x] + grey[y, x - 1] + grey[y, x + 1]


def moments_in_loops(
    image: ImageArray, left: int, top: int, right: int, bottom: int, level: float, is_dark: bool
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return what ``moments_beyond`` does, by loops that Numba compiles."""
    zero, sign = int(level), -1 if is_dark else 1
    m00 = m10 = m01 = m20 = m11 = m02 = m30 = m03 = 0
    for y in range(bottom - top):
        row, s0, s1, s2, s3 = image[top + y, left:right], 0, 0, 0, 0
        for x in range(right - left):
            grey = max(sign * (int(row[x]) - zero), 0)
            s0, s1, s2, s3 = s0 + grey, s1 + x * grey, s2 + x * x * grey, s3 + x * x * x * grey
        m00, m10, m20, m30 = m00 + s0, m10 + s1, m20 + s2, m30 + s3
        m01, m11, m02, m03 = m01 + y * s0, m11 + y * s1, m02 + y * y * s0, m03 + y * y * y * s0
    return float(m00), float(m10), float(m01), float(m20), float(m11), float(m02), float(m30), float(m03)


def cross_by_pixels(image: ImageArray, y: int, x: int) -> float:
    """Return what ``_cross`` does, for Numba."""
    beside = float(image[y - 1, x]) + float(image[y + 1, x]) + float(image[y, x - 1]) + float(image[y, x + 1])
    return float(image[y, x]) + beside


@cache
def compiled_spot_numbers() -> Callable[..., tuple[int, tuple[Any, ...]]] | None:
    """Return ``spot_numbers`` as machine code, its sums made in loops, or None without Numba."""
    try:
        from numba import njit, types
    except ImportError:
        return None
    own = {"moments_beyond": njit(moments_in_loops), "_cross": njit(cross_by_pixels)}
    whole, real = types.int64, types.float64
    found = types.Tuple([whole, types.Tuple([*[real] * 10, types.UniTuple(whole, 4)])])
    sums = types.UniTuple(real, 8)
    images = [types.Array(grey, 2, "A", readonly=True) for grey in (types.uint8, types.uint16)]
    compiled: Callable[..., tuple[int, tuple[Any, ...]]] = njit(
        [found(image, real, real, whole, *[real] * 4, types.boolean, sums) for image in images],
        cache=True,
        nogil=True,
    )(FunctionType(spot_numbers.__code__, {**globals(), **own}))
    return compiled
