"""Why a mode of a fit cannot be trusted: the gates that every mode must pass, whatever the data.

A mode counts when its damping did not run to zero, its frequency stayed where the input
excites (or where lines and samples can show it), its pole is known well enough to mean something,
and its residues stand out of their uncertainty at all outputs taken together.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.data.bandwidth import Band
from beam_ident.modal.fit import ModalFit
from beam_ident.modal_estimation.variable_projection import MIN_DAMPING, ModalProblem

_MAX_FREQUENCY_SD = 0.02  # of the frequency: beyond this a pole says nothing
_SIGNIFICANCE = 1e-6  # level at which a mode's residues must differ from zero


def mode_complaint(fit: ModalFit, problem: ModalProblem, mode: int, band: Band) -> str:
    """Return why a mode cannot be trusted, or an empty string when it can."""
    n = len(fit.omegas)
    omega, zeta = float(fit.omegas[mode]), float(fit.zetas[mode])
    hertz = omega / (2.0 * np.pi)
    if zeta <= 2.0 * MIN_DAMPING:
        return f"the damping ratio at {hertz:.4g} Hz ran to zero"
    if not 0.5 * band.low_hz < hertz < 1.3 * band.high_hz:
        return f"the frequency ran out of the excited band, to {hertz:.4g} Hz"
    frequency_sd = math.sqrt(max(float(fit.covariance[mode, mode]), 0.0))
    damping_sd = math.sqrt(max(float(fit.covariance[n + mode, n + mode]), 0.0))
    if not frequency_sd < _MAX_FREQUENCY_SD:
        return f"the frequency at {hertz:.4g} Hz is known to {100 * frequency_sd:.1f} % only"
    if not damping_sd < zeta:
        return f"the damping ratio at {hertz:.4g} Hz is {zeta:.2g} +- {damping_sd:.2g}"
    statistic, freedom = mode_significance(fit, problem, mode, band)
    if statistic < chi_squared_isf(freedom, _SIGNIFICANCE):
        return f"the mode at {hertz:.4g} Hz does not stand out of its uncertainty at any output"
    return ""


def mode_significance(fit: ModalFit, problem: ModalProblem, mode: int, band: Band) -> tuple[float, int]:
    """Return how far a mode's residues stand out of their uncertainty: chi-squared, degrees of freedom.

    Without an excitation it is the free motion in the first record that counts.
    """
    forced = problem.n_forced
    telling = slice(0, forced) if band.is_excited else slice(forced, forced + 2)
    index, values = [], []
    place = fit.n_theta
    for found, columns in zip(fit.coefficients, fit.mode_columns, strict=True):
        own = columns[mode, telling]
        index.append(place + own)
        values.append(found[own])
        place += len(found)
    places, amplitudes = np.concatenate(index), np.concatenate(values)
    covariance = fit.covariance[np.ix_(places, places)]
    return float(amplitudes @ np.linalg.lstsq(covariance, amplitudes, rcond=1e-12)[0]), len(amplitudes)


def mode_warnings(fit: ModalFit, problem: ModalProblem, band: Band) -> list[str]:
    """Return what a reader must know of a fit and its modes before trusting the numbers."""
    warnings = [] if fit.converged else [f"The fit did not converge: {fit.reason}."]
    for mode in range(len(fit.omegas)):
        complaint = mode_complaint(fit, problem, mode, band)
        if complaint:
            warnings.append(f"Mode {mode + 1}: {complaint}.")
    return warnings
