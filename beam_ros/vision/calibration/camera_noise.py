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

from beam_ros.arrays import ByteArray, FloatArray, ImageArray
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.parameters import WHITES

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
_CUT = 0.01
"""So many pixels whose noise is cut off are worth a note."""
_BURIED = 2.0
"""A dark level closer than so many standard deviations to black has lost part of its noise there."""
_SURE = 3.0
"""A dark series is not the darkest where it is brighter by so many of the frames' standard deviations."""
_ROUNDING = 1.0 / 12.0


@dataclass(frozen=True)
class Series:
    """Frames of one scene at rest, averaged.

    Attributes
    ----------
    name : str -- what messages call it
    bits : int -- of a grey level, as stored
    n_frames, n_repeated : int -- frames that count, and those that repeat the one before bit for bit
    mean, variance : ndarray, shape (height, width) -- over time [grey levels, grey levels^2]
    drift : float -- standard deviation of the frames' mean [grey levels]
    white : float -- largest grey level that such a frame can hold
    """

    name: str
    bits: int
    n_frames: int
    n_repeated: int
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
            The frames are too few, or of several sizes or depths.
        """
        total: FloatArray | None = None
        before = squares = np.empty(0)
        means: list[float] = []
        peak, bits, n_repeated = 0, 8, 0
        for k, frame in enumerate(frames):
            grey = np.asarray(frame, dtype=np.float64)
            if total is None:
                total, squares, bits = np.zeros_like(grey), np.zeros_like(grey), 8 * frame.dtype.itemsize
            elif (grey.shape, 8 * frame.dtype.itemsize) != (total.shape, bits):
                raise CalibrationError(
                    f"{name}: frame {k} has shape {grey.shape} and {8 * frame.dtype.itemsize} bits; expected "
                    f"{total.shape} and {bits}, as the frames before: give one series of one camera"
                )
            elif np.array_equal(grey, before) and grey.min() < grey.max():
                n_repeated += 1
                continue
            else:
                step = grey - before
                squares += (step - step.mean()) ** 2
            means.append(float(grey.mean()))
            peak = max(peak, int(frame.max()))
            total += grey
            before = grey
        if total is None or len(means) < MIN_FRAMES:
            copies = f" and {n_repeated} that repeat the one before bit for bit" if n_repeated else ""
            raise CalibrationError(
                f"{name}: holds {len(means)} frames{copies}; expected at least {MIN_FRAMES} of one scene at rest: "
                "film longer" + (", as copies of a picture show no noise" if n_repeated else "")
            )
        return cls(
            name,
            bits,
            len(means),
            n_repeated,
            total / len(means),
            squares / (2 * (len(means) - 1)),
            float(np.std(means)),
            float(peak if bits == 16 and peak in WHITES else 2**bits - 1),
        )

    @property
    def level(self) -> float:
        """Mean of all pixels [grey levels]."""
        return float(self.mean.mean())

    @property
    def margin(self) -> float:
        """Distance from black and white within which noise is cut off [grey levels]."""
        return _CLEAR * math.sqrt(float(self.variance.mean()))

    @property
    def clear(self) -> ByteArray:
        """1 for pixels whose noise is cut off neither at black nor at white, 0 for others, shape (height, width)."""
        is_clear = (self.mean > self.margin) & (self.mean < self.white - self.margin)
        return np.asarray(is_clear, dtype=np.uint8)

    def points(self) -> FloatArray:
        """Mean, variance and the variance's own standard deviation by level, shape (n, 3)."""
        is_clear = self.clear > 0
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

    def pattern(self, bias: float) -> tuple[float, float] | None:
        """Non-uniformity of the pixels' response over the light above the bias, and its standard deviation.

        Only surroundings without a pixel whose noise is cut off count: to leave out the bright pixels alone would
        make the others look even. None where these are less than half of the image.
        """
        smooth = cv2.blur(self.mean, (_EVEN_PX, _EVEN_PX))
        edge = _EVEN_PX // 2
        surroundings = np.ones((_EVEN_PX, _EVEN_PX), dtype=np.uint8)
        inner = cv2.erode(self.clear, surroundings) > 0
        inner[:edge] = inner[-edge:] = inner[:, :edge] = inner[:, -edge:] = False
        height, width = inner.shape
        if np.count_nonzero(inner) <= 0.5 * max(0, height - 2 * edge) * max(0, width - 2 * edge):
            return None
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

    def doubts(self) -> list[str]:
        """Return what of the series does not count, and the remedy."""
        found = []
        if self.n_repeated:
            found.append(
                f"{self.name}: {self.n_repeated} frames repeat the one before bit for bit and are left out; film "
                "without copies"
            )
        black, white = np.mean(self.mean <= self.margin), np.mean(self.mean >= self.white - self.margin)
        for share, edge, remedy in (
            (black, "black (0)", "brighter"),
            (white, f"white ({self.white:.0f})", "darker"),
        ):
            if share > _CUT:
                found.append(
                    f"{self.name}: noise of {100 * share:.0f} % of its pixels is cut off at {edge}, and they are "
                    f"left out; film it {remedy}"
                )
        return found


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
    prnu, prnu_sd : float or None -- non-uniformity of the response, over the response (over the level without a dark
        series); None where no series shows it
    curvature, curvature_sd : float -- how much the variance at the highest level departs from the line, over what the
        line has gained there: a gamma, an automatic gain or denoising shows in it
    levels : (float, float) -- lowest and highest level used [grey levels]
    n_frames : tuple of int -- of each series
    warnings : tuple of str -- what a reader should know
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
    prnu: float | None
    prnu_sd: float | None
    curvature: float
    curvature_sd: float
    levels: tuple[float, float]
    n_frames: tuple[int, ...]
    warnings: tuple[str, ...]

    @property
    def is_straight(self) -> bool:
        """True where the variance follows the line within three standard deviations or three percent."""
        return abs(self.curvature) <= max(3.0 * self.curvature_sd, 0.03)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, without the warnings."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
            if name != "warnings"
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
        Series are of several sizes or depths, the dark one is not the darkest, the levels do not differ enough, or
        the variance does not grow with them.
    """
    _require_one_camera([*series, *([dark] if dark else [])])
    if dark is not None:
        _require_darkest(dark, series)
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
        bias = dark.level
        bias_sd = dark.drift / math.sqrt(dark.n_frames)
        of_dark = float(dark.variance.mean())
        read = math.sqrt(max(of_dark - _ROUNDING, 0.0))
        of_dark_sd = of_dark * math.sqrt(3.0 / (dark.mean.size * dark.n_frames))
        read_sd = of_dark_sd / (2.0 * read) if read > 0.0 else math.sqrt(of_dark_sd)
    warnings = [doubt for one in series for doubt in one.doubts()]
    if dark is not None and dark.level <= _BURIED * math.sqrt(float(dark.variance.mean())):
        warnings.append(
            f"{dark.name}: the dark level, {dark.level:.2g}, lies in its own noise at black: bias and read noise are "
            "not the sensor's; raise the camera's black level (offset)"
        )
    patterns = (one.pattern(bias or 0.0) for one in sorted(series, key=lambda one: -one.level))
    prnu, prnu_sd = next((pattern for pattern in patterns if pattern is not None), (None, None))
    if prnu is None:
        warnings.append(
            f"no series shows the PRNU: expected one more than {_EVEN_PX} px wide and high with half of its pixels "
            "clear of black and white; film an even scene of medium light"
        )
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
        tuple(warnings),
    )


def _require_one_camera(series: Sequence[Series]) -> None:
    first = series[0]
    for one in series:
        if (one.mean.shape, one.bits) != (first.mean.shape, first.bits):
            (height, width), (of_first, across) = one.mean.shape, first.mean.shape
            raise CalibrationError(
                f"{one.name}: frames are {width} x {height} of {one.bits} bits; expected {across} x {of_first} of "
                f"{first.bits} bits, as those of {first.name}: give series of one camera with the same settings"
            )


def _require_darkest(dark: Series, series: Sequence[Series]) -> None:
    for one in series:
        if dark.level - one.level > _SURE * math.hypot(dark.drift, one.drift):
            raise CalibrationError(
                f"{dark.name}: has level {dark.level:.1f}, and {one.name} has {one.level:.1f}; expected the dark "
                "series to be the darkest: give --dark the frames that were taken with the lens covered"
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
