"""Stamps that scatter: noise that grows with the speed of what is measured, and is common to all outputs.

A stamp that is late by delta shifts what all outputs show at that instant by ``-speed delta``. Such noise is largest
where the outputs move fastest, which is where they tell most of clock and damping, and no marker averages it away:
taken for noise of one level that is independent from output to output, it makes intervals of the clock and the first
frequencies too narrow, and those of what the quiet parts show too wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.noise.scores import Whiteness

_LEVEL = 1e-6  # how often stamps without an error are said to scatter
_COLOURED = 1e-6  # what an error of the model leaves follows the speed too, but not at random
_WILD = 6.0  # standard deviations: outliers are no jitter
_TURNS = 200
_SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class StampJitter:
    """Scatter of the stamps of one record, which its outputs share.

    Attributes
    ----------
    sd_s : float -- standard deviation [s]; 0: none is seen
    variances : ndarray, shape (n_outputs,) -- of the outputs' own noise beside it
    speeds : ndarray, shape (n_instants, n_outputs) -- of the outputs, 0 where none was seen [unit/s]
    """

    sd_s: float
    variances: FloatArray
    speeds: FloatArray

    @staticmethod
    def of(residuals: FloatArray, speeds: FloatArray, seen: BoolArray) -> StampJitter:
        """Estimate it from what a fit with equal weights left.

        Parameters
        ----------
        residuals, speeds : ndarray, shape (n_instants, n_outputs)
            Of instants at which outputs have one stamp in common; zero where an output was not seen.
        seen : ndarray of bool, shape (n_instants, n_outputs)

        Notes
        -----
        The residuals of an instant have the covariance ``diag(sigma_j^2) + tau v v^T``, v the speeds. Likelihood is
        climbed in turns: ``tau`` by scoring, the ``sigma_j^2`` by expectation over the errors of the stamps. With
        ``s = sum v r / sigma^2`` and ``q = sum v^2 / sigma^2`` an error is ``tau s / (1 + tau q)`` on average.
        """
        counts = np.maximum(np.sum(seen, axis=0), 1)
        plain = np.maximum(np.sum(residuals**2, axis=0) / counts, 1e-300)
        none = StampJitter(0.0, plain, speeds)
        variances = plain
        # To begin with, half of what is left is the jitter's.
        tau = 0.5 * float(np.sum(residuals**2 / plain)) / max(float(np.sum(speeds**2 / plain)), 1e-300)
        for _ in range(_TURNS):
            s, q = (residuals * speeds) @ (1.0 / variances), speeds**2 @ (1.0 / variances)
            spread = 1.0 / (1.0 + tau * q)
            step = np.sum((s**2 - q - tau * q**2) * spread**2) / max(np.sum((q * spread) ** 2), 1e-300)
            before, tau = tau, max(tau + float(step), 0.0)
            if tau == 0.0:
                return none
            spread = 1.0 / (1.0 + tau * q)
            left = residuals - speeds * (tau * s * spread)[:, None]
            moved = np.sum(left**2 + speeds**2 * (tau * spread)[:, None], axis=0) / counts
            change = max(abs(tau / before - 1.0), float(np.max(np.abs(moved / variances - 1.0))))
            variances = np.maximum(moved, 1e-6 * plain)
            if change < _SETTLED:
                break
        s, q = (residuals * speeds) @ (1.0 / variances), speeds**2 @ (1.0 / variances)
        grown = 1.0 + tau * q
        # Twice the gain in log-likelihood over noise of one level.
        gain = float(counts @ np.log(plain / variances) - np.sum(np.log(grown)))
        gain += float(np.sum(counts) - np.sum(residuals**2 / variances) + np.sum(tau * s**2 / grown))
        errors = s[q > 0.0] / np.sqrt((q * grown)[q > 0.0])
        if chi_squared_sf(1, max(gain, 0.0)) > _LEVEL or Whiteness.of(errors).p_value < _COLOURED:
            return none
        scale = np.sqrt(variances + tau * speeds**2)
        if np.max(np.abs(residuals) / scale) > _WILD:
            return none
        return StampJitter(float(np.sqrt(tau)), variances, speeds)

    def __str__(self) -> str:
        """Say what it is."""
        return f"stamps that scatter by {1e6 * self.sd_s:.2g} us"


def is_any(jitters: Sequence[StampJitter]) -> bool:
    """Return whether the stamps of any record scatter."""
    return any(own.sd_s > 0.0 for own in jitters)
