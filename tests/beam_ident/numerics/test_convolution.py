"""Tests of convolutions, against SciPy's."""

import numpy as np
import pytest
from scipy import ndimage, signal

from beam_ident.numerics.convolution import causal_convolution, eroded, inner_convolution, running_mean

WEIGHTS = np.array([1.0, -0.7, 0.4, 2.0])


@pytest.mark.parametrize("n", [1, 3, 4, 50])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_causal_convolution_begins_at_rest(n: int, axis: int) -> None:
    values = np.random.default_rng(1).standard_normal((n, n + 2))
    found = causal_convolution(WEIGHTS, values, axis)
    np.testing.assert_allclose(found, signal.lfilter(WEIGHTS, [1.0], values, axis), rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(
        causal_convolution(WEIGHTS, values[0]), causal_convolution(WEIGHTS, values)[0]
    )


@pytest.mark.parametrize("n_weights", [1, 2, 63, 1000])
def test_an_inner_convolution_is_where_all_weights_lie_on_values(n_weights: int) -> None:
    rng = np.random.default_rng(2)
    values, weights = rng.standard_normal(1000), rng.standard_normal(n_weights)
    # The transforms round to some 1e-16 of the largest values.
    np.testing.assert_allclose(
        inner_convolution(values, weights), np.convolve(values, weights, "valid"), atol=1e-12
    )


@pytest.mark.parametrize("width", [1, 2, 5, 8])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_running_mean_is_the_uniform_filter(width: int, axis: int) -> None:
    values = np.random.default_rng(3).standard_normal((20, 30))
    expected = ndimage.uniform_filter1d(values, width, axis, mode="nearest")
    np.testing.assert_allclose(running_mean(values, width, axis), expected, rtol=1e-12, atol=1e-14)


def test_a_running_mean_keeps_what_is_small_behind_what_is_large() -> None:
    values = np.concatenate([[1e20], np.ones(9)])
    np.testing.assert_allclose(running_mean(values, 5)[3:], 1.0)


def test_a_mask_is_eroded_from_both_sides_and_at_its_ends() -> None:
    mask = np.random.default_rng(4).random(200) > 0.1
    np.testing.assert_array_equal(eroded(mask, 5), ndimage.binary_erosion(mask, np.ones(5)))
