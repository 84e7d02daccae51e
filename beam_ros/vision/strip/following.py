"""The whole strip, followed from frame to frame: its column at every tenth row, with standard deviation or a reason.

A point is a band of rows. In each of its rows the cross-section (``profile``) gives a shift against a common smooth
curve by least squares; the rows' shifts are averaged with the weights that they deserve. The mean is at the
Cramer-Rao bound of white noise:

    sigma_u^2 >= sigma_n^2 / sum (a T')^2        over the pixels of the band

The curve (a polynomial along the strip) only says where to look and how the strip leans within a band; a point is
free to deviate from it by as much as its noise allows. The noise is measured in the same pixels, as a + b I. Rows
that do not look like the strip (a hand, a dot, a thread) are left out; a band that has lost too many of them, whose
height has changed alone, or that lies off the curve is not valid and says why.

Where prediction fails, at the start and after a jump, the strip is searched: the cross-section is correlated with
every column, and the best path from the clamp to the tip is taken (dynamic programming).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, ImageArray, IndexArray
from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.strip.profile import SMEAR_STEP_PX, ProfileTable

_DEGREE = 9
"""Of the curve: four modes of a cantilever to some thousandths of their amplitude."""
_SMEAR_CLASSES_PX = (1.0, 3.0, 6.0, 12.0, 24.0)
_RECURSION = 8
"""Order of the recursion that predicts the curve."""
_REMEMBERED = 63
_REFIT_FRAMES = 4
_MAX_TURNS = 6
_SETTLED_PX = 0.03
_NEAR_PX = 0.12
_LINEAR_PX = 0.6
"""Longest step of a point in one turn: beyond it the cross-section is no longer linear in its shift [px]."""
_MIN_ROWS = 0.6
"""Share of a band's rows that must look like the strip."""
_HEIGHT_TOLERANCE = 0.35
_SIGMAS = 6.0
_OFF_CURVE_PX = 0.25
_ROW_SIGMAS = 5.0
_MIN_GOOD = 0.6
"""Share of bands that must be found; below it the strip is searched."""
_MIN_SIGNIFICANCE = 5.0
"""Height of the strip in a typical band over its standard deviation, below which nothing is there: the search would
find a path through noise."""
_SLOW = 0.05
_VOTING = 40
_VOTES = frozenset(range(2, _VOTING, 5))
"""Frames in which the blur is measured again, and up to which every frame tells of the noise."""
_BLURS_PX = tuple(np.geomspace(0.3, 4.0, 27))
_SEARCHES_PX = (12, 60)
_LEAN = 3
"""Columns that the path may move from band to band while it is searched [px]."""
_QUANTISATION = 1.0 / 12.0

REASONS = ("ok", "no_strip", "covered", "height", "off_curve", "outside")
"""Whether a point is valid, or why it is not: the strip is nowhere; its rows look like something else; its height has
changed alone; it lies off the curve through the others; it is beyond the image's edge."""


@dataclass(frozen=True)
class StripParameters:
    """What the follower expects.

    Attributes
    ----------
    first_row, last_row : float -- rows of the tip and of the clamp, first_row < last_row [px]
    rest_column : float -- column of the strip at rest at home [px]
    width_px : float -- width of the strip as the camera sees it [px]
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
        if self.last_row - self.first_row < 12 * self.row_step:
            raise VisionParameterError(
                f"the strip spans rows {self.first_row:.0f} to {self.last_row:.0f}; expected at least 12 points of "
                f"{self.row_step} rows: correct beam.length and camera.pixels_per_metre, or give fewer rows a point"
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


@lru_cache(maxsize=64)
def _still_profile(width_px: float, blur_px: float) -> ProfileTable:
    """Return the cross-section at rest with one of the blurs that are tried."""
    return ProfileTable(width_px, blur_px, 0.0)


class StripFollower:
    """Follows one strip.

    Parameters
    ----------
    parameters : StripParameters
    shape : (int, int) -- height and width of the images [px]

    Attributes
    ----------
    rows_px : ndarray, shape (n_points,) -- row of every point, from the clamp upwards [px]
    blur_px : float -- blur found in the first frames [px]; NaN before
    searches : int -- how often the strip was searched
    """

    def __init__(self, parameters: StripParameters, shape: tuple[int, int]) -> None:
        self.parameters = parameters
        self._height, self._width = shape
        step = parameters.row_step
        last = min(int(np.floor(parameters.last_row)), self._height - 1)
        first = max(int(np.ceil(parameters.first_row)), 0)
        self._n = (last - first + 1) // step
        if self._n < 12:
            raise VisionParameterError(
                f"{self._n} points of {step} rows lie in the image; expected at least 12: correct "
                f"camera.origin_v and "
                "camera.pixels_per_metre, or give fewer rows a point"
            )
        self._rows = last - np.arange(self._n * step)
        self.rows_px = np.asarray(self._rows.reshape(self._n, step).mean(axis=1), dtype=np.float64)
        basis = np.polynomial.chebyshev.chebvander(
            1.0 - 2.0 * (self._rows - self._rows[-1]) / (self._rows[0] - self._rows[-1]), _DEGREE
        )
        self._basis = np.asarray(basis)
        self._band_basis = basis.reshape(self._n, step, -1).mean(axis=1)
        self._tables: dict[float, ProfileTable] = {}
        self.blur_px = float("nan")
        self.searches = 0
        self._misfits = np.zeros(len(_BLURS_PX))
        self._heights: FloatArray | None = None
        self._frames = 0
        self._noise = np.array([np.nan, np.nan, np.nan, np.nan])
        self._past: list[FloatArray] = []
        self._recursion: FloatArray | None = None
        self._mean = np.zeros(_DEGREE + 1)
        self._way: FloatArray | None = None
        self._is_lost = False

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
        found = None
        if self._heights is None:
            found = self._acquire(flat)
        else:
            found = self._turns(flat, self._predicted())
            for reach in _SEARCHES_PX:
                if found is not None:
                    break
                self.searches += 1
                found = self._turns(flat, self._searched(flat, self._past[-1], reach))
        if found is None:
            self._past = self._past[-1:]
            self._recursion = None
            self._is_lost = True
            return self._nothing()
        curve, frame = found
        self._is_lost = False
        self._past = [*self._past[-_REMEMBERED:], curve]
        if self._frames in _VOTES and float(self._smear(curve).max(initial=0.0)) < 0.5 * self.blur_px:
            self._vote_for_blur(flat, curve)
        return frame

    def _nothing(self) -> StripFrame:
        nan = np.full(self._n, np.nan)
        return StripFrame(nan, nan.copy(), np.full(self._n, REASONS.index("no_strip"), dtype=np.intp))

    def _predicted(self) -> FloatArray:
        """Curve of the next frame: what moved in the last ones goes on, by one linear recursion for all of it.

        A beam in n modes obeys a recursion of order 2 n, and so does whatever is linear in its coordinates.
        """
        past = self._past
        self._way = None
        if len(past) < _RECURSION + 8:
            return np.asarray(past[-1] if len(past) < 2 else 2 * past[-1] - past[-2])
        if self._recursion is None or self._frames % _REFIT_FRAMES == 0:
            record = np.array(past)
            self._mean = record.mean(axis=0)
            record = record - self._mean
            design = np.stack(
                [record[_RECURSION - lag : len(record) - lag].ravel() for lag in range(1, _RECURSION + 1)]
            )
            normal = design @ design.T
            normal += 1e-4 * len(record) * np.eye(_RECURSION)
            self._recursion = np.linalg.solve(normal, design @ record[_RECURSION:].ravel())
        lately = [point - self._mean for point in past[: -_RECURSION - 1 : -1]]
        for _ in range(3):
            lately.insert(0, np.asarray(self._recursion @ np.array(lately[:_RECURSION])))
        after, soon, now, last, before = lately[:5]
        # Central difference of fourth order: a mode at a quarter of the frame rate is at 0.85 of its speed.
        self._way = np.asarray((8.0 * (soon - last) - (after - before)) / 12.0)
        return np.asarray(self._mean + now)

    def _smear(self, curve: FloatArray) -> FloatArray:
        """Way of every row during the exposure [px], as the frames before let expect."""
        share = self.parameters.exposure_frames
        if not self._past or share == 0.0 or self._is_lost:
            return np.zeros(len(self._rows))
        way = curve - self._past[-1] if self._way is None else self._way
        return np.asarray(np.abs(self._basis @ way) * share)

    def _table(self, longest_px: float) -> ProfileTable:
        chosen = next((limit for limit in _SMEAR_CLASSES_PX if longest_px <= limit), _SMEAR_CLASSES_PX[-1])
        if chosen not in self._tables:
            self._tables[chosen] = ProfileTable(self.parameters.width_px, self.blur_px, chosen)
        return self._tables[chosen]

    def _pixels(
        self, flat: ImageArray, table: ProfileTable, column: IndexArray
    ) -> tuple[Float32Array, np.ndarray]:
        """Pixels about every row's column, shape (n_rows, size), and whether they lie in the image."""
        left = column - table.half
        inside = (left >= 0) & (left + table.size <= self._width)
        left = np.where(inside, left, 0)
        index = (self._rows * self._width + left)[:, None] + np.arange(table.size)[None, :]
        return flat.take(index).astype(np.float32), inside

    # -- least squares in every row ------------------------------------------------------------------------

    def _turns(self, flat: ImageArray, curve: FloatArray) -> tuple[FloatArray, StripFrame] | None:
        """Gauss-Newton from a predicted curve; None where it does not lead to the strip."""
        assert self._heights is not None
        step, n = self.parameters.row_step, self._n
        variance = self._variance()
        for turn in range(_MAX_TURNS):
            smear = self._smear(curve)
            table = self._table(float(smear.max(initial=0.0)))
            u = self._basis @ curve
            column, entry, tabulated = table.entries(u, smear)
            pixels, inside = self._pixels(flat, table, column)
            fitted = np.einsum("rkw,rw->rk", table.weights[entry], pixels)
            residual = pixels - np.einsum("rk,rkw->rw", fitted, table.shapes[entry])
            heights = fitted[:, 0].astype(np.float64)
            gains = table.gains[entry]
            grey = np.einsum("rw,rw->r", table.weights[entry, 2] ** 2, pixels) / gains[:, 1]
            white = variance[0] + variance[1] * np.maximum(grey, 0.0)
            gain = self._gain(heights, inside, np.sqrt((gains[:, 0] * white).reshape(n, step).sum(axis=1)))
            if gain is None:
                return None
            expected = self._heights * gain
            chi = np.einsum("rw,rw->r", residual, residual) / (
                np.sum(table.freedom[entry], axis=1) * self._loose(variance, expected, pixels)
            )
            limit = 1.0 + _ROW_SIGMAS * np.sqrt(2.0 / (table.size - 3))
            is_good = inside & (chi < limit)
            worth = np.where(is_good, expected**2 / (gains[:, 1] * white), 0.0)
            shift = np.where(is_good, expected * (fitted[:, 2] + 0.0) / (gains[:, 1] * white), 0.0)
            total = worth.reshape(n, step).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                # The table's positions differ from the curve's by up to half a phase: take that out of the shifts.
                offset = (worth * (tabulated - u)).reshape(n, step).sum(axis=1)
                moved = (shift.reshape(n, step).sum(axis=1) + offset) / total
                sigma = 1.0 / np.sqrt(total)
            reasons = self._judged(heights, expected, gains, white, is_good, inside)
            usable = (reasons == 0) & (np.abs(moved) < 3 * _LINEAR_PX) & np.isfinite(moved)
            if np.count_nonzero(usable) < _MIN_GOOD * n / 2:
                return None
            middle = self._band_basis @ curve
            points = middle + np.clip(moved, -_LINEAR_PX, _LINEAR_PX)
            last = curve
            curve, off = self._fitted_curve(points, sigma, usable, middle)
            change = np.max(np.abs(self._band_basis @ (curve - last)))
            # A second turn changes nothing where the first had hardly anything to move.
            if change < _SETTLED_PX and (turn > 0 or np.max(np.abs(moved[usable])) < _NEAR_PX):
                break
        is_far = ~(np.abs(moved) < _LINEAR_PX)
        reasons = np.where((reasons == 0) & (off | is_far), REASONS.index("off_curve"), reasons)
        # A point alone among bands that are lost holds the curve there, which holds it: nobody vouches for either.
        beside = np.convolve(reasons == 0, [1, 1, 0, 1, 1], mode="same")
        reasons = np.where((reasons == 0) & (beside < 2), REASONS.index("off_curve"), reasons)
        is_ok = reasons == 0
        if np.count_nonzero(is_ok) < _MIN_GOOD * n or change > 0.5:
            return None
        assert gain is not None
        self._learn(table, entry, heights, gain, pixels, residual, np.repeat(is_ok, step) & is_good)
        position = np.where(is_ok, middle + moved, np.nan)
        return curve, StripFrame(position, np.where(is_ok, sigma, np.nan), reasons)

    def _gain(self, heights: FloatArray, inside: np.ndarray, sd: FloatArray) -> float | None:
        """Brightness of this frame against the learned one; None where there is none to speak of."""
        assert self._heights is not None
        step = self.parameters.row_step
        learned = self._heights.reshape(self._n, step).sum(axis=1)
        seen = (heights * inside).reshape(self._n, step).sum(axis=1)
        gain = float(np.median(seen / learned))
        typical = float(np.median(np.abs(learned))) * gain
        return gain if 0.1 < gain < 10.0 and typical > _MIN_SIGNIFICANCE * float(np.median(sd)) else None

    def _judged(
        self,
        heights: FloatArray,
        expected: FloatArray,
        gains: FloatArray,
        white: FloatArray,
        is_good: np.ndarray,
        inside: np.ndarray,
    ) -> IndexArray:
        """Judge every band by its rows and its height."""
        step, n = self.parameters.row_step, self._n
        count = is_good.reshape(n, step).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(is_good, heights, 0.0).reshape(n, step).sum(axis=1) / count
            wanted = np.where(is_good, expected, 0.0).reshape(n, step).sum(axis=1) / count
            sd = np.sqrt(np.where(is_good, gains[:, 0] * white, 0.0).reshape(n, step).sum(axis=1)) / count
        reasons = np.zeros(n, dtype=np.intp)
        reasons[~(np.abs(mean - wanted) < _HEIGHT_TOLERANCE * np.abs(wanted) + 4.0 * sd)] = REASONS.index(
            "height"
        )
        reasons[count < _MIN_ROWS * step] = REASONS.index("covered")
        reasons[inside.reshape(n, step).sum(axis=1) < _MIN_ROWS * step] = REASONS.index("outside")
        return reasons

    def _fitted_curve(
        self, points: FloatArray, sigma: FloatArray, usable: np.ndarray, middle: FloatArray
    ) -> tuple[FloatArray, np.ndarray]:
        """Polynomial through the usable points, and which points lie off it."""
        chosen = usable.copy()
        off = np.zeros(len(points), dtype=bool)
        # A floor keeps one sharp point from bending the curve; a faint prior holds what no point says.
        scale = np.hypot(np.where(np.isfinite(sigma), sigma, 1.0), 0.02)
        for _ in range(3):
            weight = np.where(chosen, 1.0 / scale, 0.0)
            rows = self._band_basis * weight[:, None]
            prior = 1e-3 * np.arange(_DEGREE + 1)
            normal = rows.T @ rows + np.diag(prior**2)
            curve = np.linalg.solve(normal, rows.T @ (np.where(chosen, points, 0.0) * weight))
            deviation = np.abs(points - self._band_basis @ curve)
            off = ~(deviation < np.maximum(_SIGMAS * scale, _OFF_CURVE_PX))
            again = usable & ~off
            if np.array_equal(again, chosen) or np.count_nonzero(again) < _DEGREE + 2:
                break
            chosen = again
        return curve, off

    # -- what is learned -----------------------------------------------------------------------------------

    def _variance(self) -> FloatArray:
        """Noise of a pixel as a + b I: (a, b), from the ground's and the strip's residuals."""
        ground, strip, dark, light = self._noise
        slope = 0.0
        if abs(light - dark) > 5.0:
            slope = max(0.0, (strip - ground) / (light - dark))
        base = ground - slope * dark
        if base < _QUANTISATION:
            base, slope = max(base, _QUANTISATION), max(0.0, min(slope, ground / max(dark, 1.0)))
        return np.array([base, slope])

    def _loose(self, variance: FloatArray, expected: FloatArray, pixels: Float32Array) -> FloatArray:
        """Variance that a row's residuals may have: the noise, and 3 % of the height for what no model holds."""
        mean = np.mean(pixels, axis=1, dtype=np.float64)
        return np.asarray(variance[0] + variance[1] * np.maximum(mean, 0.0) + (0.03 * expected) ** 2)

    def _learn(
        self,
        table: ProfileTable,
        entry: IndexArray,
        heights: FloatArray,
        gain: float,
        pixels: Float32Array,
        residual: Float32Array,
        good: np.ndarray,
    ) -> None:
        """Follow the rows' heights and the noise slowly."""
        assert self._heights is not None
        self._frames += 1
        rate = max(_SLOW, 1.0 / (self._frames + 5.0))
        self._heights = np.where(good, self._heights + rate * (heights / gain - self._heights), self._heights)
        if self._frames > _VOTING and self._frames % _REFIT_FRAMES:
            return
        levels = self._noise_of(table, entry, pixels, residual, good)
        if np.all(np.isfinite(levels)):
            fresh = np.isnan(self._noise)
            rate = max(_SLOW, 1.0 / self._frames)
            self._noise = np.where(fresh, levels, self._noise + rate * (levels - self._noise))

    @staticmethod
    def _noise_of(
        table: ProfileTable,
        entry: IndexArray,
        pixels: Float32Array,
        residual: Float32Array,
        good: np.ndarray,
    ) -> FloatArray:
        """Variance on the ground and on the strip, and the grey levels there."""
        if not np.any(good):
            return np.full(4, np.nan)
        chosen = entry[good]
        shape = table.shapes[chosen, 0]
        share = shape / shape.max(axis=1, keepdims=True)
        freedom, square, grey = table.freedom[chosen], residual[good] ** 2, pixels[good]
        ground, strip = share < 0.02, share > 0.3
        return np.array(
            [
                square[ground].sum() / freedom[ground].sum(),
                square[strip].sum() / freedom[strip].sum(),
                grey[ground].mean(),
                grey[strip].mean(),
            ]
        )

    # -- search --------------------------------------------------------------------------------------------

    def _acquire(self, flat: ImageArray) -> tuple[FloatArray, StripFrame] | None:
        """Find the strip where nothing is known of it but its width; learn blur, heights and noise."""
        rest = np.zeros(_DEGREE + 1)
        rest[0] = self.parameters.rest_column
        self.searches += 1
        start = rest
        self.blur_px = 1.0
        self._tables.clear()
        reach = max(self._width - 1 - int(rest[0]), int(rest[0]))
        curve = self._searched(flat, start, reach)
        for _ in range(3):
            curve = self._settled(flat, curve)
        self._misfits = np.zeros(len(_BLURS_PX))
        self._vote_for_blur(flat, curve)
        for _ in range(3):
            curve = self._settled(flat, curve)
        table, entry, pixels, inside, fitted, residual = self._row_fit(flat, curve)
        heights = fitted[:, 0].astype(np.float64)
        levels = self._noise_of(table, entry, pixels, residual, inside)
        step = self.parameters.row_step
        # Rows with dots or hands before them: the median of the bands knows better.
        typical = float(np.median(heights[inside])) if np.any(inside) else 0.0
        spread = np.sqrt(np.median(residual[inside] ** 2) / 0.455 * np.median(table.gains[entry, 0]))
        significance = typical * np.sqrt(step) / max(float(spread), 1e-6)
        if not np.all(np.isfinite(levels)) or (1 if self.parameters.is_bright else -1) * significance < (
            _MIN_SIGNIFICANCE
        ):
            return None
        quiet = float(np.median(residual[inside] ** 2) / 0.455)
        self._noise = np.array([min(levels[0], 2 * quiet), min(levels[1], 2 * quiet), levels[2], levels[3]])
        bands = np.median(heights.reshape(self._n, step), axis=1)
        local = np.array([np.median(bands[max(0, k - 3) : k + 4]) for k in range(self._n)])
        local = np.where(local * typical > 0.2 * typical**2, local, typical)
        # A band whose height is far from its neighbours' shows something else; less than that is texture.
        ratio = bands / local
        own = np.where((ratio > 0.4) & (ratio < 2.5), bands, local)
        self._heights = np.repeat(own, step)
        self._frames = 0
        self._past = []
        found = self._turns(flat, curve)
        if found is None:
            self._heights = None
        return found

    def _row_fit(
        self, flat: ImageArray, curve: FloatArray
    ) -> tuple[ProfileTable, IndexArray, Float32Array, np.ndarray, Float32Array, Float32Array]:
        table = self._table(SMEAR_STEP_PX)
        column, entry, _ = table.entries(self._basis @ curve, np.zeros(len(self._rows)))
        pixels, inside = self._pixels(flat, table, column)
        fitted = np.einsum("rkw,rw->rk", table.weights[entry], pixels)
        residual = pixels - np.einsum("rk,rkw->rw", fitted, table.shapes[entry])
        return table, entry, pixels, inside, fitted, residual

    def _settled(self, flat: ImageArray, curve: FloatArray) -> FloatArray:
        """One turn without any knowledge of heights: bands weighted by what they show."""
        _, _, _, inside, fitted, _ = self._row_fit(flat, curve)
        step, n = self.parameters.row_step, self._n
        mean = np.where(inside, fitted[:, 0], 0.0).reshape(n, step).mean(axis=1)
        slope = np.where(inside, fitted[:, 2], 0.0).reshape(n, step).mean(axis=1)
        sign = 1.0 if self.parameters.is_bright else -1.0
        is_there = sign * mean > 0.3 * np.median(sign * mean)
        is_there &= sign * mean > 0
        if np.count_nonzero(is_there) < _DEGREE + 2:
            return curve
        moved = np.where(is_there, slope / np.where(mean == 0, 1.0, mean), 0.0)
        middle = self._band_basis @ curve
        points = middle + np.clip(moved, -_LINEAR_PX, _LINEAR_PX)
        return self._fitted_curve(points, np.full(n, 0.1), is_there, middle)[0]

    def _vote_for_blur(self, flat: ImageArray, curve: FloatArray) -> None:
        """Add this frame's misfits with every blur; the least of all frames so far decides."""
        half = max(self._candidate(len(_BLURS_PX) - 1).half, 12)
        u = self._basis @ curve
        column = np.floor(u + 0.5).astype(np.intp)
        inside = (column >= half) & (column < self._width - half)
        if np.count_nonzero(inside) < len(u) // 2:
            return
        rows, u, column = self._rows[inside], u[inside], column[inside]
        index = (rows * self._width + column - half)[:, None] + np.arange(2 * half + 1)[None, :]
        pixels = flat.take(index).astype(np.float64)
        pixels -= np.median(pixels, axis=1, keepdims=True)
        still = np.zeros(len(u))
        for k in range(len(_BLURS_PX)):
            table = self._candidate(k)
            _, entry, _ = table.entries(u, still)
            seen = pixels[:, half - table.half : half + table.half + 1]
            fitted = np.einsum("rkw,rw->rk", table.weights[entry], seen)
            model = np.einsum("rk,rkw->rw", fitted, table.shapes[entry])
            # Beyond the table's pixels there is the ground alone, the same for every candidate.
            rest = np.sum((pixels - fitted[:, 1:2]) ** 2, axis=1) - np.sum(
                (seen - fitted[:, 1:2]) ** 2, axis=1
            )
            squares = np.sum((seen - model) ** 2, axis=1) + rest
            self._misfits[k] += np.sum(np.minimum(squares, 4.0 * np.median(squares)))
        k = int(np.clip(np.argmin(self._misfits), 1, len(_BLURS_PX) - 2))
        left, mid, right = self._misfits[k - 1 : k + 2]
        bend = left - 2 * mid + right
        shift = float(np.clip(0.5 * (left - right) / bend, -1, 1)) if bend > 0 else 0.0
        self.blur_px = float(_BLURS_PX[k] * (_BLURS_PX[1] / _BLURS_PX[0]) ** shift)
        self._tables.clear()

    def _candidate(self, k: int) -> ProfileTable:
        return _still_profile(self.parameters.width_px, _BLURS_PX[k])

    def _searched(self, flat: ImageArray, curve: FloatArray, reach: int) -> FloatArray:
        """Best path of the cross-section within some columns of a curve."""
        step, n = self.parameters.row_step, self._n
        table = self._table(SMEAR_STEP_PX)
        middle = self._band_basis @ curve
        shape = table.shapes[(len(table.shapes) // 2) % len(table.shapes), 0].astype(np.float64)
        shape = shape - shape.mean()
        if not self.parameters.is_bright:
            shape = -shape
        # The window of a band stands upright about its middle; what leaves the image repeats its edge.
        left = np.rint(middle).astype(np.intp) - reach - table.half
        columns = left[:, None] + np.arange(2 * reach + table.size)[None, :]
        rows = self._rows.reshape(n, step)
        index = rows[:, :, None] * self._width + np.clip(columns, 0, self._width - 1)[:, None, :]
        bands = flat.take(index).astype(np.float64).mean(axis=1)
        windows = np.lib.stride_tricks.sliding_window_view(bands, table.size, axis=1)
        score = windows @ shape
        centre = columns[:, table.half : table.half + score.shape[1]]
        score = np.where((centre >= table.half) & (centre < self._width - table.half), score, -np.inf)
        # Bright spots and edges must not outweigh the strip: no band counts for more than thrice the median of the
        # bests.
        best = np.max(score, axis=1)
        cap = 3.0 * float(np.median(best[np.isfinite(best)])) if np.any(np.isfinite(best)) else 1.0
        score = np.minimum(np.maximum(score, -abs(cap)), abs(cap))
        # Bands lean against the curve by a few columns at most, and the less the better.
        leans = np.arange(-_LEAN, _LEAN + 1)
        toll = (0.02 * abs(cap) * np.abs(leans))[:, None]
        came = np.zeros((n, score.shape[1]), dtype=np.intp)
        every = np.arange(score.shape[1])
        total = score[0]
        for k in range(1, n):
            padded = np.pad(total, _LEAN, constant_values=-np.inf)
            views = np.lib.stride_tricks.sliding_window_view(padded, len(total)) - toll
            choice = np.argmax(views, axis=0)
            came[k] = every + leans[choice]
            total = score[k] + views[choice, every]
        path = np.empty(n, dtype=np.intp)
        path[-1] = int(np.argmax(total))
        for k in range(n - 1, 0, -1):
            path[k - 1] = min(max(int(came[k, path[k]]), 0), score.shape[1] - 1)
        points = centre[np.arange(n), path].astype(np.float64)
        return self._fitted_curve(points, np.full(n, 0.5), np.ones(n, dtype=bool), middle)[0]
