"""What the intervals of a result rest on, each with its test: where one fails, so does the coverage that they state.

The tests are of innovations: what is left of the residuals after what the estimator took the noise for.  They are
white by then, so that each statistic has a known distribution whatever the colour of the noise was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.special import chdtrc as chi_squared_sf
from scipy.special import ndtr

from beam_ident.arrays import FloatArray
from beam_ident.data.records import TimeRecord
from beam_ident.noise.autoregression import autoregression
from beam_ident.noise.scores import InputCorrelation, Whiteness, are_rounding
from beam_ident.numerics.convolution import causal_convolution


@dataclass(frozen=True)
class Assumption:
    """One assumption that intervals rest on.

    Attributes
    ----------
    name : str -- what is assumed
    test : str -- how it was tested, with what was found
    p_value : float
        How often chance alone would speak against it as much, with the number of outputs counted in; NaN where there
        was no test.
    verdict : {"holds", "fails", "not tested"}
        Of all assumptions of a result together, so that where all hold one "fails" as rarely as the level says (Holm,
        Scandinavian Journal of Statistics 6, 1979).
    """

    name: str
    test: str
    p_value: float = math.nan
    verdict: Literal["holds", "fails", "not tested"] = "not tested"


def assumptions(
    result: Any, records: Sequence[TimeRecord] = (), level: float = 0.01
) -> tuple[Assumption, ...]:
    """Test what the intervals of a result rest on.

    Parameters
    ----------
    result : Result -- of those that keep no ``records`` of their fit, nothing can be tested
    records : sequence of TimeRecord -- that it was estimated from; without them the input is not looked at
    level : float -- how often one of all assumptions may seem to fail where all hold

    Returns
    -------
    tuple of Assumption -- always the same ones in the same order, also those that could not be tested
    """
    parts = _innovations(result)
    found = (
        _as_modelled(parts),
        _independent(parts),
        _steady(parts),
        _driven(parts, records),
    )
    return _judged(found, level)


@dataclass(frozen=True, eq=False)
class _Part:
    """The innovations of one output in one record."""

    output: str
    record: str
    times_s: FloatArray
    innovations: FloatArray


def _innovations(result: Any) -> list[_Part]:
    """Return the innovations of every output, record by record; none of residuals that are rounding alone."""
    if not (hasattr(result, "scores") and hasattr(result, "records")):
        return []
    of_outputs = [result.records] if hasattr(result.scores, "fit_percent") else result.records
    models = getattr(result, "models", None) or (result.model,)
    names = [
        name for model in models for name in getattr(model, "output_names", None) or (model.output_name,)
    ]
    parts = []
    for name, fits in zip(names, of_outputs, strict=True):
        for fit in fits:
            if are_rounding(fit.measured, fit.residuals):
                continue
            innovations = fit.innovations
            if not len(innovations):
                innovations = causal_convolution(fit.noise_coefficients, fit.residuals / fit.spread)
            first = len(fit.noise_coefficients) - 1  # before it, innovations lack what came before the record
            parts.append(_Part(name, fit.name, fit.times_s[first:], innovations[first:]))
    return parts


def _together(p_values: Sequence[float]) -> float:
    """Return how often the least of independent p-values would be as small (Sidak 1967)."""
    least = min(p_values, default=math.nan)
    return -math.expm1(len(p_values) * math.log1p(-min(least, 1.0 - 1e-16)))


def _as_modelled(parts: Sequence[_Part]) -> Assumption:
    name = "noise is white, or of the colour that was modelled"
    tested = [(Whiteness.of(part.innovations).p_value, part.output) for part in parts]
    if not tested:
        return Assumption(name, "the result keeps no residuals that could be tested")
    return Assumption(
        name, f"Ljung-Box, worst at {min(tested)[1]}", _together([p_value for p_value, _ in tested])
    )


def _independent(parts: Sequence[_Part]) -> Assumption:
    """Test whether outputs have noise in common at instants that they share."""
    name = "noise of one output is not that of another"
    tested = []
    for one, other in combinations(parts, 2):
        if one.record != other.record or one.output == other.output:
            continue
        _, here, there = np.intersect1d(one.times_s, other.times_s, assume_unique=True, return_indices=True)
        if len(here) < 3:
            continue
        a, b = one.innovations[here], other.innovations[there]
        correlation = float(np.corrcoef(a, b)[0, 1])
        p_value = float(chi_squared_sf(1.0, len(here) * correlation**2))
        tested.append((p_value, f"{one.output} and {other.output}: correlation {correlation:+.2f}"))
    if not tested:
        return Assumption(name, "no two outputs have instants in common")
    return Assumption(name, f"largest of {min(tested)[1]}", _together([p_value for p_value, _ in tested]))


def _steady(parts: Sequence[_Part], n_blocks: int = 8) -> Assumption:
    """Test whether the noise has one variance throughout each record (Bartlett's test with the fourth moment)."""
    name = "noise is as loud at the end of a record as at its beginning"
    tested = []
    for part in parts:
        blocks = np.array_split(part.innovations, n_blocks)
        if len(part.innovations) < 20 * n_blocks:
            continue
        scaled = part.innovations / np.std(part.innovations)
        # Of a sample of n values the logarithm of the variance scatters by (kurtosis - 1) / n.
        scatter = (float(np.mean(scaled**4)) - 1.0) * n_blocks / len(scaled)
        levels = np.log([np.mean(np.square(block)) for block in blocks])
        statistic = float(np.sum(np.square(levels - np.mean(levels)))) / scatter
        ratio = math.exp(0.5 * float(np.ptp(levels)))
        p_value = float(chi_squared_sf(n_blocks - 1.0, statistic))
        tested.append((p_value, f"{part.output}: by a factor of {ratio:.2g} between its parts"))
    if not tested:
        return Assumption(name, "too few samples")
    return Assumption(name, f"most at {min(tested)[1]}", _together([p_value for p_value, _ in tested]))


def _driven(parts: Sequence[_Part], records: Sequence[TimeRecord]) -> Assumption:
    """Test whether what is left follows an input: dynamics, a path or a force that the model lacks."""
    name = "nothing that the input does is left out"
    by_name = {record.name: record for record in records}
    tested = []
    for part in parts:
        record = by_name.get(part.record)
        for drive in record.inputs if record is not None else ():
            # Of a white input neighbouring lags speak for themselves (prewhitening; Box and Jenkins 1970, ch. 11).
            seen = np.interp(part.times_s, drive.times_s, drive.values)
            found = InputCorrelation.of(part.innovations, causal_convolution(autoregression(seen), seen))
            largest = float(np.max(np.abs(found.correlation)))
            p_value = _together([2.0 * float(ndtr(-largest * math.sqrt(len(seen))))] * len(found.lags))
            tested.append((p_value, f"{part.output} with {drive.name}: {largest:.2g}"))
    if not tested:
        return Assumption(name, "the records were not given")
    return Assumption(
        name, f"largest correlation of {min(tested)[1]}", _together([p_value for p_value, _ in tested])
    )


def _judged(found: Sequence[Assumption], level: float) -> tuple[Assumption, ...]:
    """Return the assumptions with verdicts of all tests together."""
    tested = sorted((own.p_value, place) for place, own in enumerate(found) if not math.isnan(own.p_value))
    judged, fails = list(found), True
    for rank, (p_value, place) in enumerate(tested):
        fails = fails and p_value <= level / (len(tested) - rank)
        judged[place] = replace(found[place], verdict="fails" if fails else "holds")
    return tuple(judged)
