from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.free_motion import free_motions
from tests.beam_ident.truth import averaged_cosine


@pytest.mark.parametrize("exposure", [1e-7, 0.02])
def test_free_motions_are_means_over_the_exposure_with_their_slopes(exposure):
    sigma, omega = -0.9, 2 * np.pi * 28.3
    times, pole = np.linspace(0.1, 2.0, 40), np.array([[complex(sigma, omega)]])
    decay, by_sigma, by_time = free_motions(pole, times, exposure, (np.ones((1, 1)),))
    if exposure > 1e-6:
        seen = averaged_cosine(times, complex(sigma, omega), 1.0, exposure)
    else:
        seen = np.exp(sigma * times) * np.cos(omega * times)
    np.testing.assert_allclose(decay[0].real, seen, rtol=1e-9, atol=1e-12)
    h = 1e-6
    later = free_motions(pole, times + h, exposure, ())[0] - free_motions(pole, times - h, exposure, ())[0]
    moved = free_motions(pole + h, times, exposure, ())[0] - free_motions(pole - h, times, exposure, ())[0]
    np.testing.assert_allclose(by_time, later / (2 * h), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(by_sigma, moved / (2 * h), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("elapsed", "exposure"), [(-100.0, 0.0), (-100.0, 0.02), (100.0, 0.02), (0.0, 60.0)])
@pytest.mark.filterwarnings("error")
def test_stamps_far_from_the_beginning_and_endless_exposures_give_numbers(elapsed, exposure):
    pole = np.array([[-50.0 + 80.0j]])
    for found in free_motions(pole, np.array([elapsed, 1.0]), exposure, (pole, 1j * pole)):
        assert np.all(np.isfinite(np.square(np.abs(found))))
