"""Noise of the pixels about a strip as a + b I, from what the fits leave beside the strip and on it."""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, IndexArray
from beam_ros.vision.parameters import WHITES
from beam_ros.vision.strip.profile import ProfileTable

_QUANTISATION = 1.0 / 12.0
_DISTINCT_GREY = 5.0
"""Ground and strip less apart than this do not tell how the noise grows with the light."""
_UNLIT, _LIT = 0.02, 0.3
"""Pixels with less of the strip's light show the ground, with more the strip."""
_CUT_OFF = 0.1
"""Pixels of a row that are white where anything is cut off."""
_USUAL = 0.455
"""Median of the square of a standard normal variable."""


class StripNoise:
    """Variances of a pixel on the ground and on the strip, beside the grey levels there.

    Attributes
    ----------
    ground_grey : float -- grey level of the ground
    line : (float, float) -- variance at level 0, at least that of rounding, and its growth with the level
    """

    def __init__(self, levels: FloatArray, quiet: float) -> None:
        """Begin with the levels of one frame, in which things other than the strip may stand."""
        self._levels = np.array([min(levels[0], 2 * quiet), min(levels[1], 2 * quiet), levels[2], levels[3]])
        self._settle()

    def learn(self, levels: FloatArray, rate: float) -> None:
        """Follow the levels of a frame."""
        if np.all(np.isfinite(levels)):
            self._levels += rate * (levels - self._levels)
            self._settle()

    def _settle(self) -> None:
        ground, strip, dark, light = (float(level) for level in self._levels)
        slope = max(0.0, (strip - ground) / (light - dark)) if abs(light - dark) > _DISTINCT_GREY else 0.0
        base = ground - slope * dark
        if base < _QUANTISATION:
            base, slope = max(base, _QUANTISATION), max(0.0, min(slope, ground / max(dark, 1.0)))
        self.ground_grey, self.line = dark, (base, slope)


def noise_levels(
    table: ProfileTable,
    entry: IndexArray,
    pixels: Float32Array,
    residual: Float32Array,
    seen: np.ndarray | None = None,
) -> FloatArray:
    """Variance on the ground and on the strip, and the grey levels there; NaN where no pixel shows one of them.

    Parameters
    ----------
    table : ProfileTable
    entry : ndarray of int, shape (n,) -- of the rows
    pixels, residual : ndarray, shape (n, size) -- grey levels, and what the fit leaves of them
    seen : ndarray of bool, shape (n, size), optional -- pixels that are not cut off at white
    """
    shape = table.shapes.take(entry, axis=0)
    share = shape / shape.max(axis=1, keepdims=True)
    freedom, square = table.freedom_of(entry, seen), residual**2
    ground, strip = share < _UNLIT, share > _LIT
    told = [ground, strip] if seen is None else [ground & seen, strip & seen]
    if not (np.any(ground) and np.any(strip) and np.any(told)):
        return np.full(4, np.nan)
    # What is cut off altogether is as noisy as the other, for want of better.
    where = [one if np.any(one) else told[0] | told[1] for one in told]
    return np.array(
        [square[one].sum() / freedom[one].sum() for one in where]
        + [pixels[ground].mean(), pixels[strip].mean()]
    )


def usual_variance(residual: Float32Array) -> float:
    """Variance of a pixel by the median, which a hand or a dot in some of the rows does not move."""
    return float(np.median(residual**2)) / _USUAL if residual.size else float("nan")


def white_level(pixels: np.ndarray) -> float | None:
    """Grey level at which pixels are cut off; None where none are.

    Parameters
    ----------
    pixels : ndarray, shape (n_rows, size) -- grey levels
    """
    white = float(pixels.max())
    is_white = white in (255.0, 65535.0) or white in WHITES
    return white if is_white and np.count_nonzero(pixels == white) > _CUT_OFF * len(pixels) else None
