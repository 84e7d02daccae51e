"""Why a mode of a fit cannot be trusted: the gates that every mode must pass, whatever the data.

A mode counts when its damping did not run to zero, its frequency stayed where the input
excites (or where lines and samples can show it), its pole is known well enough to mean something,
and its residues stand out of their uncertainty at all outputs taken together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.data.bandwidth import Band
from beam_ident.modal.fit import ModalFit
from beam_ident.modal_estimation.variable_projection import MIN_DAMPING, ModalProblem
from beam_ident.noise.scores import Whiteness

_MAX_FREQUENCY_SD = 0.02  # of the frequency: beyond this a pole says nothing
_MISTAKEN_GAIN = 5.0  # standard deviations from zero: a gain that is known this well names a mistake
_OTHER_UNIT = 30.0  # between what a calibration may be off and a factor of 1000
_SIGNIFICANCE = 1e-6  # level at which a mode's residues must differ from zero
_DECAYS = 4.0  # standard deviations of the damping from zero: free motion of less may be a tone
_SAME_SHAPE = 0.98  # modal assurance criterion beyond which outputs do not tell two shapes apart


def mode_complaint(fit: ModalFit, problem: ModalProblem, mode: int, band: Band) -> str:
    """Return why a mode cannot be trusted, or an empty string when it can."""
    n = len(fit.omegas)
    omega, zeta = float(fit.omegas[mode]), float(fit.zetas[mode])
    hertz = omega / (2.0 * np.pi)
    if zeta <= 2.0 * MIN_DAMPING:
        return f"the damping ratio at {hertz:.4g} Hz ran to zero"
    lowest, highest = band.reach_hz
    if not lowest < hertz < highest:
        return f"the frequency ran out of the excited band, to {hertz:.4g} Hz"
    frequency_sd = math.sqrt(max(float(fit.covariance[mode, mode]), 0.0))
    damping_sd = math.sqrt(max(float(fit.covariance[n + mode, n + mode]), 0.0))
    if not frequency_sd < _MAX_FREQUENCY_SD:
        return f"the frequency at {hertz:.4g} Hz is known to {100 * frequency_sd:.1f} % only"
    if not damping_sd < zeta:
        return f"the damping ratio at {hertz:.4g} Hz is {zeta:.2g} +- {damping_sd:.2g}"
    may_be_tone = band.is_excited and zeta < _DECAYS * damping_sd
    own_motions = [False] if may_be_tone else [False, True] if band.is_excited else [True]
    if not _stands_out(fit, problem, mode, band, own_motions):
        if may_be_tone and _stands_out(fit, problem, mode, band, [True]):
            return f"the tone at {hertz:.4g} Hz neither decays nor follows the input, as hum does"
        return f"the mode at {hertz:.4g} Hz does not stand out of its uncertainty at any output"
    return ""


def _stands_out(
    fit: ModalFit, problem: ModalProblem, mode: int, band: Band, own_motions: Sequence[bool]
) -> bool:
    """Return whether a mode differs from nothing, at all outputs together or at one of them.

    Parameters
    ----------
    own_motions : sequence of bool -- with its free motion or without, each a way to stand out

    Notes
    -----
    Of many outputs a mode may move one alone, where its share drowns in the freedom of the others.  And a blow at
    the very beginning of a record moves as free motion does: then the two are known together, and neither alone.
    Each way to stand out is a test of its own at the same level, so that what one output shows alone is also found
    beside others.
    """
    n_outputs = len(fit.coefficients)
    places = [range(n_outputs), *([j] for j in range(n_outputs))] if n_outputs > 1 else [range(1)]
    for with_free_motion in own_motions:
        for outputs in places:
            telling = slice(
                0 if band.is_excited else problem.n_forced, None if with_free_motion else problem.n_forced
            )
            statistic, freedom = _significance(fit, mode, outputs, telling)
            if freedom and statistic > chi_squared_isf(freedom, _SIGNIFICANCE):
                return True
    return False


def mode_significance(fit: ModalFit, problem: ModalProblem, mode: int, band: Band) -> tuple[float, int]:
    """Return how far a mode's residues stand out of their uncertainty: chi-squared, degrees of freedom.

    Without an excitation it is the free motion in the first record that counts.
    """
    forced = problem.n_forced
    telling = slice(0, forced) if band.is_excited else slice(forced, forced + 2)
    return _significance(fit, mode, range(len(fit.coefficients)), telling)


def _significance(fit: ModalFit, mode: int, outputs: Sequence[int], telling: slice) -> tuple[float, int]:
    """Return chi-squared and degrees of freedom of some of a mode's columns at some of the outputs."""
    index, values = [], []
    place = fit.n_theta
    for output, (found, columns) in enumerate(zip(fit.coefficients, fit.mode_columns, strict=True)):
        if output in outputs:
            own = columns[mode, telling]
            index.append(place + own)
            values.append(found[own])
        place += len(found)
    places, amplitudes = np.concatenate(index), np.concatenate(values)
    # A column that is not told from others was set to zero, without a variance.
    known = np.diag(fit.covariance)[places] > 0.0
    covariance = fit.covariance[np.ix_(places[known], places[known])]
    # In units of their own scatter, since forced and free columns have other units.
    sd = np.sqrt(np.diag(covariance))
    scaled = amplitudes[known] / sd
    statistic = scaled @ np.linalg.lstsq(covariance / np.outer(sd, sd), scaled, rcond=1e-12)[0]
    return float(statistic), len(scaled)


def gain_warnings(gains: FloatArray, gain_sd: FloatArray, names: Sequence[str]) -> list[str]:
    """Return which outputs do not follow the base as they must: a sign, or a unit, is mistaken.

    Parameters
    ----------
    gains, gain_sd : ndarray, shape (n_outputs,) -- one for an output that moves with the base
    names : sequence of str -- of the outputs
    """
    warnings = []
    for name, gain, sd in zip(names, gains, gain_sd, strict=True):
        if not abs(gain) > _MISTAKEN_GAIN * sd:
            continue
        mistakes = ["the sign of one of them is turned"] * bool(gain < 0.0)
        if abs(gain) > _OTHER_UNIT:
            mistakes.append("the output may be in millimetres, or the input in kilometres")
        elif abs(gain) < 1.0 / _OTHER_UNIT:
            mistakes.append("the input may be in millimetres, or the output does not move with the base")
        if mistakes:
            said = " and ".join(mistakes)
            warnings.append(f"Output {name} follows the base with a gain of {gain:.4g}, not 1: {said}.")
    return warnings


def mode_warnings(fit: ModalFit, problem: ModalProblem, band: Band) -> list[str]:
    """Return what a reader must know of a fit and its modes before trusting the numbers."""
    warnings = [] if fit.converged else [f"The fit did not converge: {fit.reason}."]
    for mode in range(len(fit.omegas)):
        complaint = mode_complaint(fit, problem, mode, band)
        if complaint:
            warnings.append(f"Mode {mode + 1}: {complaint}.")
    # Where they leave white noise, a linear model explains all that was seen.
    is_linear = problem.is_sequence and all(Whiteness.of(left).is_white for left in fit.residuals)
    for group in [] if is_linear else _alike(fit, problem, band):
        names = ", ".join(str(mode + 1) for mode in group)
        warnings.append(
            f"Modes {names} overlap and move the outputs alike. Two modes may do so, but so does a single one whose "
            "damping or stiffness depends on its amplitude (air drag, friction), or that a sensor with a dead band "
            "sees: compare with a run of half the amplitude; "
            f"n_modes={len(fit.omegas) - len(group) + 1} gives one mode in their place."
        )
    return warnings


def crowd(fit: ModalFit, problem: ModalProblem, band: Band) -> list[int]:
    """Return three modes or more of the same shape in the half-power band of the sharpest of them; or none.

    No structure has them. Poles make them of a mode whose frequency or damping goes with the amplitude.
    """
    for group in _alike(fit, problem, band):
        for sharpest in group:
            width = 2.0 * fit.zetas[sharpest] * fit.omegas[sharpest]
            near = [
                mode
                for mode in group
                if fit.zetas[mode] >= fit.zetas[sharpest]
                and abs(fit.omegas[mode] - fit.omegas[sharpest]) < width
            ]
            if len(near) > 2:
                return near
    return []


def _alike(fit: ModalFit, problem: ModalProblem, band: Band) -> list[list[int]]:
    """Return groups of modes that overlap, each with another of its group, and have the same shape."""
    column = 0 if band.is_excited else problem.n_forced
    shapes = np.array(
        [
            found[columns[:, column]] / sigma
            for found, columns, sigma in zip(fit.coefficients, fit.mode_columns, fit.sigmas, strict=True)
        ]
    )
    shapes /= np.maximum(np.linalg.norm(shapes, axis=0), 1e-300)
    widths = 2.0 * fit.zetas * fit.omegas
    apart = np.abs(np.subtract.outer(fit.omegas, fit.omegas))
    linked = (apart < np.add.outer(widths, widths)) & (np.square(shapes.T @ shapes) > _SAME_SHAPE)
    groups: list[list[int]] = []
    for mode in range(len(fit.omegas)):
        own = [group for group in groups if np.any(linked[mode, group])]
        groups = [group for group in groups if group not in own] + [sorted(sum(own, [mode]))]
    return [group for group in groups if len(group) > 1]
