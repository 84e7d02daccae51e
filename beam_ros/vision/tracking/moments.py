"""What of a small region lies beyond a level, and its moments.

The sums

    m_pq = sum x^p y^q g(x, y)

are one product of tabulated powers with the grey levels: for a region of some thirty pixels a side that takes half
the time of OpenCV's general routine, of whose 24 numbers eight are of use here. All are whole numbers below 2^53, so
that the sums are exact whatever the order in which they are made.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray

_ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (0, 3))


def beyond(region: ImageArray, level: float, *, is_dark: bool = False) -> ImageArray:
    """Grey levels beyond a level, with saturation.

    Parameters
    ----------
    region : ndarray, shape (height, width), uint8 or uint16
    level : float -- a whole grey level
    is_dark : bool -- beyond it towards black

    Returns
    -------
    ndarray, of the region's shape and type -- contiguous
    """
    plane = _even(level, region.shape, region.itemsize)
    found: ImageArray = cv2.subtract(plane, region) if is_dark else cv2.subtract(region, plane)
    return found


@lru_cache(maxsize=1024)
def _even(level: float, shape: tuple[int, ...], itemsize: int) -> ImageArray | float:
    """Return a region of one grey level, which is subtracted in half the time that a number takes.

    A level that the grey levels do not reach stays a number.
    """
    dtype = np.dtype(np.uint8 if itemsize == 1 else np.uint16)
    if not 0 <= level <= np.iinfo(dtype).max:
        return level
    plane = np.full(shape, level, dtype)
    plane.flags.writeable = False
    return plane


def raw_moments(grey: ImageArray) -> list[float]:
    """Sums of grey levels times powers of the distance from the first column and row.

    Parameters
    ----------
    grey : ndarray, shape (height, width), uint8 or uint16 -- contiguous

    Returns
    -------
    list of 8 float -- m_00, m_10, m_01, m_20, m_11, m_02, m_30, m_03
    """
    sums: list[float] = _powers(grey.shape).dot(grey.ravel().astype(np.float64)).tolist()
    return sums


@lru_cache(maxsize=64)
def _powers(shape: tuple[int, int]) -> FloatArray:
    """Return x^p y^q for every pixel of a region, shape (8, height * width)."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([(x**p * y**q).ravel() for p, q in _ORDERS])


def central_moments(raw: list[float]) -> tuple[float, float, float, float, float]:
    """Move moments to the centre of gravity.

    Parameters
    ----------
    raw : list of 8 float -- as ``raw_moments`` gives them, the first of them positive

    Returns
    -------
    mu_20, mu_11, mu_02, mu_30, mu_03 : float
    """
    m00, m10, m01, m20, m11, m02, m30, m03 = raw
    x, y = m10 / m00, m01 / m00
    mu20, mu02 = m20 - x * m10, m02 - y * m01
    return mu20, m11 - y * m10, mu02, m30 - x * (3 * mu20 + x * m10), m03 - y * (3 * mu02 + y * m01)
