"""Curves that peak, or dip, where modes are."""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import require_frequency_record
from beam_ident.data.frequency_record import FrequencyRecord


def complex_mode_indicator(record: FrequencyRecord) -> FloatArray:
    """Return the singular values of the response matrix at every line, largest first.

    Returns
    -------
    ndarray, shape (n_lines, min(n_outputs, n_inputs))
        A mode is a peak; two modes at one frequency are peaks of two curves (Shih, Tsuei, Allemang
        and Brown 1988).  NaN at lines that were not measured.
    """
    require_frequency_record(record)
    seen = np.all(np.isfinite(record.response), axis=(1, 2))
    values = np.full((record.n_lines, min(record.n_outputs, record.n_inputs)), np.nan)
    values[seen] = np.linalg.svd(record.response[seen], compute_uv=False)
    return values


def multivariate_mode_indicator(record: FrequencyRecord, differentiations: int = 0) -> FloatArray:
    """Return the multivariate mode indicator, which dips to 0 at the modes, smallest first.

    Parameters
    ----------
    record : FrequencyRecord
    differentiations : int
        0 for a receptance, 1 for a mobility, 2 for an accelerance: at a mode the response of a
        receptance to a tuned force is imaginary, that of a mobility real.

    Returns
    -------
    ndarray, shape (n_lines, n_inputs)
        Eigenvalues of ``(Re^T Re) x = lambda (Re^T Re + Im^T Im) x`` (Williams, Crowley and Vold 1985).
        At most as many can be near 0 as there are modes at a line.  NaN at lines that were not measured.
    """
    require_frequency_record(record)
    seen = np.all(np.isfinite(record.response), axis=(1, 2))
    response = record.response[seen] / 1j**differentiations
    real, imaginary = response.real, response.imag
    top = np.einsum("loi,loj->lij", real, real)
    whole = top + np.einsum("loi,loj->lij", imaginary, imaginary)
    scale = np.sqrt(np.maximum(np.einsum("lii->li", whole), 1e-300))
    shrink = scale[:, :, None] * scale[:, None, :]
    bottom = whole / shrink + 1e-12 * np.eye(record.n_inputs)
    lower = np.linalg.cholesky(bottom)
    half = np.linalg.solve(lower, top / shrink)
    values = np.full((record.n_lines, record.n_inputs), np.nan)
    values[seen] = np.linalg.eigvalsh(np.linalg.solve(lower, np.swapaxes(half, 1, 2)))
    return values
