"""Noise in continuous time: held against its dense covariance, and found again by its likelihood."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ident.noise.continuous_noise import ContinuousNoise, ContinuousWhitening, continuous_noise

PROCESSES = {
    "OU": ContinuousNoise(2.0),
    "OU beside white": ContinuousNoise(2.0, white=0.3),
    "two time constants": ContinuousNoise(2.0, 1.5, 0.5),
    "double pole": ContinuousNoise(0.5, 0.0, -0.5),
    "smooth": ContinuousNoise(1.5, -9.0, 1.5, white=0.1),
    "resonance": ContinuousNoise(0.5, -400.0, 0.3),
    "resonance beside white": ContinuousNoise(0.5, -400.0, 0.3, 0.2),
}


def covariance(noise: ContinuousNoise, times: np.ndarray) -> np.ndarray:
    """Return the covariance from the poles' own partial fractions, entry by entry."""
    lags = np.abs(times[:, None] - times[None, :])
    if noise.split is None:
        process = np.exp(-noise.decay * lags)
    else:
        root = np.sqrt(complex(noise.split) + 1e-12)
        share = 0.5 * (1.0 + noise.slope / root)
        process = np.real(
            share * np.exp((root - noise.decay) * lags) + (1.0 - share) * np.exp(-(root + noise.decay) * lags)
        )
    return (1.0 - noise.white) * process + noise.white * np.eye(len(times))


@pytest.mark.parametrize("name", list(PROCESSES))
def test_whitening_is_the_inverse_root_of_the_covariance_of_determinant_one(name):
    rng = np.random.default_rng(0)
    times = np.sort(rng.uniform(0.0, 50.0, 300))
    times[200:] += 30.0  # and a gap
    full = covariance(PROCESSES[name], times)
    whitening = ContinuousWhitening(PROCESSES[name], times)
    design = rng.standard_normal((300, 3))
    unit = math.exp(np.linalg.slogdet(full)[1] / 600.0)
    expected = unit * np.linalg.solve(np.linalg.cholesky(full), design)
    np.testing.assert_allclose(whitening.apply(design), expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(whitening.apply(design[:, 0]), expected[:, 0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        whitening.score_covariance(design), design.T @ full @ design, rtol=1e-6, atol=1e-6
    )


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("OU", "Ornstein-Uhlenbeck noise of 0."),
        ("OU beside white", "white noise"),
        ("resonance", "resonance at 3."),
        ("resonance beside white", "white noise"),
    ],
)
def test_a_process_is_found_again_at_scattered_stamps(name, words):
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0.0, 100.0, 1500))
    root = np.linalg.cholesky(covariance(PROCESSES[name], times) + 1e-12 * np.eye(1500))
    found = continuous_noise(root @ rng.standard_normal(1500), times)
    assert words in str(found)
    assert found.order == PROCESSES[name].order
    if name.startswith("resonance"):
        assert math.sqrt(-found.split) == pytest.approx(20.0, rel=0.03)
    else:
        assert found.decay == pytest.approx(2.0, rel=0.4)
    assert found.white == pytest.approx(PROCESSES[name].white, abs=0.08)


def test_no_columns_are_whitened_to_no_columns():
    # LAPACK writes past the end of what has no column, which ends the process sooner or later.
    whitening = ContinuousWhitening(ContinuousNoise(3.0, white=0.1), 0.01 * np.arange(500))
    assert whitening.apply(np.empty((500, 0))).shape == (500, 0)
    assert whitening.score_covariance(np.empty((500, 0))).shape == (0, 0)


def test_white_noise_has_no_process():
    rng = np.random.default_rng(2)
    times = np.sort(rng.uniform(0.0, 100.0, 500))
    # BIC charges log 500 = 6.2 of 2 log-likelihood for one parameter: a chance of 1.3 % each, less what the
    # test of whiteness keeps back.
    assert sum(continuous_noise(rng.standard_normal(500), times) is not None for _ in range(60)) <= 2


@pytest.mark.first_case
@pytest.mark.parametrize("name", list(PROCESSES))
def test_a_process_that_is_known_already_is_followed_in_its_form(name):
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 60.0, 800))
    root = np.linalg.cholesky(covariance(PROCESSES[name], times) + 1e-12 * np.eye(800))
    residuals = root @ rng.standard_normal(800)

    def misfit(noise):
        return 400.0 * math.log(np.sum(np.square(ContinuousWhitening(noise, times).apply(residuals))))

    known = PROCESSES[name]
    found = continuous_noise(residuals, times, near=known)
    assert (found.order, found.n_parameters) == (known.order, known.n_parameters)
    assert misfit(found) <= misfit(known) + 0.05
    anew = continuous_noise(residuals, times)
    if (anew.order, anew.n_parameters) == (known.order, known.n_parameters):
        assert misfit(found) == pytest.approx(misfit(anew), abs=0.3)
