"""What a fit to frequency data leaves, against what its noise alone would leave."""

from __future__ import annotations

import math
from dataclasses import dataclass

_SUSPICIOUS = 5.0  # standard deviations


@dataclass(frozen=True)
class LineMisfit:
    """Sum of squared weighted residuals, with its expectation.

    Attributes
    ----------
    chi_squared : float
        Of real and imaginary parts; NaN where the noise is not known.
    expected, sd : float
        What noise alone leaves, and its scatter, the finite freedom of the variances included.
    """

    chi_squared: float
    expected: float
    sd: float

    @staticmethod
    def of(chi_squared: float, n_rows: int, n_parameters: int, n_series: int, freedom: float) -> LineMisfit:
        """Judge a fit.

        Parameters
        ----------
        chi_squared : float
        n_rows : int -- real equations
        n_parameters : int
        n_series : int -- responses, each with variances of its own
        freedom : float -- degrees of freedom of every variance

        Notes
        -----
        A variance of ``nu`` complex degrees of freedom weighs ``nu / (nu - 1)`` too much on average
        (Pintelon and Schoukens 2012, ch. 10), and lines that share it err together.
        """
        n_free = max(n_rows - n_parameters, 1)
        if not math.isfinite(freedom):
            return LineMisfit(chi_squared, float(n_free), math.sqrt(2.0 * n_free))
        inflation = freedom / (freedom - 1.0) if freedom > 2.0 else 2.0
        expected = n_free * inflation
        # The whole series rests on as many independent variances as windows fit into it; a
        # window of one period pair is the worst case.
        common = 2.0 * n_series / n_rows
        return LineMisfit(
            chi_squared, expected, math.sqrt(2.0 * n_free * inflation**2 + expected**2 * common)
        )

    @property
    def is_noise(self) -> bool:
        """Whether noise alone explains the residuals, as far as the noise is known."""
        return not self.chi_squared > self.expected + _SUSPICIOUS * self.sd

    @property
    def inflation(self) -> float:
        """By how much variances grow where more than noise is left: as if it were noise, what else is not known."""
        return 1.0 if self.is_noise else self.chi_squared / self.expected

    @property
    def warning(self) -> str:
        """What a reader must know, or an empty string."""
        if self.is_noise:
            return ""
        return (
            f"the residuals hold {self.chi_squared / self.expected:.2f} times what noise alone would leave: modes "
            "or distortion are not in the model, and standard deviations count it as noise"
        )


UNKNOWN_NOISE = LineMisfit(math.nan, math.nan, math.nan)


def weighting_loss(freedom: float) -> float:
    """Return by how much variances grow when weights are estimates of ``freedom`` degrees of freedom.

    Notes
    -----
    ``nu / (nu - 2)``: the weights are ``nu / (nu - 1)`` too large on average, and their scatter
    costs ``(nu - 1) / (nu - 2)`` (Pintelon and Schoukens 2012, ch. 10).
    """
    return freedom / (freedom - 2.0) if math.isfinite(freedom) and freedom > 4.0 else 1.0
