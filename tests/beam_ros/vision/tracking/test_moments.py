"""The tracker's own sums are OpenCV's, exactly, and those of loops are these."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beam_ros.vision.tracking.moments import (
    BORDER,
    HIDDEN,
    SEEN,
    UNKNOWN,
    beyond,
    compiled_spot_numbers,
    cross_by_pixels,
    first_moments,
    moments_beyond,
    moments_in_loops,
    spot_numbers,
)

RNG = np.random.default_rng(7)
ORDERS = ("00", "10", "01", "20", "11", "02", "30", "03")


@pytest.mark.parametrize("top", [255, 65535])
@pytest.mark.parametrize("is_dark", [False, True])
def test_beyond_levels_is_what_saturated_subtraction_of_each_number_leaves(top, is_dark):
    dtype = np.uint8 if top == 255 else np.uint16
    regions = RNG.integers(0, top + 1, (60, 24)).astype(dtype)
    # What lies beyond a level that the grey levels do not reach is nothing.
    levels = (-20.0 if is_dark else top + 40.0, 1.0, float(top // 3), float(top))
    found = beyond(regions, levels, is_dark=is_dark)
    assert found.dtype == dtype
    assert found.flags.c_contiguous
    for k, level in enumerate(levels):
        part = slice(15 * k, 15 * k + 15)
        expected = cv2.subtract(level, regions[part]) if is_dark else cv2.subtract(regions[part], level)
        assert np.array_equal(found[part], expected)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_dark", [False, True])
def test_moments_of_several_squares_are_those_of_each_and_unknown_where_an_edge_cuts_one(dtype, is_dark):
    image = RNG.integers(0, np.iinfo(dtype).max + 1, (60, 80)).astype(dtype)
    places = [(20.3, 14.2, 60.0), (65.4, 30.0, 90.0), (14.0, 45.4, 10.0)]
    found = first_moments(image, places, 14, is_dark)
    for (u, v, level), sums in zip(places, found, strict=True):
        region = round(u) - 14, round(v) - 14, round(u) + 15, round(v) + 15
        assert list(sums) == list(moments_beyond(image, *region, level, is_dark))
        assert list(sums) == list(moments_in_loops(image, *region, level, is_dark))
    for cut in ((13.0, 30.0), (66.0, 30.0), (30.0, 13.0), (30.0, 46.0)):
        assert first_moments(image, [*places, (*cut, 9.0)], 14, is_dark) == [UNKNOWN] * 4


@pytest.mark.parametrize("shape", [(29, 29), (19, 29), (31, 12), (1, 1)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_moments_are_opencvs_to_the_last_digit(shape, dtype):
    most = np.iinfo(dtype).max
    for grey in (
        RNG.integers(0, most + 1, shape).astype(dtype),
        np.full(shape, most, dtype),
        np.zeros(shape, dtype),
    ):
        whole = np.pad(grey, ((3, 1), (2, 4)), constant_values=7)
        region = 2, 3, 2 + shape[1], 3 + shape[0]
        for level, is_dark in ((0.0, False), (90.0, False), (90.0, True), (most, True)):
            expected = cv2.moments(beyond(grey, (level,), is_dark=is_dark))
            expected = [expected[f"m{order}"] for order in ORDERS]
            assert list(moments_beyond(whole, *region, level, is_dark)) == expected
            assert list(moments_in_loops(whole, *region, level, is_dark)) == expected


def egg(polarity: int = 1) -> np.ndarray:
    """Return a spot that is asymmetric on both axes, at (31.2, 29.3)."""
    x, y = np.meshgrid(np.arange(60.0) - 31.2, np.arange(50.0) - 29.3)
    spot = np.rint(200 * np.exp(-np.hypot(x, 1.4 * y) / (3 + 0.1 * np.clip(x + 10, 0, 20)))).astype(np.uint8)
    return spot if polarity > 0 else 255 - spot


@pytest.mark.parametrize("is_dark", [False, True])
def test_the_numbers_of_a_spot_are_opencvs_central_moments(is_dark):
    image = egg(-1 if is_dark else 1)
    level = 240.0 if is_dark else 15.0
    seen, numbers = spot_numbers(image, 30.0, 30.0, 14, level, 0.0, 100.0, 7.0, is_dark)
    assert seen == SEEN
    u, v, mass, _, variance_u, variance_v, covariance, skew_u, skew_v, plateau, region = numbers
    left, top, right, bottom = region
    expected = cv2.moments(beyond(image[top:bottom, left:right], (level,), is_dark=is_dark))
    # Differences of sums some thousand times as large.
    assert u == pytest.approx(left + expected["m10"] / expected["m00"], rel=1e-12)
    assert v == pytest.approx(top + expected["m01"] / expected["m00"], rel=1e-12)
    assert variance_u * mass == pytest.approx(expected["mu20"], rel=1e-9)
    assert variance_v * mass == pytest.approx(expected["mu02"], rel=1e-9)
    assert covariance * mass == pytest.approx(expected["mu11"], rel=1e-9)
    assert skew_u * mass * variance_u**1.5 == pytest.approx(expected["mu30"], rel=1e-9)
    assert skew_v * mass * variance_v**1.5 == pytest.approx(expected["mu03"], rel=1e-9)
    row, column = round(v), round(u)
    cross = [image[row + y, column + x] for y, x in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))]
    assert plateau == pytest.approx(np.mean(cross), rel=1e-12)
    assert 5 * plateau == pytest.approx(cross_by_pixels(image, row, column), rel=1e-12)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_dark", [False, True])
def test_compiled_numbers_of_a_spot_are_the_same(dtype, is_dark):
    compiled = compiled_spot_numbers()
    if compiled is None:
        pytest.skip("Numba is not installed (the extra compiled)")
    image = egg(-1 if is_dark else 1).astype(dtype)
    level = 240.0 if is_dark else 15.0
    frozen = np.frombuffer(image.tobytes(), dtype).reshape(image.shape)
    seen = set()
    for u, v in ((31.2, 29.3), (26.0, 35.0), (40.0, 29.0), (3.0, 3.0), (500.0, 3.0), (8.0, 20.0)):
        for speck, least, reach in ((0.0, 100.0, 7.0), (0.3, 100.0, 7.0), (0.0, 1e6, 7.0), (0.0, 1.0, 25.0)):
            asked = (u, v, 14, level, speck, least, reach, is_dark)
            expected = spot_numbers(image, *asked)
            for shown in (image, frozen, np.pad(image, 5)[5:-5, 5:-5]):
                assert compiled(shown, *asked, UNKNOWN) == expected
            seen.add(expected[0])
    assert seen == {SEEN, HIDDEN, BORDER}
