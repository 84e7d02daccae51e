from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, OutputSignal
from beam_ident.modal_estimation.free_decay import fit_free_decay

OMEGAS, ZETAS = 2 * np.pi * np.array([4.4, 28.3]), np.array([0.005, 0.008])
AMPLITUDES = np.array([[1.0, 0.3 - 0.2j], [0.4j, -0.5]])
TIMES = np.sort(np.random.default_rng(0).uniform(2.0, 8.0, 500))


def decays(noise, seed=0, exposure=0.0, times=TIMES):
    poles = OMEGAS * (-ZETAS + 1j * np.sqrt(1 - ZETAS**2))
    elapsed = times[:, None] - TIMES[0]
    shape = 1.0 if exposure == 0.0 else np.sinh(0.5 * poles * exposure) / (0.5 * poles * exposure)
    ringing = np.real(np.exp(elapsed * poles) * shape @ AMPLITUDES.T) + np.array([3.0, -1.0])
    noisy = ringing + noise * np.random.default_rng(seed).standard_normal(ringing.shape)
    return [OutputSignal(n, "m", times, noisy[:, j], exposure) for j, n in enumerate(("tip", "root"))]


def test_two_modes_ring_at_irregular_stamps_and_are_found_exactly():
    found = fit_free_decay(decays(0.0, exposure=0.01))
    np.testing.assert_allclose(found.natural_frequencies, OMEGAS, rtol=1e-10)
    np.testing.assert_allclose(found.damping_ratios, ZETAS, rtol=1e-8)
    np.testing.assert_allclose(found.amplitudes, AMPLITUDES, atol=1e-9)
    np.testing.assert_allclose(found.offsets, [3.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(found.logarithmic_decrements, 2 * np.pi * ZETAS, rtol=1e-4)


def test_intervals_cover():
    scores = []
    for seed in range(8):
        found = fit_free_decay(decays(0.1, seed), n_modes=2)
        estimate = np.concatenate([found.natural_frequencies - OMEGAS, found.damping_ratios - ZETAS])
        scores.append(estimate / np.concatenate([found.natural_frequency_sd, found.damping_ratio_sd]))
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3  # 32 scores: 1 +- 0.13


def test_outputs_with_clocks_of_their_own_share_the_poles():
    tip, root = decays(0.02)
    later = decays(0.02, seed=1, times=TIMES[50:] + 1e-3)[1]
    both = fit_free_decay([tip, later], n_modes=2)
    np.testing.assert_allclose(both.natural_frequencies, OMEGAS, rtol=3e-4)
    assert both.damping_ratio_sd[0] < fit_free_decay(root, n_modes=2).damping_ratio_sd[0]
    assert all(w.is_white for w in both.whiteness)


def test_nothing_that_rings_is_refused():
    with pytest.raises(EstimationError, match="nothing rings"):
        fit_free_decay(OutputSignal("y", "", TIMES, np.random.default_rng(1).standard_normal(len(TIMES))))
    with pytest.raises(EstimationError, match="a decay needs at least 12"):
        fit_free_decay(decays(0.1), end_s=2.05)
    with pytest.raises(EstimationError, match="n_modes is 0"):
        fit_free_decay(decays(0.1), n_modes=0)
