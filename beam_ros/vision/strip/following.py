"""The whole strip, followed from frame to frame: its column at every tenth row, with standard deviation or a reason.

A point is a band of rows. In each of its rows the cross-section (``profile``) gives a shift against a common smooth
curve by least squares; the rows' shifts are averaged with the weights that they deserve. The mean is at the
Cramer-Rao bound of white noise:

    sigma_u^2 >= sigma_n^2 / sum (a T')^2        over the pixels of the band

The curve (a polynomial along the strip) only says where to look and how the strip leans within a band; a point is
free to deviate from it by as much as its noise allows. The noise is measured in the same pixels, as a + b I. Rows
that do not look like the strip (a hand, a dot, a thread) are left out; a band that has lost too many of them, whose
height has changed alone, or that lies off the curve is not valid and says why. The heights follow the light, which
may change at once, and along the strip as slowly as shadows do.

Where prediction fails, at the start and after a jump, the strip is searched: the cross-section is correlated with
every column, and the best path from the clamp to the tip is taken (dynamic programming).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, ImageArray, IndexArray
from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.repeats import LATELY, RepeatedImages, is_on_its_way
from beam_ros.vision.strip.cross_section import CrossSection
from beam_ros.vision.strip.noise import StripNoise, noise_levels, usual_variance, white_level
from beam_ros.vision.strip.prediction import CurvePrediction
from beam_ros.vision.strip.profile import SMEAR_STEP_PX, ProfileTable, RowFits
from beam_ros.vision.strip.scatter import PointScatter
from beam_ros.vision.strip.search import best_path

_MIN_POINTS = 12
_DEGREE = 9
"""Of the curve: four modes of a cantilever to some thousandths of their amplitude."""
_PRIOR = np.diag((1e-3 * np.arange(_DEGREE + 1)) ** 2)
"""Holds the curve where no point does."""
_FLOOR_PX = 0.02
"""Keeps one sharp point from bending the curve."""
_SMEAR_CLASSES_PX = (1.0, 3.0, 6.0, 12.0, 24.0)
_MAX_TURNS = 6
_NEAR, _NEAR_POINTS = 0.1, 0.3
"""Steps of the curve and of any point in a turn, over the cross-section's spread, behind which no other is needed: a
step d is d^3 / (4 spread^2) short."""
_LINEAR_PX = 0.6
"""Longest step of a point in one turn: beyond it the cross-section is no longer linear in its shift [px]."""
_LOST_PX = 0.5
_MIN_ROWS = 0.6
"""Share of a band's rows that must look like the strip."""
_UNMODELLED = 0.03
"""Share of the height that the pixels of a row may be off what any model holds."""
_LEFT = 1.0 / 3.0
"""A line looks like the strip where the cross-section leaves less of the pixels' variance, but for noise, than that
share of what it explains; of a step of the light, the edge of something wide, it leaves about as much."""
_LEFT_ALONE = 1.0 / 16.0
"""What leaves more, a quarter of the grey levels, is not alone: another line beside it may be the strip."""
_MOST_LOOKS = 4
"""All but one of so many lines may be refused in the search for the strip."""
_HEIGHT_TOLERANCE, _HEIGHT_SIGMAS = 0.35, 4.0
"""A band may be so much higher or lower than the bands about it. Light that leaves less than that share is none: what
is not the strip may show as much."""
_BESIDE = 3
"""Bands on either side that say how the light is at a band: a shadow is longer than half of them all."""
_EIGHTH, _BETWEEN_SIGMAS, _BETWEEN_CHANCE = 0.125, 2.3, 8.0
"""Light is uneven where the bands between the lowest and the highest eighth differ by more than noise. Those of n
normal values differ by so many standard deviations, and four of that difference's are 8 / sqrt(n)."""
_TIP_BLURS = 4.0
"""Farther above the tip than so many blurs nothing of it is seen."""
_SIGMAS, _OFF_CURVE_PX = 6.0, 0.25
_ROW_SIGMAS = 5.0
_MIN_GOOD = 0.6
"""Share of bands that must be found; below it the strip is searched."""
_MIN_SIGNIFICANCE = 5.0
"""Height of the strip in a typical band over its standard deviation, below which nothing is there: the search would
find a path through noise."""
_HEIGHT_RATE, _NOISE_RATE = 0.05, 0.1
_EARLY, _NOISE_FRAMES, _NOISE_ROWS, _SCATTER_FRAMES = 10, 8, 3, 16
"""The noise is measured in every one of the first frames, then in every eighth in a third of the rows; the points'
scatter then in every sixteenth."""
_SECTION_FRAMES = frozenset(range(2, 40, 5))
"""Frames in which width and blur are measured again, ..."""
_SECTION_ROWS = slice(None, None, 3)
"""... in these rows."""
_MAX_SECTIONS = 12
_NOTHING, _LEAST_SPREAD = 1e-12, 1e-6
_SEARCHES_PX = (12, 60)

REASONS = ("ok", "no_strip", "covered", "height", "off_curve", "outside", "repeated", "doubtful")
"""Whether a point is valid, or why it is not: the strip is nowhere; its rows look like something else; its height has
changed alone; it lies off the curve through the others; it is beyond the image's edge; the image is the one before,
bit for bit, though the strip moved; another line looks like it, and neither has moved yet."""


@dataclass(frozen=True)
class StripParameters:
    """What the follower expects.

    Attributes
    ----------
    first_row, last_row : float -- rows of the tip and of the clamp, first_row < last_row [px]
    rest_column : float -- column of the strip at rest at home [px]
    width_px : float -- width of the strip as the camera sees it, where the film does not show another [px]
    is_bright : bool -- brighter than the ground behind it
    max_speed_px : float -- longest smear expected in an exposure [px]
    exposure_frames : float -- exposure as a share of the time between frames
    row_step : int -- rows of a point
    """

    first_row: float
    last_row: float
    rest_column: float
    width_px: float
    is_bright: bool = True
    exposure_frames: float = 0.0
    row_step: int = 10

    def __post_init__(self) -> None:
        if not 1 <= self.row_step <= 200:
            raise VisionParameterError(
                f"StripParameters.row_step is {self.row_step}; expected 1 to 200 rows: correct --row-step"
            )
        if not self.width_px > 0:
            raise VisionParameterError(
                f"StripParameters.width_px is {self.width_px!r}; expected a width > 0: correct beam.thickness"
            )
        if self.last_row - self.first_row < _MIN_POINTS * self.row_step:
            raise VisionParameterError(
                f"the strip spans rows {self.first_row:.0f} to {self.last_row:.0f}; expected at least {_MIN_POINTS} "
                f"points of {self.row_step} rows: correct beam.length and camera.pixels_per_metre, or give fewer "
                "rows a point"
            )


@dataclass(frozen=True)
class StripFrame:
    """The strip in one frame.

    Attributes
    ----------
    u_px, sigma_px : ndarray, shape (n_points,) -- column and its standard deviation; NaN where not valid [px]
    reasons : ndarray of int, shape (n_points,) -- index into ``REASONS``
    """

    u_px: FloatArray
    sigma_px: FloatArray
    reasons: IndexArray


class _Step(NamedTuple):
    """One linear step from a curve: bands, and the rows that they are made of."""

    middle: FloatArray
    moved: FloatArray
    sigma: FloatArray
    pulled: FloatArray
    reasons: IndexArray
    gain: float | FloatArray
    heights: FloatArray
    is_good: np.ndarray
    table: ProfileTable
    entry: IndexArray
    pixels: Float32Array
    seen: np.ndarray | None


class _RestFit(NamedTuple):
    """The cross-section of a strip at rest, fitted in every row on a curve.

    Attributes
    ----------
    table : ProfileTable
    column, entry : ndarray of int, shape (n_rows,) -- pixel nearest to the curve, row of the table
    pixels : ndarray, shape (n_rows, size) -- about the columns [grey levels]
    is_inside : ndarray of bool, shape (n_rows,) -- the pixels lie in the image
    seen : ndarray of bool, shape (n_rows, size), or None -- pixels that are not cut off at white; None: all
    fits : RowFits
    """

    table: ProfileTable
    column: IndexArray
    entry: IndexArray
    pixels: Float32Array
    is_inside: np.ndarray
    seen: np.ndarray | None
    fits: RowFits

    @property
    def height(self) -> float:
        """Of the strip [grey levels]: rows with dots or hands before them do not move the median."""
        return float(np.median(self.fits.height[self.is_inside]))

    @property
    def height_gain(self) -> float:
        """Variance of a row's height for white noise of variance 1."""
        return float(np.median(self.fits.height_gain))

    def significance(self, variance: float, rows: int) -> float:
        """Height over its standard deviation in a band of so many rows, for pixels of that variance."""
        return self.height / max(math.sqrt(variance * self.height_gain / rows), _LEAST_SPREAD)

    def inside(self) -> tuple[IndexArray, Float32Array, np.ndarray | None]:
        """Return entries, pixels and what is seen of them in the rows that lie in the image."""
        here = self.is_inside
        return self.entry[here], self.pixels[here], None if self.seen is None else self.seen[here]


class LineFollower:
    """Follows what looks like the strip.

    Parameters
    ----------
    parameters : StripParameters
    shape : (int, int) -- height and width of the images [px]

    Attributes
    ----------
    rows_px : ndarray, shape (n_points,) -- row of every point, from the clamp upwards [px]
    section : CrossSection -- width and blur found in the first frames
    searches : int -- how often the strip was searched
    avoided : sequence of ndarray, shape (n_points,) -- columns of lines that are not it; no search leads there [px]
    is_alone : bool -- where it was found first, there was hardly anything else
    is_disturbed : bool -- something more than noise is beside a line that is avoided, which may hide what it is
    is_second : bool -- something else looked like the strip then, as a whole, but not in its parts
    """

    def __init__(self, parameters: StripParameters, shape: tuple[int, int]) -> None:
        self.parameters = parameters
        self._sign = 1.0 if parameters.is_bright else -1.0
        self._width = shape[1]
        step = parameters.row_step
        last = min(int(np.floor(parameters.last_row)), shape[0] - 1)
        first = max(int(np.ceil(parameters.first_row)), 0)
        self._n = (last - first + 1) // step
        if self._n < _MIN_POINTS:
            raise VisionParameterError(
                f"{self._n} points of {step} rows lie in the image; expected at least {_MIN_POINTS}: correct "
                "camera.origin_v and camera.pixels_per_metre, or give fewer rows a point"
            )
        rows = last - np.arange(self._n * step)
        self._starts = rows * self._width
        self._ones = np.ones(step)
        self.rows_px = self._bands(rows.astype(np.float64)) / step
        along = 1.0 - 2.0 * (rows - rows[-1]) / (rows[0] - rows[-1])
        self._basis = np.asarray(np.polynomial.chebyshev.chebvander(along, _DEGREE))
        self._band_basis = self._basis.reshape(self._n, step, -1).mean(axis=1)
        self._along = along
        self.section = CrossSection(parameters.width_px, along)
        self.searches = 0
        self.avoided: Sequence[FloatArray] = ()
        self.is_alone, self.is_second, self.is_disturbed = True, False, False
        self._tabulate()
        self._heights: FloatArray | None = None
        self._typical = 0.0  # height of a band
        self._noise: StripNoise | None = None
        self._white: float | None = None  # grey level at which pixels are cut off
        self._scatter = PointScatter(self._n, step)
        self._prediction: CurvePrediction | None = None
        self._repeats = RepeatedImages()
        self._sigma_px = np.full(self._n, np.inf)  # of every point in the last frame that showed the strip
        self._is_lost = False
        self._frames = 0

    def _bands(self, of_rows: FloatArray) -> FloatArray:
        """Sums over the rows of every band, shape (..., n_points)."""
        return np.asarray(of_rows.reshape(*of_rows.shape[:-1], self._n, -1) @ self._ones)

    @property
    def is_found(self) -> bool:
        """The last frame showed it."""
        return self._prediction is not None and not self._is_lost

    @property
    def columns_px(self) -> FloatArray:
        """Columns of all points where it was last, shape (n_points,) [px]."""
        assert self._prediction is not None
        return np.asarray(self._band_basis @ self._prediction.last)

    @property
    def apart_px(self) -> float:
        """Two strips that are closer are one [px]."""
        return float(self._table_widths_px.max()) + 2.0 * self.section.blur_px

    @property
    def curve(self) -> FloatArray | None:
        """Coefficients of the curve that was found last."""
        return None if self._prediction is None else self._prediction.last

    def has_left(self, curve: FloatArray) -> bool:
        """True where it is another line than that of this curve, or has come as far."""
        return not self.is_at(self._band_basis @ curve)

    def is_at(self, columns_px: FloatArray) -> bool:
        """True where it is the line in these columns."""
        return bool(np.median(np.abs(self.columns_px - columns_px)) < self.apart_px)

    def goes_on(self, image: ImageArray) -> bool:
        """True where the line is seen above the strip's tip, too, at least half as high as below it.

        Where the image ends within the tip's blur, or the line leaves it there, nothing is known: False.
        """
        table = self._table_of(SMEAR_STEP_PX)
        step, tip = self.parameters.row_step, self.parameters.first_row
        rows = np.arange(
            max(0, math.ceil(tip) - 2 * step), math.floor(tip - _TIP_BLURS * self.section.blur_px)
        )
        if len(rows) == 0 or not self.is_found:
            return False
        # The curve is no guide beyond its end: the upper bands' line is, give or take a few columns.
        along = np.polyfit(self.rows_px[-_BESIDE:], self.columns_px[-_BESIDE:], 1)
        column = np.rint(np.polyval(along, rows)).astype(np.intp)
        reach = table.half + math.ceil(self.apart_px)
        columns = column[:, None] + np.arange(-reach, reach + 1)
        if columns.min() < 0 or columns.max() >= self._width:
            return False
        mean = image[rows[:, None], columns].astype(np.float32).mean(axis=0)
        windows = np.lib.stride_tricks.sliding_window_view(mean, table.size)
        entry = np.full(len(windows), table.entries(np.zeros(1), np.zeros(1), self._width_index[-1:])[1][0])
        heights = self._sign * table.fit(entry, windows - windows.mean()).height
        return float(heights.max()) > 0.5 * self._typical / step

    # -- one frame -----------------------------------------------------------------------------------------

    def process(self, image: ImageArray) -> StripFrame:
        """Find the strip in the next frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16

        Returns
        -------
        StripFrame
        """
        flat = np.ascontiguousarray(image).reshape(-1)
        prediction, speed = self._prediction, None
        is_repeated = self._repeats.is_repeated(image)
        if is_repeated and prediction is not None and self._is_moving(prediction):
            prediction.remember(prediction.next()[0])
            return self._nothing("repeated")
        if prediction is None:
            found = self._acquire(flat)
        else:
            curve, speed = prediction.next()
            found = self._turns(flat, curve, speed)
            if found is None:
                self._white = white_level(flat.reshape(-1, self._width))
            for reach in _SEARCHES_PX:
                if found is not None:
                    break
                self.searches += 1
                found = self._turns(flat, self._searched(flat, prediction.last, reach), speed)
        if found is None:
            if prediction is not None:
                prediction.forget()
            self._is_lost = True
            return self._nothing("no_strip")
        curve, frame = found
        self._sigma_px = frame.sigma_px
        if (
            self._frames in _SECTION_FRAMES
            and float(self._smear(curve, speed).max()) < 0.5 * self.section.blur_px
        ):
            self._learn_section(flat, curve, _SECTION_ROWS)
        if prediction is None:
            self._prediction = CurvePrediction(curve)
        else:
            prediction.remember(curve)
        self._is_lost = False
        return frame

    def _nothing(self, reason: str) -> StripFrame:
        nothing = np.full(self._n, np.nan)
        return StripFrame(nothing, nothing.copy(), np.full(self._n, REASONS.index(reason), dtype=np.intp))

    def _is_moving(self, prediction: CurvePrediction) -> bool:
        """True where some of the strip came farther than noise in its last steps."""
        steps = np.max(np.abs(prediction.steps(LATELY) @ self._band_basis.T), axis=1)
        return is_on_its_way(steps.tolist(), float(np.nanmedian(self._sigma_px)))

    def _smear(
        self, curve: FloatArray, speed: FloatArray | None, farthest: float = float("inf")
    ) -> FloatArray:
        """Way of every row during the exposure [px], as the frames before let expect.

        Where they do not, it follows from the way since the last frame, ``farthest`` at most [px].
        """
        share = self.parameters.exposure_frames
        if self._prediction is None or share == 0.0 or self._is_lost:
            return np.zeros(len(self._starts))
        way = np.abs(self._basis @ (curve - self._prediction.last if speed is None else speed))
        return np.asarray(np.minimum(way, farthest) * share)

    def _table(self, longest_px: float) -> ProfileTable:
        chosen = next((limit for limit in _SMEAR_CLASSES_PX if longest_px <= limit), _SMEAR_CLASSES_PX[-1])
        return self._table_of(chosen)

    def _table_of(self, smear_px: float) -> ProfileTable:
        """Cross-section with the widths and the blur that were found."""
        if smear_px not in self._tables:
            self._tables[smear_px] = ProfileTable(self._table_widths_px, self.section.blur_px, smear_px)
        return self._tables[smear_px]

    def _tabulate(self) -> None:
        """Take the cross-section that was found last."""
        self._tables: dict[float, ProfileTable] = {}
        self._table_widths_px, self._width_index = self.section.tabulated_widths()

    def _pixels(
        self, flat: ImageArray, half: int, column: IndexArray, rows: slice = slice(None)
    ) -> tuple[Float32Array, np.ndarray, np.ndarray | None]:
        """Pixels about every row's column, shape (n_rows, 2 half + 1), and whether they lie in the image.

        Where some are cut off at white, the last tells which ones are not.
        """
        left = column - half
        inside = (left >= 0) & (left < self._width - 2 * half)
        first = self._starts[rows] + np.where(inside, left, 0)
        size = 2 * half + 1
        windows = np.ndarray((flat.size - 2 * half, size), flat.dtype, flat, strides=2 * flat.strides)
        pixels = windows[first]
        seen = None if self._white is None else pixels < self._white
        return pixels.astype(np.float32), inside, None if seen is None or seen.all() else seen

    # -- least squares in every row ------------------------------------------------------------------------

    def _turns(
        self, flat: ImageArray, curve: FloatArray, speed: FloatArray | None
    ) -> tuple[FloatArray, StripFrame] | None:
        """Gauss-Newton from a predicted curve; None where it does not lead to the strip."""
        farthest = float("inf")
        for _ in range(_MAX_TURNS):
            step = self._step(flat, curve, self._smear(curve, speed, farthest))
            if step is None:
                return None
            distance = np.abs(step.moved)
            usable = (step.reasons == 0) & (distance < 3 * _LINEAR_PX)
            if np.count_nonzero(usable) < _MIN_GOOD * self._n / 2:
                return None
            points = step.middle + np.minimum(np.maximum(step.moved, -_LINEAR_PX), _LINEAR_PX)
            before = curve
            curve, off = self._fitted_curve(points, step.sigma, usable)
            if speed is None and self._prediction is not None:
                # Where no point holds the curve it may lead anywhere, but the strip does not.
                moves = np.abs(points - self._band_basis @ self._prediction.last)
                farthest = float(np.max(moves, where=usable, initial=0.0))
            change = float(np.max(np.abs(self._band_basis @ (curve - before))))
            # What the end of the turns would refuse is not near, however wide the cross-section is.
            near = min(_NEAR * step.table.spread_px, _LOST_PX)
            near_points = min(_NEAR_POINTS * step.table.spread_px, _LINEAR_PX)
            if change < near and float(np.max(distance, where=usable, initial=0.0)) < near_points:
                break
        assert step is not None
        reasons = step.reasons
        is_far = off | ~(distance < _LINEAR_PX)
        if np.any(is_far) or np.any(reasons):
            off_curve = REASONS.index("off_curve")
            reasons = np.where((reasons == 0) & is_far, off_curve, reasons)
            # A point alone among lost bands holds the curve there, which holds it: nobody vouches for either.
            beside = np.convolve(reasons == 0, [1, 1, 0, 1, 1], mode="same")
            reasons = np.where((reasons == 0) & (beside < 2), off_curve, reasons)
        is_ok = reasons == 0
        if np.count_nonzero(is_ok) < _MIN_GOOD * self._n or change > _LOST_PX:
            return None
        self._learn(step, curve, is_ok)
        position = np.where(is_ok, step.middle + step.moved, np.nan)
        return curve, StripFrame(
            position, np.where(is_ok, np.hypot(step.sigma, step.pulled), np.nan), reasons
        )

    def _step(self, flat: ImageArray, curve: FloatArray, smear: FloatArray) -> _Step | None:
        """Shift of every band against a curve; None where there is no strip along it."""
        assert self._heights is not None
        assert self._noise is not None
        dark, (base, growth) = self._noise.ground_grey, self._noise.line
        table = self._table(float(smear.max()))
        u = self._basis @ curve
        column, entry, tabulated = table.entries(u, smear, self._width_index)
        pixels, inside, seen = self._pixels(flat, table.half, column)
        pixels -= np.float32(dark)
        fits = table.fit(entry, pixels, seen)
        white = base + growth * np.maximum(fits.grey + dark, 0.0)
        height_variance = fits.height_gain * white
        gain = self._gain(fits.height * inside, height_variance)
        if gain is None:
            return None
        expected = self._heights * gain
        loose = base + growth * np.maximum(fits.mean + dark, 0.0) + (_UNMODELLED * expected) ** 2
        freedom = table.size - 3 if seen is None else np.maximum(seen.sum(axis=1) - 3, 1)
        limit = freedom + _ROW_SIGMAS * (2.0 * freedom) ** 0.5
        is_good = inside & (fits.misfit < limit * loose)
        weight = is_good * expected / (fits.slope_gain * white)
        pulled, pulled_gain = table.pulled(entry, pixels, seen)
        # The table's positions differ from the curve's by up to half a phase: that is taken out of the shifts.
        worth = weight * expected
        columns = (
            worth,
            weight * fits.slope + worth * (tabulated - u),
            inside,
            is_good,
            is_good * fits.height,
            is_good * expected,
            is_good * height_variance,
            weight * pulled,
            weight**2 * pulled_gain * white,
        )
        sums = self._bands(np.concatenate(columns).reshape(len(columns), -1))
        total = np.maximum(sums[0], _NOTHING)
        moved, sigma = sums[1] / total, self._scatter.factor / np.sqrt(total)
        return _Step(
            self._band_basis @ curve,
            moved,
            sigma,
            np.sqrt(np.maximum(sums[7] ** 2 - _HEIGHT_SIGMAS**2 * sums[8], 0.0)) / total,
            self._judged(sums[2:7]),
            gain,
            fits.height,
            is_good,
            table,
            entry,
            pixels,
            seen,
        )

    def _gain(self, heights: FloatArray, variance: FloatArray) -> float | FloatArray | None:
        """Brightness of this frame against the learned one; None where there is none to speak of.

        One for all rows, or one for each where the light has changed along the strip.
        """
        assert self._heights is not None
        seen, learned, spread = self._bands(np.concatenate([heights, self._heights, variance]).reshape(3, -1))
        gains = seen / learned
        ordered = np.sort(gains)
        gain, noise, typical = (
            float(ordered[self._n // 2]),
            math.sqrt(_middle(spread)),
            _middle(np.abs(learned)),
        )
        if not (0.1 < gain < 10.0 and typical * gain > _MIN_SIGNIFICANCE * noise):
            return None
        eighth = int(_EIGHTH * self._n)
        between = (_BETWEEN_SIGMAS + _BETWEEN_CHANCE / math.sqrt(self._n)) * noise / typical
        if ordered[-1 - eighth] - ordered[eighth] < between + 2.0 * _UNMODELLED * gain:
            return gain
        return np.repeat(_gains_along(gains, gain), self.parameters.row_step)

    def _judged(self, sums: FloatArray) -> IndexArray:
        """Judge bands by their rows inside, good ones, and the heights, expected heights and variances."""
        seen, count, height, expected, variance = sums
        enough = _MIN_ROWS * self.parameters.row_step
        tolerance = _HEIGHT_TOLERANCE * np.abs(expected) + _HEIGHT_SIGMAS * np.sqrt(variance)
        reasons = np.where(np.abs(height - expected) < tolerance, 0, REASONS.index("height"))
        reasons[count < enough] = REASONS.index("covered")
        reasons[seen < enough] = REASONS.index("outside")
        return reasons

    def _fitted_curve(
        self, points: FloatArray, sigma: FloatArray, usable: np.ndarray
    ) -> tuple[FloatArray, np.ndarray]:
        """Polynomial through the usable points, and which points lie off it."""
        chosen = usable
        scale = np.hypot(np.where(np.isfinite(sigma), sigma, 1.0), _FLOOR_PX)
        limit = np.maximum(_SIGMAS * scale, _OFF_CURVE_PX)
        known = np.where(usable, points, 0.0)
        for _ in range(3):
            rows = self._band_basis.T * (chosen / scale**2)
            curve = np.linalg.solve(rows @ self._band_basis + _PRIOR, rows @ known)
            off = ~(np.abs(points - self._band_basis @ curve) < limit)
            again = usable & ~off
            if np.array_equal(again, chosen) or np.count_nonzero(again) < _DEGREE + 2:
                break
            chosen = again
        return curve, off

    # -- what is learned -----------------------------------------------------------------------------------

    def _learn(self, step: _Step, curve: FloatArray, is_ok: np.ndarray) -> None:
        """Follow the rows' heights, the noise and the points' scatter slowly."""
        assert self._heights is not None
        assert self._noise is not None
        self._frames += 1
        good = np.repeat(is_ok, self.parameters.row_step) & step.is_good
        rate = max(_HEIGHT_RATE, 1.0 / (self._frames + 5.0))
        self._heights += np.where(good, rate * (step.heights / step.gain - self._heights), 0.0)
        if self._frames > _EARLY and self._frames % _NOISE_FRAMES:
            return
        self._typical = _middle(np.abs(self._bands(self._heights)))
        rows = np.flatnonzero(good)[:: 1 if self._frames <= _EARLY else _NOISE_ROWS]
        entry, pixels = step.entry[rows], step.pixels[rows]
        seen = None if step.seen is None else step.seen[rows]
        residual = step.table.residual(entry, pixels, seen)
        pixels += np.float32(self._noise.ground_grey)
        levels = noise_levels(step.table, entry, pixels, residual, seen)
        if self._white is None and len(rows) > 0:
            self._white = white_level(np.rint(pixels))
        self._noise.learn(levels, max(_NOISE_RATE, 1.0 / self._frames))
        if self._frames <= _EARLY or self._frames % _SCATTER_FRAMES == 0:
            self._learn_scatter(step, curve, is_ok)

    def _learn_scatter(self, step: _Step, curve: FloatArray, is_ok: np.ndarray) -> None:
        """Compare the distances of the points from their curve with what white noise leaves of them."""
        scale = np.where(is_ok, np.hypot(step.sigma, _FLOOR_PX), np.inf)
        fitted = self._band_basis.T / scale**2
        left = np.eye(self._n) - self._band_basis @ np.linalg.solve(
            fitted @ self._band_basis + _PRIOR, fitted
        )
        distance = step.middle + step.moved - self._band_basis @ curve
        self._scatter.learn(distance, left, step.sigma / self._scatter.factor, is_ok)

    def _learn_section(self, flat: ImageArray, curve: FloatArray, rows: slice = slice(None)) -> bool:
        """Measure width and blur in this frame, too; False where that changes nothing."""
        table = self._table_of(0.0)
        u = self._basis[rows] @ curve
        column, entry, _ = table.entries(u, np.zeros(len(u)), self._width_index[rows])
        pixels, inside, seen = self._pixels(flat, table.half, column, rows)
        if np.count_nonzero(inside) < len(u) // 2:
            return False
        pixels = pixels[inside] - np.median(pixels)
        indices = np.arange(len(self._starts))[rows][inside]
        there = None if seen is None else seen[inside]
        is_other = self.section.learn(table, entry[inside], pixels, indices, there)
        if is_other:
            self._tabulate()
        return is_other

    # -- search --------------------------------------------------------------------------------------------

    def _acquire(self, flat: ImageArray) -> tuple[FloatArray, StripFrame] | None:
        """Find the strip where no more than its width is known, and that roughly; learn what it looks like."""
        self._white = white_level(flat.reshape(-1, self._width))
        self.is_disturbed = False
        refused: list[FloatArray] = []
        is_like_another = False
        self.searches += 1
        for _ in range(_MOST_LOOKS):
            led, curve = self._first_curve(flat, refused)
            fit = self._rest_fit(flat, curve)
            if not np.any(fit.is_inside):
                break
            entry, pixels, seen = fit.inside()
            residual = fit.table.residual(entry, pixels, seen)
            levels = noise_levels(fit.table, entry, pixels, residual, seen)
            left = usual_variance(residual if seen is None else residual[seen])
            is_there = self._significance(fit, left) > _MIN_SIGNIFICANCE and np.all(np.isfinite(levels))
            # What rows have in common is no noise.
            below = np.diff(fit.pixels, axis=0)[np.diff(fit.column) == 0]
            noise = usual_variance(below if fit.seen is None else below[below != 0.0]) / 2.0
            if self._significance(fit, noise) > _MIN_SIGNIFICANCE:
                at, reach = self._band_basis @ curve, fit.table.half + self.apart_px / 2.0
                self.is_disturbed |= any(np.median(np.abs(at - line)) < reach for line in self.avoided)
            if not is_there and fit.seen is None:
                break
            share = (left - noise) * fit.height_gain * fit.table.size / max(fit.height**2, _NOTHING)
            if is_there and share < _LEFT:
                self.is_alone, self.is_second = share < _LEFT_ALONE, is_like_another
                is_like_another = True
                self._noise = StripNoise(levels, left)
                heights = _own_heights(fit.fits.height.reshape(self._n, -1), fit.height)
                self._heights = np.repeat(heights, self.parameters.row_step)
                self._typical = _middle(np.abs(self._bands(self._heights)))
                self._frames = 0
                found = self._turns(flat, curve, None)
                if found is not None:
                    return found
            refused += [self._band_basis @ led, self._band_basis @ curve]
        self.section = CrossSection(self.parameters.width_px, self._along)
        return None

    def _first_curve(self, flat: ImageArray, refused: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Best line in the whole image but for those refused, as searched and then settled, with width and blur."""
        rest = np.zeros(_DEGREE + 1)
        rest[0] = self.parameters.rest_column
        for is_certain in (False, True):
            self.section = CrossSection(self.parameters.width_px, self._along, is_certain=is_certain)
            self._tabulate()
            reach = max(self._width - 1 - int(rest[0]), int(rest[0]))
            led = curve = self._searched(flat, rest, reach, refused)
            for turn in range(_MAX_SECTIONS):
                curve = self._settled(flat, curve)
                if turn == 0 and not self._shows_anything(flat, curve):
                    return led, curve
                self.section.forget()
                if not self._learn_section(flat, curve):
                    break
            if self.section.is_plausible:
                break
        for _ in range(3):
            curve = self._settled(flat, curve)
        return led, curve

    def _shows_anything(self, flat: ImageArray, curve: FloatArray) -> bool:
        """False where a better cross-section, of twice the height, would not let it stand out of its noise either."""
        fit = self._rest_fit(flat, curve)
        if fit.seen is not None or not np.any(fit.is_inside):
            return True
        noise = usual_variance(fit.table.residual(*fit.inside()))
        return 2.0 * self._significance(fit, noise) > _MIN_SIGNIFICANCE

    def _significance(self, fit: _RestFit, variance: float) -> float:
        """Height of the strip in a typical band over its standard deviation; negative where it should be dark."""
        return self._sign * fit.significance(variance, self.parameters.row_step)

    def _rest_fit(self, flat: ImageArray, curve: FloatArray) -> _RestFit:
        """Fit every row at rest on a curve."""
        table = self._table_of(SMEAR_STEP_PX)
        column, entry, _ = table.entries(self._basis @ curve, np.zeros(len(self._starts)), self._width_index)
        pixels, inside, seen = self._pixels(flat, table.half, column)
        return _RestFit(table, column, entry, pixels, inside, seen, table.fit(entry, pixels, seen))

    def _settled(self, flat: ImageArray, curve: FloatArray) -> FloatArray:
        """One turn without any knowledge of heights: bands weighted by what they show."""
        fit = self._rest_fit(flat, curve)
        height, slope = self._bands(np.stack([fit.fits.height, fit.fits.slope]) * fit.is_inside)
        seen = self._sign * height
        is_there = (seen > 0.3 * np.median(seen)) & (seen > 0)
        if np.count_nonzero(is_there) < _DEGREE + 2:
            return curve
        moved = np.where(is_there, slope / np.where(height == 0, 1.0, height), 0.0)
        middle = self._band_basis @ curve
        points = middle + np.clip(moved, -_LINEAR_PX, _LINEAR_PX)
        return self._fitted_curve(points, np.full(self._n, 0.1), is_there)[0]

    def _searched(
        self, flat: ImageArray, curve: FloatArray, reach: int, refused: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """Best path of the cross-section within some columns of a curve."""
        table = self._table_of(SMEAR_STEP_PX)
        middle = self._band_basis @ curve
        shape = table.shapes[len(table.shapes) // 2].astype(np.float64)
        shape = (shape - shape.mean()) * self._sign
        # The window of a band stands upright about its middle; what leaves the image repeats its edge.
        left = np.rint(middle).astype(np.intp) - reach - table.half
        columns = left[:, None] + np.arange(2 * reach + table.size)[None, :]
        index = (
            self._starts.reshape(self._n, -1)[:, :, None] + np.clip(columns, 0, self._width - 1)[:, None, :]
        )
        bands = flat.take(index).astype(np.float64).mean(axis=1)
        scores = np.lib.stride_tricks.sliding_window_view(bands, table.size, axis=1) @ shape
        centre = columns[:, table.half : table.half + scores.shape[1]]
        within = (centre >= table.half) & (centre < self._width - table.half)
        apart = self.apart_px
        for line in (*self.avoided, *refused):
            within &= np.abs(centre - line[:, None]) > apart
        path = best_path(np.where(within, scores, -np.inf))
        points = centre[np.arange(self._n), path].astype(np.float64)
        return self._fitted_curve(points, np.full(self._n, 0.5), np.ones(self._n, dtype=bool))[0]


def _middle(values: FloatArray) -> float:
    """Middle value; of an even number the upper one."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _gains_along(gains: FloatArray, usual: float) -> FloatArray:
    """Gain of every band as the bands about it have it, by their median: it follows the edge of a shadow.

    Where one of them shows no light that the strip may stand in, the usual gain is left: a hand ends there.
    """
    size = 2 * _BESIDE + 1
    first = np.clip(np.arange(len(gains)) - _BESIDE, 0, len(gains) - size)
    about = np.sort(gains[first[:, None] + np.arange(size)], axis=1)
    is_light = (about[:, 0] > _HEIGHT_TOLERANCE * usual) & (about[:, -1] < usual / _HEIGHT_TOLERANCE)
    return np.where(is_light, about[:, _BESIDE], usual)


def _own_heights(rows: FloatArray, typical: float) -> FloatArray:
    """Height of every band, by its neighbours' where it shows something else; less than that is texture.

    Parameters
    ----------
    rows : ndarray, shape (n_points, row_step) -- heights of the rows
    typical : float -- of all of them
    """
    bands = np.median(rows, axis=1)
    local = np.array([np.median(bands[max(0, k - 3) : k + 4]) for k in range(len(bands))])
    local = np.where(local * typical > 0.2 * typical**2, local, typical)
    ratio = bands / local
    return np.where((ratio > 0.4) & (ratio < 2.5), bands, local)
