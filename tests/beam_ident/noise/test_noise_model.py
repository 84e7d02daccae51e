import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz
from scipy.signal import lfilter

from beam_ident.noise.continuous_noise import ContinuousNoise, ContinuousWhitening
from beam_ident.noise.heavy_tails import HeavyTails
from beam_ident.noise.noise_model import NoisePass, RecordNoise, Whitening

N = 300
TIMES = np.delete(np.arange(N + 3) * 0.01, [50, 51, 130])  # three runs
ODD_TIMES = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.02, N))
KEPT = np.ones(N, dtype=bool)
KEPT[[7, 48, 49, 120, 121, 299]] = False


def noises() -> dict[str, RecordNoise]:
    colour = np.array([1.0, -0.9, 0.4, 0.1])
    pair = ContinuousNoise(20.0, -(60.0**2), 10.0, white=0.2)
    slow = ContinuousNoise(5.0, white=0.3)
    residuals = np.random.default_rng(1).standard_t(3.0, N)
    return {
        "white": RecordNoise(Whitening(np.ones(1), TIMES)),
        "autoregression": RecordNoise(Whitening(colour, TIMES)),
        "without outliers": RecordNoise(Whitening(colour, TIMES[KEPT]), KEPT),
        "process of first order": RecordNoise(ContinuousWhitening(slow, ODD_TIMES)),
        "process of second order": RecordNoise(ContinuousWhitening(pair, ODD_TIMES)),
        "process without outliers": RecordNoise(ContinuousWhitening(pair, ODD_TIMES[KEPT]), KEPT),
        "tails": RecordNoise(Whitening(np.ones(1), TIMES), tails=HeavyTails.of(residuals, KEPT)),
    }


@pytest.mark.parametrize("kind", noises())
def test_rows_that_come_in_pieces_are_whitened_like_the_whole(kind):
    noise = noises()[kind]
    columns = np.random.default_rng(2).standard_normal((N, 3))
    passed = NoisePass(noise)
    found = np.concatenate([passed.apply(own) for own in np.split(columns, [1, 2, 7, 8, 49, 52, 130, 131])])
    np.testing.assert_allclose(found, noise.apply(columns), rtol=1e-11, atol=1e-11)


def test_whitening_is_the_inverse_root_of_the_covariance():
    noise = ContinuousNoise(20.0, -(60.0**2), 10.0, white=0.2)
    covariance = noise.correlation(ODD_TIMES[:, None] - ODD_TIMES) + 0.2 * np.eye(N)
    passed = NoisePass(RecordNoise(ContinuousWhitening(noise, ODD_TIMES)))
    white = np.concatenate([passed.apply(own) for own in np.split(np.eye(N), [1, 100, 101])])
    left = white @ covariance @ white.T
    np.testing.assert_allclose(left, left[0, 0] * np.eye(N), atol=1e-9 * left[0, 0])


def test_runs_of_any_length_are_whitened_each_from_its_first_sample_on():
    coefficients = np.poly([0.7, -0.4, 0.2])
    lengths = (1, 2, 9, 3, 1, 4, 12)
    times = np.concatenate([100 * k + np.arange(n) for k, n in enumerate(lengths)]) * 0.01
    impulse = lfilter([1.0], coefficients, np.eye(1, 400)[0])
    correlation = np.array([impulse[k:] @ impulse[: len(impulse) - k] for k in range(max(lengths))])
    covariance = block_diag(*(toeplitz(correlation[:n]) for n in lengths))
    white = Whitening(coefficients, times).apply(np.eye(len(times)))
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(len(times)), atol=1e-12)
