"""Tests of the recursions of samples."""

import numpy as np
import pytest
from scipy.linalg import lapack
from scipy.signal import lfilter

from beam_ident.numerics.recursions import all_pole, one_pole

LONG = 20_000
"""Samples: more than two of the blocks that are taken at once."""


@pytest.mark.parametrize("n", [0, 1, 7, LONG])
@pytest.mark.parametrize("feedback", [0.97, -0.5, 1.0, 0.999 * np.exp(0.4j)])
def test_one_pole_is_the_filter_of_scipy(n: int, feedback: complex) -> None:
    drive = np.random.default_rng(1).standard_normal(n).astype(type(feedback))
    before = 0.3 * feedback
    expected = lfilter([1.0], [1.0, -feedback], drive, zi=[feedback * before])[0]
    # Both add the same two numbers at every sample; a fused multiply-add rounds once less.
    np.testing.assert_allclose(one_pole(feedback, drive, before), expected, rtol=1e-12, atol=1e-12)


def test_one_pole_leaves_its_drive_alone() -> None:
    drive = np.ones(5)
    one_pole(0.5, drive, 1.0)
    assert np.all(drive == 1.0)


def test_a_pole_that_has_faded_ends_at_zero() -> None:
    drive = np.zeros(LONG)
    drive[0] = 1.0
    found = one_pole(0.5, drive)
    np.testing.assert_array_equal(found[:1000], 0.5 ** np.arange(1000))
    assert np.all(found[1200:] == 0.0)  # below 2^-1074 nothing is left


@pytest.mark.parametrize("n", [1, 3, 5, 6, LONG])
def test_all_pole_is_the_filter_of_scipy(n: int) -> None:
    rng = np.random.default_rng(2)
    coefficients = np.poly([0.9, -0.8, 0.7j, -0.7j, 0.5]).real
    rows, state = rng.standard_normal((3, n)), rng.standard_normal((3, 5))
    given = state.copy()
    expected, expected_state = lfilter([1.0], coefficients, rows, zi=state)
    found, found_state = all_pole(coefficients, rows, state)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found_state, expected_state, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(state, given)


def test_all_pole_goes_on_from_its_state() -> None:
    rows = np.random.default_rng(3).standard_normal((2, 40))
    coefficients, rest = np.array([1.0, -1.2, 0.9, -0.3]), np.zeros((2, 3))
    whole, end = all_pole(coefficients, rows, rest)
    parts, state = [], rest
    for part in np.split(rows, [1, 3, 20], axis=1):
        found, state = all_pole(coefficients, part, state)
        parts.append(found)
    np.testing.assert_allclose(np.concatenate(parts, axis=1), whole, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state, end, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", [(0, 50), (2, 0)])
def test_nothing_is_handed_to_lapack_where_there_are_no_samples(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of no right sides dtbtrs solves one all the same, in memory that is not the array's.
    monkeypatch.setattr(lapack, "dtbtrs", None)
    rows, state = np.empty(shape), np.ones((shape[0], 1))
    found, after = all_pole(np.array([1.0, -0.5]), rows, state)
    assert found.shape == shape
    np.testing.assert_array_equal(after, state)
