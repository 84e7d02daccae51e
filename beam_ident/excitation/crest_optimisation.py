"""Phases that keep a multisine flat in time: Schroeder's formula, and the minimisation of L_p norms.

A multisine of random phases has peaks of about three to four times its effective value;
Schroeder's phases bring 1.7 for a flat full spectrum, and the minimisation about 1.5: more energy in the
same travel.
"""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray

_NORMS = (4, 8, 16, 32, 64, 128)
_ITERATIONS = 60  # for each norm; the crest factor changes in the third digit from there on
_OVERSAMPLING = 8  # samples of the highest line's period: its peaks are missed by less than 0.5 % on the way


def crest_factor(values: FloatArray) -> float:
    """Return peak over effective value, 0 for a signal that is zero throughout."""
    effective = float(np.sqrt(np.mean(np.square(values))))
    return float(np.max(np.abs(values))) / effective if effective > 0.0 else 0.0


def schroeder_phases(amplitudes: FloatArray) -> FloatArray:
    """Return Schroeder's phases for lines of any amplitudes [rad].

    Parameters
    ----------
    amplitudes : ndarray, shape (n_lines,)

    Notes
    -----
    ``phi_n = -2 pi sum_{l<n} (n - l) p_l`` with the lines' shares of the power ``p_l``
    (Schroeder, IEEE Trans. Inf. Theory 16, 1970).
    """
    share = np.square(amplitudes) / np.sum(np.square(amplitudes))
    phases = -2.0 * np.pi * np.cumsum(np.concatenate([[0.0], np.cumsum(share)[:-1]]))
    return np.asarray(np.mod(phases, 2.0 * np.pi))


def optimised_phases(numbers: IndexArray, amplitudes: FloatArray) -> FloatArray:
    """Return phases of a low crest factor [rad].

    Parameters
    ----------
    numbers : ndarray of int, shape (n_lines,) -- line numbers, in cycles per period
    amplitudes : ndarray, shape (n_lines,)

    Notes
    -----
    Minimises the L_p norm of the signal with p = 4, 8, .. 128 in turn, from Schroeder's phases, as
    Guillaume, Schoukens, Pintelon and Kollar do (IEEE Trans. Instrum. Meas. 40, 1991), with
    exact gradients by the fast Fourier transform and a limited-memory quasi-Newton method.
    """
    from scipy.optimize import minimize  # here: recipes are read where none is optimised, and fast

    n = 1 << int(np.ceil(np.log2(_OVERSAMPLING * int(numbers[-1]) + 1)))
    effective = np.sqrt(0.5 * np.sum(np.square(amplitudes)))
    weights = amplitudes / effective

    def signal(phases: FloatArray) -> FloatArray:
        spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
        # Sines: a phase of zero begins at zero.
        spectrum[numbers] = -0.5j * n * weights * np.exp(1j * phases)
        return np.asarray(np.fft.irfft(spectrum, n))

    def norm(phases: FloatArray, power: int) -> tuple[float, FloatArray]:
        x = signal(phases)
        peak = float(np.max(np.abs(x)))
        scaled = x / peak  # powers of 128 would overflow
        total = float(np.mean(scaled**power))
        pull = np.fft.rfft(scaled ** (power - 1))[numbers] / n
        # d x / d phi_k = w_k cos(2 pi k t + phi_k)
        slope = weights * np.real(np.conj(pull) * np.exp(1j * phases))
        value = peak * total ** (1.0 / power)
        return value, np.asarray(value * slope / (total * peak))

    phases = schroeder_phases(amplitudes)
    best, lowest = phases, float(np.max(np.abs(signal(phases))))
    for power in _NORMS:
        found = minimize(
            norm,
            phases,
            args=(power,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": _ITERATIONS, "gtol": 1e-12, "ftol": 1e-12},
        )
        phases = np.asarray(found.x, dtype=np.float64)
        peak = float(np.max(np.abs(signal(phases))))
        if peak < lowest:
            best, lowest = phases, peak
    return np.asarray(np.mod(best, 2.0 * np.pi))
