from __future__ import annotations

import math

import pytest
from scipy.stats import chi2, f

from beam_ident.noise.line_misfit import LineMisfit


@pytest.mark.parametrize("n_free", [1, 2, 9])
def test_noise_of_known_size_leaves_chi_squared(n_free):
    found = LineMisfit.of(3.0, 20, 20 - n_free, 1, math.inf)
    assert (found.expected, found.sd) == pytest.approx((chi2.mean(n_free), chi2.std(n_free)), rel=1e-12)


@pytest.mark.parametrize("n_free", [1, 2, 9])
def test_a_variance_of_few_periods_lets_more_be_expected(n_free):
    # A complex line over its variance of nu complex degrees of freedom follows F(2, 2 nu).
    found = LineMisfit.of(3.0, 20, 20 - n_free, 1, 6.0)
    assert found.expected == pytest.approx(n_free * f.mean(2, 2 * 6), rel=1e-12)
