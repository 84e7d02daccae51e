"""A robust likelihood: Student's t, whose freedom the residuals decide, without gross outliers.

Least squares weighs an error by its square.  Under Student's t (Lange, Little and Taylor 1989) a residual r of
scale s weighs by ``w = (nu + 1) / (nu + (r / s)^2)`` times its square: what lies within the noise counts as ever,
and the farther off a sample stands the less it counts.  What the rule of ``noise.outliers`` names does not count at
all: with it out of the way the tails of the rest are light, and little efficiency is lost.

The covariance is that of an M-estimator (Huber and Ronchetti 2009, eq. 7.6.5), which holds whatever the outliers
are as long as they have no preferred sign.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from beam_ident.arrays import BoolArray, FloatArray

_FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0)
_TURNS = 100
_SETTLED = 1e-4  # of the scale's square
_FAR = 5.0  # scales: where the rule for outliers begins
_TO_SIGMA = 1.4826  # of Gaussian noise, from the median absolute deviation


@dataclass(frozen=True, eq=False)
class HeavyTails:
    """Student's t for the residuals of one record.

    Attributes
    ----------
    freedom : float -- degrees of freedom
    scale : float -- in units of the residuals
    residuals : ndarray, shape (n,)
    kept : ndarray of bool, shape (n,) -- which count
    """

    freedom: float
    scale: float
    residuals: FloatArray
    kept: BoolArray

    @staticmethod
    def of(residuals: FloatArray, kept: BoolArray) -> HeavyTails:
        """Return the distribution of highest likelihood, of residuals that are not all zero."""
        fits = [HeavyTails(nu, _scale(residuals[kept], nu), residuals, kept) for nu in _FREEDOMS]
        return min(fits, key=lambda own: own._misfit(residuals[kept] / own.scale))

    def followed(self, residuals: FloatArray) -> HeavyTails:
        """Return the same distribution, at the likeliest scale, for other residuals of the same samples."""
        return HeavyTails(self.freedom, _scale(residuals[self.kept], self.freedom), residuals, self.kept)

    @cached_property
    def weights(self) -> FloatArray:
        """By what the square of every residual counts, shape (n,)."""
        return np.asarray(_weights(self.residuals / self.scale, self.freedom) * self.kept)

    @property
    def cost(self) -> float:
        """Negative log-likelihood, counted as ``n/2 log(sum r^2)`` counts that of Gaussian noise.

        What does not count is taken to stand where the rule begins, so that more of it is never better.
        """
        n = len(self.residuals)
        gaussian = 0.5 * n * (1.0 + math.log(2.0 * math.pi) - math.log(n))
        return self._misfit(np.where(self.kept, self.residuals / self.scale, _FAR)) - gaussian

    def _misfit(self, z: FloatArray) -> float:
        """Return the negative log-likelihood of residuals in units of the scale."""
        nu = self.freedom
        norm = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * math.log(nu * math.pi)
        return len(z) * (math.log(self.scale) - float(norm)) + 0.5 * (nu + 1.0) * float(
            np.sum(np.log1p(np.square(z) / nu))
        )

    @property
    def inflation(self) -> float:
        """By what the variance of weighed least squares grows to be that of the estimate.

        Notes
        -----
        ``E psi^2 / (E psi')^2`` is the variance over that of unit weights, psi = w r; the weighed information is
        ``E w`` of it.
        """
        z, nu, w = self.residuals / self.scale, self.freedom, self.weights
        slope = (nu + 1.0) * (nu - z**2) / np.square(nu + z**2) * self.kept
        power = float(np.mean(np.square(w * z)))
        return power * float(np.mean(w)) / max(float(np.mean(slope)), 1e-3) ** 2 / float(np.mean(w * z**2))

    @property
    def gain(self) -> float:
        """Variance of the estimate over that of least squares, for these residuals."""
        own = (
            self.inflation
            * float(np.mean(self.weights * np.square(self.residuals)))
            / float(np.mean(self.weights))
        )
        return own / float(np.mean(np.square(self.residuals)))

    @property
    def efficiency(self) -> float:
        """Efficiency where the noise were Gaussian after all, from a quadrature."""
        points, mass = np.polynomial.hermite_e.hermegauss(101)
        mass = mass / np.sum(mass)
        scale = 1.0
        for _ in range(_TURNS):
            scale *= math.sqrt(
                float(mass @ (_weights(points / scale, self.freedom) * np.square(points / scale)))
            )
        z, nu = points / scale, self.freedom
        slope = (nu + 1.0) * (nu - z**2) / np.square(nu + z**2)
        return float(mass @ slope) ** 2 / (scale**2 * float(mass @ np.square(_weights(z, nu) * z)))

    def __str__(self) -> str:
        """Return what the likelihood is and what it costs, in words."""
        left_out = int(np.count_nonzero(~self.kept))
        return (
            f"Student's t likelihood of {self.freedom:g} degrees of freedom without {left_out} outliers (variance "
            f"{self.gain:.2g} of that of least squares; efficiency {self.efficiency:.0%} were the noise Gaussian)"
        )


def _weights(z: FloatArray, freedom: float) -> FloatArray:
    return np.asarray((freedom + 1.0) / (freedom + np.square(z)))


def _scale(residuals: FloatArray, freedom: float) -> float:
    """Return the likeliest scale at given degrees of freedom, by expectation and maximisation."""
    square = max((_TO_SIGMA * float(np.median(np.abs(residuals)))) ** 2, 1e-12 * float(np.mean(residuals**2)))
    for _ in range(_TURNS):
        following = float(np.mean(_weights(residuals / math.sqrt(square), freedom) * np.square(residuals)))
        is_settled = abs(following / square - 1.0) < _SETTLED
        square = following
        if is_settled:
            break
    return math.sqrt(square)
