"""Why a mode of a fit cannot be trusted: the gates that every mode must pass.

A mode counts when its damping did not run to zero, its frequency stayed where the input
excites, its pole is known well enough to mean something, and its residues stand
out of their uncertainty at all outputs taken together.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.data.bandwidth import Band
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.variable_projection import MIN_DAMPING, ModalFit

_MAX_FREQUENCY_SD = 0.02  # of the frequency: beyond this a pole says nothing
_SIGNIFICANCE = 1e-6  # level at which a mode's residues must differ from zero


def mode_complaint(fit: ModalFit, regression: ModalRegression, mode: int, band: Band) -> str:
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
    statistic, freedom = mode_significance(fit, regression, mode, band)
    if statistic < chi_squared_isf(freedom, _SIGNIFICANCE):
        return f"the mode at {hertz:.4g} Hz does not stand out of its uncertainty at any output"
    return ""


def mode_significance(fit: ModalFit, regression: ModalRegression, mode: int, band: Band) -> tuple[float, int]:
    """Return how far a mode's residues stand out of their uncertainty: chi-squared, degrees of freedom."""
    n = len(fit.omegas)
    index, values = [], []
    place = len(fit.covariance) - sum(len(c) for c in fit.coefficients)
    n_own = regression.n_nuisance(n)
    n_plain = n_own - 2 * n if regression.structure.has_free_response else n_own
    for found in fit.coefficients:
        columns = [regression.n_shared_fixed + mode] if band.is_excited else []
        if regression.structure.has_free_response and not band.is_excited:
            own = regression.n_shared_fixed + n + n_plain + 2 * mode
            columns += [own, own + 1]
        index += [place + c for c in columns]
        values += [found[c] for c in columns]
        place += len(found)
    amplitudes = np.array(values)
    covariance = fit.covariance[np.ix_(index, index)]
    return float(amplitudes @ np.linalg.lstsq(covariance, amplitudes, rcond=1e-12)[0]), len(amplitudes)
