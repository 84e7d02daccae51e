"""Raw mosaics of a colour sensor that are called grey, and what is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from beam_ros.vision.mosaic import is_mosaic
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)
GROUND = 12.0
RED = np.array([[1.0, 0.55], [0.55, 0.25]])
GREENISH = np.array([[0.75, 1.0], [1.0, 0.75]])
BALANCED = np.array([[1.3, 1.0], [1.0, 0.7]])
"""Here red and blue lie as far above green as below it: no checkerboard is left."""


def shown(image: np.ndarray, gains: np.ndarray, row: int = 0, column: int = 0) -> np.ndarray:
    """An image behind filters that let through so much, the first of them at a row and a column."""
    tiled = np.tile(np.roll(gains, (row, column), axis=(0, 1)), (image.shape[0] // 2, image.shape[1] // 2))
    return np.clip(np.rint(image * tiled), 0, 255).astype(np.uint8)


def spot(diameter: float, u: float, v: float, blur: float = 0.8) -> np.ndarray:
    """A disc in 40 x 40 pixels of ground."""
    fine = (np.arange(40 * 8) + 0.5) / 8 - 0.5
    depth = diameter / 2 - np.hypot(fine - u, fine[:, None] - v)
    return GROUND + 180.0 * ndtr(depth / blur).reshape(40, 8, 40, 8).mean(axis=(1, 3))


@pytest.mark.parametrize("gains", [RED, GREENISH, BALANCED])
@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 1), (1, 0), (1, 1)])
@pytest.mark.parametrize("diameter", [6.0, 12.0, 30.0])
def test_a_mosaic_is_seen_in_every_order_of_its_colours(gains, row, column, diameter):
    light = shown(spot(diameter, 19.3, 20.6), gains, row, column)
    for cut in (0, 1):
        assert is_mosaic(light[cut:], GROUND * gains.mean(), 2.0)


ALIKE, COLUMNS, ROWS, NEARLY = (
    ([1, 1], [1, 1]),
    ([1, 0.6], [1, 0.6]),
    ([1, 1], [0.5, 0.5]),
    ([0.98, 1], [1, 0.95]),
)


@pytest.mark.slow
@pytest.mark.parametrize("gains", [ALIKE, COLUMNS, ROWS, NEARLY])
@pytest.mark.parametrize("blur", [0.1, 0.8])
def test_rows_and_columns_that_differ_and_sharp_discs_are_no_mosaic(gains, blur):
    rng = np.random.default_rng(4)
    for u, v in 19.0 + rng.random((40, 2)):
        for diameter in (6.0, 12.0):
            light = shown(spot(diameter, u, v, blur) + 2.0 * rng.standard_normal((40, 40)), np.array(gains))
            assert not is_mosaic(light, GROUND * np.mean(gains), 2.0)
            sharp = shown(spot(diameter, u, v, blur) - GROUND, np.array(gains))
            assert not is_mosaic(sharp[8:32, 8:32], 0.0, 0.0)


def test_a_region_without_light_and_noise_that_may_be_one_are_no_mosaic():
    assert not is_mosaic(np.zeros((20, 20), np.uint8), 0.0, 0.0)
    assert not is_mosaic(shown(spot(6.0, 19.3, 20.6), GREENISH), GROUND, 30.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "is_dark", "is_named"),
    [(RED, False, True), (GREENISH, False, True), (GREENISH, True, True), (RED, True, False)],
)
def test_markers_in_a_raw_mosaic_are_never_measured_and_those_in_grey_are(gains, is_dark, is_named):
    levels = {"background": 80.0, "contrast": -70.0} if is_dark else {}
    camera = packaged_camera(noise_grey=2.0, **levels)
    renderer, rng = SceneRenderer(camera, HEIGHTS), np.random.default_rng(1)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3)
    n_mosaics = 0
    for k in range(60):
        image = renderer.render(0.012 * np.sin(0.2 * k + np.arange(3.0)), rng)
        markers = tracker.process(shown(image, gains), k).markers
        assert not any(marker.is_valid for marker in markers)
        n_mosaics += sum(marker.reason == "mosaic" for marker in markers)
    # A bright ground under such filters is so uneven that nothing is like a marker.
    assert tracker.shows_mosaic == is_named
    assert n_mosaics > 150 or not is_named
    tracker.reset()
    for k in range(60, 70):
        result = tracker.process(renderer.render(0.012 * np.sin(0.2 * k + np.arange(3.0)), rng), k)
    assert result.is_complete
    assert not tracker.shows_mosaic
