"""Noise that is not white: what it does to the uncertainty of an estimate.

An estimator that weighs samples as if their noise were white stays unbiased when it
is not, but its stated covariance is wrong.  With the autocorrelation of the residuals
the right one follows, the sandwich ``H^-1 S H^-1``: H the information under white noise,
S the covariance of the score under the real one.  The autocorrelation is that of
an autoregressive model whose order BIC chooses.

So do the lines of a frequency response, where neighbours share an error (a window, zero padding, a local smoother):
their autoregression is complex, and runs over the lines.

Equation numbers are those of docs/identification.md.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft
from scipy.signal import lfilter

from beam_ident.arrays import ComplexArray, FloatArray

_MAX_ORDER = 40
_MAX_LINE_ORDER = 30
_FORGOTTEN = 1e-12  # correlation below which it is none


def autoregression(
    residuals: FloatArray, max_order: int = _MAX_ORDER, doubt: FloatArray | None = None
) -> FloatArray:
    """Return the coefficients ``1, c_1 .. c_p`` of the autoregression that BIC prefers.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    max_order : int
    doubt : ndarray or None, shape (n, n_parameters)
        U of (I.24), what the model that left these residuals is not known by; their mean then counts as well.

    Notes
    -----
    Levinson-Durbin on the biased autocorrelation, which is always stable.
    """
    n = len(residuals)
    max_order = max(0, min(max_order, n // 10))
    # The autocovariance as the inverse transform of the periodogram, padded so that no lag wraps around.
    length = next_fast_len(n + max_order, real=True)
    if doubt is None:
        power = np.square(np.abs(rfft(residuals - np.mean(residuals), length)))
    else:
        every = np.concatenate([residuals[None], doubt.T])
        power = np.sum(np.square(np.abs(rfft(every, length))), axis=0)
    covariance = irfft(power, length)[: max_order + 1] / n
    if covariance[0] <= 0.0:
        return np.ones(1)
    coefficients, variance = np.ones(1), covariance[0]
    best, best_bic = coefficients, n * np.log(variance)
    for order in range(1, max_order + 1):
        # Levinson-Durbin: the reflection coefficient is the partial correlation at this lag, and the order
        # grows by one without solving anew.
        reflection = -float(coefficients @ covariance[order:0:-1][: len(coefficients)]) / variance
        extended = np.append(coefficients, 0.0)
        coefficients = extended + reflection * extended[::-1]
        # What this lag explains of the variance; BIC charges log n for it.
        variance *= max(1.0 - reflection**2, 1e-12)
        bic = n * np.log(variance) + order * np.log(n)
        if bic < best_bic:
            best, best_bic = coefficients, bic
    return np.asarray(best)


def autocorrelation(coefficients: FloatArray, n: int) -> FloatArray:
    """Return the autocorrelation of an autoregression's noise at lags 0 .. n - 1."""
    if len(coefficients) == 1:
        result = np.zeros(n)
        result[0] = 1.0
        return result
    impulse = np.zeros(n)
    impulse[0] = 1.0
    response = lfilter([1.0], coefficients, impulse)
    length = next_fast_len(2 * n - 1, real=True)
    result = irfft(np.square(np.abs(rfft(response, length))), length)[:n]
    return np.asarray(result / result[0])


class ScoreExcess:
    """``D^T R D - D^T D`` for the noise of an autoregression, D's rows coming piece by piece.

    Parameters
    ----------
    coefficients : ndarray -- of the autoregression
    n : int -- number of rows of D

    Attributes
    ----------
    total : ndarray, shape (n_parameters, n_parameters) -- of the rows so far
    """

    def __init__(self, coefficients: FloatArray, n: int) -> None:
        correlation = autocorrelation(coefficients, n)
        # From some lag on rows do not know of each other.
        reach = int(np.flatnonzero(np.abs(correlation) > _FORGOTTEN)[-1]) + 1
        self._correlation = correlation[:reach]
        self._before: FloatArray = np.empty((0, 0))
        self.total: FloatArray = np.empty(0)

    def add(self, design: FloatArray) -> None:
        """Take in more rows of D, shape (n, n_parameters)."""
        if not len(self._before):
            self.total = np.zeros((design.shape[1], design.shape[1]))
            self._before = np.empty((0, design.shape[1]))
        # With the rows before in front: theirs among themselves have been counted.
        joined = np.concatenate([self._before, design])
        self.total += self._score(joined) - self._score(self._before) - design.T @ design
        self._before = joined[max(len(joined) - len(self._correlation), 0) :]

    def _score(self, design: FloatArray) -> FloatArray:
        if not len(design):
            return np.zeros_like(self.total)
        correlation = np.zeros(len(design))
        known = self._correlation[: len(design)]
        correlation[: len(known)] = known
        return score_covariance(design, correlation)


def score_covariance(design: FloatArray, correlation: FloatArray) -> FloatArray:
    """Return ``D^T R D`` for a noise correlation R that depends on the lag alone.

    Parameters
    ----------
    design : ndarray, shape (n, n_parameters)
    correlation : ndarray, shape (n,) -- at lags 0 .. n - 1

    Notes
    -----
    R is a corner of a circulant matrix, whose eigenvalues are the Fourier transform of its first
    row: the product is a sum over frequencies.
    """
    n = len(design)
    length = next_fast_len(2 * n - 1, real=True)
    # S of (I.11): the first row of the circulant that holds R as its corner, lags of both signs.
    row = np.zeros(length)
    row[:n] = correlation
    row[length - n + 1 :] = correlation[:0:-1]
    weights = rfft(row).real
    weights[1 : (length + 1) // 2] *= 2.0  # and their mirror images
    spectra = rfft(np.ascontiguousarray(design.T), length)
    return np.asarray(np.real((spectra * (weights / length)) @ spectra.conj().T))


def line_autoregression(residuals: ComplexArray, max_order: int = _MAX_LINE_ORDER) -> ComplexArray:
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


def excess_over_lines(
    design: FloatArray, residuals: FloatArray, correlation: ComplexArray | None = None
) -> FloatArray:
    """Return ``S - H``, by which the covariance of the score exceeds the information of independent lines.

    Parameters
    ----------
    design : ndarray, shape (2 n_lines, n_parameters) -- rows over the noise, real parts above imaginary ones
    residuals : ndarray, shape (2 n_lines,) -- alike
    correlation : complex ndarray, shape (n_lines,), or None
        Of errors 0 .. n_lines - 1 lines apart, where it is known; None takes that which the residuals show.

    Notes
    -----
    With complex rows D and errors of correlation P that has the lag alone, ``S = Re(D^H P D)`` and ``H = Re(D^H D)``.
    """
    n = len(residuals) // 2
    if correlation is None:
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
