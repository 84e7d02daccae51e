"""Defective pixels of the sensor, which are hot, dead or stuck: alone, a few together, or whole rows and columns.

What has been through the lens is blurred: no pixel differs from all that is beside it by as much as a defective one
does, which the most favourable of the four lines through it shows,

    p - max over four directions of (one neighbour + the opposite one) / 2

Such a pixel is taken for the mean of those two opposite neighbours that differ least, which lie along the rim where
it is on one. What only seems to be defective loses next to nothing by that.
"""

from __future__ import annotations

import math
from collections import deque
from functools import reduce

import cv2
import numpy as np

from beam_ros.arrays import ImageArray, IndexArray

LOOKS = 3
"""What shows in so many looks in a row is a defect of the sensor, which stays."""
_SHARP = 0.4
"""A defective pixel stands out of its neighbours by so much of the markers' contrast: no disc of 4 px and more does,
however sharp (0.39), nor any dot behind a lens that blurs by 0.6 px (0.394)."""
_SHARP_LINE = 0.7
"""A pixel of a defective row or column does so of the two beside that: no line behind a lens that blurs by 0.3 px
does (0.673)."""
_LINE = 3
"""So many such pixels make a row or a column a defective one."""
_BESIDE, _CROWD = 9, 4
"""A square of so many pixels a side has no more than so many defective ones: a pattern has more, as of a mosaic."""
_MOST = 0.01
"""A picture of which a greater share stands out is noise or a pattern."""
_PAIRS = np.array([[0, 1], [1, 0], [1, 1], [1, -1]])
"""Rows and columns from a pixel to one neighbour; the opposite one is as far the other way."""
_BENT = 0.16
"""Across a rim blurred by e px the mean of two neighbours is wrong by this over e of their difference, half of the
x / (2 e)^2 that it is at a distance x = e from the middle of the rim."""


class DefectivePixels:
    """Finds a sensor's defective pixels, and fills them in.

    Attributes
    ----------
    count : int -- so many are filled in
    """

    def __init__(self) -> None:
        self._looks: deque[IndexArray] = deque(maxlen=LOOKS)
        self._known = self._filled = self._rows = self._columns = np.zeros(0, np.intp)
        self._is_good = np.zeros((len(_PAIRS), 0), np.bool_)
        self._apart = np.zeros(0, np.intp)
        self.count = 0

    def mended(self, image: ImageArray, contrast: float = 0.0) -> ImageArray:
        """Fill in the pixels that are known to be defective.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16
        contrast : float -- of the markers, to look for such pixels, and fill in what is found, too; 0 does not look
            [grey levels]

        Returns
        -------
        ndarray -- a picture of its own, or the same one where nothing is to be filled in
        """
        if contrast > 0.0:
            self._looks.append(_defective(image, contrast))
            if len(self._looks) == LOOKS:
                self._known = np.union1d(self._known, reduce(np.intersect1d, self._looks))
            self._fill(np.union1d(self._known, self._looks[-1]), image.shape[1])
        elif self._filled is not self._known:
            self._fill(self._known, image.shape[1])
        if not self.count:
            return image
        pairs = _neighbours(image, self._rows, self._columns)
        apart = np.where(self._is_good, abs(pairs[0] - pairs[1]), np.iinfo(np.intp).max)
        best = np.argmin(apart, axis=0), np.arange(self.count)
        self._apart = apart[best]
        mended: ImageArray = image.copy()
        mended[self._rows, self._columns] = (pairs[0][best] + pairs[1][best] + 1) // 2
        return mended

    def pull(self, u: float, v: float, disc: tuple[float, float], contrast: float, noise: float) -> float:
        """Standard deviation of what the pixels that were filled in do to the centre of a disc [px].

        Parameters
        ----------
        u, v : float -- its centre [px]
        disc : (float, float) -- its radius, and the standard deviation of its rim's blur [px]
        contrast, noise : float -- of the disc and of a pixel [grey levels]

        Notes
        -----
        A pixel that is wrong by d moves the centre by d g over the sum of all g^2, g being the slope of the grey
        levels along u: at most sqrt(2) d / (pi A R) for a disc of contrast A and radius R. All are wrong alike.
        """
        radius, edge = disc
        near = np.hypot(self._columns - u, self._rows - v) <= radius + 2.0 * edge
        apart = float(np.maximum(self._apart[near] - 3.0 * noise, 0.0).sum())
        return math.sqrt(2.0) / (math.pi * contrast * radius) * _BENT / edge * apart

    def _fill(self, pixels: IndexArray, width: int) -> None:
        """Fill in these pixels of pictures of a width from now on, as far as others are beside them."""
        self._filled = pixels
        ahead, behind = (np.isin(pixels + sign * _PAIRS @ [[width], [1]], pixels) for sign in (1, -1))
        is_good = ~(ahead | behind)
        can_be = is_good.any(axis=0)
        self._rows, self._columns = np.divmod(pixels[can_be], width)
        self._is_good, self.count = is_good[:, can_be], int(can_be.sum())


def _neighbours(image: ImageArray, rows: IndexArray, columns: IndexArray) -> IndexArray:
    """Grey levels of the two neighbours of some pixels in each direction, shape (2, 4, n)."""
    return np.array(
        [[image[rows + sign * y, columns + sign * x] for y, x in _PAIRS] for sign in (1, -1)], dtype=np.intp
    )


def _defective(image: ImageArray, contrast: float) -> IndexArray:
    """Pixels, row by row, that are not what a lens and a sensor without defects show."""
    columns, rows = _stuck(image), _stuck(image.T)
    # The mean of nine leaves eight ninths of what a pixel stands out by, and two thirds of what a line does.
    least = min(8 / 9 * _SHARP, 2 / 3 * _SHARP_LINE) * contrast
    stands_out = cv2.absdiff(image, cv2.blur(image, (3, 3))) > least
    stands_out[[0, -1]] = stands_out[:, [0, -1]] = False
    places = cv2.findNonZero(stands_out.view(np.uint8))
    dots = np.zeros((0, 2), np.intp)
    if places is not None and len(places) <= _MOST * image.size:
        x, y = places.reshape(-1, 2).astype(np.intp).T
        apart = image[y, x] - _neighbours(image, y, x)
        beyond = apart.sum(axis=0) / 2
        is_dot = np.maximum(beyond.min(axis=0), -beyond.max(axis=0)) > _SHARP * contrast
        dots = np.stack([y[is_dot], x[is_dot]], axis=1)
        # A column stands out of what is to its left and right, a row of what is above and below. It does of both:
        # beside a defective one a sound one is far from the mean of its neighbours, too.
        out_of_both = np.maximum(apart[:, :2].min(axis=0), -apart[:, :2].max(axis=0))
        in_column, in_row = (out_of_both > _SHARP_LINE * contrast) & ~is_dot
        columns = np.union1d(columns, np.flatnonzero(np.bincount(x[in_column]) >= _LINE))
        rows = np.union1d(rows, np.flatnonzero(np.bincount(y[in_row]) >= _LINE))
    if not columns.size + rows.size + len(dots):
        return np.zeros(0, np.intp)
    found = np.zeros(image.shape, np.uint8)
    found[tuple(dots.T)] = 1
    found[cv2.boxFilter(found, -1, (_BESIDE, _BESIDE), normalize=False) > _CROWD] = 0
    found[1:-1, columns] = found[rows, 1:-1] = 1
    return np.flatnonzero(found)


def _stuck(image: ImageArray) -> IndexArray:
    """Columns that show one grey level from end to end, while most pixels to their left and right show others."""
    is_even = (image[:: max(len(image) // 8, 1)] == image[0]).all(axis=0)
    columns = 1 + np.flatnonzero(is_even[1:-1] & ~is_even[:-2] & ~is_even[2:])
    within = image[:, columns]
    differs = [(image[:, columns + side] != within).mean(axis=0) > 0.5 for side in (-1, 1)]
    found: IndexArray = columns[(within == within[0]).all(axis=0) & differs[0] & differs[1]]
    return found
