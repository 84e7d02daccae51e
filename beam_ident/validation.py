"""How good a fit is, in numbers and in words.

FIT and R_T^2 compare residuals with the output; because an output near the hub is
mostly its input, both are given on the deflection too (the output less its direct
part).  Whiteness of the residuals is tested with the Ljung-Box statistic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from beam_ident.piecewise import FloatArray

_WHITENESS_LEVEL = 1e-3


@dataclass(frozen=True)
class Scores:
    """Agreement of a simulated with a measured signal.

    Attributes
    ----------
    fit_percent : float -- 100 (1 - ||e|| / ||y - mean y||)
    r_squared : float -- R_T^2 = 1 - var(e) / var(y)
    """

    fit_percent: float
    r_squared: float

    @staticmethod
    def of(values: FloatArray, residuals: FloatArray) -> Scores:
        """Compute both scores."""
        spread = max(float(np.linalg.norm(values - np.mean(values))), 1e-300)
        fit = 100.0 * (1.0 - float(np.linalg.norm(residuals)) / spread)
        return Scores(fit, 1.0 - float(np.var(residuals)) / (spread**2 / len(values)))


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Whether residuals look like white noise.

    Attributes
    ----------
    autocorrelation : ndarray, shape (n_lags,) -- at lags 1 .. n_lags
    band : float -- half-width of the 99 % band of a white sequence
    statistic, p_value : float -- Ljung-Box
    is_white : bool
    verdict : str -- the same in words
    """

    autocorrelation: FloatArray
    band: float
    statistic: float
    p_value: float
    is_white: bool
    verdict: str

    @staticmethod
    def of(residuals: FloatArray, n_lags: int = 25) -> Whiteness:
        """Test a sequence of residuals in the order of their stamps."""
        n = len(residuals)
        n_lags = max(1, min(n_lags, n // 4))
        centred = residuals - np.mean(residuals)
        power = max(float(centred @ centred), 1e-300)
        rho = np.array([float(centred[k:] @ centred[:-k]) / power for k in range(1, n_lags + 1)])
        statistic = float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, n_lags + 1))))
        p_value = float(chi2.sf(statistic, n_lags))
        is_white = p_value > _WHITENESS_LEVEL
        worst = int(np.argmax(np.abs(rho)))
        if is_white:
            verdict = f"the residuals look white (p = {p_value:.2g} over {n_lags} lags)"
        else:
            verdict = (
                f"the residuals are not white (p = {p_value:.1g}; autocorrelation {rho[worst]:+.2f} at lag "
                f"{worst + 1}): "
                "something is left unmodelled, or the noise is coloured; stated intervals are then too "
                "narrow or wide"
            )
        return Whiteness(rho, 2.576 / np.sqrt(n), statistic, p_value, is_white, verdict)
