"""What errors that several outputs, or neighbouring lines, have in common add to the covariance of a fit to lines.

A fit takes every line of every output for an observation of its own.  Noise of the input is in all outputs at once,
and a response of one record shares data from line to line: the estimate stays, its scatter grows.  With the score
``s = J^T W e`` of covariance ``J^T W J + M`` the covariance C of the fit becomes ``C + C M C``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal.fit import ModalFit
from beam_ident.noise.autoregression import excess_over_lines


def from_common_noise(
    fit: ModalFit, jacobians: Sequence[FloatArray], records: Sequence[FrequencyRecord]
) -> FloatArray:
    """Return what is added where errors of several pairs of output and input depend on each other.

    Parameters
    ----------
    fit : ModalFit -- to lines weighed by the variances of the records
    jacobians : sequence of ndarray, shape (2 n_lines, n_parameters)
        Of every pair, inputs varying quickest, over the noise: real parts above imaginary ones, record by record.
    records : sequence of FrequencyRecord -- nothing is added unless all have a ``covariance``

    Notes
    -----
    ``M = J^T (S - 1) J`` with S the correlation of the weighted errors between pairs.  For circular errors of
    correlation ``rho = a + jb`` the real parts correlate by a, and the real part of one with the imaginary part of
    the other by b.
    """
    middle, places = np.zeros_like(fit.covariance), list(_places(fit))
    if any(record.covariance is None for record in records):
        return middle
    for record, rows in rows_by_record(records):
        n = record.n_lines
        assert record.covariance is not None
        sd = np.sqrt(np.maximum(np.einsum("lpp->lp", record.covariance).real, 1e-300))
        for i in range(len(places)):
            for j in range(i):
                rho = np.nan_to_num(record.covariance[:, i, j] / (sd[:, i] * sd[:, j]))[:, None]
                one, other = jacobians[i][rows], jacobians[j][rows]
                real, imaginary = other[:n], other[n:]
                shared = [rho.real * real - rho.imag * imaginary, rho.imag * real + rho.real * imaginary]
                part = one.T @ np.concatenate(shared)
                middle[np.ix_(places[i], places[j])] += part
                middle[np.ix_(places[j], places[i])] += part.T
    return np.asarray(fit.covariance @ middle @ fit.covariance)


def from_neighbours(
    fit: ModalFit, jacobians: Sequence[FloatArray], records: Sequence[FrequencyRecord]
) -> FloatArray:
    """Return what is added by errors that neighbouring lines share (``noise.autoregression``).

    Parameters
    ----------
    fit, jacobians, records : as of ``from_common_noise``
    """
    middle = np.zeros_like(fit.covariance)
    for own, design, residuals, sigma in zip(_places(fit), jacobians, fit.residuals, fit.sigmas, strict=True):
        for record, rows in rows_by_record(records):
            excess = excess_over_lines(design[rows], residuals[rows], record.line_correlation)
            middle[np.ix_(own, own)] += excess / sigma**2
    return np.asarray(fit.covariance @ middle @ fit.covariance)


def _places(fit: ModalFit) -> Iterator[IndexArray]:
    """Yield where in the covariance the parameters of every pair stand."""
    first = fit.n_theta
    for found in fit.coefficients:
        yield np.append(np.arange(fit.n_theta), first + np.arange(len(found)))
        first += len(found)


def rows_by_record(records: Sequence[FrequencyRecord]) -> Iterator[tuple[FrequencyRecord, slice]]:
    """Yield every record with its rows."""
    first = 0
    for record in records:
        yield record, slice(first, first + 2 * record.n_lines)
        first += 2 * record.n_lines
