"""Defective pixels of the sensor beside, on and under markers, and what is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from beam_ros.vision.defects import LOOKS, DefectivePixels
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)
CAMERA = packaged_camera(noise_grey=2.0)
ROW, COLUMN = round(CAMERA.rows(HEIGHTS)[1]), round(CAMERA.origin_px[0])
WHITE, BLACK, ALL = 255, 0, slice(None)
DEFECTS = {
    "one in the row": [(0, 12, WHITE)],
    "one at the rim": [(0, 7, WHITE)],
    "one on the rim": [(1, 6, WHITE)],
    "four around": [(3, 12, WHITE), (-4, 15, WHITE), (2, -11, WHITE), (0, -14, WHITE)],
    "two in one": [(0, 10, WHITE), (0, 11, WHITE)],
    "a dead one in the middle": [(0, 0, BLACK)],
    "a dead one near the rim": [(1, 4, BLACK)],
    "a dead column in the middle": [(ALL, 0, BLACK)],
    "a dead column aside": [(ALL, 3, BLACK)],
    "a part of a dead column": [(row, 3, BLACK) for row in range(-20, 20)],
    "a dead column on the rim": [(ALL, -5, BLACK)],
    "a dead column beside the rim": [(ALL, 7, BLACK)],
    "a hot column": [(ALL, 2, WHITE)],
    "a dead row": [(1, ALL, BLACK)],
}


def spoilt(image: np.ndarray, defects: list, scale: int = 1) -> np.ndarray:
    """A picture with other levels in pixels whose rows and columns are those from the middle marker's, or all."""
    for row, column, level in defects:
        image[row if row is ALL else ROW + row, column if column is ALL else COLUMN + column] = level * scale
    return image


@pytest.mark.first_case
@pytest.mark.parametrize("amplitude_px", [0.0, 12.0])
@pytest.mark.parametrize("defects", DEFECTS.values(), ids=DEFECTS)
def test_markers_are_measured_with_defective_pixels_from_the_first_frame_on(defects, amplitude_px):
    renderer, rng = SceneRenderer(CAMERA, HEIGHTS), np.random.default_rng(3)
    tracker = MarkerTracker(packaged_tracker(CAMERA, HEIGHTS), 3)
    scores, n_lost = [], 0
    for k in range(60):
        moved = (
            (amplitude_px * np.sin(0.15 * k + 0.3) + 0.2) / CAMERA.pixels_per_metre * np.array([0.4, 1, 1.2])
        )
        result = tracker.process(spoilt(renderer.render(moved, rng), defects), k)
        truth = CAMERA.origin_px[0] + CAMERA.direction * CAMERA.pixels_per_metre * moved
        for marker, u in zip(result.markers, truth, strict=True):
            n_lost += not marker.is_valid
            if marker.is_valid:
                scores.append((marker.u_px - u) / marker.sigma_px)
    # What a marker covers as it is looked for, and does not stand out of it, is found after it was lost there.
    assert n_lost <= (10 if amplitude_px else 0)
    assert np.sqrt(np.mean(np.square(scores))) < 1.2
    assert np.abs(scores).max() < 5.0


def disc(diameter: float, u: float, v: float, blur: float) -> np.ndarray:
    """A disc of the contrast 1 in 40 x 40 pixels."""
    fine = (np.arange(40 * 16) + 0.5) / 16 - 0.5
    depth = diameter / 2 - np.hypot(fine - u, fine[:, None] - v)
    return ndtr(depth / blur).reshape(40, 16, 40, 16).mean(axis=(1, 3))


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("diameter", "blur"), [(4.0, 0.05), (6.0, 0.05), (12.0, 0.05), (30.0, 0.05), (1.0, 0.6)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_no_disc_however_sharp_and_no_dot_behind_a_lens_is_a_defect(diameter, blur, sign):
    rng = np.random.default_rng(1)
    for u, v in 19.0 + rng.random((40, 2)):
        defects = DefectivePixels()
        image = np.rint(128 + sign * 100 * disc(diameter, u, v, blur)).astype(np.uint8)
        assert all(defects.mended(image, 100.0) is image for _ in range(LOOKS))


def test_a_line_behind_a_lens_is_no_defective_column():
    columns = np.arange(40.0)
    for width in (0.7, 1.0, 1.5, 3.0):
        line = ndtr((width / 2 - columns + 20.0) / 0.5) - ndtr((-width / 2 - columns + 20.0) / 0.5)
        image = np.tile(np.rint(20.0 + 200.0 * line), (40, 1)).astype(np.uint8)
        defects = DefectivePixels()
        assert all(defects.mended(image, 200.0) is image for _ in range(LOOKS))


def test_what_flickers_is_filled_in_and_not_remembered():
    rng, defects = np.random.default_rng(2), DefectivePixels()
    for _ in range(4 * LOOKS):
        image = np.full((200, 200), 20, np.uint8)
        image[rng.integers(1, 199, 20), rng.integers(1, 199, 20)] = 250
        assert (defects.mended(image, 180.0) == 20).mean() > 0.9995
    assert defects.mended(image) is image
    assert defects.count == 0


def test_defects_are_remembered_between_looks_and_the_picture_is_left_as_it_was():
    image, defects = np.full((60, 80), 20, np.uint16), DefectivePixels()
    image[30, 40:42] = 4000
    image[[0, 59], [5, 79]] = 4000  # nothing is told of the picture's edge
    before = image.copy()
    for _ in range(LOOKS):
        defects.mended(image, 3000.0)
    for _ in range(3):
        mended = defects.mended(image)
        assert (mended[1:-1, 1:-1] == 20).all()
    assert defects.count == 2
    assert (image == before).all()


@pytest.mark.parametrize("step", [2, 3])
def test_a_pattern_of_single_pixels_is_no_defect(step):
    image, defects = np.full((200, 200), 20, np.uint8), DefectivePixels()
    image[90:110:step, 90:110:step] = 250
    assert all((defects.mended(image, 180.0) != image).sum() <= 4 for _ in range(LOOKS))


@pytest.mark.slow
def test_defective_pixels_are_filled_in_along_the_rim_and_what_is_left_of_them_is_stated():
    rng = np.random.default_rng(5)
    pulls, stated = [], []
    for u, v in 19.0 + rng.random((60, 2)):
        whole = np.pad(
            np.rint(20.0 + 180.0 * disc(12.0, u, v, 0.8)).astype(np.uint8), ((0, 40), (0, 40)), "edge"
        )
        broken, defects = whole.copy(), DefectivePixels()
        broken[:, rng.integers(14, 25)] = BLACK
        mended = defects.mended(broken, 180.0)
        assert defects.count == 78
        columns = np.arange(80)
        centres = [((image - 20.0).sum(axis=0) @ columns) / (image - 20.0).sum() for image in (whole, mended)]
        pulls.append(centres[1] - centres[0])
        stated.append(defects.pull(u, v, (6.0, 0.8), 180.0, 0.0))
    assert 0.02 < np.sqrt(np.mean(np.square(stated))) < 0.1
    assert np.sqrt(np.mean(np.square(pulls))) < 1.2 * np.sqrt(np.mean(np.square(stated)))
