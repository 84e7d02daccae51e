"""What one record of several contributes to a fit: its samples, its noise, and what belongs to it alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.noise.scores import Scores, Whiteness


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One output of one record: what was measured and what the model says.

    Attributes
    ----------
    name : str -- of the record
    times_s, measured, modelled, residuals : ndarray, shape (n_used,)
        The samples that entered the fit; times on the record's own axis.
    noise_sd : float -- of this record's noise, by which it was weighed
    scores : Scores
    whiteness : Whiteness -- of the residuals, or of the innovations of their autoregression
    offset, ramp : float -- at the middle of the record, and over its whole length
    noise_coefficients : ndarray
        1, c_1 .. c_p of an autoregression that the estimator gave this record's noise; 1 alone otherwise.
    noise : str -- what the estimator took the noise for, in words; empty for white noise without outliers
    spread : ndarray -- the noise of every sample over the record's; one number where it is the same for all
    innovations : ndarray
        What the estimator's weights make of the residuals, white where the noise is what it was taken for; empty
        where ``noise_coefficients`` say it all.
    """

    name: str
    times_s: FloatArray
    measured: FloatArray
    modelled: FloatArray
    residuals: FloatArray
    noise_sd: float
    scores: Scores
    whiteness: Whiteness
    offset: float
    ramp: float
    noise_coefficients: FloatArray = field(default_factory=lambda: np.ones(1))
    noise: str = ""
    spread: FloatArray = field(default_factory=lambda: np.ones(1))
    innovations: FloatArray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False, kw_only=True)
class OverOneOutput:
    """What a result says over the samples of one output.

    Attributes
    ----------
    times_s, measured, modelled, residuals : ndarray, shape (n_used,)
        The samples that entered the fit, in the order of the records; stamps in s.
    noise_coefficients : ndarray
        1, c_1 .. c_p of an autoregression of the noise, 1 alone where it has none; of the first record.
    records : tuple of RecordFit -- the same record by record
    scores : Scores -- with several records, each about its own mean
    whiteness : Whiteness
        Of the residuals, or of the innovations of their autoregression; in units of each record's level.
    condition : float -- of the scaled information matrix
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    times_s: FloatArray
    measured: FloatArray
    modelled: FloatArray
    residuals: FloatArray
    noise_coefficients: FloatArray
    records: tuple[RecordFit, ...]
    scores: Scores
    whiteness: Whiteness
    condition: float
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]


class OverOutputs:
    """What a result says over its ``outputs``: a tuple with one of each for every output.

    Attributes
    ----------
    times_s, measured, modelled, residuals : tuple of ndarray, each (n_used,) -- stamps in s
    scores : tuple of Scores
    whiteness : tuple of Whiteness
    records : tuple of tuple of RecordFit -- of every output, record by record
    """

    outputs: tuple[Any, ...]

    @property
    def times_s(self) -> tuple[FloatArray, ...]:
        """Stamps of the samples used, of every output [s]."""
        return tuple(output.times_s for output in self.outputs)

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """Samples used, of every output."""
        return tuple(output.measured for output in self.outputs)

    @property
    def modelled(self) -> tuple[FloatArray, ...]:
        """What the model says there, of every output."""
        return tuple(output.modelled for output in self.outputs)

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Measured less modelled, of every output."""
        return tuple(output.residuals for output in self.outputs)

    @property
    def records(self) -> tuple[tuple[RecordFit, ...], ...]:
        """What belongs to each record, of every output."""
        return tuple(output.records for output in self.outputs)

    @property
    def scores(self) -> tuple[Scores, ...]:
        """Agreement, of every output."""
        return tuple(output.scores for output in self.outputs)

    @property
    def whiteness(self) -> tuple[Whiteness, ...]:
        """Whiteness of the residuals, of every output."""
        return tuple(output.whiteness for output in self.outputs)


def in_units_of_level(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the residuals of several records in a row, each in units of its own level; of one as they are.

    Tests of whiteness take the variance to be one and the same everywhere.
    """
    if len(parts) == 1:
        return parts[0]
    sizes = [max(float(np.linalg.norm(part)), 1e-300) / math.sqrt(max(len(part), 1)) for part in parts]
    return np.concatenate([part / size for part, size in zip(parts, sizes, strict=True)])


def pooled_scores(records: Sequence[tuple[FloatArray, FloatArray]]) -> Scores:
    """Return scores over several records, each about its own mean.

    About a mean of all of them, records that differ by an offset would score for their offsets.

    Parameters
    ----------
    records : sequence of (values, residuals) -- each of shape (n,)
    """
    if len(records) == 1:
        return Scores.of(*records[0])
    values = np.concatenate([own - np.mean(own) for own, _ in records])
    return Scores.of(values, np.concatenate([left for _, left in records]))
