"""Errors of neighbouring lines that go together: what a window, zero padding or a local smoother does.

A fit that weighs lines as if each erred for itself stays unbiased, but its stated covariance is too small by the
number of lines that share an error.  As for samples (``noise.autoregression``), the residuals show the
correlation, and the sandwich ``H^-1 S H^-1`` has the right covariance.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import fft, ifft, next_fast_len

from beam_ident.arrays import ComplexArray, FloatArray

_MAX_ORDER = 30


def line_autoregression(residuals: ComplexArray, max_order: int = _MAX_ORDER) -> ComplexArray:
    """Return the coefficients ``1, c_1 .. c_p`` of the autoregression over lines that BIC prefers.

    Parameters
    ----------
    residuals : complex ndarray, shape (n_lines,) -- in units of the noise of every line
    max_order : int

    Notes
    -----
    Levinson-Durbin for complex values. Their mean is not taken away: errors of lines have none.
    """
    n = len(residuals)
    max_order = max(0, min(max_order, n // 10))
    length = next_fast_len(n + max_order)
    covariance = ifft(np.square(np.abs(fft(residuals, length))))[: max_order + 1] / n
    best, variance = np.ones(1, dtype=np.complex128), float(covariance[0].real)
    if variance <= 0.0:
        return best
    # Each lag has a real and an imaginary part, and each line two values.
    coefficients, best_bic = best, 2.0 * n * np.log(variance)
    for order in range(1, max_order + 1):
        reflection = -complex(coefficients @ covariance[order:0:-1][: len(coefficients)]) / variance
        extended = np.append(coefficients, 0.0)
        coefficients = extended + reflection * np.conj(extended[::-1])
        variance *= max(1.0 - abs(reflection) ** 2, 1e-12)
        bic = 2.0 * n * np.log(variance) + 2.0 * order * np.log(2.0 * n)
        if bic < best_bic:
            best, best_bic = coefficients, bic
    return np.asarray(best)


def line_correlation(coefficients: ComplexArray, n: int) -> ComplexArray:
    """Return ``E e_(k+m) conj(e_k)`` of an autoregression over lines, m = 0 .. n - 1, that at m = 0 being 1."""
    # The impulse response dies out within the record or is cut there, as far as n lines can tell.
    length = next_fast_len(4 * n)
    padded = np.zeros(length, dtype=np.complex128)
    padded[: len(coefficients)] = coefficients
    result = ifft(1.0 / np.maximum(np.square(np.abs(fft(padded))), 1e-12))[:n]
    return np.asarray(result / result[0].real)


def excess_over_lines(design: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return ``S - H``, by which the covariance of the score exceeds the information of independent lines.

    Parameters
    ----------
    design : ndarray, shape (2 n_lines, n_parameters) -- rows over the noise, real parts above imaginary ones
    residuals : ndarray, shape (2 n_lines,) -- alike

    Notes
    -----
    With complex rows D and errors of correlation P that has the lag alone, ``S = Re(D^H P D)`` and ``H = Re(D^H D)``.
    """
    n = len(residuals) // 2
    colour = line_autoregression(residuals[:n] + 1j * residuals[n:])
    if len(colour) == 1:
        return np.zeros((design.shape[1], design.shape[1]))
    correlation = line_correlation(colour, n)
    rows = design[:n] + 1j * design[n:]
    length = next_fast_len(2 * n - 1)
    # P is a corner of a circulant matrix; its first column holds both signs of the lag.
    column = np.zeros(length, dtype=np.complex128)
    column[:n] = correlation
    column[length - n + 1 :] = np.conj(correlation[:0:-1])
    weights = fft(column).real
    spectra = fft(rows, length, axis=0)
    score = np.real(spectra.conj().T @ (weights[:, None] * spectra)) / length
    return np.asarray(score - design.T @ design)
