"""Numbers as a reader wants them: to two digits of their uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np

COVERAGE = 1.96
"""Standard deviations to either side of a value that hold 95 % of a normal distribution."""


def with_uncertainty(value: float, sd: float) -> str:
    """Return a value and its standard deviation, rounded to two digits of the latter."""
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{value:.6g}"
    if max(abs(value), sd) < 1e-4:
        power = int(np.floor(np.log10(max(abs(value), sd))))
        return f"({with_uncertainty(value / 10.0**power, sd / 10.0**power)})e{power:03d}"
    digits = decimals(sd)
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def interval(value: float, sd: float) -> str:
    """Return the 95 % interval of a value; a dash where its standard deviation is not known."""
    if not np.isfinite(sd) or sd <= 0.0:
        return "–"
    digits = decimals(sd)
    return f"{value - COVERAGE * sd:.{digits}f} to {value + COVERAGE * sd:.{digits}f}"


def small(value: float) -> str:
    """Return a standard deviation, or a share of one, to two digits; a dash where it is not known."""
    return f"{value:.2g}" if np.isfinite(value) else "–"


def signed(value: float) -> str:
    """Return a deviation in standard deviations, with its sign; a dash where it is not known."""
    return f"{value:+.1f}" if np.isfinite(value) else "–"


def r_squared(value: float) -> str:
    """Return a coefficient of determination to two digits of what it lacks, so that none but a perfect one is 1."""
    return f"{value:.{decimals(max(1.0 - value, 1e-12), 2)}f}" if np.isfinite(value) else "–"


def sentence(text: str) -> str:
    """Return words that begin with a capital and end with a full stop."""
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '?', '!')) else '.'}" if text else ""


def decimals(sd: float, least: int = 0) -> int:
    """Return how many decimals show two digits of a standard deviation."""
    if not np.isfinite(sd) or sd <= 0.0:
        return max(least, 6)
    return int(np.clip(1 - np.floor(np.log10(sd)), least, 12))


def nearest_mode(natural_frequencies: Any, omega: float) -> int | None:
    """Return the index of the frequency within 25 % of ``omega`` that is nearest, or None."""
    if not len(natural_frequencies):
        return None
    distance = np.abs(np.log(np.asarray(natural_frequencies) / omega))
    best = int(np.argmin(distance))
    return best if distance[best] < np.log(1.25) else None
