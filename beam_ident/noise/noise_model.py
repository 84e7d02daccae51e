"""The noise of sampled outputs: a colour, a level and tails of its own for every record.

Maximum likelihood weighs every sample by the noise that it carries.  Within a record the noise has a
colour, whose inverse makes residuals independent: an autoregression at the stamps of a clock
(``Whitening``), a process in continuous time at any others (``noise.continuous_noise``).  It may have outliers,
which weigh by Student's t (``noise.heavy_tails``) or, under a colour, are left out, and it may be less than the
steps to which values are rounded (``noise.rounding``).  From record to record it has another level, by which they
are divided.  All are linear maps, applied to residuals and gradients alike, and costs under different noise models
can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.noise.autoregression import autoregression, score_covariance
from beam_ident.noise.continuous_noise import ContinuousWhitening, continuous_noise
from beam_ident.noise.heavy_tails import HeavyTails
from beam_ident.noise.outliers import outliers, spoiling
from beam_ident.noise.rounding import RoundedNoise
from beam_ident.numerics.convolution import causal_convolution

_OFF_GRID = 1e-3  # of a period
_FEW_BREAKS = 0.02  # of the samples: with so few gaps an autoregression knows its neighbours


class Whitening:
    """The inverse of an autoregression, exact from the first sample of every run on.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, c_1 .. c_p
    times_s : ndarray, shape (n,)
        Stamps on a regular grid [s]; where some are missing a new run begins.

    Notes
    -----
    The first samples of a run are predicted by autoregressions of lower order, from the
    backward Levinson recursion, and weighed by the variances of those predictions; so the weighed sum
    of squares is that of the exact likelihood, without samples lost.
    """

    def __init__(self, coefficients: FloatArray, times_s: FloatArray) -> None:
        steps = np.diff(times_s)
        self.coefficients = coefficients
        first = np.flatnonzero(steps > 1.5 * float(np.median(steps))) + 1 if len(steps) else steps.astype(int)
        self._runs = list(zip([0, *first], [*first, len(times_s)], strict=True))
        self._starts_and_ends = np.append(0, first), np.append(first, len(times_s))
        self._predictors = [coefficients]
        self._weights = [1.0]
        current = coefficients
        while len(current) > 1:
            reflection = current[-1]
            left = 1.0 - reflection**2
            current = ((current - reflection * current[::-1]) / left)[:-1]
            self._predictors.insert(0, current)
            self._weights.insert(0, self._weights[0] * math.sqrt(left))

    @property
    def n_parameters(self) -> int:
        """Number of parameters beside the variance."""
        return len(self.coefficients) - 1

    def __str__(self) -> str:
        """Return what the noise is, in words."""
        return f"an autoregression of order {self.n_parameters}" if self.n_parameters else "white noise"

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the map: the first samples of every run weigh less."""
        logs = np.cumsum([0.0, *np.log(self._weights[:-1])])
        return float(sum(logs[min(end - start, len(logs) - 1)] for start, end in self._runs))

    def score_covariance(self, design: FloatArray) -> FloatArray:
        """Return ``D^T R D`` for this noise's correlation R and the derivatives D, shape (n, n_parameters)."""
        parts = [design[start:end] for start, end in self._runs]
        return np.asarray(sum(score_covariance(own, self.coefficients) for own in parts))

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n, ...) as the noise's innovations see them."""
        return self.continued(columns, 0, ())[0]

    def continued(
        self, columns: FloatArray, begin: int, memory: tuple[FloatArray, ...]
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Return the same of some rows, and what is to be known of them for the next ones.

        Parameters
        ----------
        columns : ndarray, shape (n, ...)
        begin : int -- number of the first of these rows
        memory : tuple of ndarray -- of the rows before; empty for the first ones
        """
        order = len(self.coefficients) - 1
        if order == 0:
            return columns, ()
        joined = np.concatenate([memory[0], columns]) if memory else columns
        known = begin - (len(joined) - len(columns))  # number of the first row in ``joined``
        # As if all were one run; a prediction looks back by the order, and that many rows before are in ``joined``.
        result = causal_convolution(self.coefficients, joined, axis=0)[len(joined) - len(columns) :]
        starts, ends = self._starts_and_ends
        for k in range(order):
            # The k-th rows of all runs have k rows before them.
            rows = (starts + k)[
                (starts + k < ends) & (starts + k >= begin) & (starts + k < begin + len(columns))
            ]
            before = joined[rows[:, None] - np.arange(k + 1) - known]
            result[rows - begin] = self._weights[k] * np.einsum("rk...,k->r...", before, self._predictors[k])
        return result, (joined[max(len(joined) - order, 0) :].copy(),)


Colour = Whitening | ContinuousWhitening


def colour_of(
    residuals: FloatArray,
    times_s: FloatArray,
    doubt: FloatArray | None = None,
    near: Colour | None = None,
) -> Colour:
    """Return the colour that BIC prefers for residuals: an autoregression at a clock's stamps, or continuous.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    times_s : ndarray, shape (n,) -- rising [s]
    doubt : ndarray or None, shape (n, n_parameters) -- U of (I.24), what the model is not known by
    near : Whitening or ContinuousWhitening or None
        What was chosen for residuals almost like these: a process in continuous time keeps its form.

    Notes
    -----
    A clock that misses samples here and there leaves the choice between both to BIC.
    """
    steps = np.diff(times_s)
    period = float(np.median(steps))
    white = Whitening(np.ones(1), times_s)
    is_on_grid = float(np.max(np.abs(steps / period - np.round(steps / period)))) < _OFF_GRID
    found: Colour = white
    if is_on_grid:
        found = Whitening(autoregression(residuals, doubt=doubt), times_s)
        if np.count_nonzero(steps > 1.5 * period) < _FEW_BREAKS * len(steps):
            return found
    known = near.noise if isinstance(near, ContinuousWhitening) else None
    process = continuous_noise(residuals, times_s, doubt, known)
    every = np.reshape(residuals - np.mean(residuals), (-1, 1))
    if doubt is not None:
        every = np.concatenate([residuals[:, None], doubt], axis=1)
    if process is None:
        return found if is_on_grid and _criterion(found, every) < _criterion(white, every) else white
    try:
        continuous = ContinuousWhitening(process, times_s)
    except LinAlgError:
        return found
    return min((found, continuous), key=lambda colour: _criterion(colour, every))


def _criterion(colour: Colour, every: FloatArray) -> float:
    """Return BIC of residuals and doubts, shape (n, 1 + n_doubts), under a colour, up to a constant."""
    left, n = colour.apply(every), len(every)
    scaled = 0.0 if isinstance(colour, ContinuousWhitening) else colour.log_determinant
    misfit = n * math.log(max(float(np.sum(np.square(left))), 1e-300)) - 2.0 * scaled
    return misfit + colour.n_parameters * math.log(n)


@dataclass(frozen=True, eq=False)
class RecordNoise:
    """Colour, tails and rounding of the noise in one record.

    Attributes
    ----------
    colour : Whitening or ContinuousWhitening -- of the samples that are kept
    kept : ndarray of bool or None, shape (n,) -- which samples count; None is all
    tails : HeavyTails or None
    rounding : RoundedNoise or None
    """

    colour: Colour
    kept: BoolArray | None = None
    tails: HeavyTails | None = None
    rounding: RoundedNoise | None = None

    @staticmethod
    def of(
        values: FloatArray,
        residuals: FloatArray,
        times_s: FloatArray,
        doubt: FloatArray | None = None,
        near: Colour | None = None,
    ) -> RecordNoise:
        """Return the noise that residuals show.

        Parameters
        ----------
        values, residuals : ndarray, shape (n,) -- as they were measured, and less the model
        times_s : ndarray, shape (n,) -- rising [s]
        doubt : ndarray or None, shape (n, n_parameters) -- U of (I.24), what the model is not known by
        near : Whitening or ContinuousWhitening or None -- the colour of residuals almost like these

        Notes
        -----
        Outliers are left out by the rule of ``noise.outliers``, which takes 6 in 10 million samples of Gaussian
        noise; a filter would smear them over their neighbours. What is left weighs by its colour, or, where it is
        white, by Student's t. Coarse rounding weighs by the likelihood of its intervals: the colour that
        rounding errors have of the signal is none of the noise.
        """
        far, rounding = outliers(residuals), RoundedNoise.of(values, residuals)
        if rounding is not None:  # errors of a step stand alone where the signal seldom comes near an edge
            far = far[np.abs(residuals[far]) > rounding.step]
        if not spoiling(residuals, far):
            if rounding is not None:
                return RecordNoise(Whitening(np.ones(1), times_s), rounding=rounding)
            return RecordNoise(colour_of(residuals, times_s, doubt, near))
        kept = np.ones(len(residuals), dtype=bool)
        kept[far] = False
        colour = colour_of(residuals[kept], times_s[kept], None if doubt is None else doubt[kept], near)
        if colour.n_parameters:
            return RecordNoise(colour, kept)
        return RecordNoise(Whitening(np.ones(1), times_s), tails=HeavyTails.of(residuals, kept))

    def followed(self, residuals: FloatArray, is_near: bool = True) -> RecordNoise:
        """Return the same noise, outliers included, with the weights that other residuals have under it.

        Parameters
        ----------
        residuals : ndarray, shape (n,)
        is_near : bool -- whether the optimum is so near that weights need no caution
        """
        if self.rounding is not None:
            return RecordNoise(self.colour, rounding=self.rounding.followed(residuals, not is_near))
        return self if self.tails is None else RecordNoise(self.colour, tails=self.tails.followed(residuals))

    @property
    def is_plain(self) -> bool:
        """Whether the noise is white, without outliers, and not rounded away."""
        parts = (self.kept, self.tails, self.rounding)
        return all(part is None for part in parts) and not self.colour.n_parameters

    @property
    def follows(self) -> bool:
        """Whether weights go with the residuals."""
        return self.tails is not None or self.rounding is not None

    @property
    def is_cautious(self) -> bool:
        """Whether weights are those of the way to the optimum."""
        return self.rounding is not None and self.rounding.is_cautious

    def moved(self, values: FloatArray) -> FloatArray:
        """Return values, or what a model leaves of them, as least squares takes them."""
        return values if self.rounding is None else values + self.rounding.shift

    @property
    def n_parameters(self) -> int:
        """Number of parameters beside the level."""
        return self.colour.n_parameters + (self.tails is not None)

    def counted(self, residuals: FloatArray) -> FloatArray:
        """Return the residuals that are no outliers."""
        kept = self.kept if self.tails is None else self.tails.kept
        return residuals if kept is None else residuals[kept]

    @property
    def inflation(self) -> float:
        """By what the variance of the weighed residuals grows to be that which the covariance takes."""
        if self.tails is not None:
            return self.tails.inflation
        return 1.0 if self.kept is None else len(self.kept) / np.count_nonzero(self.kept)

    @property
    def expected(self) -> float:
        """Power that the noise should leave in the weighed residuals, over what it leaves.

        Under coarse rounding a few samples near an edge leave most, so that their power scatters far more than the
        likelihood of all knows sigma.
        """
        if self.rounding is None:
            return 1.0
        weighed = self.apply(self.moved(self.rounding.residuals))
        return self.rounding.sigma**2 / max(float(np.mean(np.square(weighed))), 1e-300)

    @property
    def excess(self) -> float:
        """What the cost of the weighed squares lacks to be the negative log-likelihood."""
        own = self.tails or self.rounding
        if own is None:
            return 0.0
        weighed = self.apply(self.moved(own.residuals))
        return own.cost - 0.5 * len(weighed) * math.log(float(weighed @ weighed))

    def __str__(self) -> str:
        """Return what the noise is, in words."""
        if self.tails is not None:
            return str(self.tails)
        if self.rounding is not None:
            return str(self.rounding)
        beside = "" if self.kept is None else f" without {np.count_nonzero(~self.kept)} outliers"
        return f"{self.colour}{beside}"

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n, ...) as independent noise sees them."""
        return NoisePass(self).apply(columns)


class NoisePass:
    """The rows of a record as independent noise sees them, piece by piece.

    Parameters
    ----------
    noise : RecordNoise -- of all rows
    """

    def __init__(self, noise: RecordNoise) -> None:
        self.noise = noise
        self._seen = self._kept = 0
        self._memory: tuple[FloatArray, ...] = ()

    def moved(self, residuals: FloatArray) -> FloatArray:
        """Return the residuals of the next rows as least squares takes them, shape (n,)."""
        if self.noise.rounding is None:
            return residuals
        return np.asarray(residuals + self.noise.rounding.shift[self._seen : self._seen + len(residuals)])

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return the next rows, shape (n, ...)."""
        noise, rows = self.noise, slice(self._seen, self._seen + len(columns))
        self._seen = rows.stop
        weighing = noise.tails or noise.rounding
        if weighing is not None:
            roots = np.sqrt(weighing.weights[rows])
            return np.asarray(columns * roots.reshape(-1, *([1] * (columns.ndim - 1))))
        if noise.kept is None:
            return self._whitened(columns)
        result, kept = np.zeros_like(columns), noise.kept[rows]
        result[kept] = self._whitened(columns[kept])
        return result

    def _whitened(self, columns: FloatArray) -> FloatArray:
        white, self._memory = self.noise.colour.continued(columns, self._kept, self._memory)
        self._kept += len(columns)
        return white


class NoiseModel:
    """Colour, tails and level of the noise in every record.

    Parameters
    ----------
    noises : sequence of RecordNoise or None
        Of every record; None where all noise is white and without outliers.
    sds : ndarray, shape (n_records,) -- standard deviations of the innovations, or in proportion to them
    rows : sequence of slice -- where every record's samples stand
    """

    def __init__(self, noises: Sequence[RecordNoise] | None, sds: FloatArray, rows: Sequence[slice]) -> None:
        self.noises, self.rows = noises, list(rows)
        sizes = np.array([part.stop - part.start for part in rows], dtype=np.float64)
        mean = float(np.average(np.log(sds), weights=sizes))
        self.levels = np.exp(np.log(sds) - mean) if len(rows) > 1 else np.ones(1)
        share = sizes / np.sum(sizes)
        self.inflation = (
            1.0 if noises is None else float(share @ [own.inflation * own.expected for own in noises])
        )
        self.excess = 0.0 if noises is None else sum(own.excess for own in noises)

    @property
    def is_plain(self) -> bool:
        """Whether no record has a colour or outliers."""
        return self.noises is None or all(own.is_plain for own in self.noises)

    @property
    def is_rounded(self) -> bool:
        """Whether some record weighs by the likelihood of its intervals."""
        return self.noises is not None and any(own.rounding is not None for own in self.noises)

    @property
    def is_cautious(self) -> bool:
        """Whether weights of some record are those of the way to the optimum."""
        return self.noises is not None and any(own.is_cautious for own in self.noises)

    def moved(self, values: FloatArray) -> FloatArray:
        """Return values of all records, or what a model leaves of them, as least squares takes them."""
        if self.noises is None or not self.is_rounded:
            return values
        pairs = zip(self.noises, self.rows, strict=True)
        return np.concatenate([own.moved(values[part]) for own, part in pairs])

    @property
    def colours(self) -> tuple[FloatArray, ...]:
        """1, c_1 .. c_p of every record's autoregression; 1 alone where it has none."""
        if self.noises is None:
            return tuple(np.ones(1) for _ in self.rows)
        return tuple(own.colour.coefficients for own in self.noises)

    @property
    def n_parameters(self) -> int:
        """Number of parameters beside the levels."""
        return 0 if self.noises is None else sum(own.n_parameters for own in self.noises)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n_samples, ...) as independent noise of one level sees them."""
        if len(self.rows) == 1:
            return columns if self.noises is None else self.noises[0].apply(columns)
        result = np.empty_like(columns)
        for record, (part, level) in enumerate(zip(self.rows, self.levels, strict=True)):
            own = columns[part]
            if self.noises is not None:
                own = self.noises[record].apply(own)
            np.divide(own, level, out=result[part])
        return result
