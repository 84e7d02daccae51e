"""Intervals where noise on the input stands in every output at once."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import analyse_modes, fit_frequency_modes, models_of, stabilisation_chart
from beam_ident.data.frequency_record import FrequencyRecord

OMEGA, ZETA = 20.0, 0.05
GAINS = np.array([1.0, -0.5, 0.8])
LINES = 2.0 * np.pi * np.arange(1.0, 8.0, 0.1)


def under_input_noise(seed: int, size: float = 0.02, own: float = 1e-3) -> FrequencyRecord:
    """Return receptances that all have one error, that of the input, and a small one of their own."""
    rng = np.random.default_rng(seed)
    clean = np.outer(OMEGA**2 / (OMEGA**2 - LINES**2 + 2j * ZETA * OMEGA * LINES), GAINS)

    def noise(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    covariance = size**2 * np.einsum("lp,lq->lpq", clean, np.conj(clean)) + own**2 * np.eye(len(GAINS))
    response = clean * (1.0 + size * noise(len(LINES), 1)) + own * noise(*clean.shape)
    variance = np.einsum("lpp->lp", covariance).real
    return FrequencyRecord(LINES, response, variance, covariance=covariance)


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimate",
    [
        lambda record: fit_frequency_modes(record, "receptance", n_modes=1),
        lambda record: analyse_modes(stabilisation_chart(record, max_order=4), [OMEGA / 2.0 / np.pi]),
    ],
    ids=["fit_frequency_modes", "analyse_modes"],
)
def test_noise_that_all_outputs_share_is_counted_once(estimate):
    scores = []
    for seed in range(60):
        model = models_of(estimate(under_input_noise(seed)))[0]
        found = np.concatenate([model.natural_frequencies, model.damping_ratios])
        scores.append((found - [OMEGA, ZETA]) / np.sqrt(np.diag(model.covariance)[:2]))
    # Without what they share, three outputs would promise deviations too small by the root of three.
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2  # 120 scores: 1 +- 0.065
