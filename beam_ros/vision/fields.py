"""Interlaced images: even and odd rows show two instants, half a frame apart, or a whole one.

The disc of a marker that moves is combed. Of even and of odd rows alone the centre of gravity is measured, and the
difference of the two compared with how far the marker moves in a frame:

    u(odd rows) - u(even rows) = b (u(next frame) - u(frame before)) / 2 + noise

With one instant in an image b is zero, with two it is the time between them as a part of a frame. It is found by
least squares from some samples, and believed by Student's t.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import ImageArray

DEINTERLACE = "ffmpeg -i FILM -vf bwdif -c:v ffv1 NEW.mkv"
"""A command that makes a film with one instant in every image."""
_SAMPLES = 16
"""So many samples are a test, ..."""
_EXPLAINED = 0.81
"""... which finds two fields where b explains this share of the squares (t = 7.9, by chance once in a million) ..."""
_MIN_APART = 0.25
"""... and is no less: half of what the nearest fields have [frames]."""
_MOVING = 16.0
"""A sample is taken where a marker moves by so many standard deviations of its place."""
_REST_FRAMES = 1000
"""After a test so many frames are left in peace."""


class _Pending(NamedTuple):
    """Half a sample: its frame, the marker's column in the frame before, and the difference of the fields [px]."""

    frame: int
    before: float
    apart: float


def rows_apart(light: ImageArray, top: int) -> float:
    """Difference of a spot's centres of gravity in odd and even rows of the image [px]; 0 where one has none.

    Parameters
    ----------
    light : ndarray, shape (rows, columns), uint8 or uint16 -- grey levels of a region beyond its background
    top : int -- the region's first row in the image [px]
    """
    columns = np.arange(light.shape[1], dtype=np.float64)
    sums = np.stack([light.sum(axis=1), light @ columns])
    (even, even_u), (odd, odd_u) = sums[:, top % 2 :: 2].sum(axis=1), sums[:, 1 - top % 2 :: 2].sum(axis=1)
    return float(odd_u / odd - even_u / even) if even > 0.0 < odd else 0.0


class InterlacedFields:
    """Finds out whether even and odd rows show two instants.

    Attributes
    ----------
    apart : float -- time between the two instants [frames]; 0 where they are one, or nobody knows yet
    likely_apart : float -- the same, or what the samples of a test that has not ended show of it [frames]
    next_frame : int -- number of the first frame that is of use

    Notes
    -----
    Every second frame gives a difference, the frame after it the step: where the two fields change places from frame
    to frame, b has one sign all the same.
    """

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}
        self._samples: list[tuple[float, float]] = []
        self.apart = self.likely_apart = 0.0
        self.next_frame = 0

    def look(
        self,
        frame: int,
        marker: int,
        light: Callable[[], ImageArray],
        top: int,
        u: float,
        step: float,
        sigma: float,
    ) -> None:
        """Look at a marker, in an even frame and the next one.

        Parameters
        ----------
        frame, marker : int -- their numbers
        light : callable -- gives the grey levels about the marker beyond the background, as of ``rows_apart``
        top : int -- first row of that in the image [px]
        u, step, sigma : float -- where it is, how far that is from the frame before, and the standard deviation [px]
        """
        if frame < self.next_frame:
            return
        pending = self._pending.pop(marker, None)
        if frame % 2 == 0:
            if abs(step) > _MOVING * sigma:
                self._pending[marker] = _Pending(frame, u - step, rows_apart(light(), top))
            return
        if pending is None or pending.frame != frame - 1:
            return
        speed = (u - pending.before) / 2
        if abs(speed) <= _MOVING * sigma:
            return
        self._samples.append((speed, pending.apart))
        explaining = self._explaining()
        self.likely_apart = max(explaining, self.apart)
        if len(self._samples) == _SAMPLES:
            self.apart = self.likely_apart = explaining
            self._samples = []
            self.next_frame = frame + _REST_FRAMES

    def _explaining(self) -> float:
        """Time apart that explains the samples [frames]; 0 where none does."""
        speed, apart = np.array(self._samples).T
        b = float(speed @ apart / (speed @ speed))
        is_explained = b * (speed @ apart) > _EXPLAINED * (apart @ apart) and abs(b) >= _MIN_APART
        return abs(b) if is_explained else 0.0
