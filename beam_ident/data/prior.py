"""What is known of a parameter before any data: a mean and a standard deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beam_ident.errors import EstimationError


@dataclass(frozen=True)
class Prior:
    """Gaussian knowledge about a clock parameter.

    Parameters
    ----------
    mean : float
    sd : float
        0 fixes the parameter at its mean, infinity leaves it to the data alone.
    """

    mean: float = 0.0
    sd: float = 0.0

    def __post_init__(self) -> None:
        try:
            mean, sd = float(self.mean), float(self.sd)
        except (TypeError, ValueError):
            mean = sd = math.nan
        if not math.isfinite(mean) or math.isnan(sd) or sd < 0.0:
            raise EstimationError(
                f"prior is {self.mean} +- {self.sd}; expected a finite mean and sd >= 0 (or inf)"
            )
        # Whole numbers, too, begin what moves by fractions.
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "sd", sd)

    @property
    def is_free(self) -> bool:
        """Whether the parameter is estimated."""
        return self.sd > 0.0
