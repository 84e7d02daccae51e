"""The tabulated cross-section against one summed by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.strip.profile import ProfileTable, profile


@pytest.mark.parametrize(("width", "blur", "smear"), [(0.75, 0.8, 0.0), (0.75, 0.8, 3.0), (8.0, 0.5, 1.5)])
def test_the_cross_section_is_bar_blur_smear_and_pixel(width, blur, smear):
    fine = np.arange(-30, 30, 1e-3) + 5e-4
    bar = (np.abs(fine) < width / 2).astype(float)
    rng = np.random.default_rng(0)
    pixels = np.linspace(-9, 9, 37)
    # Every photon: a place on the bar, a shift by the blur, a shift by the motion, caught by a pixel of width one.
    places = rng.uniform(-width / 2, width / 2, 400_000)
    places += blur * rng.standard_normal(places.size) + smear * rng.uniform(-0.5, 0.5, places.size)
    caught = np.array([np.mean(np.abs(places - pixel) < 0.5) for pixel in pixels]) * width
    assert bar.sum() * 1e-3 == pytest.approx(width, abs=2e-3)
    # 400 000 photons: a standard deviation of at most width * 0.0008.
    shape, slope = profile(pixels, width, blur, smear)
    assert shape == pytest.approx(caught, abs=4 * 0.0008 * max(width, 1.0))
    right, left = (profile(pixels + 1e-3 * sign, width, blur, smear)[0] for sign in (1, -1))
    assert slope == pytest.approx((left - right) / 2e-3, abs=1e-5)


def test_the_weights_give_back_ground_height_and_shift():
    table = ProfileTable(2.0, 0.9, 2.0)
    rng = np.random.default_rng(1)
    u = 40 + rng.uniform(-3, 3, 50)
    smear = rng.integers(0, 9, 50) * 0.25
    column, entry, tabulated = table.entries(u, smear)
    pixels = column[:, None] + np.arange(-table.half, table.half + 1)
    grey = 17.0 + 120.0 * np.array(
        [profile(row - at, 2.0, 0.9, s)[0] for row, at, s in zip(pixels, u, smear, strict=True)]
    )
    fits = table.fit(entry, grey.astype(np.float32))
    assert np.abs(u - tabulated).max() <= 0.5 / 32 + 1e-12
    assert fits.height == pytest.approx(np.full(50, 120.0), rel=2e-3)
    # Linear to a thousandth of a pixel within half a phase.
    assert tabulated + fits.slope / fits.height == pytest.approx(u, abs=1e-3)
    assert np.abs(table.residual(entry, grey.astype(np.float32))).max() < 0.1


def test_misfit_and_variances_of_a_fit_are_those_of_the_noise():
    table = ProfileTable(1.0, 0.8, 1.0)
    rng = np.random.default_rng(2)
    u, smear = 40 + rng.uniform(-3, 3, 4000), rng.uniform(0, 1, 4000)
    column, entry, _ = table.entries(u, smear)
    fits = table.fit(entry, 3.0 * rng.standard_normal((4000, table.size), dtype=np.float32))
    # 4000 rows: a variance is known to 2.2 %.
    assert np.var(fits.height / np.sqrt(fits.height_gain)) == pytest.approx(9.0, rel=0.09)
    assert np.var(fits.slope / np.sqrt(fits.slope_gain)) == pytest.approx(9.0, rel=0.09)
    assert np.mean(fits.misfit) == pytest.approx(9.0 * (table.size - 3), rel=0.03)
    assert np.abs(u - column).max() <= 0.5


@pytest.mark.parametrize(("width", "blur"), [(0.75, 0.8), (3.0, 0.8), (25.0, 0.8), (60.0, 2.0)])
def test_a_step_is_short_by_its_cube_over_four_spreads_squared(width, blur):
    table = ProfileTable(width, blur, 0.0)
    _, entry, tabulated = table.entries(np.array([40.0]), np.zeros(1))
    places = np.arange(40 - table.half, 41 + table.half) - tabulated
    at, shift = table.shapes[entry[0]], 0.3 * table.spread_px
    moved = 100.0 * profile(places - shift, width, blur, 0.0)[0]
    step = table.fit(entry, moved[None, :].astype(np.float32)).slope[0] / 100.0
    assert at == pytest.approx(profile(places, width, blur, 0.0)[0], abs=1e-5)
    # The next term of the series is of the order of 0.3^2 of this one.
    assert shift - step == pytest.approx(shift**3 / (4 * table.spread_px**2), rel=0.15)
