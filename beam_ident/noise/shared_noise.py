"""Noise that outputs share: one camera's shake, one lamp's flicker, one cable's hum.

What is left of every output once it is weighed by its own noise is independent from instant to instant, not from
output to output. At the instants at which outputs were sampled together it has a correlation C, and what weighs by
its inverse (generalised least squares over outputs) is the most precise estimate and states the right intervals.
Equal weights are unbiased all the same, but take m outputs for m witnesses where there may be one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray

_MIN_INSTANTS = 2  # instants for each output: a covariance of m outputs is regular from m instants on
_MIN_EIGENVALUE = 1e-6  # eigenvalue of a correlation: half of the digits that its inverse has


@dataclass(frozen=True, eq=False)
class SharedNoise:
    """Correlation between outputs at instants at which they were sampled together.

    Attributes
    ----------
    correlation : ndarray, shape (n_outputs, n_outputs)
    rows : ndarray of int, shape (n_instants, n_outputs) -- row of each output at each instant, -1 where it has none
    """

    correlation: FloatArray
    rows: IndexArray

    @staticmethod
    def of(white: Sequence[FloatArray], rows: IndexArray) -> SharedNoise | None:
        """Return the correlation that BIC prefers to none; None where outputs seem to share nothing.

        Parameters
        ----------
        white : sequence of ndarray -- what every output leaves, weighed by its own noise, each (n_rows,)
        rows : ndarray of int, shape (n_instants, n_outputs)
        """
        n_outputs = len(white)
        if n_outputs < 2:
            return None
        scaled = [own / max(math.sqrt(float(np.mean(np.square(own)))), 1e-300) for own in white]
        correlation = np.eye(n_outputs)
        n_pairs = 0
        for j in range(n_outputs):
            for k in range(j):
                both = (rows[:, j] >= 0) & (rows[:, k] >= 0)
                if np.count_nonzero(both) > _MIN_INSTANTS * n_outputs:
                    one, other = scaled[j][rows[both, j]], scaled[k][rows[both, k]]
                    size = max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-300)
                    correlation[j, k] = correlation[k, j] = float(one @ other) / size
                    n_pairs += 1
        found = SharedNoise(regular_correlation(correlation), rows)
        gain = sum(
            -len(own) * float(np.linalg.slogdet(found.correlation[np.ix_(seen, seen)])[1])
            for seen, own in _patterns(rows)
        )
        return found if n_pairs and gain > n_pairs * math.log(len(rows)) else None

    def share(self, output: int) -> float:
        """Return how much of an output's noise the noise of all others tells, between 0 and 1."""
        return 1.0 - 1.0 / float(np.linalg.inv(self.correlation)[output, output])

    def unshared(self, columns: Sequence[FloatArray], places: Sequence[slice]) -> list[FloatArray]:
        """Return rows as noise sees them that no output shares with those before it.

        Parameters
        ----------
        columns : sequence of ndarray -- of every output, weighed by its own noise, each (n_rows, n_columns)
        places : sequence of slice -- which of its rows these are
        """
        result = [own.copy() for own in columns]
        for seen, rows in self._within(places):
            factor = np.linalg.inv(np.linalg.cholesky(self.correlation[np.ix_(seen, seen)]))
            together = np.stack([columns[output][own] for output, own in zip(seen, rows.T, strict=True)])
            for output, own, mixed in zip(seen, rows.T, np.tensordot(factor, together, axes=1), strict=True):
                result[output][own] = mixed
        return result

    def excess(self, designs: Sequence[FloatArray], places: Sequence[slice]) -> FloatArray:
        """Return by how much the covariance of the score exceeds that of outputs which share nothing.

        Parameters
        ----------
        designs : sequence of ndarray -- derivatives of every output by all parameters, each (n_rows, n_parameters)
        places : sequence of slice -- which of its rows these are
        """
        total = np.zeros((designs[0].shape[1],) * 2)
        for seen, rows in self._within(places):
            between = self.correlation[np.ix_(seen, seen)] - np.eye(len(seen))
            together = np.stack([designs[output][own] for output, own in zip(seen, rows.T, strict=True)])
            total += np.tensordot(np.tensordot(between, together, axes=1), together, axes=((0, 1), (0, 1)))
        return total

    def told_by_others(self, designs: Sequence[FloatArray], output: int) -> FloatArray:
        """Return the covariance of an output's noise, row by row, with the score that all others have.

        Parameters
        ----------
        designs : sequence of ndarray -- of every output by the same parameters, each (n_rows, n_parameters)
        output : int
        """
        result = np.zeros_like(designs[output])
        for other in range(len(designs)):
            both = (self.rows[:, output] >= 0) & (self.rows[:, other] >= 0)
            if other != output:
                own, there = self.rows[both, output], self.rows[both, other]
                result[own] += self.correlation[output, other] * designs[other][there]
        return result

    def _within(self, places: Sequence[slice]) -> Iterator[tuple[IndexArray, IndexArray]]:
        """Yield the outputs that were seen together, and their rows within some places."""
        starts = np.array([own.start for own in places])
        rows = self.rows - starts
        is_here = (self.rows >= 0) & (rows >= 0) & (rows < np.array([own.stop for own in places]) - starts)
        yield from _patterns(np.where(is_here, rows, -1))


def together(times: Sequence[FloatArray], rows: Sequence[IndexArray]) -> tuple[FloatArray, IndexArray]:
    """Merge the instants of all outputs; each has its times and the rows that they stand in.

    Returns
    -------
    tuple
        Distinct times, shape (n_instants,), and the row of each output at each of them, -1 where it has none.
    """
    distinct = times[0]
    if not all(np.array_equal(distinct, own) for own in times[1:]):
        distinct = np.unique(np.concatenate(times))
    table = np.full((len(distinct), len(times)), -1, dtype=np.intp)
    for output, (instants, places) in enumerate(zip(times, rows, strict=True)):
        table[np.searchsorted(distinct, instants), output] = places
    return distinct, table


def _patterns(rows: IndexArray) -> Iterator[tuple[IndexArray, IndexArray]]:
    """Yield every set of outputs that were seen together, and their rows, shape (n_instants, n_seen)."""
    kinds, which = np.unique(rows >= 0, axis=0, return_inverse=True)
    for number, kind in enumerate(kinds):
        seen = np.flatnonzero(kind)
        if len(seen) > 1:
            yield seen, rows[np.ravel(which) == number][:, seen]


def regular_correlation(correlation: FloatArray) -> FloatArray:
    """Return the nearest correlation whose inverse can be taken: pairs that were seen apart need not make one."""
    values, vectors = np.linalg.eigh(correlation)
    covariance = (vectors * np.maximum(values, _MIN_EIGENVALUE)) @ vectors.T
    sds = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sds, sds))
