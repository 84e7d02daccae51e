from __future__ import annotations

import re
from dataclasses import replace
from itertools import zip_longest

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from beam_ros.vision.errors import ImageFormatError, VisionParameterError
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.disturbances import Disturbances, Glare, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.tracker import MarkerTracker
from benchmarks import vision_guard
from benchmarks.vision_scenes import Verdict, judge
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)


def make(camera: CameraParameters, heights=HEIGHTS, **changes):
    tracker = MarkerTracker(packaged_tracker(camera, heights, **changes), len(heights))
    return SceneRenderer(camera, heights), tracker


def columns(result) -> np.ndarray:
    return np.array([marker.u_px for marker in result.markers])


def test_markers_are_named_from_the_lowest_without_any_expectation():
    camera = packaged_camera()
    renderer = SceneRenderer(camera, HEIGHTS)
    tracker = MarkerTracker(packaged_tracker(), 3)
    result = tracker.process(renderer.render([0.001, 0.002, 0.003], np.random.default_rng(0)), 77)
    assert result.stamp_ns == 77
    assert result.is_complete
    assert tracker.is_acquired
    assert columns(result) == pytest.approx(camera.columns([0.001, 0.002, 0.003]), abs=0.04)
    assert [marker.v_px for marker in result.markers] == pytest.approx(camera.rows(HEIGHTS), abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("contrast", "background"), [(180.0, 30.0), (-180.0, 220.0)])
@pytest.mark.parametrize(("noise", "limit"), [(2.0, 0.0060), (5.0, 0.016), (10.0, 0.031)])
def test_error_and_stated_standard_deviation(contrast, background, noise, limit):
    camera = packaged_camera(contrast=contrast, background=background, noise_grey=noise)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(12)
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
    assert np.median(stated) == pytest.approx(rms, rel=0.2)
    # Among places at random, of frames of an exposure that nobody knows, a few may hold the one before.
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(rms, rel=0.3)


@pytest.mark.slow
def test_the_mean_position_of_a_smeared_marker_is_unbiased():
    camera = packaged_camera(noise_grey=2.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(12)
    errors = []
    for k in range(300):
        # 6 px of motion within the exposure at the crest of every half period
        centre = 0.02 * np.sin(0.6 * k)
        travel = 0.004 * np.cos(0.6 * k) * np.linspace(-0.5, 0.5, 6)
        x = (centre + travel)[:, None] + rng.random(3)[None, :] / 1500
        result = tracker.process(renderer.render(x, rng), k)
        if k < 2:  # a smear is believed once the speed explains it
            continue
        assert result.is_complete, [marker.reason for marker in result.markers]
        errors.append(columns(result) - renderer.exposure_weights @ camera.columns(x))
    errors = np.array(errors)
    # Reference figure for 6 px of smear: 0.0073 px; the mean of 900 values is known to 3e-4 px.
    assert np.sqrt(np.mean(errors**2)) < 0.009
    assert abs(errors.mean()) < 1.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("noise", [2.0, 10.0])
@pytest.mark.parametrize("refinement", ["none", "disc_model"])
@pytest.mark.parametrize("diameter", [6, 8])
def test_a_marker_smeared_by_more_than_it_is_wide_is_measured(diameter, refinement, noise):
    # A quarter of the light is missing from the middle of 6 px at the fastest, and the ends are below the level.
    camera = packaged_camera(noise_grey=noise, marker_diameter_m=diameter / 1500)
    renderer, tracker = make(camera, refinement=refinement)
    rng = np.random.default_rng(13)
    instants = np.polynomial.legendre.leggauss(renderer.sub_instants)[0] / 2
    errors, stated = [], []
    for k in range(240):
        way = 59.0 * np.sin(0.15 * (k + instants)) / 1500
        result = tracker.process(renderer.render(np.repeat(way[:, None], 3, axis=1), rng), k)
        errors.append(columns(result) - renderer.exposure_weights @ camera.columns(way))
        stated.append([marker.sigma_px for marker in result.markers])
    ratio = (np.array(errors) / np.array(stated))[40:]
    # At 6 px and a noise of 10 the fastest has eleven standard deviations of noise left in its middle.
    assert np.isfinite(ratio).mean() >= 0.98
    # Where it turns in an exposure of unknown length, what is stated allows for any bend.
    assert 0.55 < np.sqrt(np.nanmean(ratio**2)) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("contrast", [180.0, -180.0])
@pytest.mark.parametrize(
    ("refinement", "noise", "limit"),
    [("disc_model", 2.0, 0.0050), ("disc_model", 10.0, 0.0246), ("radial_symmetry", 2.0, 0.0053)],
)
def test_refinements_come_closer_to_the_noise_limit(refinement, noise, limit, contrast):
    camera = packaged_camera(noise_grey=noise, contrast=contrast, background=30.0 if contrast > 0 else 220.0)
    renderer, tracker = make(camera, refinement=refinement)
    rng = np.random.default_rng(22)
    errors, stated = [], []
    for k in range(250):
        x = 0.004 * np.sin(0.1 * k + np.arange(3)) + rng.random(3) / 1500
        result = tracker.process(renderer.render(x, rng), k)
        assert result.is_complete
        errors.append(columns(result) - camera.columns(x))
        stated.append([marker.sigma_px for marker in result.markers])
    errors, stated = np.array(errors[10:]), np.array(stated[10:])
    # Cramer-Rao bounds 0.0045 and 0.0223 px, of which 1.05; 720 values: the RMS is known to 2.6 %.
    rms = np.sqrt(np.mean(errors**2))
    assert rms <= limit
    assert np.median(stated) == pytest.approx(rms, rel=0.2)
    # Among places at random, of frames of an exposure that nobody knows, a few may hold the one before.
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(rms, rel=0.3)


def phase_bias(noise: float, n_per_phase: int) -> tuple[np.ndarray, float]:
    """Mean error at twenty sub-pixel phases of u, and the standard deviation of each mean."""
    camera = packaged_camera(noise_grey=noise)
    heights = (0.01, 0.1, 0.2, 0.285)
    renderer, tracker = make(camera, heights)
    rng = np.random.default_rng(21)
    errors = np.empty((n_per_phase, 20, 4))
    for k in range(n_per_phase):
        for phase in range(20):
            x = (phase / 20 + rng.integers(-1, 2, 4)) / 1500
            z = np.array(heights) + (rng.random(4) - 0.5) / 1500
            result = tracker.process(renderer.render(x, rng, marker_z=z), k)
            errors[k, phase] = columns(result) - camera.columns(x)
    return errors.mean(axis=(0, 2)), float(errors.std()) / np.sqrt(4 * n_per_phase)


@pytest.mark.slow
def test_the_error_does_not_follow_the_sub_pixel_phase():
    bias, sd = phase_bias(0.5, 20)
    # Acceptance asks for 0.002 px; the scatter of the twenty means (0.00016 px) is taken off.
    assert np.sqrt(max(0.0, np.mean(bias**2) - sd**2)) <= 0.0003


@pytest.mark.verify
def test_the_error_does_not_follow_the_sub_pixel_phase_at_full_length():
    bias, sd = phase_bias(2.0, 400)
    assert np.sqrt(max(0.0, np.mean(bias**2) - sd**2)) <= 0.0003
    assert np.abs(bias).max() <= 0.0003 + 3 * sd


@pytest.mark.parametrize("top", [0.285, 0.225 + 23 / 1500])
def test_a_hidden_marker_is_flagged_in_the_same_frame_and_found_in_the_first_visible_one(top):
    camera = packaged_camera()
    # The upper one is far from the hidden one, or its disc begins 17 px above.
    renderer, tracker = SceneRenderer(camera, (*HEIGHTS[:2], top)), MarkerTracker(packaged_tracker(), 3)
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


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.5, 1.5, 1.8])
@pytest.mark.parametrize("refinement", ["none", "disc_model"])
def test_a_marker_that_alone_has_another_light_is_believed_where_the_others_say_it_is(gain, refinement):
    camera = packaged_camera(noise_grey=1.0, contrast=90.0)
    renderer, tracker = make(camera, refinement=refinement)
    rng, valid, errors = np.random.default_rng(7), [], []
    for k in range(160):
        x = 0.006 * np.sin(0.2 * k) * np.array(HEIGHTS) / 0.3
        light = renderer.render(x, rng).astype(float)
        if 60 <= k < 110:
            light[:100] = 20.0 + gain * (light[:100] - 20.0)
        result = tracker.process(np.clip(np.rint(light), 0, 255).astype(np.uint8), k)
        valid.append([marker.is_valid for marker in result.markers])
        errors.append((columns(result) - camera.columns(x)) / [marker.sigma_px for marker in result.markers])
    lost = ~np.array(valid)
    # A light comes and goes, and is confirmed by three frames each time.
    assert lost[:, :2].sum() == 0
    assert lost[:, 2].sum() <= 8
    assert np.nanmax(np.abs(errors)) < 6.0


@pytest.mark.slow
def test_a_spot_in_another_light_beside_where_the_others_say_is_no_marker():
    camera = packaged_camera(noise_grey=1.0, contrast=90.0)
    renderer, tracker = make(camera)
    rng, others = np.random.default_rng(7), SceneRenderer(camera, HEIGHTS[:2])
    for k in range(160):
        x = 0.006 * np.sin(0.2 * k) * np.array(HEIGHTS) / 0.3
        frame = renderer.render(x, rng)
        if k >= 60:  # the tip is hidden, and something brighter swings with the beam, 8 px aside
            frame = others.render(x[:2], rng)
            alone = renderer.render(x + 8.0 / 1500, rng)[:100].astype(float)
            frame[:100] = np.clip(20.0 + 1.6 * (alone - 20.0), 0, 255)
        tip = tracker.process(frame, k).markers[2]
        assert tip.is_valid == (k < 60)


@pytest.mark.slow
@pytest.mark.parametrize("amount", [0.7, 1.5])
def test_a_camera_that_sharpens_hides_no_marker_but_one_that_a_second_disc_touches(amount):
    camera = packaged_camera(noise_grey=2.0)
    renderer, tracker = make(camera)
    touching = SecondSpot(renderer.camera.origin_px[0] + 3.0, float(camera.rows(0.225)))
    rng, errors, is_seen = np.random.default_rng(8), [], []
    beside = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3)

    def sharpened(picture):
        light = picture.astype(np.float32)
        light += amount * (light - cv2.GaussianBlur(light, (0, 0), 2.0))
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)

    for k in range(60):
        x = 0.004 * np.sin(0.2 * k + np.arange(3))
        result = tracker.process(sharpened(renderer.render(x, rng)), k)
        errors.append((columns(result) - camera.columns(x)) / [marker.sigma_px for marker in result.markers])
        twin = renderer.render(np.zeros(3), rng, disturbances=Disturbances(spots=(touching,)))
        is_seen.append([marker.is_valid for marker in beside.process(sharpened(twin), k).markers])
    assert np.isfinite(errors).mean() >= 0.98
    assert 0.5 < np.sqrt(np.nanmean(np.square(errors))) < 1.15
    assert np.mean(is_seen, axis=0) == pytest.approx([1.0, 0.0, 1.0], abs=0.1)


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("strip", "width"),
    [(0.1, 3.0), (0.15, 3.0), (0.15, 1.5), (0.1, 6.0), (0.2, 6.0), (0.3, 3.0), (0.25, 8.0)],
)
@pytest.mark.parametrize("contrast", [180.0, -180.0])
def test_a_strip_that_shows_behind_the_markers_hides_none(strip, width, contrast):
    camera = packaged_camera(noise_grey=2.0, contrast=contrast, background=20.0 if contrast > 0 else 220.0)
    camera = replace(camera, strip_width_m=width / 1500, strip_contrast=strip * abs(contrast))
    _, tracker = make(camera)
    heights = np.linspace(0.0, 0.3, 31)
    renderer = SceneRenderer(camera, HEIGHTS, strip_heights=heights)
    rng, errors = np.random.default_rng(6), []
    for k in range(100):
        x = 0.006 * np.sin(0.2 * k) * np.array(HEIGHTS) / 0.3
        frame = renderer.render(x, rng, strip=0.006 * np.sin(0.2 * k) * heights / 0.3)
        result = tracker.process(frame, k)
        errors.append((columns(result) - camera.columns(x)) / [marker.sigma_px for marker in result.markers])
    assert np.isfinite(errors).mean() >= 0.95
    assert np.sqrt(np.nanmean(np.square(errors))) < 1.2


@pytest.mark.slow
@pytest.mark.parametrize(("aside", "across"), [(1.5, 0.0), (3.0, 0.0), (6.0, 0.0), (0.0, 4.0), (2.0, 3.0)])
def test_a_strip_hides_no_second_disc_that_touches_a_marker(aside, across):
    camera = packaged_camera(noise_grey=2.0, strip_width_m=6.0 / 1500, strip_contrast=36.0)
    heights = np.linspace(0.0, 0.3, 31)
    renderer, rng = SceneRenderer(camera, HEIGHTS, strip_heights=heights), np.random.default_rng(7)
    touching = SecondSpot(camera.origin_px[0] + aside, float(camera.rows(0.225)) + across)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3)
    for k in range(12):
        twin = renderer.render(np.zeros(3), rng, 0.0 * heights, disturbances=Disturbances(spots=(touching,)))
        assert [marker.is_valid for marker in tracker.process(twin, k).markers] == [True, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("refinement", ["none", "disc_model"])
@pytest.mark.parametrize(
    ("blurs", "diameters"),
    [
        (np.linspace(0.8, 1.3, 13)[1:], [12.0]),  # a lens that drifts for 1.2 s
        ([1.3], [12.0]),  # one that jumps: before, it is 0.8 px
        ([0.5], [12.0]),
        ([0.8], np.linspace(12.0, 12.6, 13)[1:]),  # focusing that makes the picture larger
    ],
)
def test_a_camera_that_focuses_anew_loses_no_marker(blurs, diameters, refinement):
    camera = packaged_camera(noise_grey=2.0)
    renderer, tracker = make(camera, refinement=refinement)
    rng, errors = np.random.default_rng(3), []
    changes = zip_longest(blurs, diameters)
    for k in range(200):
        if k >= 50 and k % 10 == 0 and (change := next(changes, None)) is not None:
            blur, diameter = (now or first[0] for now, first in zip(change, (blurs, diameters), strict=True))
            size = float(diameter) / 1500
            now = packaged_camera(noise_grey=2.0, blur_px=float(blur), marker_diameter_m=size)
            renderer = SceneRenderer(now, HEIGHTS)
        x = 0.004 * np.sin(0.1 * k + np.arange(3))
        result = tracker.process(renderer.render(x, rng), k)
        errors.append((columns(result) - camera.columns(x)) / [marker.sigma_px for marker in result.markers])
    assert np.isfinite(errors).mean() >= 0.99
    assert np.sqrt(np.nanmean(np.square(errors))) < 1.35
    assert np.nanmax(np.abs(errors)) < 6.0


@pytest.mark.slow
def test_an_edge_that_covers_all_markers_from_the_side_is_no_change_of_focus():
    camera = packaged_camera(background=30.0)
    renderer, tracker = make(camera)
    rng, valid = np.random.default_rng(4), []
    for k in range(320):
        edge = camera.origin_px[0] - 8.0 + 0.03 * max(k - 40, 0)
        cover = Disturbances(occluders=(Occluder(edge - 60.0, 0.0, edge, float(camera.height), 30.0),))
        result = tracker.process(renderer.render(np.zeros(3), rng, disturbances=cover), k)
        valid.append([marker.is_valid for marker in result.markers])
        for marker in result.markers:
            # What one percent of the disc under the cover does, and noise.
            assert not marker.is_valid or abs(marker.u_px - camera.origin_px[0]) < 0.2
    assert not np.any(valid[-10:])


@pytest.mark.first_case
@pytest.mark.parametrize("side", ["left", "right", "above", "below"])
@pytest.mark.parametrize("grey", [0.0, 30.0, 110.0])
def test_a_marker_covered_by_thirty_percent_is_flagged_at_once(side, grey):
    camera = packaged_camera(noise_grey=5.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(31)
    for k in range(40):
        tracker.process(renderer.render([0.0, 0.0, 0.0], rng), k)
    u, v = float(camera.columns(0.0)), float(camera.rows(0.225))
    # A chord 2.1 px from the centre of a disc of 6 px radius cuts off 29 % of it.
    cover = {
        "left": Occluder(u - 40, v - 40, u - 2.0, v + 40, grey),
        "right": Occluder(u + 2.0, v - 40, u + 40, v + 40, grey),
        "above": Occluder(u - 40, v - 40, u + 40, v - 2.0, grey),
        "below": Occluder(u - 40, v + 2.0, u + 40, v + 40, grey),
    }[side]
    for k in range(5):
        frame = renderer.render([0.0, 0.0, 0.0], rng, disturbances=Disturbances(occluders=(cover,)))
        result = tracker.process(frame, 40 + k)
        assert [marker.is_valid for marker in result.markers] == [True, False, True]
    assert tracker.process(renderer.render([0.0, 0.0, 0.0], rng), 45).is_complete


@pytest.mark.slow
@pytest.mark.parametrize("speed_px", [0.1, 0.7, 3.3])
@pytest.mark.parametrize("grey", [0.0, 100.0, 210.0])
def test_no_creeping_cover_makes_a_valid_measurement_wrong(speed_px, grey):
    camera = packaged_camera(background=30.0)  # so far above the darkest cover
    renderer, tracker = make(camera)
    rng = np.random.default_rng(32)
    n_flagged = 0
    for k in range(round(40 + 40 / speed_px)):
        x = 0.006 * np.sin(0.28 * k + np.arange(3.0))
        u, v = float(camera.columns(x[1])), float(camera.rows(0.225))
        edge = u - 7.0 + speed_px * max(0, k - 40)
        cover = Occluder(edge - 60, v - 30, edge, v + 30, grey)
        frame = renderer.render(x, rng, disturbances=Disturbances(occluders=(cover,)) if k >= 40 else None)
        marker = tracker.process(frame, k).markers[1]
        n_flagged += not marker.is_valid
        if marker.is_valid:
            # One percent of the disc under the cover moves its centre by 0.07 px; less is not seen in noise.
            assert abs(marker.u_px - u) < 0.12
    assert n_flagged >= 5


@pytest.mark.slow
def test_glare_on_a_marker_is_flagged_or_harmless():
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(33)
    v = float(camera.rows(0.225))
    valid = []
    for k in range(120):
        glare = Glare(320.0 - 90.0 + 2.0 * max(0, k - 30), v + 4.0, 12.0, 60.0)
        frame = renderer.render(
            np.zeros(3), rng, disturbances=Disturbances(glares=(glare,)) if k > 30 else None
        )
        marker = tracker.process(frame, k).markers[1]
        valid.append(marker.is_valid)
        if marker.is_valid:
            assert abs(marker.u_px - 320.0) < 0.1
    assert not all(valid[60:90])
    assert all(valid[:40])
    assert all(valid[-5:])


def cross_with_a_twin(
    n_frames: int, speed_px: float, row_offset_px: float, swing_m: float, *, is_hidden_at_times: bool
) -> tuple[int, int, float]:
    """Let a second, identical spot cross the row of the middle marker again and again.

    Returns the numbers of valid and of wrong measurements, and the largest error of the valid ones [px].
    """
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(34)
    row = float(camera.rows(0.225)) + row_offset_px
    n_valid = n_wrong = 0
    largest = 0.0
    for k in range(n_frames):
        x = swing_m * np.sin(0.28 * k + np.arange(3.0))
        way = (speed_px * k) % 1200.0
        twin = SecondSpot(20.0 + min(way, 1200.0 - way), row)
        shown = x.copy()
        if is_hidden_at_times and k > 60 and k % 97 < 20:
            shown[1] = np.nan
        frame = renderer.render(shown, rng, disturbances=Disturbances(spots=(twin,)) if k > 10 else None)
        marker = tracker.process(frame, k).markers[1]
        if marker.is_valid:
            error = abs(marker.u_px - float(camera.columns(x[1])))
            n_valid += 1
            n_wrong += error > 0.1
            largest = max(largest, error)
    return n_valid, n_wrong, largest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row_offset_px", "swing_m", "is_hidden_at_times"),
    [(0.0, 0.0, False), (0.0, 0.006, True), (9.0, 0.0, True), (9.0, 0.006, False)],
)
def test_a_crossing_twin_never_takes_a_marker_over(row_offset_px, swing_m, is_hidden_at_times):
    n_valid, n_wrong, largest = cross_with_a_twin(
        330, 5.0, row_offset_px, swing_m, is_hidden_at_times=is_hidden_at_times
    )
    assert n_wrong == 0, largest
    assert n_valid > 150


@pytest.mark.verify
@pytest.mark.parametrize("is_hidden_at_times", [False, True])
@pytest.mark.parametrize("row_offset_px", [0.0, 2.0, 9.0])
@pytest.mark.parametrize(("speed_px", "swing_m"), [(5.0, 0.006), (3.1, 0.0), (9.0, 0.002)])
def test_ten_thousand_frames_with_a_crossing_twin(speed_px, row_offset_px, swing_m, is_hidden_at_times):
    n_valid, n_wrong, largest = cross_with_a_twin(
        10_000, speed_px, row_offset_px, swing_m, is_hidden_at_times=is_hidden_at_times
    )
    assert n_wrong == 0, largest
    assert n_valid > 2_000


@pytest.mark.slow
def test_a_twin_beside_a_moving_marker_takes_nothing_over_even_while_the_marker_is_hidden():
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(35)
    row = float(camera.rows(0.225))
    for k in range(150):
        x = 0.003 * np.sin(0.28 * k + np.arange(3.0))
        hidden = 60 <= k < 80
        shown = x.copy()
        if hidden:
            shown[1] = np.nan
        # It came from the side and stays 26 px beside the marker's resting place.
        twin = SecondSpot(max(346.0, 600.0 - 8.0 * k), row)
        marker = tracker.process(
            renderer.render(shown, rng, disturbances=Disturbances(spots=(twin,)))
            if k > 5
            else renderer.render(shown, rng),
            k,
        ).markers[1]
        assert marker.is_valid == (not hidden), (k, marker)
        if marker.is_valid:
            assert marker.u_px == pytest.approx(float(camera.columns(x[1])), abs=0.05)


def test_markers_that_leave_the_image_are_lost_and_found_again():
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(37)
    seen = []
    for k in range(220):
        x = np.full(3, 0.22 * np.sin(0.03 * k))
        result = tracker.process(renderer.render(x, rng), k)
        valid = np.array([marker.is_valid for marker in result.markers])
        seen.append(valid.all())
        assert columns(result)[valid] == pytest.approx(camera.columns(x)[valid], abs=0.05)
        # 9 px from the edge the whole blurred disc is in view.
        if abs(float(camera.columns(x[0])) - 319.5) > 319.5 - 6.0:
            assert not valid.any()
    assert seen[0]
    assert not all(seen)
    assert seen[100]


@pytest.mark.slow
def test_no_image_breaks_the_tracker_and_invalid_means_nothing_is_told():
    rng = np.random.default_rng(38)
    for n_markers, polarity in ((1, "bright"), (3, "dark"), (3, "bright")):
        for _ in range(12):
            tracker = MarkerTracker(packaged_tracker(polarity=polarity), n_markers)
            shape = (int(rng.integers(1, 200)), int(rng.integers(1, 300)))
            for image in (
                rng.integers(0, 256, shape),
                np.linspace(0, 255, shape[0] * shape[1]).reshape(shape),
                np.where(rng.random(shape) < 0.01, 255, 0),
                (np.indices(shape) // 13).sum(axis=0) % 2 * 255,
            ):
                for dtype in (np.uint8, np.uint16):
                    for marker in tracker.process(image.astype(dtype), 0).markers:
                        assert marker.is_valid == (marker.reason == "ok")
                        assert (
                            np.isfinite([marker.u_px, marker.v_px, marker.sigma_px]).all() == marker.is_valid
                        )


def test_a_change_of_light_costs_frames_but_no_truth():
    camera = packaged_camera()
    brighter = packaged_camera(background=60.0)
    renderer, tracker = make(camera)
    second = SceneRenderer(brighter, HEIGHTS)
    rng = np.random.default_rng(36)
    for k in range(60):
        x = 0.003 * np.sin(0.28 * k + np.arange(3.0))
        result = tracker.process((renderer if k < 40 else second).render(x, rng), k)
        valid = np.array([marker.is_valid for marker in result.markers])
        assert columns(result)[valid] == pytest.approx(camera.columns(x)[valid], abs=0.05)
    assert result.is_complete


def test_times_are_those_of_the_marker_rows():
    camera = packaged_camera(readout_s=0.004, exposure_s=0.002, stamp="start")
    timing = FrameTiming(camera)
    renderer = SceneRenderer(camera, HEIGHTS)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3, timing)
    result = tracker.process(renderer.render([0.0, 0.0, 0.0], np.random.default_rng(0)), 10**18)
    for marker, row in zip(result.markers, camera.rows(HEIGHTS), strict=True):
        # 0.04 px of row at 8.3 us a row
        assert marker.stamp_ns == pytest.approx(timing.row_middle(10**18, row), abs=400)


def rolled(
    camera: CameraParameters, u: np.ndarray, speed: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Discs at u in their own rows, of which every other row shows another instant; speed in px per frame."""
    image = camera.background + camera.noise_grey * rng.standard_normal((camera.height, camera.width))
    fine = (np.arange(40 * 4) + 0.5) / 4 - 0.5
    delay = camera.readout_s * camera.rate_hz / (camera.height - 1)
    for at, v, px in zip(u, camera.rows(HEIGHTS), speed, strict=True):
        left, top = int(at) - 20, int(v) - 20
        rows, columns = (top + fine)[:, None], left + fine
        shifted = at + px * delay * (np.round(rows) - v)
        depth = camera.marker_diameter_px / 2 - np.hypot(columns - shifted, rows - v)
        disc = ndtr(depth / 0.8).reshape(40, 4, 40, 4).mean(axis=(1, 3))
        image[top : top + 40, left : left + 40] += camera.contrast * disc
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_an_exposure_of_no_length_bends_nothing():
    camera = packaged_camera(exposure_s=0.0)
    renderer, rng = SceneRenderer(camera, HEIGHTS), np.random.default_rng(1)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3, FrameTiming(camera))
    for k in range(12):
        positions = np.full(3, 0.001 * np.sin(0.4 * k))
        result = tracker.process(renderer.render(positions, rng), k * 10_000_000)
        assert result.is_complete, [marker.reason for marker in result.markers]
        found = [marker.u_px for marker in result.markers]
        assert found == pytest.approx(camera.columns(positions), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("readout_s", [0.0, 0.009])
@pytest.mark.parametrize(("frequency", "noise"), [(0.05, 0.7), (0.21, 2.0)])
def test_a_rolling_shutter_costs_moving_markers_nothing(readout_s, frequency, noise):
    camera = packaged_camera(readout_s=readout_s, exposure_s=1e-4, noise_grey=noise)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3, FrameTiming(camera))
    rng = np.random.default_rng(16)
    speed_px, omega = 8.0 * np.array([0.5, 0.8, 1.0]), 2 * np.pi * frequency
    errors, stated, speeds = [], [], []
    for k in range(200):
        phase = omega * k + np.arange(3.0)
        u, speed = camera.origin_px[0] + speed_px / omega * np.sin(phase), speed_px * np.cos(phase)
        result = tracker.process(rolled(camera, u, speed, rng), 10_000_000 * k)
        assert result.is_complete, [marker.reason for marker in result.markers]
        errors.append(columns(result) - u)
        stated.append([marker.sigma_px for marker in result.markers])
        speeds.append(speed)
    errors, stated, speeds = np.array(errors[5:]), np.array(stated[5:]), np.array(speeds[5:])
    # At rest it is 0.92 to 0.95; of 585 values the RMS is known to 2.9 %.
    assert 0.84 < np.sqrt(np.mean((errors / stated) ** 2)) < 1.15
    # The shear moves no centre: four standard deviations of 585 values at speeds of 4.6 px in the mean.
    assert abs(np.sum(errors * speeds) / np.sum(speeds**2)) < 4 * 0.00225 * noise / (4.6 * np.sqrt(585))


@pytest.mark.slow
@pytest.mark.parametrize("is_sheared", [True, False])
@pytest.mark.parametrize(("speed_px", "frequency"), [(24.0, 0.03), (32.0, 0.15), (45.0, 0.12)])
def test_no_speed_of_a_marker_makes_a_rolling_shutter_hide_it(speed_px, frequency, is_sheared):
    camera = packaged_camera(readout_s=0.009, exposure_s=5e-4, noise_grey=2.0)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3, FrameTiming(camera))
    rng, omega, scores = np.random.default_rng(17), 2 * np.pi * frequency, []
    speed_px = speed_px * np.array([0.9, 0.95, 1.0])
    for k in range(60):
        phase = omega * k + 0.4
        u, speed = camera.origin_px[0] + speed_px / omega * np.sin(phase), speed_px * np.cos(phase)
        result = tracker.process(rolled(camera, u, is_sheared * speed, rng), 10_000_000 * k)
        scores.append((columns(result) - u) / [marker.sigma_px for marker in result.markers])
    assert np.isfinite(scores).mean() > 0.95
    assert np.sqrt(np.nanmean(np.square(scores))) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("is_known", [False, True])
def test_a_rolling_shutter_shears_no_marker_that_rests(is_known):
    camera = packaged_camera(readout_s=0.009, exposure_s=5e-4, noise_grey=2.0)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3, FrameTiming(camera))
    rng, u = np.random.default_rng(18), np.full(3, camera.origin_px[0] + 0.3)
    for k in range(60):
        sheared = 0.0 if is_known and k < 40 else 30.0  # whatever makes it so, it is no speed
        result = tracker.process(rolled(camera, u, np.array([0.0, sheared, 0.0]), rng), 10_000_000 * k)
        is_valid = [marker.is_valid for marker in result.markers]
        assert is_valid == [True, sheared == 0.0, True], [marker.reason for marker in result.markers]


def test_sixteen_bit_images_are_tracked_as_eight_bit_ones():
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(14)
    frame = renderer.render([0.001, 0.002, 0.003], rng).astype(np.uint16) * 16
    assert columns(tracker.process(frame, 0)) == pytest.approx(
        camera.columns([0.001, 0.002, 0.003]), abs=0.04
    )


@pytest.mark.parametrize("grey", [0, 30, 255])
def test_a_uniform_image_shows_nothing_and_breaks_nothing(grey):
    camera = packaged_camera()
    renderer, tracker = make(camera)
    blank = np.full((480, 640), grey, np.uint8)
    for k in range(3):
        result = tracker.process(blank, k)
        assert all(marker.reason == "no_contrast" for marker in result.markers)
        assert np.all(np.isnan(columns(result)))
    frame = renderer.render([0.0, 0.0, 0.0], np.random.default_rng(0))
    assert tracker.process(frame, 3).is_complete
    assert not any(marker.is_valid for marker in tracker.process(blank, 4).markers)


@pytest.mark.parametrize("times", [2, 4])
def test_an_image_that_comes_again_tells_nothing_of_markers_that_move(times):
    camera = packaged_camera(noise_grey=2.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(3)
    for k in range(60):
        if k % times == 0 or k < 10:
            x = 0.004 * np.sin(0.3 * k + np.arange(3))
            image = renderer.render(x, rng)
            result = tracker.process(image, k)
            assert np.abs(columns(result) - camera.columns(x)).max() < 0.04
        else:
            result = tracker.process(image.copy(), k)
            assert {marker.reason for marker in result.markers} == {"repeated"}


def test_a_region_changes_no_place_and_no_time():
    camera = packaged_camera(noise_grey=2.0, readout_s=0.008)
    renderer, timing, rng = SceneRenderer(camera, HEIGHTS), FrameTiming(camera), np.random.default_rng(3)
    whole, part = (
        MarkerTracker(packaged_tracker(camera, HEIGHTS, region_px=region), 3, timing)
        for region in (None, (250.0, 390.5, 10.0, 479.0))
    )
    for k in range(20):
        image = renderer.render(0.002 * np.sin(0.3 * k + np.arange(3)), rng)
        one, other = (tracker.process(image, 10_000_000 * k).markers for tracker in (whole, part))
        for a, b in zip(one, other, strict=True):
            assert (b.u_px, b.v_px) == pytest.approx((a.u_px, a.v_px), abs=2e-3)
            assert abs(b.stamp_ns - a.stamp_ns) < 100


def test_an_image_without_room_for_the_region_says_so():
    tracker = MarkerTracker(packaged_tracker(region_px=(250.0, 390.0, 0.0, 479.0)), 3)
    with pytest.raises(
        ImageFormatError, match=r"tracker\.region .* leaves 6 x 480; .* correct tracker\.region"
    ):
        tracker.process(np.zeros((480, 256), np.uint8), 0)


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_still_image_may_come_for_ever(noise):
    camera = packaged_camera(noise_grey=noise)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(3)
    images = [renderer.render([0.0005 * min(k, 10)] * 3, rng) for k in range(11)]
    results = [tracker.process(image, k) for k, image in enumerate(images)]
    # Nobody moves any more: believed where it rests, and soon enough where it stopped in full swing.
    results += [tracker.process(images[-1].copy(), k) for k in range(11, 111)]
    assert all(result.is_complete for result in [*results[:11], *results[-50:]])
    still = MarkerTracker(packaged_tracker(), 3)
    assert all(still.process(images[-1].copy(), k).is_complete for k in range(20))


def test_a_camera_that_writes_every_frame_into_the_same_memory_repeats_nothing():
    camera = packaged_camera(noise_grey=2.0)
    renderer, tracker = make(camera)
    rng, memory = np.random.default_rng(3), np.empty((480, 640), np.uint8)
    for k in range(10):
        memory[:] = renderer.render([0.004 * np.sin(0.3 * k)] * 3, rng)
        assert tracker.process(memory, k).is_complete


@pytest.mark.slow
@pytest.mark.parametrize("refinement", ["none", "disc_model"])
@pytest.mark.parametrize("depth", [0.0, 0.3])
def test_the_edge_of_a_shadow_on_a_marker_is_in_its_standard_deviation(depth, refinement):
    camera = packaged_camera(noise_grey=0.0)
    renderer, tracker = make(camera, refinement=refinement)
    rng, across = np.random.default_rng(3), np.arange(640)
    errors, stated = [], []
    for k in range(160):
        x = 0.003 * np.sin(0.1 * k + np.arange(3))
        edge = 0.5 * (1.0 + np.tanh((across - 230.0 - 1.2 * k) / 15.0))
        light = renderer.render(x, rng) * (1.0 - depth * edge) + 2.0 * rng.standard_normal((480, 640))
        result = tracker.process(np.clip(np.rint(light), 0, 255).astype(np.uint8), k)
        errors.append(columns(result) - camera.columns(x))
        stated.append([marker.sigma_px for marker in result.markers])
    errors, stated = np.array(errors), np.array(stated)
    seen = np.isfinite(errors)
    assert seen.mean() > 0.9
    # The centre of gravity goes with the light, by 0.1 px under the edge; the model takes that off.
    assert (np.sqrt(np.mean(errors[seen] ** 2)) > 0.02) == (depth > 0.0 and refinement == "none")
    assert 0.8 < np.sqrt(np.mean((errors[seen] / stated[seen]) ** 2)) < 1.7
    assert np.all(np.abs(errors[seen]) < np.maximum(0.35, 6.0 * stated[seen]))


def test_too_many_spots_without_expected_rows_are_ambiguous():
    camera = packaged_camera()
    renderer = SceneRenderer(camera, (0.010, 0.1, 0.225, 0.285))
    tracker = MarkerTracker(packaged_tracker(), 3)
    frame = renderer.render(np.zeros(4), np.random.default_rng(0))
    assert [marker.reason for marker in tracker.process(frame, 0).markers] == ["ambiguous"] * 3


def test_expected_rows_pick_the_markers_among_other_spots():
    camera = packaged_camera()
    renderer = SceneRenderer(camera, (0.010, 0.1, 0.225, 0.285))
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3)
    result = tracker.process(renderer.render([0.0, 0.01, 0.0, 0.0], np.random.default_rng(0)), 0)
    assert result.is_complete
    assert columns(result) == pytest.approx([320.0] * 3, abs=0.04)


def seen_at_an_angle(camera: CameraParameters, u: float, aspect: float, rng) -> np.ndarray:
    """A picture of the markers as discs turned about the beam, drawn from their edges' distance."""
    y, x = np.mgrid[: camera.height, : camera.width].astype(float)
    picture = np.full(x.shape, camera.background)
    for row in camera.rows(HEIGHTS):
        away = np.hypot((x - u) / aspect, y - row)
        picture += camera.contrast * 0.5 * (1 - np.tanh((away - camera.marker_diameter_px / 2) / 0.9))
    return np.clip(np.rint(picture + 2.0 * rng.standard_normal(x.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("aspect", [0.7, 0.8])
def test_discs_turned_about_the_beam_are_acquired_where_the_rig_says_so(aspect):
    camera, rng = packaged_camera(), np.random.default_rng(16)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS, aspect=aspect), 3)
    for u in (320.0, 320.4, 321.3):
        result = tracker.process(seen_at_an_angle(camera, u, aspect, rng), 0)
        assert columns(result) == pytest.approx([u] * 3, abs=0.06)
    head_on = MarkerTracker(packaged_tracker(camera, HEIGHTS), 3)
    assert not head_on.process(seen_at_an_angle(camera, 320.0, aspect, rng), 0).is_complete


@pytest.mark.slow
def test_a_wide_swing_near_the_camera_is_followed_through_its_foreshortening():
    # 28 mm at 3300 px/m lower the tip by 0.6 w^2 / L, or 5 px.
    camera = packaged_camera(
        width=1280, height=1100, pixels_per_metre=3300.0, origin_px=(640.0, 1050.0), exposure_s=0.001
    )
    renderer, tracker = make(camera)
    rng, heights = np.random.default_rng(17), np.array(HEIGHTS)
    for k in range(60):
        x = 0.028 * np.sin(0.25 * k) * (heights / 0.285) ** 1.8
        z = heights - 0.6 * x**2 / 0.3
        assert tracker.process(renderer.render(x, rng, marker_z=z), k).is_complete


def test_markers_one_above_the_other_with_a_diameter_between_them_are_followed():
    camera, heights = packaged_camera(), (0.01, 0.2, 0.216)
    renderer, tracker = make(camera, heights)
    rng = np.random.default_rng(18)
    for k in range(40):
        x = 0.004 * np.sin(0.3 * k + np.arange(3.0))
        result = tracker.process(renderer.render(x, rng), k)
        assert columns(result) == pytest.approx(camera.columns(x), abs=0.04)


@pytest.mark.parametrize("contrast", [60.0, -60.0])
def test_light_elsewhere_in_the_picture_keeps_no_marker_from_being_found(contrast):
    camera = packaged_camera(contrast=contrast, background=20.0 if contrast > 0 else 235.0)
    renderer, tracker = make(camera)
    image = renderer.render([0.001, 0.002, 0.003], np.random.default_rng(3))
    # A lamp beside the beam, and the lowest marker in light that is three times as strong.
    row = round(float(camera.rows(HEIGHTS[0]))) - 30
    lowest = image[row:].astype(float)
    image[row:] = np.clip(3 * lowest if contrast > 0 else 235 + 3 * (lowest - 235), 0, 255)
    image[200:260, 500:560] = 255 if contrast > 0 else 0
    assert tracker.process(image, 0).is_complete


@pytest.mark.slow
@pytest.mark.parametrize("aside_px", [1.0, 2.0, 4.0])
def test_two_discs_that_touch_are_never_acquired_as_one(aside_px):
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng, row = np.random.default_rng(51), float(camera.rows(HEIGHTS[1]))
    for k in range(40):
        x = 0.004 * np.sin(0.3 * k + np.arange(3.0))
        twin = SecondSpot(float(camera.columns(x[1])) + aside_px, row)
        result = tracker.process(renderer.render(x, rng, disturbances=Disturbances(spots=(twin,))), k)
        assert [marker.is_valid for marker in result.markers] == [True, False, True]
        assert result.markers[1].reason in ("shape", "smear", "area")
    # Alone again it is a marker at once.
    assert tracker.process(renderer.render(np.zeros(3), rng), 40).markers[1].is_valid


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "most"),
    [
        ("threads", 4000025, 3),  # the thread was taken for a spot beside the marker
        ("threads", 9200003, 3),  # the thread was taken for noise, and the marker acquired with a part of it
        (
            "threads",
            9200011,
            3,
        ),  # a thread touched the marker in the one frame it was compared with from then on
        ("cover", 4000009, 3),  # a dim bar was taken for a twin
        ("cover", 7000016, 5),  # on a spot so weak that no level is above its noise the tracker stopped
        ("cover_and_twin", 4000003, 3),  # a twin was found for a covered marker
        ("cover_and_twin", 7039, 3),  # the same, while the beam swung away from where the marker had vanished
        ("leaving", 4000003, 25),  # a twin that went on its way was taken for the marker that had left
        (
            "leaving",
            700031,
            10,
        ),  # the same, of one that was known, while all markers jumped from frame to frame
        ("leaving", 9000013, 3),  # a twin in another row was taken for a marker that had just left
        (
            "twin_resting",
            9000002,
            3,
        ),  # a twin in another row was not told from the marker that it had touched
        (
            "doubled",
            7004,
            3,
        ),  # a marker that turned was blended with the frame before, which its speed might explain
        ("doubled", 51011, 3),  # so was one that had been lost, whose step nobody knew
        ("doubled", 53004, 3),  # several were in noise, none of which told of the film
        ("doubled", 53022, 3),  # a marker that turned was taken to be faster than any of its steps allowed
        ("doubled", 7016, 3),  # the first ones of a film were stated as if it had none
        ("ghost", 7003, 3),  # a reflection crept over a marker while its look was learned
        ("ghost", 7009, 3),  # one aside and above added more to the covariance than to the width
        ("ghost", 7031, 3),  # of a marker that one lay over from the first frame on, any speed explained it
        ("ghost", 91033, 3),  # of another one, that crept, it was forgotten from one frame to the next
        ("ghost", 53033, 3),  # it crept away from a marker that had been found with it, in much noise
        ("ghost", 53064, 3),  # it lay over markers that were found anew every few frames
        ("appearing", 7001, 3),  # a disc that came while a marker was hidden was taken for it
        ("appearing", 7005, 3),
        ("appearing", 7012, 3),
        ("appearing", 7039, 3),
        ("twin_resting", 9000000, 13),  # of two spots the one that swings with the beam was not acquired
    ],
)
def test_scenes_of_the_benchmark_that_once_were_wrong_or_waited(kind, seed, most):
    verdict = Verdict()
    judge("suite", kind, seed, verdict)
    assert verdict.wrong == 0
    assert max(verdict.waits + verdict.ambiguous, default=0) <= most


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("kind", "seed", "least"),
    [
        ("label", 3, 1.0),  # 30 px wide: the ground ends where a smear might reach
        ("label", 4, 1.0),
        ("label", 13, 1.0),  # 23 px wide
        ("bright_wall", 0, 1.0),
        ("noisy_repeats", 2, 1.0),
        ("noisy_repeats", 3, 1.0),
        ("plain", 1, 1.0),
        ("two_rigs", 0, 1.0),
        ("clutter", 1, 1.0),
    ],
)
def test_films_of_the_guard_are_seen_as_by_a_person(kind, seed, least):
    found = vision_guard.row(kind, [seed], with_peer=False)
    assert found["wrong"] == 0
    assert found["valid"] >= least


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("kind", "seed"),
    [("triangles", 0), ("square", 0), ("crosses", 1), ("triangles", 1), ("cut_dots", 1), ("square", 3)],
)
def test_what_is_no_disc_is_measured_by_its_centre_of_gravity_as_well_as_is_stated(kind, seed):
    found = vision_guard.row(kind, [seed], with_peer=False)
    assert (found["valid"], found["wrong"]) == (1.0, 0)
    # As discs that they are not, four to five times too much was stated.
    assert 0.6 < found["z"] < 1.3


@pytest.mark.first_case
@pytest.mark.parametrize(("kind", "seed"), [("pitched", 1), ("turned", 1), ("pitched", 0), ("turned", 0)])
def test_dots_that_are_out_of_round_are_named_with_the_key_that_helps(kind, seed):
    def film() -> vision_guard.Film:
        return vision_guard.CLASSES[kind](np.random.default_rng(seed))

    def measured(shown: vision_guard.Film) -> tuple[MeasuringChain, list[tuple[str, ...]]]:
        chain = vision_guard.chain(shown)
        pictures = zip(range(8), vision_guard.pictures(shown), strict=False)
        return chain, [
            chain.measure(10**18 + k * vision_guard.PERIOD_NS, picture).reasons for k, picture in pictures
        ]

    chain, reasons = measured(film())
    assert set(reasons[-1]) == {"out_of_round"}
    told = re.search(r"set tracker\.aspect to (\d\.\d+)", chain.aspect_doubt)
    assert told is not None
    # The width of the film's ellipse over its height, from its chords.
    half_u = film().shape(np.zeros(1))[0][1][0]
    low = np.linspace(0.0, 7.0, 70001)
    half_v = low[np.ptp(film().shape(low)[0], axis=0) > 0][-1]
    assert float(told[1]) == pytest.approx(half_u / half_v, rel=5e-3)
    better = film()
    better.settings["aspect"] = float(told[1])
    chain, reasons = measured(better)
    assert set(reasons[-1]) == {"ok"}
    assert chain.aspect_doubt == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        (
            "hidden",
            2,
        ),  # of a twin at rest and a marker that was covered at once after it had been told from it
        ("leaving", 500021),  # a twin came in while all markers were out of the picture
    ],
)
def test_scenes_with_a_beam_on_a_hub_that_once_were_wrong(kind, seed):
    verdict = Verdict()
    judge("suite", kind, seed, verdict, is_driven=True)
    assert verdict.wrong == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9000006, 9000009, 9000010, 9200009])
def test_a_marker_before_a_texture_is_acquired_and_kept(seed):
    # Before three of these textures a marker was not round for 35 frames and more; the third was lost when it moved.
    verdict = Verdict()
    judge("suite", "textured", seed, verdict)
    assert verdict.wrong == 0
    assert max(verdict.waits, default=0) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 1.3])
def test_a_twin_at_rest_in_the_swing_of_a_marker_is_not_acquired_for_it(start):
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(52)
    twin = Disturbances(spots=(SecondSpot(320.0, float(camera.rows(HEIGHTS[1]))),))
    for k in range(80):
        travel = np.linspace(-0.15, 0.15, 6)  # over the exposure
        x = np.repeat(0.014 * np.sin(0.3 * (k + travel) + start)[:, None], 3, axis=1)
        for marker in tracker.process(renderer.render(x, rng, disturbances=twin), k).markers:
            if marker.is_valid:
                assert marker.u_px == pytest.approx(
                    float(camera.columns(renderer.exposure_weights @ x[:, 0])), abs=0.35
                )


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.3, 0.5, 1.2])
def test_a_step_of_the_light_loses_no_marker(gain):
    camera = packaged_camera(noise_grey=0.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(53)
    for k in range(60):
        x = 0.003 * np.sin(0.28 * k + np.arange(3.0))
        lit = renderer.render(x, rng) * (gain if k >= 40 else 1.0) + 2.0 * rng.standard_normal((480, 640))
        result = tracker.process(np.clip(np.rint(lit), 0, 255).astype(np.uint8), k)
        assert columns(result) == pytest.approx(camera.columns(x), abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "bits"), [(1.5, 8), (2.4, 8), (1.8, 16)])
def test_light_that_saturates_the_markers_and_light_that_ceases_to_costs_three_frames_at_most(gain, bits):
    camera = packaged_camera(noise_grey=0.0, contrast=160.0)
    renderer, tracker = make(camera)
    rng, top = np.random.default_rng(57), 256 if bits == 16 else 1
    for k in range(60):
        x = 0.003 * np.sin(0.28 * k + np.arange(3.0))
        lit = renderer.render(x, rng) * (gain if 30 <= k < 45 else 1.0) + 2.0 * rng.standard_normal(
            (480, 640)
        )
        picture = np.clip(np.rint(top * lit), 0, 256 * top - 1)
        result = tracker.process(picture.astype(np.uint16 if bits == 16 else np.uint8), k)
        for marker, u in zip(result.markers, camera.columns(x), strict=True):
            assert marker.is_valid or 30 <= k < 33 or 45 <= k < 48
            assert not marker.is_valid or marker.u_px == pytest.approx(u, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.5, 1.7])
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_a_short_film_of_saturated_markers_is_stated_as_it_is(gain, noise):
    camera = packaged_camera(noise_grey=0.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(59)
    places = rng.random(3) / 1500
    errors, stated = [], []
    for k in range(60):
        x = places + 0.001 * np.sin(0.1 * k + np.arange(3.0))
        lit = renderer.render(x, rng) * gain + noise * rng.standard_normal((480, 640))
        result = tracker.process(np.clip(np.rint(lit), 0, 255).astype(np.uint8), k)
        assert result.is_complete
        errors.append(columns(result) - camera.columns(x))
        stated.append([marker.sigma_px for marker in result.markers])
    errors, stated = np.array(errors[2:]), np.array(stated[2:])
    # 174 values, 5 %; taken for noise, what a blurred disc leaves of a flat top made it 0.78 and less.
    assert 0.87 < np.sqrt(np.mean((errors / stated) ** 2)) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.4, 1.25])
def test_a_marker_that_was_hidden_while_the_light_changed_is_found_in_the_first_visible_frame(gain):
    camera = packaged_camera(noise_grey=0.0, contrast=120.0)
    renderer, tracker = make(camera)
    rng = np.random.default_rng(58)
    for k in range(50):
        x = 0.003 * np.sin(0.28 * k + np.arange(3.0))
        shown = np.where((np.arange(3) == 1) & (30 <= k < 40), np.nan, x)
        flicker = gain * (1.0 + 0.2 * (-1) ** k) if k >= 32 else 1.0
        lit = renderer.render(shown, rng) * flicker + 2.0 * rng.standard_normal((480, 640))
        result = tracker.process(np.clip(np.rint(lit), 0, 255).astype(np.uint8), k)
        assert [marker.is_valid for marker in result.markers] == np.isfinite(shown).tolist()


def test_one_marker_in_another_light_than_the_others_is_not_believed():
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(54)
    for k in range(50):
        frame = renderer.render(np.zeros(3), rng)
        if k >= 40:
            frame[90:170] = frame[90:170] // 2
        reasons = [marker.reason for marker in tracker.process(frame, k).markers]
        assert reasons == (["ok"] * 3 if k < 40 else ["ok", "brightness", "ok"])


@pytest.mark.parametrize("across_px", [-0.1, 0.1])
def test_a_camera_that_sags_slowly_is_followed(across_px):
    camera = packaged_camera()
    renderer, tracker = make(camera)
    rng = np.random.default_rng(55)
    for k in range(150):
        z = np.array(HEIGHTS) - across_px * k / 1500
        x = np.full(3, 0.1 * k / 1500)
        assert tracker.process(renderer.render(x, rng, marker_z=z), k).is_complete


@pytest.mark.slow
def test_a_swing_of_a_hundred_pixels_a_frame_is_followed():
    camera = packaged_camera(exposure_s=0.0002)
    renderer, tracker = make(camera)
    rng, shape = np.random.default_rng(56), (np.array(HEIGHTS) / 0.285) ** 1.8
    for k in range(60):
        x = 0.13 * np.sin(0.7 * max(0, k - 20)) * shape
        assert tracker.process(renderer.render(x, rng), k).is_complete


def test_reset_forgets_and_another_image_size_starts_anew():
    camera = packaged_camera()
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
        MarkerTracker(packaged_tracker(), 1).process(image, 0)


def test_a_tiny_image_is_no_reason_to_fail():
    result = MarkerTracker(packaged_tracker(), 1).process(np.arange(64, dtype=np.uint8).reshape(8, 8), 0)
    assert not result.is_complete


def test_rows_and_markers_must_agree_in_number():
    with pytest.raises(VisionParameterError, match="2 rows; expected 3"):
        MarkerTracker(packaged_tracker(expected_rows_px=(300.0, 100.0)), 3)


NARROW = packaged_camera(width=200, origin_px=(100.0, 455.0), contrast=120.0, noise_grey=0.0)


def seen_twice(picture: np.ndarray, du: float, dv: float, share: float) -> np.ndarray:
    """A picture with a share of its light moved aside, along u and v [px]."""
    aside = np.array([[1.0, 0.0, du], [0.0, 1.0, dv]])
    moved = cv2.warpAffine(picture, aside, picture.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    return (1 - share) * picture + share * moved


def film_seen_twice(first: int, last: int, swing_px: float, noise: float, second: tuple[float, float, float]):
    """Frames of which some show a second image of everything: the tracker's result of each, and the true columns."""
    renderer = SceneRenderer(NARROW, HEIGHTS)
    tracker = MarkerTracker(packaged_tracker(NARROW, HEIGHTS), 3, FrameTiming(NARROW))
    rng = np.random.default_rng(41)
    for k in range(60):
        instants = k + NARROW.exposure_s * NARROW.rate_hz * np.linspace(-0.5, 0.5, 6)
        x = swing_px / 1500 * np.sin(0.3 * instants)[:, None] * np.array([0.1, 0.8, 1.0])
        picture = renderer.render(x, rng).astype(np.float32)
        if first <= k < last:
            picture = seen_twice(picture, *second)
        picture += noise * rng.standard_normal(picture.shape, dtype=np.float32)
        result = tracker.process(np.clip(np.rint(picture), 0, 255).astype(np.uint8), k * 10_000_000)
        yield k, result, renderer.exposure_weights @ NARROW.columns(x)


def is_wrong(result, truth: np.ndarray) -> bool:
    """True where a valid marker is off by more than six standard deviations and 0.35 px."""
    sigma = np.array([marker.sigma_px for marker in result.markers])
    return bool(np.any(np.abs(columns(result) - truth) > np.fmax(6.0 * sigma, 0.35)))


@pytest.mark.slow
@pytest.mark.parametrize(("swing_px", "pace"), [(8.0, 0.009), (80.0, 0.053)])
def test_what_a_demosaiced_picture_adds_to_the_moments_is_no_second_image(swing_px, pace):
    # 0.05 and 3 px a frame over the pixels of a colour sensor: a disc's moments waver by 0.03 px^2, its place little.
    camera = packaged_camera(noise_grey=1.0, readout_s=0.0)
    renderer, rng = SceneRenderer(camera, HEIGHTS), np.random.default_rng(3)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), len(HEIGHTS), FrameTiming(camera))
    exposed = np.polynomial.legendre.leggauss(renderer.sub_instants)[0] / 2 * camera.exposure_s
    errors, stated = [], []
    for k in range(260):
        instants = np.maximum(k + exposed / camera.period_s - 40, 0.0)
        x = (swing_px * np.sin(pace * instants)[:, None] * [0.6, 0.8, 1.0] + [0.4, 3.1, 5.7]) / 1500
        mosaic = renderer.render(x, rng)
        colours = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR)
        result = tracker.process(cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY), round(1e9 * k * camera.period_s))
        assert result.is_complete
        errors.append(columns(result) - renderer.exposure_weights @ camera.columns(x))
        stated.append([marker.sigma_px for marker in result.markers])
    error, sigma = np.sqrt(np.mean(np.square(errors[60:]))), np.array(stated[60:])
    assert error < 0.007
    # As of a second image, all slow frames and a third of the fast ones were stated so.
    assert np.mean(sigma > 5 * error) < 0.03


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("du", "dv", "strength", "swing_px", "noise"),
    [  # every place with every strength; at rest, under more noise and in motion by turns
        (3.0, 0.0, 0.2, 0.0, 2.0),
        (3.0, 0.0, 0.35, 0.0, 5.0),
        (3.0, 0.0, 0.5, 10.0, 2.0),
        (-4.5, 0.0, 0.2, 0.0, 5.0),
        (-4.5, 0.0, 0.35, 10.0, 2.0),
        (-4.5, 0.0, 0.5, 0.0, 2.0),
        (2.5, -2.0, 0.2, 10.0, 2.0),
        (2.5, -2.0, 0.35, 0.0, 2.0),
        (2.5, -2.0, 0.5, 0.0, 5.0),
    ],
)
def test_a_reflection_of_the_picture_over_itself_is_never_valid_but_wrong(du, dv, strength, swing_px, noise):
    second = du, dv, strength / (1 + strength)
    for _, result, truth in film_seen_twice(40, 60, swing_px, noise, second):
        assert not is_wrong(result, truth)


@pytest.mark.slow
@pytest.mark.parametrize(("du", "strength", "swing_px"), [(3.0, 0.5, 10.0), (-4.5, 0.35, 0.0)])
def test_a_reflection_from_the_first_frame_on_is_never_valid_but_wrong(du, strength, swing_px):
    second = du, 0.0, strength / (1 + strength)
    for _, result, truth in film_seen_twice(0, 40, swing_px, 2.0, second):
        assert not is_wrong(result, truth)


@pytest.mark.first_case
@pytest.mark.parametrize("du", [0.8, -1.0])
@pytest.mark.parametrize("strength", [0.3, 0.5])
def test_a_reflection_that_is_there_first_is_stated_while_it_may_be_a_marker_that_is_not_round(du, strength):
    scores = []
    for _, result, truth in film_seen_twice(0, 60, 0.0, 2.0, (du, 0.0, strength / (1 + strength))):
        sigma = np.array([marker.sigma_px for marker in result.markers])
        scores.append((columns(result) - truth) / sigma)
    # The share of the light is not known: for these it is larger than the mean of those that may be.
    assert np.all(np.isfinite(scores))
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.max(np.abs(scores)) < 6.0


@pytest.mark.parametrize(("du", "dv", "share"), [(3.0, 0.0, 0.4), (-3.0, 0.0, 0.5), (2.0, 1.0, 0.3)])
@pytest.mark.parametrize("swing_px", [0.0, 10.0])
def test_a_doubled_frame_is_refused_and_the_next_one_is_not(swing_px, du, dv, share):
    for k, result, truth in film_seen_twice(45, 46, swing_px, 2.0, (du, dv, share)):
        reasons = {marker.reason for marker in result.markers}
        if k == 45:
            assert reasons <= {"smear", "shape", "asymmetry", "area"}
        elif k > 2:
            assert reasons == {"ok"}
            assert columns(result) == pytest.approx(truth, abs=0.1)


def test_what_lies_over_a_marker_is_named_and_the_marker_is_followed_under_it():
    reasons = [
        [marker.reason for marker in result.markers]
        for _, result, _ in film_seen_twice(40, 50, 10.0, 2.0, (3.0, 0.0, 0.3))
    ]
    assert reasons[40:50] == [["smear"] * 3] * 10
    assert reasons[50:] == [["ok"] * 3] * 10
