"""White noise beneath a motion, without a model of it."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident.sensing.noise_floor import noise_floor

TIMES = 0.01 * np.arange(1200)


@pytest.mark.parametrize("sigma", [1e-6, 1e-3])
def test_the_noise_beneath_a_large_motion_is_found(sigma: float) -> None:
    moving = np.sin(2 * np.pi * 4.4 * TIMES) + 3.0 * TIMES
    noise = sigma * np.random.default_rng(0).standard_normal(len(TIMES))
    # A quantile of 150 of 600 lines has a deviation of 6 %, the root of it 3 %.
    assert noise_floor(TIMES, moving + noise) == pytest.approx(sigma, rel=0.12)


def test_the_longest_stretch_without_a_hole_is_taken() -> None:
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(TIMES))
    keep = np.abs(np.arange(len(TIMES)) - 300) > 5
    assert noise_floor(TIMES[keep], noise[keep]) == pytest.approx(1e-3, rel=0.12)


def test_rounding_counts_and_too_few_samples_tell_nothing() -> None:
    steps = np.round(np.sin(0.3 * TIMES) / 0.01) * 0.01
    assert noise_floor(TIMES, steps) >= 0.01 / np.sqrt(12.0) * 0.99
    assert np.isnan(noise_floor(TIMES[:20], steps[:20]))
