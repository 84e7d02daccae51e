"""A colour sensor's raw mosaic that is taken for a grey image.

Every second pixel of every second row lies behind a filter of another colour, so that the four phases of the pixels
about a marker show different mean grey levels:

    mean + a (-1)^column + b (-1)^row + c (-1)^(row + column)

Two of the four are green and lie on one diagonal, where they see the same light: a = b or a = -b. Columns or rows
that differ among themselves, as of two amplifiers or of interlaced fields, have a or b alone; a blurred disc has next
to none of the three.
"""

from __future__ import annotations

import math

from beam_ros.arrays import ImageArray

UNDO = (
    "set the images' encoding to the one of the sensor (bayer_rggb8 and the like), or record grey or colour"
)
"""What a person can do about it."""
_APART = 0.1
"""One of a, b and c is at least this share of the marker's light, twice what pixels make of a disc of 6 px with a rim
as sharp as they, ..."""
_UNEVEN = 0.03
"""... this share of the mean grey level, three times what pixels of a grey sensor differ by, ..."""
_SIGNIFICANT = 5.0
"""... and so many standard deviations of the noise."""
_ALIKE = 0.25
"""Two greens differ by no more than this share of that."""


def is_mosaic(region: ImageArray, background: float, noise: float) -> bool:
    """True where the pixels about a spot differ as behind a mosaic of colour filters.

    Parameters
    ----------
    region : ndarray, shape (rows, columns), uint8 or uint16 -- grey levels, with the whole spot
    background : float -- level beside the spot [grey levels]
    noise : float -- standard deviation of a pixel [grey levels]
    """
    rows, columns = region.shape[0] // 2, region.shape[1] // 2
    pixels = region[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)
    (first, second), (third, fourth) = pixels.mean(axis=(0, 2)).tolist()
    a, b = (first - second + third - fourth) / 4, (first + second - third - fourth) / 4
    c = (first - second - third + fourth) / 4
    mean = (first + second + third + fourth) / 4
    apart = max(abs(a), abs(b), abs(c))
    greens = min(abs(a - b), abs(a + b))
    least = max(
        _APART * abs(mean - background), _UNEVEN * mean, _SIGNIFICANT * noise / math.sqrt(4 * rows * columns)
    )
    return bool(apart > least and greens <= _ALIKE * apart)
