"""What a camera sees of the strip in one row: a bar, smeared by its motion, blurred by the lens, summed by pixels.

    grey(j) = b + a T(j - u),      T = bar(width) * box(smear) * Gauss(blur) * pixel

with T = 1 inside a wide bar. Everything in T is symmetric about u, so that neither a wrong width nor a wrong blur
moves the position. In a row, a, b and the shift du against a nearby u0 follow from one linear least squares

    grey(j) = b + a T(j - u0) + s T'(j - u0),      s = a du

whose solution is tabulated: for each phase of u0 within a pixel and each smear, three rows of weights.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from beam_ros.arrays import FloatArray, IndexArray

PHASES = 32
"""Tabulated positions of the strip per pixel; the rest, at most 1/64 px, is what ``du`` is for."""
SMEAR_STEP_PX = 0.25
"""Smears are tabulated in these steps [px]."""
_MARGIN_SIGMAS = 4.0
_BACKGROUND_PX = 1.5
"""Columns on either side that show nothing but the ground [px]."""
_SHARPEST_PX = 0.05


def _third_integral(x: FloatArray) -> FloatArray:
    """Return the normal density, integrated three times from minus infinity."""
    density = np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
    return np.asarray(0.5 * ((x * x + 1.0) * ndtr(x) + x * density))


def profile(x: FloatArray, width_px: float, blur_px: float, smear_px: float) -> FloatArray:
    """Grey level of the pixels of a row, as a share of that of a wide bar.

    Parameters
    ----------
    x : ndarray -- pixel centres, from the middle of the strip [px]
    width_px, blur_px : float -- width of the bar, standard deviation of the lens's Gaussian [px]
    smear_px : float -- way of the strip during the exposure, at constant speed [px]

    Returns
    -------
    ndarray, same shape -- T

    Notes
    -----
    Three boxes (bar, pixel, smear) convolved with a Gaussian: the third integral of the Gaussian, differenced once
    for each box over its width and divided by the widths of pixel and smear.
    """
    sigma = max(blur_px, _SHARPEST_PX)
    smear = max(smear_px, 1e-2)
    total = np.zeros_like(x)
    for bar in (1.0, -1.0):
        for pixel in (1.0, -1.0):
            for box in (1.0, -1.0):
                end = x + 0.5 * (bar * width_px + pixel + box * smear)
                total += bar * pixel * box * _third_integral(end / sigma)
    return np.asarray(total * sigma**2 / smear)


class ProfileTable:
    """Weights that turn the pixels of a row into ground, height and shift of the strip.

    Parameters
    ----------
    width_px, blur_px : float -- width of the strip, standard deviation of the lens's Gaussian [px]
    max_smear_px : float -- longest smear tabulated [px]

    Attributes
    ----------
    half : int -- pixels on either side of the one that holds the strip's middle
    size : int -- pixels of a row that are looked at
    max_smear_px : float -- longest smear tabulated [px]
    shapes : ndarray, shape (n_entries, 3, size) -- T, 1 and T' (positive where a shift to the right brightens)
    weights : ndarray, shape (n_entries, 3, size) -- from grey levels to a, b and s
    gains : ndarray, shape (n_entries, 2) -- variances of a and s for white noise of variance 1
    freedom : ndarray, shape (n_entries, size) -- share of a pixel's variance that is left in its residual
    """

    def __init__(self, width_px: float, blur_px: float, max_smear_px: float) -> None:
        spread = math.hypot(blur_px, math.sqrt(1.0 / 12.0))
        reach = (width_px + max_smear_px) / 2 + _MARGIN_SIGMAS * spread + _BACKGROUND_PX
        self.half = math.ceil(reach)
        self.size = 2 * self.half + 1
        self.max_smear_px = max_smear_px
        self._bins = round(max_smear_px / SMEAR_STEP_PX) + 1
        pixels = np.arange(-self.half, self.half + 1, dtype=np.float64)
        phases = (np.arange(PHASES) + 0.5) / PHASES - 0.5
        x = pixels[None, :] - phases[:, None]
        shapes = np.empty((self._bins, PHASES, 3, self.size))
        step = 1e-3
        for k in range(self._bins):
            smear = k * SMEAR_STEP_PX
            shapes[k, :, 0] = profile(x, width_px, blur_px, smear)
            shapes[k, :, 1] = 1.0
            shapes[k, :, 2] = (
                profile(x - step, width_px, blur_px, smear) - profile(x + step, width_px, blur_px, smear)
            ) / (2 * step)
        flat = shapes.reshape(-1, 3, self.size)
        normal = flat @ flat.transpose(0, 2, 1)
        inverse = np.linalg.inv(normal)
        weights = inverse @ flat
        leverage = np.sum(weights * flat, axis=1)
        self.shapes = flat.astype(np.float32)
        self.weights = weights.astype(np.float32)
        self.gains = np.stack([inverse[:, 0, 0], inverse[:, 2, 2]], axis=1)
        self.freedom = np.clip(1.0 - leverage, 0.0, 1.0).astype(np.float32)

    def entries(self, u: FloatArray, smear_px: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Look up where each row's strip is in the table.

        Parameters
        ----------
        u, smear_px : ndarray, shape (n_rows,) -- middle of the strip, its way during the exposure [px]

        Returns
        -------
        column : ndarray of int, shape (n_rows,) -- pixel nearest to the middle
        entry : ndarray of int, shape (n_rows,) -- row of the tables
        tabulated : ndarray, shape (n_rows,) -- the position that the entry stands for [px]
        """
        column = np.floor(u + 0.5).astype(np.intp)
        phase = np.minimum(((u - column + 0.5) * PHASES).astype(np.intp), PHASES - 1)
        smears = np.minimum((smear_px / SMEAR_STEP_PX + 0.5).astype(np.intp), self._bins - 1)
        return column, smears * PHASES + phase, column + (phase + 0.5) / PHASES - 0.5
