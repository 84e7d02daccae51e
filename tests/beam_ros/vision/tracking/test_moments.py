"""The tracker's own sums are OpenCV's, exactly."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beam_ros.vision.tracking.moments import beyond, central_moments, raw_moments

RNG = np.random.default_rng(7)
ORDERS = ("00", "10", "01", "20", "11", "02", "30", "03")


@pytest.mark.parametrize("top", [255, 65535])
@pytest.mark.parametrize("is_dark", [False, True])
def test_beyond_a_level_is_what_saturated_subtraction_of_a_number_leaves(top, is_dark):
    dtype = np.uint8 if top == 255 else np.uint16
    region = RNG.integers(0, top + 1, (40, 50)).astype(dtype)[3:22, 5:29]
    # A dark marker's floor may lie beyond white, and the level before black.
    for level in (-20.0, 0.0, 1.0, top // 3, float(top), top + 40.0):
        expected = cv2.subtract(level, region) if is_dark else cv2.subtract(region, level)
        found = beyond(region, level, is_dark=is_dark)
        assert found.dtype == dtype
        assert found.flags.c_contiguous
        assert np.array_equal(found, expected)


@pytest.mark.parametrize("shape", [(29, 29), (19, 29), (31, 12), (1, 1)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_raw_moments_are_opencvs_to_the_last_digit(shape, dtype):
    for grey in (
        RNG.integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype),
        np.full(shape, np.iinfo(dtype).max, dtype),
        np.zeros(shape, dtype),
    ):
        expected = cv2.moments(grey)
        assert raw_moments(grey) == [expected[f"m{order}"] for order in ORDERS]


def test_central_moments_are_opencvs():
    # Asymmetric on both axes.
    x, y = np.meshgrid(np.arange(29.0), np.arange(23.0))
    grey = (200 * np.exp(-np.hypot(x - 11.3, 1.4 * (y - 9.1)) / (3 + 0.1 * x))).astype(np.uint8)
    expected = cv2.moments(grey)
    found = central_moments(raw_moments(grey))
    for order, value in zip(("20", "11", "02", "30", "03"), found, strict=True):
        # Differences of sums some thousand times as large.
        assert value == pytest.approx(expected[f"mu{order}"], rel=1e-9)
