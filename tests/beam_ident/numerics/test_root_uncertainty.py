from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.root_uncertainty import root_covariances


@pytest.mark.slow
def test_the_scatter_of_roots_is_that_of_drawn_coefficients():
    polynomial = np.array([1.0, 5.0, 408.0, 416.0, 1600.0])
    sd = np.array([0.01, 0.2, 0.7, 1.5])
    shape = np.array([[1.0, 0.3, 0.0, 0.1], [0.3, 1.0, 0.2, 0.0], [0.0, 0.2, 1.0, 0.4], [0.1, 0.0, 0.4, 1.0]])
    covariance = shape * np.outer(sd, sd)
    roots, stated = root_covariances(polynomial, covariance)
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(polynomial[1:], covariance, 4000)
    for root, spread in zip(roots, stated, strict=True):
        found = []
        for draw in draws:
            near = np.roots(np.concatenate([[1.0], draw]))
            found.append(near[np.argmin(np.abs(near - root))])
        seen = np.cov(np.real(found), np.imag(found))
        # Sampled variances of 4000 draws scatter by 2.2 %; second-order terms add a few per cent.
        assert np.allclose(np.diag(seen), np.diag(spread), rtol=0.15)


def test_an_uncertain_leading_coefficient_counts_too():
    # The root of b0 s + b1 is -b1 / b0: variance (b1 / b0^2)^2 var(b0) + var(b1) / b0^2.
    roots, stated = root_covariances(np.array([2.0, 6.0]), np.diag([0.01, 0.04]))
    assert roots[0] == -3.0
    assert np.isclose(stated[0, 0, 0], (6.0 / 4.0) ** 2 * 0.01 + 0.04 / 4.0)
    assert stated[0, 1, 1] == 0.0
