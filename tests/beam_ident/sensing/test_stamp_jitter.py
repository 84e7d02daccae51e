from __future__ import annotations

import numpy as np
import pytest

from beam_ident.sensing.stamp_jitter import StampJitter, is_any

N, NOISE = 3000, np.array([1.0, 2.0])
SPEEDS = np.outer(np.sin(0.7 * np.arange(N)) * np.linspace(0.0, 1.0, N), [3e3, -5e3])
SEEN = np.ones((N, 2), dtype=bool)


def residuals(sd_s: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return NOISE * rng.standard_normal((N, 2)) + SPEEDS * (sd_s * rng.standard_normal(N))[:, None]


@pytest.mark.parametrize("sd_s", [3e-4, 1e-3, 1e-2])
def test_the_scatter_of_stamps_and_the_noise_beside_it_are_told_apart(sd_s):
    found = StampJitter.of(residuals(sd_s), SPEEDS, SEEN)
    # The stamps of some 1000 instants that move say it to 1 / sqrt(2000), and half as well where it is small.
    assert found.sd_s == pytest.approx(sd_s, rel=0.15)
    assert np.sqrt(found.variances) == pytest.approx(NOISE, rel=0.06)
    assert is_any([found])


def test_noise_of_one_level_is_no_jitter():
    assert not any(is_any([StampJitter.of(residuals(0.0, seed), SPEEDS, SEEN)]) for seed in range(200))


def test_outputs_that_were_not_seen_say_nothing():
    left, seen = residuals(1e-3), SEEN.copy()
    seen[::3, 0] = False
    found = StampJitter.of(np.where(seen, left, 0.0), np.where(seen, SPEEDS, 0.0), seen)
    assert found.sd_s == pytest.approx(1e-3, rel=0.1)
    assert np.sqrt(found.variances) == pytest.approx(NOISE, rel=0.06)


def test_what_follows_the_speed_steadily_is_an_error_of_the_model():
    swelling = SPEEDS * (1e-3 * np.sin(0.01 * np.arange(N)))[:, None]
    assert not is_any([StampJitter.of(residuals(0.0) + swelling, SPEEDS, SEEN)])


def test_outliers_are_no_jitter():
    wild = residuals(0.0)
    wild[np.arange(100, N, 300)] += 40.0
    assert not is_any([StampJitter.of(wild, SPEEDS, SEEN)])
