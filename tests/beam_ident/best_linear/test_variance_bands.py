from __future__ import annotations

import numpy as np
import pytest

from beam_ident.best_linear.variance_bands import difference_band, variance_band

N = 20_000  # draws: a share of 95 % scatters by 0.15 %


@pytest.mark.parametrize("freedom", [2.0, 12.0, 100.0])
def test_the_band_of_a_variance_holds_it_as_often_as_stated(freedom):
    drawn = np.random.default_rng(0).chisquare(freedom, N) / freedom
    low, high = variance_band(drawn, np.full(N, freedom), 0.9)
    assert np.mean(low > 1.0) == pytest.approx(0.05, abs=0.006)
    assert np.mean(high < 1.0) == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize("freedoms", [(2.0, 4.0), (12.0, 42.0), (40.0, 8.0)])
@pytest.mark.parametrize("excess", [0.1, 1.0, 30.0])
def test_the_band_of_a_difference_holds_it_as_often_as_stated(freedoms, excess):
    rng = np.random.default_rng(1)
    larger, smaller = (
        (1.0 + e) * rng.chisquare(nu, N) / nu for e, nu in zip((excess, 0.0), freedoms, strict=True)
    )
    low, high = difference_band(larger, np.full(N, freedoms[0]), smaller, np.full(N, freedoms[1]))
    # The source states the coverage to within half a per cent.
    assert np.mean(low > excess) == pytest.approx(0.025, abs=0.007)
    assert np.mean(high < excess) == pytest.approx(0.025, abs=0.007)


def test_where_nothing_is_left_the_band_begins_at_zero_as_often_as_the_f_test_passes():
    rng = np.random.default_rng(2)
    larger, smaller = rng.chisquare(12.0, N) / 12.0, rng.chisquare(42.0, N) / 42.0
    low, high = difference_band(larger, np.full(N, 12.0), smaller, np.full(N, 42.0))
    assert np.mean(low > 0.0) == pytest.approx(0.025, abs=0.004)
    assert np.min(high) >= 0.0


def test_without_freedom_nothing_is_known():
    band = variance_band(np.array([1.0, 1.0]), np.array([0.0, 4.0]))
    assert band[:, 0].tolist() == [0.0, np.inf]
    assert 0.0 < band[0, 1] < 1.0 < band[1, 1] < np.inf
