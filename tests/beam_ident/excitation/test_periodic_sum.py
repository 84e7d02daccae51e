"""The transform and the plain sum give the same signal."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import BandLimitedNoise, Multisine
from beam_ident.excitation.periodic_sum import sum_of_lines

NUMBERS = np.array([1, 4, 9, 30])
AMPLITUDES = np.array([1.0, 0.5, 2.0, 0.1])
PHASES = np.array([0.1, 2.0, -1.0, 4.0])


def plain(times: np.ndarray, period: float) -> np.ndarray:
    return sum(
        a * np.sin(2 * np.pi * k * times / period + p)
        for k, a, p in zip(NUMBERS, AMPLITUDES, PHASES, strict=True)
    )


@pytest.mark.parametrize(
    "times",
    [
        np.arange(-100, 400) * 0.02,  # a grid that divides the period, from before the start
        np.arange(300) * 0.02 + 0.007,  # beside the grid
        np.arange(300) * 0.0217,  # a step that does not divide it
        np.arange(30) * 0.05,  # a grid too coarse for line 30
        np.arange(300) * (2.0 / 62),  # one just fine enough
        np.array([0.3]),
        np.array([0.5, 0.1, 0.2]),
    ],
    ids=["grid", "shifted", "other step", "coarse", "just fine enough", "one instant", "unsorted"],
)
def test_every_way_gives_the_same_sum(times):
    np.testing.assert_allclose(
        sum_of_lines(times, NUMBERS, AMPLITUDES, PHASES, 2.0), plain(times, 2.0), atol=1e-12
    )


@pytest.mark.parametrize("recipe", [Multisine(end_frequency=20.0), BandLimitedNoise(end_frequency=20.0)])
def test_samples_agree_with_the_displacement_between_the_ticks(recipe):
    ticks = np.arange(0, 3000) * 1e-2
    apart = np.append(ticks, 0.123456)  # no grid any more
    np.testing.assert_allclose(recipe.displacement(ticks), recipe.displacement(apart)[:-1], atol=1e-15)


def test_an_hour_of_noise_is_made_at_once():
    """By the plain sum this takes 1e12 sines."""
    hour = BandLimitedNoise(duration=3600.0, still=0.0).sample(2e-3)
    assert abs(hour.positions[-1]) < 1e-9
    # The held differences over 2 ms take 5 % of the power at 50 Hz, and the ceiling a little more.
    assert np.std(hour.accelerations) == pytest.approx(0.29, rel=0.02)
