from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.measurement.overlay import draw_overlay
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)
NAMES = ("z010", "z225", "z285")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_seen_markers_are_ringed_in_green_and_lost_ones_named_in_red(dtype):
    camera = packaged_camera()
    frame = SceneRenderer(camera, HEIGHTS).render([0.0, np.nan, 0.01], np.random.default_rng(0)).astype(dtype)
    before = frame.copy()
    result = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3).process(frame, 0)
    picture = draw_overlay(frame, result, NAMES, marker_diameter_px=12.0, rows_px=camera.rows(HEIGHTS))
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert np.array_equal(frame, before)
    green = (picture[..., 1].astype(int) - picture[..., 2]) > 60
    red = (picture[..., 2].astype(int) - picture[..., 1]) > 60
    # Nine pixels from the centres: on the rings.
    assert green[450, 329]
    assert green[37:39, 344].any()
    assert red[110:135, :120].any()
    assert not red[430:].any()


def test_lost_markers_are_named_one_below_the_other_where_no_rows_are_given():
    camera = packaged_camera()
    frame = SceneRenderer(camera, HEIGHTS).render([np.nan] * 3, np.random.default_rng(0))
    result = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3).process(frame, 0)
    picture = draw_overlay(frame, result, NAMES, marker_diameter_px=12.0).astype(int)
    written = np.flatnonzero(np.any(picture[..., 2] - picture[..., 1] > 60, axis=1))
    # Three lines of 14 rows: letters on the line, with at most a tail of 4 rows below the last.
    assert [np.any((14 * k + 2 <= written) & (written < 14 * k + 14)) for k in range(3)] == [True] * 3
    assert written[-1] < 3 * 14 + 5
