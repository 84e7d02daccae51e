"""Amplitude and phase of one weakly nonlinear mode that rings freely (Krylov and Bogoliubov's averaging).

To first order in its nonlinear terms, x'' + 2 zeta omega x' + mu sign(x') + beta |x'| x' + omega^2 x + kappa x^3 = 0
moves as x = A cos(phi) with

    A' = -(g_-1 + g_0 A + g_1 A^2 + ..),    phi' = w_0 + w_2 A^2 + ..
    g_-1 = 2 mu / (pi omega),  g_0 = zeta omega,  g_1 = 4 beta omega / (3 pi),  w_2 = 3 kappa / (8 omega)

(Nayfeh and Mook 1979, sections 2.3 and 3.3). Dry friction ends the motion at a finite time. Higher terms let
other laws be followed as far as the data carry them.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from beam_ident.arrays import FloatArray

_STEPS = 400


def frequency(coefficients: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return phi' = w_0 + w_2 A^2 + w_4 A^4 + .. at each amplitude.

    Parameters
    ----------
    coefficients : ndarray, shape (n_terms,) -- w_0, w_2, w_4 .. [rad/s]
    amplitude : ndarray, any shape -- A, in units of the reference amplitude
    """
    return np.asarray(np.polynomial.polynomial.polyval(amplitude**2, coefficients))


def decay_rate(coefficients: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return -A' = g_-1 + g_0 A + g_1 A^2 + .. at each amplitude; arguments as of ``frequency``."""
    return np.asarray(np.polynomial.polynomial.polyval(amplitude, coefficients))


def slow_flow(
    omega_terms: FloatArray, rate_terms: FloatArray, start: float, elapsed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return amplitude and phase at the stamps, each of shape (n,).

    Parameters
    ----------
    omega_terms : ndarray -- w_0, w_2 .. [rad/s], of A in units of the reference amplitude
    rate_terms : ndarray -- g_-1, g_0, g_1 .. [1/s]
    start : float -- A at the first instant
    elapsed : ndarray, shape (n,) -- since the first instant, rising [s]

    Notes
    -----
    Runge and Kutta's fourth order over a few hundred steps of the slow motion, Hermite's cubic between them:
    both err by less than 1e-8 of the amplitude where it falls by less than e^20.
    """
    end = max(float(elapsed[-1]), 1e-300)
    h = end / _STEPS
    grid = h * np.arange(_STEPS + 1)
    A = np.empty(_STEPS + 1)
    A[0] = now = start
    polynomial = [float(value) for value in rate_terms[::-1]]

    def slope(value: float) -> float:
        if value <= 0.0:
            return 0.0
        total = 0.0
        for own in polynomial:
            total = total * value + own
        return -total

    for k in range(_STEPS):
        k1 = slope(now)
        k2 = slope(now + 0.5 * h * k1)
        k3 = slope(now + 0.5 * h * k2)
        k4 = slope(now + h * k3)
        # An amplitude that grows without end is no decay: it is held where the fit sees that it is wrong.
        now = min(max(now + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, 0.0), 100.0 * start)
        A[k + 1] = now
    slopes = np.array([slope(value) for value in A])
    amplitude = CubicHermiteSpline(grid, A, slopes)
    # The phase by Gauss's two points of every step, which are exact to the third degree.
    offsets = 0.5 * h * (1.0 + np.array([-1.0, 1.0]) / np.sqrt(3.0))
    inner = frequency(omega_terms, amplitude(grid[:-1, None] + offsets))
    turned = np.concatenate([[0.0], np.cumsum(0.5 * h * inner.sum(axis=1))])
    phase = CubicHermiteSpline(grid, turned, frequency(omega_terms, A))
    return np.maximum(amplitude(elapsed), 0.0), np.asarray(phase(elapsed))
