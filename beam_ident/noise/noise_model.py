"""The noise of sampled outputs: a colour and a level of its own for every record.

Maximum likelihood weighs every sample by the noise that it carries.  Within a record the noise has a
colour, an autoregression whose inverse makes residuals independent; from record to record it
has another level, by which they are divided.  Both are one linear map, applied to residuals and
gradients alike, and of determinant one, so that costs under different noise models can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError

_OFF_GRID = 1e-3  # of a period


class Whitening:
    """The inverse of an autoregression, exact from the first sample of every run on.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, c_1 .. c_p
    times_s : ndarray, shape (n,)
        Stamps on a regular grid [s]; where some are missing a new run begins.

    Raises
    ------
    EstimationError
        Stamps off a regular grid: an autoregression knows neighbours only.

    Notes
    -----
    The first samples of a run are predicted by autoregressions of lower order, from the
    backward Levinson recursion, and weighed by the variances of those predictions; so the weighed sum
    of squares is that of the exact likelihood, without samples lost.
    """

    def __init__(self, coefficients: FloatArray, times_s: FloatArray) -> None:
        steps = np.diff(times_s)
        period = float(np.median(steps))
        off = float(np.max(np.abs(steps / period - np.round(steps / period))))
        if off > _OFF_GRID:
            raise EstimationError(
                f"the stamps leave a regular grid by {off:.2g} periods; expected a regular output, in which samples "
                'may be missing, for a model of its noise. Use method="auto", which takes stamps as they are'
            )
        self.coefficients = coefficients
        first = np.flatnonzero(steps > 1.5 * period) + 1
        self._runs = list(zip([0, *first], [*first, len(times_s)], strict=True))
        self._predictors = [coefficients]
        self._weights = [1.0]
        current = coefficients
        while len(current) > 1:
            reflection = current[-1]
            left = 1.0 - reflection**2
            current = ((current - reflection * current[::-1]) / left)[:-1]
            self._predictors.insert(0, current)
            self._weights.insert(0, self._weights[0] * math.sqrt(left))

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n, ...) as the noise's innovations see them."""
        order = len(self.coefficients) - 1
        if order == 0:
            return columns
        result = np.empty_like(columns)
        for start, end in self._runs:
            run = columns[start:end]
            result[start:end] = lfilter(self.coefficients, [1.0], run, axis=0)
            for k in range(min(order, end - start)):
                result[start + k] = self._weights[k] * (self._predictors[k] @ run[k::-1])
        return result


class NoiseModel:
    """Colour and level of the noise in every record.

    Parameters
    ----------
    whitenings : sequence of Whitening or None
        Of every record; None where all noise is white, at stamps of any spacing.
    sds : ndarray, shape (n_records,) -- standard deviations of the innovations, or in proportion to them
    rows : sequence of slice -- where every record's samples stand
    """

    def __init__(
        self, whitenings: Sequence[Whitening] | None, sds: FloatArray, rows: Sequence[slice]
    ) -> None:
        self.whitenings, self.rows = whitenings, list(rows)
        sizes = np.array([part.stop - part.start for part in rows], dtype=np.float64)
        mean = float(np.average(np.log(sds), weights=sizes))
        self.levels = np.exp(np.log(sds) - mean) if len(rows) > 1 else np.ones(1)

    @property
    def colours(self) -> tuple[FloatArray, ...]:
        """1, c_1 .. c_p of every record's autoregression."""
        if self.whitenings is None:
            return tuple(np.ones(1) for _ in self.rows)
        return tuple(whitening.coefficients for whitening in self.whitenings)

    @property
    def n_parameters(self) -> int:
        """Number of coefficients beside the levels."""
        return sum(len(colour) - 1 for colour in self.colours)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n_samples, ...) as independent noise of one level sees them."""
        if len(self.rows) == 1:
            return columns if self.whitenings is None else self.whitenings[0].apply(columns)
        result = np.empty_like(columns)
        for record, (part, level) in enumerate(zip(self.rows, self.levels, strict=True)):
            own = columns[part]
            if self.whitenings is not None:
                own = self.whitenings[record].apply(own)
            np.divide(own, level, out=result[part])
        return result
