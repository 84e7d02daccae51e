"""Temporal noise reduction: a camera that averages its frames with those before, and so shows the past, too.

    y_k = (1 - a) x_k + a y_(k-1)

What moves by v from frame to frame lags by v a / (1 - a), with a tail behind it; a camera may spare what moves far.
The noise of the ground beside a marker, white in time from any other camera, gives it away. Of three frames in a row
it has the differences d and d', which what rests is no part of:

    E d d' = -(1 - a)^2 s^2      E d^2 = 2 (1 - a) s^2      a = 1 + 2 E d d' / E d^2

Grey levels are whole numbers: that adds -1/12 to the first and 1/6 to the second. The share a is found from some
samples, and believed by Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from beam_ros.arrays import FloatArray, ImageArray

_SAMPLES = 16
"""So many samples are a test, for which ..."""
_LOOKS = 64
"""... so many grounds are looked at, ..."""
_EXPLAINED = 0.81
"""... which finds an average where their mean explains this share of the squares (t = 8.0: by chance once in a
million) ..."""
_MIN_SHARE = 0.1
"""... and is no less: the lag is then a ninth of a frame, ..."""
_MAX_SHARE = 0.8
"""... and is taken for no more: of the mean of two frames it comes out as one."""
_REST_FRAMES = 4000
"""After a test so many frames are left in peace."""
_FRAMES = 3
"""A sample takes so many frames in a row."""
_COLUMNS = 16
"""The ground is so wide on either side [px], ..."""
_MIN_PIXELS = 100
"""... and has so many pixels at least."""
_STEADY = 1.5
"""Of noise, the two differences have mean squares whose ratio is no more: five standard deviations for 300 pixels."""
_RESTING = 25.0
"""Of a ground that rests, what looks like its motion in u and v, twice each, is no more than so many times the noise
of one of the four: once in 20000 by chance."""
STILL_PX = 0.5
"""Where no marker moved by less in a frame, the camera may shake over a texture too faint to show that [px]."""
_ROUNDING = 1.0 / 12.0
"""Variance of rounding to grey levels."""


def share_of(frames: FloatArray) -> tuple[float, float]:
    """Share of the frame before in a frame, by the noise of a ground, and mean square of that noise's differences.

    Parameters
    ----------
    frames : ndarray, shape (3, rows, columns) -- grey levels of the same pixels in three frames in a row

    Returns
    -------
    float -- NaN where the three show no noise, or more than noise
    float -- [grey levels^2]

    Notes
    -----
    Of the differences, what looks like the ground itself, brighter, darker or moved a little, is taken off. One that
    moved over a texture is no ground: what is moved by more than a little is like noise that comes again.
    """
    mean = frames.mean(axis=0)
    known = np.stack([np.ones_like(mean), mean, *np.gradient(mean)]).reshape(4, -1)
    basis = np.linalg.qr(known.T)[0]
    steps = np.diff(frames.reshape(_FRAMES, -1), axis=0)
    parts = steps @ basis
    steps -= parts @ basis.T
    first, second = np.mean(steps * steps, axis=1).tolist()
    squared = 0.5 * (first + second)
    if (
        squared < 4 * _ROUNDING
        or max(first, second) > _STEADY * min(first, second)
        or np.sum(parts[:, 2:] ** 2) > _RESTING * squared
    ):
        return np.nan, squared
    return 1.0 + 2.0 * (float(np.mean(steps[0] * steps[1])) + _ROUNDING) / (squared - 2 * _ROUNDING), squared


class NoiseReduction:
    """Finds out whether frames are averages with those before.

    Attributes
    ----------
    share : float -- that of the average before in a frame, a; 0 where there is none, or nobody knows yet
    next_frame : int -- number of the first frame that is of use
    """

    def __init__(self) -> None:
        self._frame = -1
        self._grounds: list[tuple[slice, slice]] = []
        self._seen: list[list[ImageArray]] = []
        self._samples: list[float] = []
        self._looks = 0
        self.share = 0.0
        self.next_frame = 0

    @property
    def lag_frames(self) -> float:
        """How far behind its time a frame shows what moves evenly, unless the camera spares it [frames]."""
        return self.share / (1.0 - self.share)

    def lag_px(self, step: float, moment: float) -> float:
        """How far a marker may lag that moves by so much in a frame [px].

        Parameters
        ----------
        step : float -- [px]
        moment : float -- second moment along its motion that is more than its own [px^2]

        Notes
        -----
        Its tail has the second moment a v^2 / (1 - a)^2, which is the square of the lag over a: one that is not seen
        of what moves far says that the camera spares it.
        """
        return min(self.lag_frames * step, math.sqrt(self.share * moment))

    def look(self, frame: int, image: ImageArray, regions: Sequence[tuple[int, int, int, int]]) -> None:
        """Look at the ground beside the markers.

        Parameters
        ----------
        frame : int -- its number
        image : ndarray, shape (height, width), uint8 or uint16
        regions : sequence of 4 int -- left, top, right and bottom of what the markers take up, the last two exclusive
            [px]
        """
        if frame != self._frame + 1 or len(self._seen) == _FRAMES:
            self._seen = []
        self._frame = frame
        if not self._seen:
            self._grounds = [
                (slice(top, bottom), side)
                for left, top, right, bottom in regions
                for side in (slice(max(left - _COLUMNS, 0), left), slice(right, right + _COLUMNS))
            ]
        self._seen.append([image[ground].copy() for ground in self._grounds])
        if len(self._seen) == _FRAMES:
            self._sample()

    def _sample(self) -> None:
        grounds = [np.array(seen, dtype=np.float64) for seen in zip(*self._seen, strict=True)]
        for beside in zip(grounds[::2], grounds[1::2], strict=True):
            found = [share_of(ground) for ground in beside if ground[0].size >= _MIN_PIXELS]
            # What passes on one side is no noise of the ground.
            most = _STEADY * min((squared for _, squared in found), default=0.0)
            shares = [share for share, squared in found if squared <= most and not np.isnan(share)]
            if shares:
                self._samples.append(sum(shares) / len(shares))
            self._looks += 1
        is_enough = len(self._samples) >= _SAMPLES
        if is_enough:
            total, squares = sum(self._samples), sum(share * share for share in self._samples)
            mean = total / len(self._samples)
            is_found = mean * total > _EXPLAINED * squares and mean >= _MIN_SHARE
            self.share = min(mean, _MAX_SHARE) if is_found else 0.0
        if is_enough or self._looks >= _LOOKS:
            self._samples, self._looks = [], 0
            self.next_frame = self._frame + _REST_FRAMES
