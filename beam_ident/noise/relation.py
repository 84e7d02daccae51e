"""Whether an input has anything to do with an output: a test of every fit against noise of any colour.

A model with a few free poles always explains something of a noisy output, and of coloured noise it may explain a
tenth: its pole goes where the noise rings.  So two explanations compete.  Either the output is noise, an
autoregression of which predicts it from its own past; or it is what the model says, plus such noise.  Both orders and
the choice between the two go by BIC.

How often the rule accepts an input that has nothing to do with the output is counted by the study
``unrelated-input``: never in 240 records of four kinds of noise, by any estimator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.noise.scores import are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution

_MAX_ORDER = 40
_GROWTH = 1.3  # of the distance, from one mean of values before that to the next
_MAX_ROWS, _CHUNKS = 40_000, 8  # of a long record: so many, in so many stretches
_ROWS_PER_LAG = 10
_SINGULAR = 1e-11  # of a column's power: what rounding leaves


def innovation_criterion(parts: Sequence[FloatArray]) -> float:
    """Return BIC of noise as an autoregression, the order chosen, up to a constant.

    Parameters
    ----------
    parts : sequence of ndarray, shape (n,) -- one for each record, each with noise of its own

    Notes
    -----
    Least squares (the covariance method: with biased autocorrelations, narrow lines would look less predictable than
    they are) on the values before, one by one, and on means of those before them, over times that grow with the
    distance: noise that rings or drifts slowly beside the sampling is known by nothing less.  One Cholesky factor of
    the Gram matrix of all these and the present has, in its last row, what every further one explains.
    """
    return sum(_criterion(np.asarray(part, dtype=np.float64)) for part in parts)


def _regressors(n: int) -> tuple[list[int], IndexArray]:
    """Return where means of the past of n values end, the longest lag first among them, and the rows that count."""
    most = max(0, min(_MAX_ORDER, n // _ROWS_PER_LAG))
    borders = [most]
    while most and (following := math.ceil(_GROWTH * borders[-1])) <= n // _ROWS_PER_LAG:
        borders.append(following)
    rows = np.arange(most, n)
    if len(rows) > _MAX_ROWS:
        chunks = np.array_split(rows, _CHUNKS)
        rows = np.concatenate([own[: _MAX_ROWS // _CHUNKS] for own in chunks])
    return borders, rows


def _white_criterion(values: FloatArray) -> float:
    """Return what ``_criterion`` does where no value before counts: no less than the best order gives."""
    _, rows = _regressors(len(values))
    power = float(np.mean(np.square(values[rows] - np.mean(values))))
    return len(values) * math.log(power) if power > 0.0 else -math.inf


def _criterion(values: FloatArray) -> float:
    n = len(values)
    values = values - np.mean(values)
    power = float(values @ values) / n
    if not power > 0.0:
        return -math.inf
    scaled = values / math.sqrt(power)
    borders, rows = _regressors(n)
    most, longest = borders[0], borders[-1]
    # A blow or a step at the beginning is half of what many a record tells: its first value stands for all before.
    sums = np.cumsum(np.concatenate([[0.0], np.full(longest, scaled[0]), scaled]))
    columns = np.empty((most + len(borders), len(rows)))
    for lag in range(1, most + 1):
        np.take(scaled, rows - lag, out=columns[lag - 1])
    for k, (near, far) in enumerate(pairwise(borders), start=most):
        columns[k] = (sums[rows + longest - near] - sums[rows + longest - far]) / (far - near)
    np.take(scaled, rows, out=columns[-1])
    gram = columns @ columns.T / len(rows)
    try:
        last = np.linalg.cholesky(gram + _SINGULAR * np.eye(len(gram)))[-1]
    except np.linalg.LinAlgError:
        return -math.inf
    # After p regressors the squares left over are those of the entries from p on.
    left = np.cumsum(np.square(last)[::-1])[::-1]
    by_order = n * np.log(left * power) + np.arange(len(left)) * math.log(n)
    return float(np.min(by_order))


def is_related(
    records: Sequence[tuple[FloatArray, FloatArray]],
    residuals: Sequence[FloatArray],
    n_parameters: int,
    has_offset: bool,
    has_ramp: bool,
) -> bool:
    """Return whether a model of an output explains more than noise of any colour would.

    Parameters
    ----------
    records : sequence of (times [s], measured) -- each of shape (n,)
    residuals : sequence of ndarray, shape (n,) -- of every record
    n_parameters : int -- of the model
    has_offset, has_ramp : bool -- what the model has beside the input's path
    """
    if all(are_rounding(measured, left) for (_, measured), left in zip(records, residuals, strict=True)):
        return True
    n = sum(len(left) for left in residuals)
    n_drift = (int(has_offset) + int(has_ramp)) * len(records)
    without_input = innovation_criterion(without_drift(records, has_offset, has_ramp))
    return leaves_less(residuals, (n_parameters - n_drift) * math.log(n), without_input)


def leaves_less(residuals: Sequence[FloatArray], penalty: float, criterion: float) -> bool:
    """Return whether residuals, with a penalty for what left them, have a smaller BIC than a criterion.

    Mostly they do as white noise already, and the autoregression need not be made.
    """
    white = sum(map(_white_criterion, residuals))
    return white + penalty < criterion or innovation_criterion(residuals) + penalty < criterion


def without_drift(
    records: Sequence[tuple[FloatArray, FloatArray]], has_offset: bool, has_ramp: bool
) -> list[FloatArray]:
    """Return what offset and ramp, where a model has them, leave of every record."""
    left = []
    for times_s, measured in records:
        columns = [np.ones_like(times_s)] if has_offset else []
        if has_ramp:
            columns.append((times_s - times_s.mean()) / float(np.ptp(times_s)))
        if columns:
            known = np.stack(columns, axis=1)
            measured = measured - known @ LinearSolution.of(known).coefficients(measured)
        left.append(measured)
    return left
