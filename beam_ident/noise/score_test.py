"""Whether a fit left something out: a score test, which needs no second fit.

Columns that a model lacks, freed of all that the model could explain by other values of its parameters, are at right
angles to what is left of the data only where nothing was left out (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948),
50-57).
The noise may be coloured: its autocorrelation is that of what is left with these columns.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import FloatArray
from beam_ident.noise.autoregression import autocorrelation, autoregression, score_covariance
from beam_ident.numerics.linear_least_squares import LinearSolution

_NOTHING_NEW = 1e-6  # of a column's length: what remains of it then is rounding
_RANK = 1e-8  # of the largest variance of a score
_ROUNDING = 1e-9  # of an output: residuals that small are errors of arithmetic


@dataclass(frozen=True)
class ScoreTest:
    """What columns that were left out would explain, of independent outputs together.

    Attributes
    ----------
    statistic : float -- chi-squared where nothing was left out
    freedom : int -- its degrees of freedom
    """

    statistic: float
    freedom: int

    @property
    def p_value(self) -> float:
        """How often chance alone would give as much; 1 where nothing new could be explained."""
        return float(chi_squared_sf(self.freedom, self.statistic)) if self.freedom else 1.0

    @staticmethod
    def of(outputs: Iterable[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]) -> ScoreTest:
        """Test what was left out at every output.

        Parameters
        ----------
        outputs : iterable of (left_out, present, residuals, values)
            Columns that were left out (n, n_left_out), all derivatives of the model (n, n_parameters), what the model
            leaves of the values (n,), and the values (n,).
        """
        total, freedom = 0.0, 0
        for left_out, present, residuals, values in outputs:
            if not left_out.shape[1] or np.linalg.norm(residuals) <= _ROUNDING * np.linalg.norm(values):
                continue
            size = np.linalg.norm(left_out, axis=0)
            columns = left_out / np.where(size > 0.0, size, 1.0)
            basis = LinearSolution.of(present).basis
            columns = columns - basis @ (basis.T @ columns)
            columns = columns[:, np.linalg.norm(columns, axis=0) > _NOTHING_NEW]
            if not columns.shape[1]:
                continue
            # The noise is what is left with them: what was left out is no colour of it.
            own = LinearSolution.of(columns).basis
            noise = residuals - own @ (own.T @ residuals)
            correlation = autocorrelation(autoregression(noise), len(noise))
            n_free = len(noise) - present.shape[1] - own.shape[1]
            variance = float(noise @ noise) / max(n_free, 1)
            spread, axes = np.linalg.eigh(variance * score_covariance(columns, correlation))
            kept = spread > _RANK * spread[-1]
            scores = axes[:, kept].T @ (columns.T @ residuals)
            total += float(np.sum(np.square(scores) / spread[kept]))
            freedom += int(np.count_nonzero(kept))
        return ScoreTest(total, freedom)
