"""Whether an input has anything to do with an output: a test of every fit against noise of any colour.

A model with a few free poles always explains something of a noisy output, and of coloured noise it may explain a
tenth: its pole goes where the noise rings.  So two explanations compete.  Either the output is noise, an
autoregression of which predicts it from its own past; or it is what the model says, plus such noise.  Both orders and
the choice between the two go by BIC.

How often the rule accepts an input that has nothing to do with the output is counted by the study
``unrelated-input``: never in 60 records of four kinds of noise, by any estimator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.noise.scores import are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution

_MAX_ORDER = 40
_ROWS_PER_LAG = 10
_SINGULAR = 1e-11  # of a column's power: what rounding leaves


def innovation_criterion(parts: Sequence[FloatArray]) -> float:
    """Return BIC of noise as an autoregression, the order chosen, up to a constant.

    Parameters
    ----------
    parts : sequence of ndarray, shape (n,) -- one for each record, each with noise of its own

    Notes
    -----
    Least squares on the lags (the covariance method): with biased autocorrelations, narrow lines would look less
    predictable than they are.  One Cholesky factor of the Gram matrix of all lags and the present has, in its last
    row, what every further lag explains.
    """
    return sum(_criterion(np.asarray(part, dtype=np.float64)) for part in parts)


def _criterion(values: FloatArray) -> float:
    n = len(values)
    most = max(0, min(_MAX_ORDER, n // _ROWS_PER_LAG))
    values = values - np.mean(values)
    power = float(values @ values) / n
    if not power > 0.0:
        return -math.inf
    scaled = values / math.sqrt(power)
    # Inner products of lags 0 .. most over the same rows for every order: from one lag to the next of both factors
    # a row comes in at the beginning and one goes at the end. So they add up along the diagonals, (lag, lag + apart).
    present = scaled[most:]
    first = np.array([float(present @ scaled[most - lag : n - lag]) for lag in range(most + 1)])
    before, after = scaled[most - 1 :: -1][:most], scaled[: n - most - 1 : -1]
    gram = np.zeros((most + 1, 2 * most + 2))
    diagonals = np.lib.stride_tricks.as_strided(
        gram, (most + 1, most + 1), (gram.strides[0] + gram.strides[1], gram.strides[1])
    )
    gram[1:, 1 : most + 1] = np.outer(before, before) - np.outer(after, after)
    diagonals[0] = first
    np.cumsum(diagonals, axis=0, out=diagonals)
    upper = gram[:, : most + 1]
    gram = np.triu(upper) + np.triu(upper, 1).T
    order = np.roll(np.arange(most + 1), -1)  # the present last
    gram = gram[np.ix_(order, order)] / (n - most)
    try:
        last = np.linalg.cholesky(gram + _SINGULAR * np.eye(most + 1))[-1]
    except np.linalg.LinAlgError:
        return -math.inf
    # After p lags the squares left over are those of the entries from p on.
    left = np.cumsum(np.square(last)[::-1])[::-1]
    by_order = n * np.log(left * power) + np.arange(most + 1) * math.log(n)
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
    with_input = innovation_criterion(residuals) + (n_parameters - n_drift) * math.log(n)
    return bool(with_input < innovation_criterion(without_drift(records, has_offset, has_ramp)))


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
