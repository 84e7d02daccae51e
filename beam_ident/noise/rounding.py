"""Values that are rounded more coarsely than their noise: the likelihood of the interval in which each one lies.

A sample rounded to steps of q says that the value lay within q/2 of it, no more.  With white Gaussian noise of
sigma before the rounding and the model at m, its probability is that of an interval, (I.25).  Least squares takes the
rounding error for noise; below half a step of noise it follows the signal, and biases.

The maximum of the likelihood is found by least squares in turns (Fisher scoring): every sample weighs by the
information w of its interval on m, and stands at ``m + s/w`` instead of y, s being the slope of ``log P``.  Samples
near an edge of their interval say most; those in the middle of a wide one say nothing.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr, ndtr

from beam_ident.arrays import FloatArray

_MULTIPLE = 0.02  # of a step, within which all differences are multiples of it
_MOST_STEPS = 1e6  # beyond which nothing can be said
_FEW = 8  # samples
DITHER = 0.5  # steps of noise, from which on rounding is noise like any other (Widrow and Kollar 2008, ch. 4)
_MIN_NOISE = 0.02  # steps: with less noise the edges are as good as sharp
_REACH = 6.0  # standard deviations to either side, in which levels are counted
_FAINT = 1e-3  # of the information of a sample that is not rounded: the least weight


def quantum(values: FloatArray) -> float:
    """Return the step to which values are rounded, 0 where there is none to be seen."""
    levels = np.unique(values[np.isfinite(values)])
    if not len(values) >= _FEW or len(levels) < 2:
        return 0.0
    steps = np.diff(levels)
    smallest = float(np.min(steps))
    if not smallest > 0.0 or float(np.ptp(levels)) > _MOST_STEPS * smallest:
        return 0.0
    # Levels that are missing leave multiples; the whole range knows the step best.
    counts = np.round(steps / smallest)
    found = float(np.ptp(levels)) / float(np.sum(counts))
    # Samples that are not rounded repeat no level.
    is_rounded = len(levels) < 0.9 * len(values) and np.max(np.abs(steps / found - counts)) < _MULTIPLE
    return found if is_rounded else 0.0


def dither(residuals: FloatArray, step: float) -> float:
    """Return the noise before a rounding in steps, from what a fit of the rounded values leaves."""
    return math.sqrt(max(float(np.mean(np.square(residuals))) / step**2 - 1.0 / 12.0, 0.0))


@dataclass(frozen=True, eq=False)
class RoundedNoise:
    """White Gaussian noise before a coarse rounding, at one point of the model.

    Attributes
    ----------
    step : float -- of the rounding
    sigma : float -- of the noise before it
    residuals : ndarray, shape (n,) -- rounded values less the model
    is_cautious : bool
        Whether samples far outside their interval weigh by how far off they are: for the way to the optimum, not for
        the covariance at it.
    """

    step: float
    sigma: float
    residuals: FloatArray
    is_cautious: bool = True

    @staticmethod
    def of(values: FloatArray, residuals: FloatArray) -> RoundedNoise | None:
        """Return the likeliest noise before the rounding, None where the rounding is noise like any other."""
        step = quantum(values)
        if not step or not dither(residuals, step) < DITHER or float(np.std(residuals)) < 0.05 * step:
            return None
        return RoundedNoise(step, _likeliest(residuals, step), residuals)

    def followed(self, residuals: FloatArray, is_cautious: bool) -> RoundedNoise:
        """Return the same at another point of the model."""
        return RoundedNoise(self.step, _likeliest(residuals, self.step), residuals, is_cautious)

    @cached_property
    def _slope(self) -> FloatArray:
        """Slope of log P by the model, times sigma."""
        upper = (self.residuals + 0.5 * self.step) / self.sigma
        lower = (self.residuals - 0.5 * self.step) / self.sigma
        logs = _log_probability(lower, upper)
        norm = 0.5 * math.log(2.0 * math.pi)
        return np.asarray(np.exp(-0.5 * lower**2 - norm - logs) - np.exp(-0.5 * upper**2 - norm - logs))

    @cached_property
    def weights(self) -> FloatArray:
        """Information of every interval on the model over that of a sample that is not rounded, shape (n,)."""
        width = self.step / self.sigma
        # Edges of all levels around the model, from where it stands in its own.
        place = self.residuals / self.sigma
        place = place - width * np.round(place / width)
        count = math.ceil(_REACH / width) + 1
        edges = place[:, None] + width * (np.arange(-count, count + 2) - 0.5)
        density = np.exp(-0.5 * edges**2) / math.sqrt(2.0 * math.pi)
        lower, upper = edges[:, :-1], edges[:, 1:]
        chance = np.where(lower > 0.0, ndtr(-lower) - ndtr(-upper), ndtr(upper) - ndtr(lower))
        found = np.sum(np.square(np.diff(density, axis=1)) / np.maximum(chance, 1e-300), axis=1)
        if self.is_cautious:
            far = self._slope * self.sigma / np.where(self.residuals == 0.0, 1.0, self.residuals)
            found = np.maximum(found, far)
        return np.asarray(np.clip(found, _FAINT, 1.0))

    @cached_property
    def shift(self) -> FloatArray:
        """By how much every value stands elsewhere than it was rounded to, for least squares, shape (n,)."""
        return np.asarray(self.sigma * self._slope / self.weights - self.residuals)

    @property
    def cost(self) -> float:
        """Negative log-likelihood, counted as ``n/2 log(sum r^2)`` counts that of noise without rounding."""
        n = len(self.residuals)
        gaussian = 0.5 * n * (1.0 + math.log(2.0 * math.pi) - math.log(n))
        return _misfit(self.residuals, self.step, self.sigma) + n * math.log(self.step) - gaussian

    def __str__(self) -> str:
        """Return what the noise is, in words."""
        return (
            f"white noise of {self.sigma / self.step:.2g} steps before a rounding to steps of {self.step:.3g}, "
            "by the likelihood of their intervals"
        )


def _log_probability(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return log(Phi(upper) - Phi(lower)), exact in both tails."""
    flips = lower > 0.0
    low, high = np.where(flips, -upper, lower), np.where(flips, -lower, upper)
    most = log_ndtr(high)
    return np.asarray(most + np.log1p(-np.exp(np.minimum(log_ndtr(low) - most, -1e-12))))


def _misfit(residuals: FloatArray, step: float, sigma: float) -> float:
    return -float(
        np.sum(_log_probability((residuals - 0.5 * step) / sigma, (residuals + 0.5 * step) / sigma))
    )


def _likeliest(residuals: FloatArray, step: float) -> float:
    """Return the sigma of highest likelihood, between a fiftieth of a step and one."""
    found = minimize_scalar(
        lambda log: _misfit(residuals, step, step * math.exp(log)),
        bounds=(math.log(_MIN_NOISE), 0.0),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return step * math.exp(float(found.x))
