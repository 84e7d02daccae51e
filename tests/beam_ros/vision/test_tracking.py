from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision import (
    CameraParameters,
    FrameTiming,
    ImageFormatError,
    TrackerParameters,
    VisionParameterError,
)
from beam_ros.vision.rendering import SceneRenderer
from beam_ros.vision.tracking import MarkerTracker

HEIGHTS = (0.010, 0.225, 0.285)


def make(camera: CameraParameters, heights=HEIGHTS, **changes):
    tracker = MarkerTracker(TrackerParameters.for_camera(camera, heights, **changes), len(heights))
    return SceneRenderer(camera, heights), tracker


def columns(result) -> np.ndarray:
    return np.array([marker.u_px for marker in result.markers])


def test_markers_are_named_from_the_lowest_without_any_expectation():
    camera = CameraParameters()
    renderer = SceneRenderer(camera, HEIGHTS)
    tracker = MarkerTracker(TrackerParameters(), 3)
    result = tracker.process(renderer.render([0.001, 0.002, 0.003], np.random.default_rng(0)), 77)
    assert result.stamp_ns == 77
    assert result.is_complete
    assert tracker.is_acquired
    assert columns(result) == pytest.approx(camera.columns([0.001, 0.002, 0.003]), abs=0.04)
    assert [marker.v_px for marker in result.markers] == pytest.approx(camera.rows(HEIGHTS), abs=0.04)


@pytest.mark.parametrize(("contrast", "background"), [(180.0, 30.0), (-180.0, 220.0)])
@pytest.mark.parametrize(("noise", "limit"), [(2.0, 0.0060), (5.0, 0.016), (10.0, 0.031)])
def test_error_and_stated_standard_deviation(contrast, background, noise, limit):
    camera = CameraParameters(contrast=contrast, background=background, noise_grey=noise)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(11)
    errors, stated = [], []
    for k in range(250):
        x = 0.004 * np.sin(0.1 * k + np.arange(3)) + rng.random(3) / 1500
        result = tracker.process(renderer.render(x, rng), k)
        assert result.is_complete
        errors.append(columns(result) - camera.columns(x))
        stated.append([marker.sigma_px for marker in result.markers])
    errors, stated = np.array(errors[10:]), np.array(stated[10:])
    rms = np.sqrt(np.mean((errors - errors.mean()) ** 2))
    # 720 values: the RMS is known to 2.6 %.
    assert rms <= limit
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(rms, rel=0.2)


def test_the_mean_position_of_a_smeared_marker_is_unbiased():
    camera = CameraParameters(noise_grey=2.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(12)
    errors = []
    for k in range(300):
        # 6 px of motion within the exposure at the crest of every half period
        centre = 0.02 * np.sin(0.6 * k)
        travel = 0.004 * np.cos(0.6 * k) * np.linspace(-0.5, 0.5, 6)
        x = (centre + travel)[:, None] + rng.random(3)[None, :] / 1500
        result = tracker.process(renderer.render(x, rng), k)
        assert result.is_complete, [marker.reason for marker in result.markers]
        errors.append(columns(result) - renderer.exposure_weights @ camera.columns(x))
    errors = np.array(errors)
    # Reference figure for 6 px of smear: 0.0073 px; the mean of 900 values is known to 3e-4 px.
    assert np.sqrt(np.mean(errors**2)) < 0.009
    assert abs(errors.mean()) < 1.5e-3


def test_a_hidden_marker_is_flagged_in_the_same_frame_and_found_in_the_first_visible_one():
    camera = CameraParameters()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(13)
    for k in range(80):
        x = 0.006 * np.sin(0.28 * k + np.arange(3.0))
        hidden = 30 <= k < 50
        shown = x.copy()
        if hidden:
            shown[1] = np.nan
        result = tracker.process(renderer.render(shown, rng), k)
        assert [marker.is_valid for marker in result.markers] == [True, not hidden, True]
        if hidden:
            assert result.markers[1].reason == "hidden"
            assert np.isnan(result.markers[1].u_px)
            assert np.isnan(result.markers[1].sigma_px)
        valid = np.array([marker.is_valid for marker in result.markers])
        assert columns(result)[valid] == pytest.approx(camera.columns(x)[valid], abs=0.04)


def test_times_are_those_of_the_marker_rows():
    camera = CameraParameters(readout_s=0.004, exposure_s=0.002, stamp="start")
    timing = FrameTiming(camera)
    renderer = SceneRenderer(camera, HEIGHTS)
    tracker = MarkerTracker(TrackerParameters.for_camera(camera, HEIGHTS), 3, timing)
    result = tracker.process(renderer.render([0.0, 0.0, 0.0], np.random.default_rng(0)), 10**18)
    for marker, row in zip(result.markers, camera.rows(HEIGHTS), strict=True):
        # 0.04 px of row at 8.3 us a row
        assert marker.stamp_ns == pytest.approx(timing.row_middle(10**18, row), abs=400)


def test_sixteen_bit_images_are_tracked_as_eight_bit_ones():
    camera = CameraParameters()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(14)
    frame = renderer.render([0.001, 0.002, 0.003], rng).astype(np.uint16) * 16
    assert columns(tracker.process(frame, 0)) == pytest.approx(
        camera.columns([0.001, 0.002, 0.003]), abs=0.04
    )


@pytest.mark.parametrize("grey", [0, 30, 255])
def test_a_uniform_image_shows_nothing_and_breaks_nothing(grey):
    camera = CameraParameters()
    renderer, tracker = make(camera)
    blank = np.full((480, 640), grey, np.uint8)
    for k in range(3):
        result = tracker.process(blank, k)
        assert all(marker.reason == "no_contrast" for marker in result.markers)
        assert np.all(np.isnan(columns(result)))
    frame = renderer.render([0.0, 0.0, 0.0], np.random.default_rng(0))
    assert tracker.process(frame, 3).is_complete
    assert not any(marker.is_valid for marker in tracker.process(blank, 4).markers)


def test_too_many_spots_without_expected_rows_are_ambiguous():
    camera = CameraParameters()
    renderer = SceneRenderer(camera, (0.010, 0.1, 0.225, 0.285))
    tracker = MarkerTracker(TrackerParameters(), 3)
    frame = renderer.render(np.zeros(4), np.random.default_rng(0))
    assert [marker.reason for marker in tracker.process(frame, 0).markers] == ["ambiguous"] * 3


def test_expected_rows_pick_the_markers_among_other_spots():
    camera = CameraParameters()
    renderer = SceneRenderer(camera, (0.010, 0.1, 0.225, 0.285))
    tracker = MarkerTracker(TrackerParameters.for_camera(camera, HEIGHTS), 3)
    result = tracker.process(renderer.render([0.0, 0.01, 0.0, 0.0], np.random.default_rng(0)), 0)
    assert result.is_complete
    assert columns(result) == pytest.approx([320.0] * 3, abs=0.04)


def test_reset_forgets_and_another_image_size_starts_anew():
    camera = CameraParameters()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(15)
    tracker.process(renderer.render([0.0, 0.0, 0.0], rng), 0)
    tracker.reset()
    assert not tracker.is_acquired
    assert np.all(np.isnan(tracker.noise_grey))
    assert tracker.process(renderer.render([0.02, 0.02, 0.02], rng), 1).is_complete
    small = renderer.render([0.0, 0.0, 0.0], rng)[:, 100:540]
    assert columns(tracker.process(small, 2)) == pytest.approx([220.0] * 3, abs=0.04)


@pytest.mark.parametrize("image", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4)), np.zeros(16, np.uint8)])
def test_what_is_no_grey_image_is_refused(image):
    with pytest.raises(ImageFormatError, match=r"expected .height, width. of uint8 or uint16"):
        MarkerTracker(TrackerParameters(), 1).process(image, 0)


def test_a_tiny_image_is_no_reason_to_fail():
    result = MarkerTracker(TrackerParameters(), 1).process(np.arange(64, dtype=np.uint8).reshape(8, 8), 0)
    assert not result.is_complete


def test_rows_and_markers_must_agree_in_number():
    with pytest.raises(VisionParameterError, match="2 rows; expected 3"):
        MarkerTracker(TrackerParameters(expected_rows_px=(300.0, 100.0)), 3)
