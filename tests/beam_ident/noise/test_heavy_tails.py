"""Student's t: its location and its stated deviation, for outliers of any share."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident.noise.heavy_tails import HeavyTails
from beam_ident.noise.outliers import outliers


def kept(residuals: np.ndarray) -> np.ndarray:
    result = np.ones(len(residuals), dtype=bool)
    result[outliers(residuals)] = False
    return result


@pytest.mark.slow
@pytest.mark.parametrize(("share", "size"), [(0.01, 20.0), (0.1, 20.0), (0.1, 4.0)])
def test_the_stated_deviation_of_a_mean_is_the_scatter_of_means(share, size):
    rng = np.random.default_rng(5)
    means, stated = [], []
    for _ in range(120):
        noise = rng.standard_normal(400)
        far = rng.uniform(size=400) < share
        noise[far] += size * rng.standard_normal(int(np.sum(far)))
        mean = 0.0
        for _ in range(6):
            tails = HeavyTails.of(noise - mean, kept(noise - mean))
            mean += float(np.average(noise - mean, weights=tails.weights))
        square = float(np.mean(tails.weights * (noise - mean) ** 2)) * tails.inflation
        means.append(mean)
        stated.append(np.sqrt(square / np.sum(tails.weights)))
    # 120 runs know a standard deviation to 6.5 %.
    assert np.mean(stated) == pytest.approx(np.std(means), rel=0.2)
    assert np.std(means) < 0.062  # 1/sqrt(400) without outliers; least squares has 0.11 to 0.32


@pytest.mark.parametrize("freedom", [1.0, 4.0, 50.0])
def test_the_stated_efficiency_is_that_of_gaussian_noise(freedom):
    rng = np.random.default_rng(6)
    noise = rng.standard_normal(400_000)
    every = np.ones(len(noise), dtype=bool)
    scale = HeavyTails(freedom, 1.0, noise, every)
    for _ in range(100):
        scale = HeavyTails(
            freedom,
            scale.scale * float(np.sqrt(np.mean(scale.weights * (noise / scale.scale) ** 2))),
            noise,
            every,
        )
    assert scale.efficiency == pytest.approx(1.0 / scale.gain, abs=0.01)


def test_gaussian_noise_keeps_the_likelihood_of_least_squares():
    noise = np.random.default_rng(7).standard_normal(5000)
    found = HeavyTails.of(noise, np.ones(5000, dtype=bool))
    assert found.freedom == 50.0
    assert found.cost == pytest.approx(2500.0 * np.log(noise @ noise), abs=5.0)
    assert found.gain == pytest.approx(1.0, abs=0.01)
