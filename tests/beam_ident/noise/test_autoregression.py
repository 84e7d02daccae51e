from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz

from beam_ident.noise.autoregression import score_covariance


@pytest.mark.parametrize("n", [1, 2, 17, 60, 101])
def test_the_covariance_of_a_score_is_that_of_the_full_correlation_matrix(n):
    design = np.random.default_rng(n).standard_normal((n, 3))
    correlation = 0.9 ** np.arange(n) * np.cos(0.3 * np.arange(n))
    expected = design.T @ toeplitz(correlation) @ design
    np.testing.assert_allclose(score_covariance(design, correlation), expected, rtol=1e-11, atol=1e-11)
