"""Noise that is not white: what it does to the uncertainty of an estimate.

An estimator that weighs samples as if their noise were white stays unbiased when it
is not, but its stated covariance is wrong.  With the autocorrelation of the residuals
the right one follows, the sandwich ``H^-1 S H^-1``: H the information under white noise,
S the covariance of the score under the real one.  The autocorrelation is that of
an autoregressive model whose order BIC chooses.

So do the lines of a frequency response, where neighbours share an error (a window, zero padding, a local smoother):
their autoregression is complex, and runs over the lines.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft
from scipy.linalg import solve_toeplitz, toeplitz

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.recursions import all_pole

_MAX_ORDER = 40
_MAX_LINE_ORDER = 30
_FORGOTTEN = 1e-14  # of all that an autoregression gives: what comes still later is rounding
_DOUBLINGS = 40
_RIDGE = 1e-12  # of the variance: what nobody can predict, were it only rounding


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
    The Yule-Walker equations of the biased autocorrelation, whose solution is always stable.
    """
    n = len(residuals)
    max_order = max(0, min(max_order, n // 10))
    # The autocovariance as the inverse transform of the periodogram, padded so that no lag wraps around.
    length = next_fast_len(n + max_order, real=True)
    if doubt is None:
        power = _power(rfft(residuals - np.mean(residuals), length))
    else:
        every = np.concatenate([residuals[None], doubt.T])
        power = np.sum(_power(rfft(every, length)), axis=0)
    covariance = irfft(power, length)[: max_order + 1] / n
    if covariance[0] <= 0.0:
        return np.ones(1)
    # The Cholesky factor of the autocovariances' Toeplitz matrix has on its diagonal what predictions from
    # 0, 1, .. samples before err by; BIC charges log n for every further one.
    lags = covariance[: max_order + 1]
    lags[0] *= 1.0 + _RIDGE
    factor = np.linalg.cholesky(toeplitz(lags))
    bic = 2.0 * n * np.log(np.diag(factor)) + np.arange(max_order + 1) * math.log(n)
    order = int(np.argmin(bic))
    result = np.ones(order + 1)
    if order:
        result[1:] = -solve_toeplitz(lags[:order], lags[1 : order + 1], check_finite=False)
    return result


def _power(spectra: ComplexArray) -> FloatArray:
    return np.asarray(np.square(spectra.real) + np.square(spectra.imag))


class ScoreCovariance:
    """``D^T R D`` for the correlation R of an autoregression's noise, D's rows coming piece by piece.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, c_1 .. c_p of a stable autoregression

    Notes
    -----
    The noise is white noise that passed 1 / A. Its correlation at a lag is the inner product of two impulse
    responses of 1 / A so far apart, and S of (I.11) that of D's columns behind 1 / A, over such noise's variance.
    After the last row they ring on: the squares of what is still to come are a quadratic form of the filter's state,
    whose matrix is the observability Gramian.
    """

    def __init__(self, coefficients: FloatArray) -> None:
        self._colour = coefficients
        self._state: FloatArray = np.empty(0)
        self._products: FloatArray = np.empty(0)
        self._white: FloatArray = np.empty(0)

    def add(self, design: FloatArray) -> None:
        """Take in more rows of D, shape (n, n_parameters)."""
        rows = np.ascontiguousarray(design.T)  # filters go along contiguous samples much faster
        if not len(self._white):
            self._state = np.zeros((len(rows), len(self._colour) - 1))
            self._white = np.zeros((len(rows), len(rows)))
            self._products = np.zeros_like(self._white)
        self._white += rows @ rows.T
        if len(self._colour) > 1:
            passed, self._state = all_pole(self._colour, rows, self._state)
            self._products += passed @ passed.T

    @property
    def white(self) -> FloatArray:
        """``D^T D`` of the rows so far, what noise without colour would have, shape (n_parameters, n_parameters)."""
        return self._white

    @property
    def total(self) -> FloatArray:
        """``D^T R D`` of the rows so far, shape (n_parameters, n_parameters)."""
        if len(self._colour) == 1:
            return self._white
        later = _rest_of_response(self._colour)
        begun = self._colour[1:]  # the filter's state after an impulse, but for the sign
        variance = 1.0 + float(begun @ later @ begun)
        return np.asarray((self._products + self._state @ later @ self._state.T) / variance)


class ColouredRows:
    """Rows behind an autoregression of variance one, coming piece by piece.

    Of two outputs whose noise has one colour and the correlation r, ``r D_j^T R D_k`` is r times the products of both
    outputs' rows behind it, but for what rings on after the last row.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, c_1 .. c_p of a stable autoregression
    """

    def __init__(self, coefficients: FloatArray) -> None:
        self._colour = coefficients
        self._state: FloatArray = np.empty(0)
        begun = coefficients[1:]
        self._sd = (
            math.sqrt(1.0 + float(begun @ _rest_of_response(coefficients) @ begun)) if len(begun) else 1.0
        )

    def passed(self, design: FloatArray) -> FloatArray:
        """Return the next rows behind it, shape (n, n_parameters)."""
        if len(self._colour) == 1:
            return design
        rows = np.ascontiguousarray(design.T)
        if not len(self._state):
            self._state = np.zeros((len(rows), len(self._colour) - 1))
        found, self._state = all_pole(self._colour, rows, self._state)
        return np.asarray(found.T / self._sd)


def _rest_of_response(coefficients: FloatArray) -> FloatArray:
    """Return G for which ``z^T G z`` are the squares of all that 1 / A still gives from its state z on."""
    order = len(coefficients) - 1
    # The states of the transposed direct form move up by one, and the output z_1 is fed back.
    step = np.eye(order, k=1)
    step[:, 0] -= coefficients[1:]
    total = np.zeros((order, order))
    total[0, 0] = 1.0
    # G = sum_k F^k^T e e^T F^k, twice as many terms each time.
    for _ in range(_DOUBLINGS):
        more = step.T @ total @ step
        total += more
        if not np.max(np.abs(more)) > _FORGOTTEN * np.max(np.abs(total)):
            break
        step = step @ step
    return total


def score_covariance(design: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return ``D^T R D`` for the correlation R of an autoregression's noise.

    Parameters
    ----------
    design : ndarray, shape (n, n_parameters)
    coefficients : ndarray, shape (order + 1,)
    """
    covariance = ScoreCovariance(coefficients)
    covariance.add(design)
    return covariance.total


def coloured_covariance(inverse: FloatArray, design: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return the covariance of a linear estimate under the colour that its residuals have.

    Parameters
    ----------
    inverse : ndarray, shape (n, n) -- what makes the estimate of ``D^T y``
    design : ndarray, shape (n_rows, n) -- D, or its instruments
    residuals : ndarray, shape (n_rows,)
    """
    variance = float(residuals @ residuals) / max(len(residuals) - design.shape[1], 1)
    scores = variance * score_covariance(design, autoregression(residuals))
    return np.asarray(inverse @ scores @ inverse.T)


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
        return np.asarray(best)
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
