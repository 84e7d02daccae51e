"""Whether a law follows its decays: what is left of them must not swing at the mode's own frequency.

Windows of a few cycles have amplitude and phase of their own in what a fit leaves, those of cos(phi(t)) and
sin(phi(t)) with the phase of the fit. Noise fills them as it fills such windows a third of the frequency below and
above, whatever its colour. A law that is wrong, a blow in mid-record, or a second mode that beats with the first
fills them more.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from beam_ident.amplitude.decay_fit import DecayFit, DecayProblem
from beam_ident.arrays import FloatArray
from beam_ident.data.records import OutputSignal

LEVEL = 1e-3
"""Chance of accusing a law that holds."""
_CYCLES = 4.0
_MIN_SAMPLES = 8
_BESIDE = (0.65, 1.35)  # of the frequency


def lack_of_fit(problem: DecayProblem, fit: DecayFit) -> float:
    """Return how often noise alone would swing as much at the mode's own frequency as what a fit leaves.

    Notes
    -----
    An F-test of the energies. The fit has taken some of the noise at the mode's frequency, which makes the test a
    little careful.
    """
    energies, counts = np.zeros(1 + len(_BESIDE)), np.zeros(1 + len(_BESIDE))
    for signal, residuals, phase, sd in _rows(problem, fit):
        for k, share in enumerate((1.0, *_BESIDE)):
            swings, n = _local_swings(signal, residuals, phase, share)
            energies[k] += float(swings @ swings) / sd**2
            counts[k] += n
    freedom = float(np.sum(counts[1:]))
    level = float(np.sum(energies[1:])) / max(freedom, 1.0)
    if not (counts[0] and level > 0.0):
        return 1.0
    return float(fdtrc(counts[0], freedom, energies[0] / counts[0] / level))


def without_own_swings(problem: DecayProblem, fit: DecayFit) -> list[OutputSignal]:
    """Return what a fit leaves of the first decay, less all that swings at the mode's own frequency."""
    first = _rows(problem, fit)[: problem.n_outputs]
    return [
        OutputSignal(
            signal.name,
            signal.unit,
            signal.times_s,
            residuals - _local_swings(signal, residuals, phase, 1.0)[0],
            signal.exposure_s,
        )
        for signal, residuals, phase, _ in first
    ]


def _rows(problem: DecayProblem, fit: DecayFit) -> list[tuple[OutputSignal, FloatArray, FloatArray, float]]:
    """Return every output of every decay with its residuals, the mode's phase and its noise."""
    return [
        (signal, residuals, flow.phase, sd)
        for k, decay in enumerate(problem.decays)
        for signal, residuals, flow, sd in zip(
            decay, fit.residuals[k], problem.flows(fit.point, k), fit.noise_sd, strict=True
        )
    ]


def _local_swings(
    signal: OutputSignal, residuals: FloatArray, phase: FloatArray, share: float
) -> tuple[FloatArray, int]:
    """Return the swings of windows at a share of the frequency, shape (n,), and how many numbers they are."""
    window = ((phase - phase[0]) / (2.0 * np.pi * _CYCLES)).astype(np.intp)
    result, n = np.zeros(len(residuals)), 0
    for rows in np.split(np.arange(len(window)), np.flatnonzero(np.diff(window)) + 1):
        if len(rows) >= _MIN_SAMPLES:
            Q, _ = np.linalg.qr(np.stack([np.cos(share * phase[rows]), np.sin(share * phase[rows])], axis=1))
            result[rows] = Q @ (Q.T @ residuals[rows])
            n += 2
    return result, n
