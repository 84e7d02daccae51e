"""The noise of a camera from series of frames of one scene at rest: photon transfer.

Light that arrives as electrons varies by the square root of their number, so that the variance of a pixel over time
grows with its mean,

    var I = a + b I        b = K, grey levels per electron;   a = read noise^2 + 1/12 - K bias

(EMVA standard 1288, release 4.0, section 2; 1/12 is the rounding). Differences of frames that follow each other give
the variance, so that light which drifts slowly and fixed patterns have no part in it; pixels of many levels give the
line. What differs from pixel to pixel after averaging over time is the response's non-uniformity (PRNU).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray
from beam_ros.vision.errors import CalibrationError

MIN_FRAMES = 8
"""Frames that a series must have."""
_BINS = 24
"""Levels into which the pixels of a series are sorted."""
_CLEAR = 4.0
"""Pixels closer than so many standard deviations to black or white are left out: there noise is cut off."""
_RANGE = 0.2
"""The brightest level must be above the darkest by this fraction of it."""
_EVEN_PX = 15
"""What is smooth over so many pixels is light and no pattern of the pixels."""
_ROUNDING = 1.0 / 12.0


@dataclass(frozen=True)
class Series:
    """Frames of one scene at rest, averaged.

    Attributes
    ----------
    n_frames : int
    mean, variance : ndarray, shape (height, width) -- over time [grey levels, grey levels^2]
    drift : float -- standard deviation of the frames' mean [grey levels]
    white : float -- largest grey level that such a frame can hold
    """

    n_frames: int
    mean: FloatArray
    variance: FloatArray
    drift: float
    white: float

    @classmethod
    def of(cls, frames: Iterable[ImageArray], name: str) -> Series:
        """Average frames.

        Parameters
        ----------
        frames : iterable of ndarray, shape (height, width), uint8 or uint16
        name : str -- what error messages call the series

        Raises
        ------
        CalibrationError
            The frames are too few or of several sizes.
        """
        total: FloatArray | None = None
        before = squares = np.empty(0)
        means: list[float] = []
        white = 255.0
        for frame in frames:
            grey = np.asarray(frame, dtype=np.float64)
            means.append(float(grey.mean()))
            white = float(np.iinfo(frame.dtype).max)
            if total is None:
                total, squares = np.zeros_like(grey), np.zeros_like(grey)
            elif grey.shape != total.shape:
                raise CalibrationError(
                    f"{name}: frame {len(means) - 1} has shape {grey.shape}; expected {total.shape}, as the frames "
                    "before: give one series of one camera"
                )
            else:
                step = grey - before
                squares += (step - step.mean()) ** 2
            total += grey
            before = grey
        if total is None or len(means) < MIN_FRAMES:
            raise CalibrationError(
                f"{name}: holds {len(means)} frames; expected at least {MIN_FRAMES} of one scene at rest: film longer"
            )
        return cls(
            len(means), total / len(means), squares / (2 * (len(means) - 1)), float(np.std(means)), white
        )

    def points(self) -> FloatArray:
        """Mean, variance and the variance's own standard deviation by level, shape (n, 3)."""
        margin = _CLEAR * np.sqrt(self.variance.mean())
        is_clear = (self.mean > margin) & (self.mean < self.white - margin)
        level, variance = self.mean[is_clear], self.variance[is_clear]
        if level.size < _BINS:
            return np.empty((0, 3))
        order = np.argsort(level)
        found = []
        for part in np.array_split(order, min(_BINS, max(1, level.size // 200))):
            of_bin = float(variance[part].mean())
            # Differences that share a frame are correlated: 3 s^4 / n instead of 2.
            sd = max(of_bin, _ROUNDING) * math.sqrt(3.0 / (part.size * self.n_frames))
            found.append((float(level[part].mean()), of_bin, sd))
        return np.array(found)

    def pattern(self, bias: float) -> tuple[float, float]:
        """Non-uniformity of the pixels' response over the light above the bias, and its standard deviation."""
        smooth = cv2.blur(self.mean, (_EVEN_PX, _EVEN_PX))
        edge = _EVEN_PX // 2
        inner = np.s_[edge:-edge, edge:-edge]
        relative = ((self.mean - smooth) / np.maximum(smooth - bias, 1.0))[inner]
        share = 1.0 - 1.0 / _EVEN_PX**2
        spread = (1.4826 * float(np.median(np.abs(relative - np.median(relative))))) ** 2 / share
        of_noise = (
            float(np.mean((self.variance / np.maximum(smooth - bias, 1.0) ** 2)[inner])) / self.n_frames
        )
        # A median of deviations is worth 37 % of the values.
        sd = spread * math.sqrt(2.0 / (0.37 * relative.size))
        prnu = math.sqrt(max(spread - of_noise, 0.0))
        return prnu, sd / (2.0 * prnu) if prnu > 0.0 else math.sqrt(sd)


@dataclass(frozen=True)
class CameraNoise:
    """What photon transfer says of a camera; every figure with its standard deviation.

    Attributes
    ----------
    variance, variance_sd : float -- a: variance at level 0 [grey levels^2]
    per_grey, per_grey_sd : float -- b: growth of the variance with the level [grey levels]
    electrons_per_grey, electrons_per_grey_sd : float -- 1 / b
    bias, bias_sd, read_noise, read_noise_sd : float or None -- level without light, and its noise without that of
        rounding [grey levels]; None without a dark series
    prnu, prnu_sd : float -- non-uniformity of the response, over the response
    curvature, curvature_sd : float -- how much the variance at the highest level departs from the line, over what the
        line has gained there: a gamma, an automatic gain or denoising shows in it
    levels : (float, float) -- lowest and highest level used [grey levels]
    n_frames : tuple of int -- of each series
    """

    variance: float
    variance_sd: float
    per_grey: float
    per_grey_sd: float
    electrons_per_grey: float
    electrons_per_grey_sd: float
    bias: float | None
    bias_sd: float | None
    read_noise: float | None
    read_noise_sd: float | None
    prnu: float
    prnu_sd: float
    curvature: float
    curvature_sd: float
    levels: tuple[float, float]
    n_frames: tuple[int, ...]

    @property
    def is_straight(self) -> bool:
        """True where the variance follows the line within three standard deviations or three percent."""
        return abs(self.curvature) <= max(3.0 * self.curvature_sd, 0.03)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain values."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()
        }


def photon_transfer(series: Sequence[Series], dark: Series | None = None) -> CameraNoise:
    """Fit the line of photon transfer.

    Parameters
    ----------
    series : sequence of Series -- scenes at rest of several levels: flat ones, or one that holds many
    dark : Series or None -- frames without light

    Raises
    ------
    CalibrationError
        The levels do not differ enough, or the variance does not grow with them.
    """
    points = np.vstack([one.points() for one in (*series, *([dark] if dark else []))])
    low, high = (float(points[:, 0].min()), float(points[:, 0].max())) if len(points) else (0.0, 0.0)
    if len(points) < 3 or high - low < _RANGE * high:
        raise CalibrationError(
            f"camera noise: the series reach from level {low:.1f} to {high:.1f} between black and white; expected "
            f"levels that differ by {100 * _RANGE:.0f} % or more: film a dark and a bright even scene, neither black "
            "nor white"
        )
    line, covariance, scatter = _fitted(points, 1)
    bent, bent_covariance, _ = _fitted(points, 2)
    if line[1] <= 0.0:
        raise CalibrationError(
            f"camera noise: the variance changes by {line[1]:.3g} for each grey level; expected it to grow: switch "
            "off the camera's denoising, gamma and automatic gain, and film without compression"
        )
    curve = (high - low) ** 2 / 4.0 / (line[1] * (high - low))
    bias = bias_sd = read = read_sd = None
    if dark is not None:
        bias = float(dark.mean.mean())
        bias_sd = dark.drift / math.sqrt(dark.n_frames)
        of_dark = float(dark.variance.mean())
        read = math.sqrt(max(of_dark - _ROUNDING, 0.0))
        of_dark_sd = of_dark * math.sqrt(3.0 / (dark.mean.size * dark.n_frames))
        read_sd = of_dark_sd / (2.0 * read) if read > 0.0 else math.sqrt(of_dark_sd)
    brightest = max(series, key=lambda one: float(one.mean.mean()))
    prnu, prnu_sd = brightest.pattern(bias or 0.0)
    sds = np.sqrt(np.diag(covariance)) * scatter
    return CameraNoise(
        line[0],
        float(sds[0]),
        line[1],
        float(sds[1]),
        1.0 / line[1],
        float(sds[1]) / line[1] ** 2,
        bias,
        bias_sd,
        read,
        read_sd,
        prnu,
        prnu_sd,
        bent[2] * curve,
        math.sqrt(bent_covariance[2, 2]) * scatter * abs(curve),
        (low, high),
        tuple(one.n_frames for one in (*series, *([dark] if dark else []))),
    )


def _fitted(points: FloatArray, degree: int) -> tuple[list[float], FloatArray, float]:
    """Coefficients of a polynomial from the lowest power, their covariance, and the scatter about it (1 or more).

    Columns are scaled to one length: powers of levels of 16 bits are too far apart for what a double tells apart.
    Coefficients that the levels leave open are 0 with an infinite variance.
    """
    level, variance, sd = points.T
    columns = np.vander(level, degree + 1, increasing=True) / sd[:, None]
    lengths = np.linalg.norm(columns, axis=0)
    left, singular, directions = np.linalg.svd(columns / lengths, full_matrices=False)
    if singular[-1] <= np.finfo(float).eps * len(level):
        return [0.0] * (degree + 1), np.diag(np.full(degree + 1, np.inf)), 1.0
    root = directions.T / singular / lengths[:, None]
    found = root @ (left.T @ (variance / sd))
    freedom = len(level) - degree - 1
    misfit = float(np.sum((variance / sd - columns @ found) ** 2))
    return found.tolist(), root @ root.T, math.sqrt(max(1.0, misfit / freedom)) if freedom > 0 else 1.0
