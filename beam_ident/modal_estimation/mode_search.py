"""Looking for modes one at a time, in any problem whose linear parameters project out.

A scan proposes where a further mode would lower the cost most, the fit refines all of them
together, and a mode is believed when the fit converged, its pole is known well enough to mean
something, its residues stand out of their uncertainty, and the Bayesian information criterion
finds it worth its parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.modal_estimation.pole_projection import PoleFit, PoleProblem, fit_poles, scan_poles
from beam_ident.modal_estimation.variable_projection import MIN_DAMPING

Family = tuple[FloatArray, FloatArray]
Proposals = Callable[[PoleFit], Sequence[Family]]

_MAX_FREQUENCY_SD = 0.02  # of the frequency: beyond this a pole says nothing
_RIVAL = 0.5  # of the best candidate's gain: a scan with all else held does not decide between families
_SIGNIFICANCE = 1e-6  # level at which a mode's residues must differ from zero
_FINAL_ITERATIONS, _TRIAL_ITERATIONS, _RIVAL_ITERATIONS = 60, 40, 6


@dataclass(frozen=True)
class PoleOrder:
    """One line of the order table: number of modes, criterion, and why it was refused (or empty)."""

    n_modes: int
    n_parameters: int
    bic: float
    converged: bool
    refused_because: str
    is_chosen: bool = False


def search_modes(
    problem: PoleProblem,
    proposals: Proposals,
    band: tuple[float, float],
    n_modes: int | None,
    max_modes: int,
) -> tuple[PoleFit, tuple[PoleOrder, ...]]:
    """Add modes until the given number is reached, or until one is not believed.

    Parameters
    ----------
    problem : PoleProblem
    proposals : callable
        From the fit so far to families of candidates, each with frequencies [rad/s] and damping ratios, both
        (n_candidates,).  Candidates of different families may be each other's aliases: the best of each is
        fitted, and the fits decide.
    band : tuple of float -- where a pole may stand [rad/s]
    n_modes : int or None -- how many; None lets the criterion decide
    max_modes : int -- bound on the search
    """
    current = fit_poles(problem, np.zeros(0), np.zeros(0))
    orders = [_order(problem, current, "")]
    best = 0
    limit = max_modes if n_modes is None else n_modes
    while len(current.omegas) < limit:
        iterations = _FINAL_ITERATIONS if len(current.omegas) + 1 == limit else _TRIAL_ITERATIONS
        starts = [
            (np.append(current.omegas, omega), np.append(current.zetas, zeta), current.latency)
            for omega, zeta in _starts(problem, current, proposals(current))
        ]
        if len(starts) > 1:
            rivals = [fit_poles(problem, *start, _RIVAL_ITERATIONS) for start in starts]
            best_rival = min(rivals, key=lambda fit: fit.cost)
            starts = [(best_rival.omegas, best_rival.zetas, best_rival.latency)]
        trial = fit_poles(problem, *starts[0], iterations)
        refusal = "" if n_modes is not None else _complaint(problem, band, trial, current)
        orders.append(_order(problem, trial, refusal))
        if refusal:
            break
        current, best = trial, len(orders) - 1
    orders[best] = dataclasses.replace(orders[best], is_chosen=True)
    return current, tuple(orders)


def _starts(problem: PoleProblem, current: PoleFit, families: Sequence[Family]) -> list[tuple[float, float]]:
    """Return the best candidate of every family that promises enough, as frequency [rad/s] and damping ratio."""
    omegas, zetas = (np.concatenate([family[k] for family in families]) for k in range(2))
    gains = scan_poles(problem, current, omegas, zetas)
    starts, first = [], 0
    for family in families:
        place = first + int(np.argmax(gains[first : first + len(family[0])]))
        first += len(family[0])
        if gains[place] >= _RIVAL * np.max(gains):
            starts.append((float(omegas[place]), float(zetas[place])))
    return starts


def _bic(problem: PoleProblem, fit: PoleFit) -> float:
    return 2.0 * fit.cost + fit.n_parameters * math.log(problem.n_rows)


def _order(problem: PoleProblem, fit: PoleFit, refusal: str) -> PoleOrder:
    return PoleOrder(len(fit.omegas), fit.n_parameters, _bic(problem, fit), fit.converged, refusal)


def _complaint(problem: PoleProblem, band: tuple[float, float], trial: PoleFit, current: PoleFit) -> str:
    """Return why a further mode is not believed, or nothing."""
    if problem.n_rows < 2 * trial.n_parameters:
        return "too few data for its parameters"
    if not trial.converged:
        return f"the fit did not converge: {trial.reason}"
    complaints = mode_complaints(trial, band)
    if complaints:
        return complaints[0]
    if not _bic(problem, trial) < _bic(problem, current):
        return "not worth its parameters by BIC"
    return ""


def mode_complaints(fit: PoleFit, band: tuple[float, float]) -> tuple[str, ...]:
    """Return why modes of a fit are not to be believed, one reason for each such mode.

    Parameters
    ----------
    fit : PoleFit
    band : tuple of float -- where a pole may stand [rad/s]
    """
    complaints = []
    n, n_theta = len(fit.omegas), fit.n_parameters - fit.coefficients.size
    width = fit.coefficients.shape[1]
    n_columns = fit.n_columns
    n_fixed = width - n * n_columns
    for mode in range(n):
        hertz = fit.omegas[mode] / (2.0 * np.pi)
        spread = math.sqrt(max(float(fit.covariance[mode, mode]), 0.0))
        strength = 0.0
        for block, found in enumerate(fit.coefficients):
            own = n_fixed + mode * n_columns + np.arange(n_columns)
            places = n_theta + block * width + own
            covariance = fit.covariance[np.ix_(places, places)]
            strength += float(found[own] @ np.linalg.lstsq(covariance, found[own], rcond=1e-12)[0])
        if not band[0] <= fit.omegas[mode] <= band[1]:
            complaints.append(f"a pole at {hertz:.4g} Hz stands outside the measured band")
        elif spread > _MAX_FREQUENCY_SD:
            complaints.append(f"the pole at {hertz:.4g} Hz is known to {100.0 * spread:.2g} % only")
        elif strength < chi_squared_isf(n_columns * len(fit.coefficients), _SIGNIFICANCE):
            complaints.append(f"the residues at {hertz:.4g} Hz do not stand out of their uncertainty")
    return tuple(complaints)


def mode_warnings(fit: PoleFit, band: tuple[float, float]) -> list[str]:
    """Return what a reader must know of a fit and its modes before trusting the numbers."""
    warnings = [] if fit.converged else [f"the fit did not converge: {fit.reason}"]
    warnings += mode_complaints(fit, band)
    for omega, zeta in zip(fit.omegas, fit.zetas, strict=True):
        if zeta <= 2.0 * MIN_DAMPING:
            warnings.append(f"the damping ratio at {omega / (2.0 * np.pi):.4g} Hz ran to zero")
    return warnings
