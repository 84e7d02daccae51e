"""What a camera sees of the strip in one row: a bar, smeared by its motion, blurred by the lens, summed by pixels.

    grey(j) = b + a T(j - u),      T = bar(width) * box(smear) * Gauss(blur) * pixel

with T = 1 inside a wide bar. Everything in T is symmetric about u, so that neither a wrong width nor a wrong blur
moves the position. In a row, a, b and the shift du against a nearby u0 follow from one linear least squares

    grey(j) = b + a T(j - u0) + s T'(j - u0),      s = a du

whose orthonormal basis is tabulated for each phase of u0 within a pixel and each smear: three sums over the pixels
give the fit, and what they leave of the sum of squares is the misfit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from beam_ros.arrays import Float32Array, FloatArray, IndexArray

_PHASE_BITS = 5
PHASES = 1 << _PHASE_BITS
"""Tabulated positions of the strip per pixel; the rest, at most 1/64 px, is what ``du`` is for."""
SMEAR_STEP_PX = 0.25
"""Smears are tabulated in these steps [px]."""
_HALF_STEP = round(SMEAR_STEP_PX / 2 * PHASES)
_MARGIN_SIGMAS = 4.0
_BACKGROUND_PX = 1.5
"""Columns on either side that show nothing but the ground [px]."""
_SHARPEST_PX = 0.05
_ROOT = math.sqrt(2.0 * math.pi)
_HARDLY = 1e-5
"""A part of the basis of which no more than this share is seen is not told; single precision rounds to 1e-7."""


def profile(x: FloatArray, width_px: float, blur_px: float, smear_px: float) -> tuple[FloatArray, FloatArray]:
    """Grey level of the pixels of a row, as a share of that of a wide bar, and how it follows the bar.

    Parameters
    ----------
    x : ndarray -- pixel centres, from the middle of the strip [px]
    width_px, blur_px : float -- width of the bar, standard deviation of the lens's Gaussian [px]
    smear_px : float -- way of the strip during the exposure, at constant speed [px]

    Returns
    -------
    shape, slope : ndarray, same shape -- T, and T' = -dT/dx, its change with a shift to the right [1/px]

    Notes
    -----
    Three boxes (bar, pixel, smear) convolved with a Gaussian: the third integral of the Gaussian, differenced once
    for each box over its width and divided by the widths of pixel and smear. One integral less gives the slope.
    """
    if smear_px == 0:
        first, second, _ = _integrals(x, width_px, blur_px)
        return second, -first
    (_, slope_right, right), (_, slope_left, left) = (
        _integrals(x + sign * smear_px / 2, width_px, blur_px) for sign in (1, -1)
    )
    return (right - left) / smear_px, (slope_left - slope_right) / smear_px


def _integrals(
    x: FloatArray, width_px: float | FloatArray, blur_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrals of the Gaussian, once to three times from minus infinity, differenced over bar and pixel."""
    sigma = max(blur_px, _SHARPEST_PX)
    sums = np.zeros((3, *np.broadcast_shapes(x.shape, np.shape(width_px))))
    for bar in (1.0, -1.0):
        for pixel in (1.0, -1.0):
            end = (x + 0.5 * (bar * width_px + pixel)) / sigma
            once, density = ndtr(end), np.exp(-0.5 * end * end) / _ROOT
            twice = end * once + density
            sums += bar * pixel * np.stack([once, sigma * twice, sigma**2 / 2 * (end * twice + once)])
    return sums[0], sums[1], sums[2]


class RowFits(NamedTuple):
    """The strip in each of n rows.

    Attributes
    ----------
    height, slope : ndarray, shape (n,) -- a and s
    mean : ndarray, shape (n,) -- mean grey level of the pixels
    misfit : ndarray, shape (n,) -- sum of the squared residuals
    height_gain, slope_gain : ndarray, shape (n,) -- variances of a and s for white noise of variance 1
    grey : ndarray, shape (n,) -- grey level of the pixels that tell the shift, as the fit has it
    """

    height: FloatArray
    slope: FloatArray
    mean: FloatArray
    misfit: FloatArray
    height_gain: FloatArray
    slope_gain: FloatArray
    grey: FloatArray


class ProfileTable:
    """Turns the pixels of a row into ground, height and shift of the strip.

    Parameters
    ----------
    width_px : float or ndarray, shape (n_widths,) -- width of the strip, or all that it has [px]
    blur_px : float -- standard deviation of the lens's Gaussian [px]
    max_smear_px : float -- longest smear tabulated [px]
    half : int or None -- pixels on either side that are looked at; None: as many as it takes

    Attributes
    ----------
    half : int -- pixels on either side of the one that holds the strip's middle
    size : int -- pixels of a row that are looked at
    spread_px : float -- over which the cross-section bends: the standard deviation of a narrow strip, and of a wide
        one 1.7 times that of either edge [px]
    basis : ndarray, shape (n_entries, 3, size) -- orthonormal: 1, then T, then T', each without what those before it
        explain
    shapes : ndarray, shape (n_entries, size) -- T
    freedom : ndarray, shape (n_entries, size) -- share of a pixel's variance that is left in its residual
    """

    def __init__(
        self, width_px: float | FloatArray, blur_px: float, max_smear_px: float, half: int | None = None
    ) -> None:
        self._widths_px, self._blur_px = np.atleast_1d(np.asarray(width_px, dtype=np.float64)), blur_px
        spread = math.hypot(blur_px, math.sqrt(1.0 / 12.0))
        reach = (float(self._widths_px.max()) + max_smear_px) / 2 + _MARGIN_SIGMAS * spread + _BACKGROUND_PX
        self.half = math.ceil(reach) if half is None else half
        self.size = 2 * self.half + 1
        self._bins = round(max_smear_px / SMEAR_STEP_PX) + 1
        shape, slope, self.spread_px = self._tabulated(self._widths_px, blur_px)
        # Gram and Schmidt, with the ground first: the shift's share is then what only a shift explains.
        ground = np.full_like(shape, 1.0 / math.sqrt(self.size))
        raised = shape - shape.mean(axis=1, keepdims=True)
        height = np.linalg.norm(raised, axis=1)
        raised /= height[:, None]
        steep = slope - slope.mean(axis=1, keepdims=True)
        shared = np.sum(raised * steep, axis=1)
        steep -= shared[:, None] * raised
        shift = np.linalg.norm(steep, axis=1)
        steep /= shift[:, None]
        basis = np.stack([ground, raised, steep], axis=1)
        self.basis = basis.astype(np.float32)
        self.shapes = shape.astype(np.float32)
        self.freedom = np.clip(1.0 - np.sum(basis**2, axis=1), 0.0, 1.0).astype(np.float32)
        # Two grounds, one higher than the other: what of them a shift does not explain tells how much it does.
        aside = np.arange(-self.half, self.half + 1) + self._phases()
        sides = np.tile(np.sign(aside), (len(shape) // PHASES, 1)) * (1.0 - shape)
        alone = sides - np.einsum("ek,ekw->ew", np.einsum("ekw,ew->ek", basis, sides), basis)
        seen = np.sum(alone**2, axis=1)
        pulls = np.sum(sides * steep, axis=1) / shift
        self._sides = (alone * (pulls / seen)[:, None]).astype(np.float32)
        self._sides_gain = pulls**2 / seen
        level = np.sum(steep**2 * shape, axis=1) - shape.mean(axis=1)
        of_raised, of_steep, per_shift = 1.0 / height, -shared / (height * shift), 1.0 / shift
        self._terms = np.stack(
            [of_raised, of_steep, per_shift, level, of_raised**2 + of_steep**2, per_shift**2]
        )

    def _tabulated(self, widths_px: FloatArray, blur_px: float) -> tuple[FloatArray, FloatArray, float]:
        """T and T' of all entries, whose smears end on the phases' own grid, and the spread.

        Notes
        -----
        Least squares takes a shift d of a T known in height for d <T(x - d), T'> / <T', T'>, which is short by
        d^3 |T''|^2 / (6 |T'|^2). A Gaussian of standard deviation s has |T''|^2 / |T'|^2 = 3 / (2 s^2), the edge of a
        wide bar 1 / (2 s^2): with spread^2 = 3 |T'|^2 / (2 |T''|^2) what is short is d^3 / (4 spread^2).
        """
        reach = (self._bins - 1) * _HALF_STEP
        fine = (np.arange(self.size * PHASES + 2 * reach) - reach + 0.5) / PHASES - self.half - 0.5
        first, second, third = _integrals(fine, widths_px[:, None], blur_px)
        at = reach + np.arange(self.size)[None, :] * PHASES + np.arange(PHASES)[::-1, None]
        shape, slope = [second[:, at]], [-first[:, at]]
        for k in range(1, self._bins):
            right, left, smear = at + k * _HALF_STEP, at - k * _HALF_STEP, k * SMEAR_STEP_PX
            shape.append((third[:, right] - third[:, left]) / smear)
            slope.append((second[:, left] - second[:, right]) / smear)
        bend = np.diff(first, axis=-1) * PHASES
        spread = math.sqrt(1.5 * float(np.sum(first**2) / np.sum(bend**2)))
        entries = (len(widths_px) * self._bins * PHASES, self.size)
        return np.stack(shape, axis=1).reshape(entries), np.stack(slope, axis=1).reshape(entries), spread

    @staticmethod
    def _phases() -> FloatArray:
        """Tabulated places of a pixel's middle against the strip's, shape (PHASES, 1) [px]."""
        return np.asarray((np.arange(PHASES)[::-1, None] + 0.5) / PHASES - 0.5)

    def pulled(
        self, entry: IndexArray, pixels: Float32Array, seen: np.ndarray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Tell how far two grounds of a row, one at either side, pull its shift.

        Parameters are those of ``fit``.

        Returns
        -------
        slope : ndarray, shape (n,) -- the part of s that they make
        gain : ndarray, shape (n,) -- its variance for white noise of variance 1
        """
        if seen is not None:
            pixels = self.residual(entry, pixels, seen)
        slope = np.einsum("rw,rw->r", self._sides.take(entry, axis=0), pixels)
        return slope.astype(np.float64), self._sides_gain.take(entry)

    def changes(self) -> Float32Array:
        """How T of a strip at rest changes with its blur's logarithm and its width [1/px], beyond the basis.

        Returns
        -------
        ndarray, shape (n_entries, 2, size)
        """
        x, widths = np.arange(-self.half, self.half + 1) + self._phases(), self._widths_px[:, None, None]
        sigma = max(self._blur_px, _SHARPEST_PX)
        of_blur = of_width = np.zeros(())
        for bar in (1.0, -1.0):
            for pixel in (1.0, -1.0):
                end = (x + 0.5 * (bar * widths + pixel)) / sigma
                # The second integral of a Gaussian changes with its deviation as the Gaussian itself.
                of_blur = of_blur + bar * pixel * sigma / _ROOT * np.exp(-0.5 * end * end)
                of_width = of_width + 0.5 * pixel * ndtr(end)
        changes = np.stack([of_blur, of_width], axis=2).reshape(-1, 2, self.size)
        basis = self.basis.astype(np.float64)
        changes -= (changes @ basis.transpose(0, 2, 1)) @ basis
        return np.asarray(changes.astype(np.float32))

    def entries(
        self, u: FloatArray, smear_px: FloatArray, width: IndexArray | int = 0
    ) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Look up where each row's strip is in the table.

        Parameters
        ----------
        u, smear_px : ndarray, shape (n_rows,) -- middle of the strip, its way during the exposure [px]
        width : ndarray of int, shape (n_rows,) -- index of its width among those of the table

        Returns
        -------
        column : ndarray of int, shape (n_rows,) -- pixel nearest to the middle
        entry : ndarray of int, shape (n_rows,) -- row of the tables
        tabulated : ndarray, shape (n_rows,) -- the position that the entry stands for [px]
        """
        position = np.floor((u + 0.5) * PHASES).astype(np.intp)
        column = position >> _PHASE_BITS
        smears = np.minimum((smear_px / SMEAR_STEP_PX + 0.5).astype(np.intp), self._bins - 1)
        entry = position + (width * self._bins + smears - column) * PHASES
        return column, entry, (position + 0.5) / PHASES - 0.5

    def fit(self, entry: IndexArray, pixels: Float32Array, seen: np.ndarray | None = None) -> RowFits:
        """Fit ground, height and shift in each of n rows.

        Parameters
        ----------
        entry : ndarray of int, shape (n,) -- of ``entries``
        pixels : ndarray, shape (n, size) -- about ``column``; near zero, for the sake of their squares [grey levels]
        seen : ndarray of bool, shape (n, size), optional -- pixels that are not cut off at white; None: all
        """
        of_raised, of_steep, per_shift, level, height_gain, slope_gain = self._terms.take(entry, axis=1)
        if seen is None:
            parts = np.einsum("rkw,rw->kr", self.basis.take(entry, axis=0), pixels).astype(np.float64)
            explained = np.einsum("kr,kr->r", parts, parts)
            squares = np.einsum("rw,rw->r", pixels, pixels)
        else:
            basis, inverse = self.seen_basis(entry, seen)
            along = np.einsum("rkw,rw->kr", basis, pixels).astype(np.float64)
            parts = np.einsum("rkl,lr->kr", inverse, along)
            explained = np.einsum("kr,kr->r", along, parts)
            squares = np.einsum("rw,rw,rw->r", pixels, pixels, seen)
            height_terms = np.stack([of_raised, of_steep])
            height_gain = np.einsum("kr,rkl,lr->r", height_terms, inverse[:, 1:, 1:], height_terms)
            slope_gain = slope_gain * inverse[:, 2, 2]
        height, slope = of_raised * parts[1] + of_steep * parts[2], per_shift * parts[2]
        mean = parts[0] / math.sqrt(self.size)
        return RowFits(
            height, slope, mean, squares - explained, height_gain, slope_gain, mean + height * level
        )

    def residual(
        self, entry: IndexArray, pixels: Float32Array, seen: np.ndarray | None = None
    ) -> Float32Array:
        """Return what the fit leaves of the pixels, shape (n, size); nothing of those not seen."""
        if seen is None:
            basis = self.basis.take(entry, axis=0)
            parts = np.einsum("rkw,rw->rk", basis, pixels)
            return np.asarray(pixels - np.einsum("rk,rkw->rw", parts, basis))
        basis, inverse = self.seen_basis(entry, seen)
        parts = np.einsum("rkl,rlw,rw->rk", inverse, basis, pixels, optimize=True)
        return np.asarray(pixels * seen - np.einsum("rk,rkw->rw", parts, basis), dtype=np.float32)

    def freedom_of(self, entry: IndexArray, seen: np.ndarray | None = None) -> FloatArray:
        """Return the share of each pixel's variance that is left in its residual, shape (n, size)."""
        if seen is None:
            return np.asarray(self.freedom.take(entry, axis=0), dtype=np.float64)
        basis, inverse = self.seen_basis(entry, seen)
        used = np.einsum("rkw,rkl,rlw->rw", basis, inverse, basis, optimize=True)
        return np.asarray(np.clip(seen - used, 0.0, 1.0))

    def seen_basis(self, entry: IndexArray, seen: np.ndarray) -> tuple[Float32Array, FloatArray]:
        """Return the basis with 0 in pixels that are not seen, and the covariances of its parts.

        Returns
        -------
        basis : ndarray, shape (n, 3, size)
        inverse : ndarray, shape (n, 3, 3) -- large where what is seen tells nothing
        """
        basis = self.basis.take(entry, axis=0) * seen[:, None, :]
        among = (basis @ basis.transpose(0, 2, 1)).astype(np.float64)
        return basis, np.linalg.inv(among + _HARDLY * np.eye(3))
