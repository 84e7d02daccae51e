"""Gross outliers among residuals: single samples that no noise of the others explains.

Least squares weighs an error by its square, so that one sample in a hundred can bias a whole model.
A sample counts where it stands far off both in the record and among its neighbours, in
robust standard deviations (1.4826 times the median absolute deviation, which outliers hardly move;
Huber and Ronchetti 2009, ch. 5).  Noise that swells, or a motion that the model misses, stands off from the
record but not from its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.noise.record_fit import RecordFit
from beam_ident.noise.scores import are_rounding

_FAR = 5.0  # robust standard deviations
_GROSS = 10.0  # the same, beyond which one sample alone is reported
_TO_SIGMA = 1.4826  # of Gaussian noise, from the median absolute deviation
_NEIGHBOURS = 25  # samples on each side
_MIN_COUNT = 3  # samples that are reported


def outliers(residuals: FloatArray, far: float = _FAR) -> IndexArray:
    """Return which residuals of a record, in the order of their stamps, are gross outliers.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    far : float -- robust standard deviations from which on a sample counts

    Returns
    -------
    places : ndarray of int, shape (n_outliers,)
    """
    away = np.abs(residuals - np.median(residuals))
    # Where at most half of them are nearer than this, the spread is so large that the farthest is no outlier.
    near = float(np.max(away, initial=0.0)) / (far * _TO_SIGMA)
    if 2 * np.count_nonzero(away < near) < len(away):
        return np.empty(0, dtype=np.intp)
    places = np.flatnonzero(away > far * _TO_SIGMA * np.median(away))
    if not len(places):
        return places
    width = min(_NEIGHBOURS, len(residuals))
    last = len(residuals) - width
    stands_off = np.ones(len(places), dtype=bool)
    # Where noise begins to swell, one side is quiet: it must stand off from both.
    for first in (places - width, places + 1):
        around = residuals[np.clip(first, 0, last)[:, None] + np.arange(width)]
        middle = np.median(around, axis=1)
        own_spread = _TO_SIGMA * np.median(np.abs(around - middle[:, None]), axis=1)
        # Where more than half of them agree exactly, as rounded values do, nothing is known of their spread.
        stands_off &= (own_spread > 0.0) & (np.abs(residuals[places] - middle) > far * own_spread)
    return np.asarray(places[stands_off])


def spoiling(residuals: FloatArray, places: IndexArray) -> bool:
    """Return whether outliers of a record are enough to report: several, or a gross one.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    places : ndarray of int -- what ``outliers`` found
    """
    return len(places) >= _MIN_COUNT or (len(places) > 0 and len(outliers(residuals, _GROSS)) > 0)


def outlier_warning(outputs: Sequence[tuple[str, Sequence[RecordFit]]]) -> str:
    """Return a warning of the outliers of outputs over all their records, or an empty string.

    Parameters
    ----------
    outputs : sequence of (name, records) -- of every output
    """
    found, treatments = [], []
    for name, records in outputs:
        seen = [
            own
            for own in records
            if not are_rounding(own.measured, own.residuals) and "rounding" not in own.noise
        ]
        count = sum(len(outliers(own.residuals / own.spread)) for own in seen)
        if count >= _MIN_COUNT or (
            count and any(len(outliers(own.residuals / own.spread, _GROSS)) for own in seen)
        ):
            found.append(f"{count} of {sum(len(own.residuals) for own in records)} samples of {name}")
            treatments += [own.noise for own in seen if "outliers" in own.noise or "Student" in own.noise]
    if not found:
        return ""
    said = (
        f"Outliers: {', '.join(found)} stand more than {_FAR:.0f} robust standard deviations off, alone among their "
        "neighbours"
    )
    if treatments:
        return f"{said}. They are weighed as what they are: {'; '.join(dict.fromkeys(treatments))}."
    return (
        f"{said}, and bias the fit. Set them to NaN (not seen) and fit again, unless they are jumps that "
        "the model misses."
    )
