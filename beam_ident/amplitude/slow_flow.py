"""Amplitude and phase of one weakly nonlinear mode that rings freely (averaging to second order).

To first order in its nonlinear terms (Krylov and Bogoliubov), x'' + 2 zeta omega x' + mu sign(x') + beta |x'| x'
+ omega^2 x + kappa x^3 = 0 moves as x = A cos(phi) with

    A' = -(g_-1 + g_0 A + g_1 A^2 + ..),    phi' = w_0 + w_2 A^2 + ..
    g_-1 = 2 mu / (pi omega),  g_0 = zeta omega,  g_1 = 4 beta omega / (3 pi),  w_2 = 3 kappa / (8 omega)

(Nayfeh and Mook 1979, sections 2.3 and 3.3), w_0 being the frequency of the ringing that linear damping leaves. A is
the amplitude of the fundamental, phi its phase. Dry friction ends the motion at a finite time. Higher terms let other
laws be followed as far as the data carry them.

To second order the harmonics act back on the fundamental. Balance of its two components gives, with
eta = w_2 A^2 / w_0, r = g_-1 + g_0 A + .., and F_n the harmonics of a damping force of which r is the first,

    phi' = w_0 + w_2 A^2 - 5/12 eta^2 w_0
           + [r r'/A - 2 r^2/A^2 + g_0^2 - sum_n n^2/(n^2 - 1) (F_n/(A w_0))^2] / (2 w_0)
    A'   = -sum_k g_k A^(k+1) (1 + eta (k - 1 + (k + 2) rho_k/4)),    rho_k = F_3/F_1 of |x'|^k x'

(the scheme of Bogoliubov and Mitropolsky 1961, chapter 1). A third harmonic h A^3 cos(3 phi) makes the maximum
A (1 + h A^2); a cubic spring alone has h = w_2/(12 w_0). What is left out is of third order. Inertia that changes
with the shape, as that of a bent strip does, has another h and other terms of second order: a law with free h, g_2,
g_3 and w_4 follows it as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import AnyArray, ComplexArray, FloatArray

_STEPS = 400
_TINY = 1e-30
"""Step of derivatives through the imaginary part, which knows no cancellation (Squire and Trapp 1998)."""
_STRONG = 0.3  # of critical damping: dry friction beyond it ends the motion within a cycle

_HARMONICS = np.arange(3.0, 1000.0, 2.0)
_MOST_POWERS = 5
# F_n/F_1 of |x'|^k x' in the sine of the phase, from k = -1: F_(n+2)/F_n = (n - 1 - k)/(n + 3 + k).
_SHARES = np.stack(
    [np.cumprod((_HARMONICS - 3.0 - k) / (_HARMONICS + 1.0 + k)) for k in range(-1, _MOST_POWERS - 1)]
)
_OF_DAMPING = 4.0 * (_SHARES * (_HARMONICS**2 / (_HARMONICS**2 - 1.0))) @ _SHARES.T
_OF_CROSSINGS = 2.0 * _SHARES @ (np.where(_HARMONICS % 4.0 == 3.0, 1.0, -1.0) / (_HARMONICS**2 - 1.0))
_OF_SPRING = np.arange(_MOST_POWERS) - 2.0 + 0.25 * (np.arange(_MOST_POWERS) + 1.0) * _SHARES[:, 0]


def rate_polynomial(w: AnyArray, g: AnyArray) -> AnyArray:
    """Return the coefficients of -A' over powers of A, beginning with A^0.

    Parameters
    ----------
    w : ndarray -- w_0, w_2 .. [rad/s], of A in units of the reference amplitude
    g : ndarray -- g_-1, g_0, g_1 .. [1/s]
    """
    if len(w) == 1:
        return g
    result = np.concatenate([g, np.zeros(2)])
    result[2:] += _OF_SPRING[: len(g)] * g * (w[1] / w[0])
    return result


def phase_rate(w: AnyArray, g: AnyArray, amplitude: AnyArray) -> AnyArray:
    """Return phi' at amplitudes of the fundamental, shape (n,); ``w`` and ``g`` as of ``rate_polynomial``."""
    powers = np.arange(len(g))
    least = abs(float(g[0].real)) / (_STRONG * float(w[0].real)) + 1e-9
    A = np.where(amplitude.real > least, amplitude, least)
    parts = g * A[:, None] ** (powers - 1)  # of r/A
    ratio = parts.sum(axis=1)
    of_damping = np.einsum("ik,kl,il->i", parts, _OF_DAMPING[: len(g), : len(g)], parts)
    second = ratio * (powers * parts).sum(axis=1) - 2.0 * ratio**2 + g[1] ** 2 - of_damping
    squares = np.asarray(amplitude**2)
    if len(w) > 1:
        second = second - 5.0 / 6.0 * (w[1] * squares) ** 2
    return np.asarray(np.polynomial.polynomial.polyval(squares, w) + second / (2.0 * w[0]))


def ringing(w: AnyArray, g: AnyArray, third: complex, maxima: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the frequency of the ringing [rad/s] and its damping ratio at maxima, each of shape (n,).

    ``third`` is h of the third harmonic.

    The frequency is that of the zero crossings, which a damping force's harmonics b_n = -F_n/((n^2 - 1) w_0^2) move
    by delta = (b_5 - b_3 + ..)/A ahead of the phase; the damping ratio is that of the maxima's logarithmic decrement.
    """
    higher = third * maxima**2
    A = np.asarray(maxima * (1.0 - higher))
    powers = np.arange(len(g))
    rate = np.polynomial.polynomial.polyval(A, rate_polynomial(w, g))
    by_amplitude = (g * _OF_CROSSINGS[: len(g)] * (powers - 1) * A[:, None] ** (powers - 2.0)).sum(
        axis=1
    ) / w[0]
    omega = phase_rate(w, g, A) + by_amplitude * rate
    return omega, np.asarray(rate / (A * omega) * (1.0 + 2.0 * higher))


def ringing_slopes(
    w: FloatArray, g: FloatArray, third: float, maxima: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how frequency and damping ratio at maxima move with w, g and h, each of shape (n, n_terms + 1)."""
    found = [ringing(*moved, third, maxima) for moved in _moved(w, g)]
    found.append(ringing(w, g, third + 1j * _TINY, maxima))
    return (
        np.stack([omega.imag / _TINY for omega, _ in found], axis=1),
        np.stack([zeta.imag / _TINY for _, zeta in found], axis=1),
    )


def _moved(w: FloatArray, g: FloatArray) -> list[tuple[ComplexArray, ComplexArray]]:
    """Return the coefficients with an imaginary step in one after the other."""
    steps = 1j * _TINY * np.eye(len(w) + len(g))
    return [(w + step[: len(w)], g + step[len(w) :]) for step in steps]


@dataclass(frozen=True, eq=False)
class SlowFlow:
    """Amplitude and phase of a decay at its stamps.

    Attributes
    ----------
    amplitude, phase : ndarray, shape (n,)
    by_amplitude, by_phase : ndarray, shape (n_terms + 1, n)
        How both move with w, with g, and with the amplitude at the first instant; empty where not asked for.
    """

    amplitude: FloatArray
    phase: FloatArray
    by_amplitude: FloatArray
    by_phase: FloatArray


def slow_flow(
    w: FloatArray, g: FloatArray, start: float, elapsed: FloatArray, *, slopes: bool = False
) -> SlowFlow:
    """Return amplitude and phase at the stamps.

    Parameters
    ----------
    w, g : ndarray -- as of ``rate_polynomial``
    start : float -- A at the first instant
    elapsed : ndarray, shape (n,) -- since the first instant, rising [s]
    slopes : bool -- whether the derivatives are wanted, too

    Notes
    -----
    Runge and Kutta's fourth order over a few hundred steps of the slow motion, Hermite's cubic between them:
    both err by less than 1e-8 of the amplitude where it falls by less than e^20.
    """
    from scipy.interpolate import CubicHermiteSpline  # here: linearity is looked at without it

    end = max(float(elapsed[-1]), 1e-300)
    h = end / _STEPS
    grid = np.linspace(0.0, end, _STEPS + 1)
    rate = np.asarray(rate_polynomial(w, g), dtype=np.float64)
    A = _integrated(rate, start, h)
    amplitude = CubicHermiteSpline(
        grid, A, np.where(A > 0.0, -np.polynomial.polynomial.polyval(A, rate), 0.0)
    )
    # The phase by Gauss's two points of every step, which are exact to the third degree.
    offsets = 0.5 * h * (1.0 + np.array([-1.0, 1.0]) / np.sqrt(3.0))
    inner = phase_rate(w, g, amplitude((grid[:-1, None] + offsets).ravel())).reshape(-1, 2)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * h * inner.sum(axis=1))])
    phase = CubicHermiteSpline(grid, turned, phase_rate(w, g, A))
    by_amplitude, by_phase = _slopes(w, g, grid, A, rate) if slopes else (np.zeros((0, 1)), np.zeros((0, 1)))
    return SlowFlow(
        np.maximum(amplitude(elapsed), 0.0),
        np.asarray(phase(elapsed)),
        np.array([np.interp(elapsed, grid, row) for row in by_amplitude]),
        np.array([np.interp(elapsed, grid, row) for row in by_phase]),
    )


def _integrated(rate: FloatArray, start: float, h: float) -> FloatArray:
    """Return the amplitude after every step."""
    A = np.empty(_STEPS + 1)
    A[0] = now = start
    polynomial = [float(value) for value in rate[::-1]]

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
        # One beyond all numbers is none, which max leaves out where it comes second.
        now = min(max(0.0, now + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0), 100.0 * start)
        A[k + 1] = now
    return A


def _slopes(
    w: FloatArray, g: FloatArray, grid: FloatArray, A: FloatArray, rate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how amplitude and phase on the grid move with the terms and the start, shape (n_terms + 1, n_grid).

    A change dA obeys dA' = -R_A dA - R_p, which exp(-int R_A) makes an integral.
    """
    steeper = np.polynomial.polynomial.polyval(A, np.polynomial.polynomial.polyder(rate))
    growth = np.clip(_integral(grid, np.asarray(steeper, dtype=np.float64)[None])[0], -60.0, 60.0)
    factor = np.where(A > 0.0, np.exp(-growth), 0.0)
    changed, turned = [], []
    for moved_w, moved_g in _moved(w, g):
        by_term = np.polynomial.polynomial.polyval(A, rate_polynomial(moved_w, moved_g)).imag / _TINY
        changed.append(-by_term * np.exp(growth))
        turned.append(phase_rate(moved_w, moved_g, A).imag / _TINY)
    by_amplitude: FloatArray = factor * np.vstack([_integral(grid, np.array(changed)), np.ones(len(grid))])
    of_amplitude = phase_rate(w, g, A + 1j * _TINY).imag / _TINY
    by_phase: FloatArray = of_amplitude * by_amplitude + np.vstack([turned, np.zeros(len(grid))])
    return by_amplitude, _integral(grid, by_phase)


def _integral(grid: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the running integral of every row by trapezoids."""
    added = 0.5 * np.diff(grid)[None] * (rows[:, 1:] + rows[:, :-1])
    return np.concatenate([np.zeros((len(rows), 1)), np.cumsum(added, axis=1)], axis=1)
