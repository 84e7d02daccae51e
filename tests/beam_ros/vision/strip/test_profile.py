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
    assert profile(pixels, width, blur, smear) == pytest.approx(caught, abs=4 * 0.0008 * max(width, 1.0))


def test_the_weights_give_back_ground_height_and_shift():
    table = ProfileTable(2.0, 0.9, 2.0)
    rng = np.random.default_rng(1)
    u = 40 + rng.uniform(-3, 3, 50)
    smear = rng.integers(0, 9, 50) * 0.25
    column, entry, tabulated = table.entries(u, smear)
    pixels = column[:, None] + np.arange(-table.half, table.half + 1)
    grey = 17.0 + 120.0 * np.array(
        [profile(row - at, 2.0, 0.9, s) for row, at, s in zip(pixels, u, smear, strict=True)]
    )
    height, ground, slope = np.einsum("rkw,rw->kr", table.weights[entry].astype(float), grey)
    assert np.abs(u - tabulated).max() <= 0.5 / 32 + 1e-12
    assert height == pytest.approx(np.full(50, 120.0), rel=2e-3)
    assert ground == pytest.approx(np.full(50, 17.0), abs=0.1)
    # Linear to a thousandth of a pixel within half a phase.
    assert tabulated + slope / height == pytest.approx(u, abs=1e-3)
