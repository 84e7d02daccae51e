"""How good a fit is, in numbers and in words.

FIT and R_T^2 compare residuals with the output; because an output near the hub is
mostly its input, both are given on the deflection too (the output less its direct
part).  Whiteness of the residuals is tested with the Ljung-Box statistic.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_sf
from scipy.special import ndtri

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.noise.autoregression import autoregression, score_covariance
from beam_ident.numerics.linear_least_squares import LinearSolution, lengths

_WHITENESS_LEVEL = 1e-3
_NOTHING_NEW = 1e-6  # of a column's length: what remains of it then is rounding
_RANK = 1e-8  # of the largest variance of a score
_ROUNDING = 1e-9  # of the output: residuals below this are errors of arithmetic, of any colour


@dataclass(frozen=True)
class Scores:
    """Agreement of a simulated with a measured signal.

    Attributes
    ----------
    fit_percent : float -- 100 (1 - ||e|| / ||y - mean y||)
    r_squared : float -- R_T^2 = 1 - var(e) / var(y)

    Notes
    -----
    NaN where nothing moves, so that there is nothing to compare with.
    """

    fit_percent: float
    r_squared: float

    @staticmethod
    def of(values: FloatArray, residuals: FloatArray) -> Scores:
        """Compute both scores."""
        spread = float(np.linalg.norm(values - np.mean(values)))
        if not spread > 0.0:
            return Scores(math.nan, math.nan)
        fit = 100.0 * (1.0 - float(np.linalg.norm(residuals)) / spread)
        return Scores(fit, 1.0 - len(values) * float(np.var(residuals) / spread) / spread)


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
        p_value = float(chi_squared_sf(n_lags, statistic))
        is_white = p_value > _WHITENESS_LEVEL
        worst = int(np.argmax(np.abs(rho)))
        if is_white:
            verdict = f"the residuals look white (p = {p_value:.2g} over {n_lags} lags)"
        else:
            verdict = (
                f"the residuals are not white (p = {p_value:.1g}; autocorrelation {rho[worst]:+.2f} at lag "
                f"{worst + 1}): something is left unmodelled, or the noise is coloured; intervals that take "
                "it as white are then too narrow or wide"
            )
        return Whiteness(rho, 2.576 / math.sqrt(n), statistic, p_value, is_white, verdict)


def are_rounding(values: FloatArray, residuals: FloatArray) -> bool:
    """Return whether residuals are no more than errors of arithmetic, as of an output without noise."""
    return float(np.linalg.norm(residuals)) <= _ROUNDING * float(np.linalg.norm(values))


def is_coloured(whiteness: Whiteness, values: FloatArray, residuals: FloatArray) -> bool:
    """Return whether residuals are not white and more than errors of arithmetic."""
    return not whiteness.is_white and not are_rounding(values, residuals)


def colour_warning(
    names: Sequence[str],
    whiteness: Sequence[Whiteness],
    values: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
) -> list[str]:
    """Return what must be known of a fit whose residuals are not white, nothing where they are."""
    found = zip(names, whiteness, values, residuals, strict=True)
    coloured = [name for name, own, seen, left in found if is_coloured(own, seen, left)]
    if not coloured:
        return []
    return [
        f"The residuals of {', '.join(coloured)} are not white. The fit is weighed by their autocorrelation and the "
        "standard deviations include it; if it is unmodelled dynamics rather than noise, or noise on a measured "
        "input whose sigma is not stated, a bias remains."
    ]


@dataclass(frozen=True, eq=False)
class InputCorrelation:
    """Whether residuals still contain the input.

    Attributes
    ----------
    lags : ndarray, shape (n_lags,) -- in samples; positive when the residual follows the input
    correlation : ndarray, shape (n_lags,)
    band : float -- half-width of the band that holds all lags together at 99 %
    is_independent : bool
    verdict : str
    """

    lags: IndexArray
    correlation: FloatArray
    band: float
    is_independent: bool
    verdict: str

    @staticmethod
    def of(residuals: FloatArray, drive: FloatArray, n_lags: int = 25) -> InputCorrelation:
        """Correlate residuals with the input taken at the same stamps."""
        n = len(residuals)
        n_lags = max(1, min(n_lags, n // 4))
        e, u = residuals - np.mean(residuals), drive - np.mean(drive)
        power = max(float(np.linalg.norm(e) * np.linalg.norm(u)), 1e-300)
        lags = list(range(-5 if n_lags > 5 else 0, n_lags + 1))
        products = [float(e[max(k, 0) : n + min(k, 0)] @ u[max(-k, 0) : n - max(k, 0)]) for k in lags]
        values = np.array(products) / power
        band = float(-ndtri(0.005 / len(lags)) / np.sqrt(n))
        worst = int(np.argmax(np.abs(values)))
        is_independent = bool(np.abs(values[worst]) <= band)
        if is_independent:
            verdict = (
                "the residuals do not follow the input: its path is modelled as far as these data can tell"
            )
        else:
            verdict = (
                f"the residuals follow the input (correlation {values[worst]:+.3f} at lag {lags[worst]}, "
                f"band {band:.3f}): dynamics, delay or hold of the model are wrong, or the order is too low"
            )
        return InputCorrelation(np.array(lags), values, band, is_independent, verdict)


Tested = tuple[FloatArray, LinearSolution, FloatArray, FloatArray]  # as of ``ScoreTest.of``


@dataclass(frozen=True)
class ScoreTest:
    """What columns that were left out would explain, of independent outputs together.

    Attributes
    ----------
    statistic : float -- chi-squared where nothing was left out
    freedom : int -- its degrees of freedom

    Notes
    -----
    A score test, which needs no second fit: columns that a model lacks, freed of all that the model could explain by
    other values of its parameters, are at right angles to what is left of the data only where nothing was left out
    (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948), 50-57). The noise may be coloured: its autocorrelation is that of
    what is left with these columns.
    """

    statistic: float
    freedom: int

    @property
    def p_value(self) -> float:
        """How often chance alone would give as much; 1 where nothing new could be explained."""
        return float(chi_squared_sf(self.freedom, self.statistic)) if self.freedom else 1.0

    @staticmethod
    def of(outputs: Iterable[Tested]) -> ScoreTest:
        """Test what was left out at every output.

        Parameters
        ----------
        outputs : iterable of (left_out, present, residuals, values)
            Columns that were left out (n, n_left_out), all derivatives of the model (n, n_parameters) as they are
            solved, what the model leaves of the values (n,), and the values (n,).
        """
        total, freedom = 0.0, 0
        for left_out, present, residuals, values in outputs:
            if not left_out.shape[1] or are_rounding(values, residuals):
                continue
            size = lengths(left_out)
            columns = present.left_of(left_out / np.where(size > 0.0, size, 1.0))
            columns = columns[:, lengths(columns) > _NOTHING_NEW]
            if not columns.shape[1]:
                continue
            # The noise is what is left with them: what was left out is no colour of it.
            own = LinearSolution.of(columns)
            noise = own.left_of(residuals)
            n_free = len(noise) - len(present.scales) - len(own.kept)
            variance = float(noise @ noise) / max(n_free, 1)
            spread, axes = np.linalg.eigh(variance * score_covariance(columns, autoregression(noise)))
            kept = spread > _RANK * spread[-1]
            scores = axes[:, kept].T @ (columns.T @ residuals)
            total += float(np.sum(np.square(scores) / spread[kept]))
            freedom += int(np.count_nonzero(kept))
        return ScoreTest(total, freedom)
