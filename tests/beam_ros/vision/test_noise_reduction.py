"""A camera that averages its frames with those before."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beam_ros.vision.noise_reduction import NoiseReduction, share_of
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)


def ground(
    share: float,
    rng: np.random.Generator,
    *,
    noise: float = 2.0,
    texture: float = 0.0,
    drift_px: float = 0.0,
    flicker: float = 0.0,
) -> np.ndarray:
    """Three frames of a ground that is averaged with so much of what was before, over a texture of 1.5 px."""
    wide = cv2.GaussianBlur(rng.standard_normal((60, 80)), (0, 0), 1.5)
    wide *= texture / wide.std()
    frames: list[np.ndarray] = []
    for k in range(23):
        place = np.array([[1.0, 0.0, drift_px * k - 30.0], [0.0, 1.0, -15.0]])
        light = 1.0 + flicker * np.sin(1.3 * k)
        scene = light * (30.0 + cv2.warpAffine(wide, place, (16, 31), flags=cv2.INTER_CUBIC))
        frame = scene + noise * rng.standard_normal((31, 16))
        frames.append(frame if not frames else (1 - share) * frame + share * frames[-1])
    return np.clip(np.rint(frames[-3:]), 0, 255)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("more", [{}, {"noise": 1.2}, {"texture": 8.0}, {"texture": 8.0, "flicker": 0.2}])
def test_the_noise_of_a_ground_that_rests_tells_the_share(share, more):
    rng = np.random.default_rng(3)
    found = [share_of(ground(share, rng, **more))[0] for _ in range(60)]
    # One sample scatters by 0.07 to 0.14, and few do not show enough noise.
    assert np.nanmean(found) == pytest.approx(share, abs=0.05)
    assert np.mean(np.isnan(found)) < 0.5


def test_a_ground_that_moves_or_is_as_even_as_whole_grey_levels_tells_nothing():
    rng = np.random.default_rng(4)
    assert all(np.isnan(share_of(ground(0.0, rng, texture=8.0, drift_px=0.4))[0]) for _ in range(20))
    assert all(np.isnan(share_of(ground(0.0, rng, noise=0.2))[0]) for _ in range(20))
    once = ground(0.0, rng)
    assert np.isnan(share_of(once[[0, 0, 1]])[0])  # a frame that comes again is no noise that does


def found_of(share: float, rng: np.random.Generator, is_disturbed: bool) -> float:
    """What a test finds beside two markers; where it is disturbed, leaves flutter on one side of each."""
    reduction, region = NoiseReduction(), (16, 2, 44, 33)
    frame, before = 0, 60.0 + 2.0 * rng.standard_normal((35, 60))
    leaves = np.zeros((35, 16))
    while reduction.next_frame == 0:
        frame += 1
        before = (1 - share) * (60.0 + 2.0 * rng.standard_normal((35, 60))) + share * before
        shown = before.copy()
        if is_disturbed:
            leaves = 0.5 * leaves + 8.0 * rng.standard_normal(leaves.shape)
            shown[:, 44:] += leaves
        reduction.look(frame, np.rint(shown).astype(np.uint8), [region, region])
    return reduction.share


@pytest.mark.slow
@pytest.mark.parametrize("is_disturbed", [False, True])
def test_noise_alone_is_hardly_ever_an_average(is_disturbed):
    rng = np.random.default_rng(8)
    assert all(found_of(0.0, rng, is_disturbed) == 0.0 for _ in range(50))
    assert found_of(0.3, rng, is_disturbed) == pytest.approx(0.3, abs=0.1)


def test_where_nothing_tells_it_the_search_has_an_end():
    reduction, image = NoiseReduction(), np.full((35, 60), 30, np.uint8)
    for frame in range(100):
        reduction.look(frame, image, [(16, 2, 44, 33)] * 4)
    assert reduction.share == 0.0
    assert reduction.next_frame > 1000


def film(share: float, is_adaptive: bool, swing_px: float, noise: float = 4.0):
    """A tracker after a film by such a camera, and its errors over stated deviations in the last frames."""
    camera = packaged_camera(noise_grey=noise)
    renderer, rng = SceneRenderer(camera, HEIGHTS), np.random.default_rng(9)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), len(HEIGHTS), FrameTiming(camera))
    shares = np.array([0.2, 0.8, 1.0]) * swing_px / camera.pixels_per_metre
    shown, scores = None, []
    for k in range(-10, 160):
        x = np.sin(0.1 * k) * shares
        frame = renderer.render(x, rng).astype(np.float32)
        if shown is None:
            shown = frame
        kept: float | np.ndarray = share
        if is_adaptive:  # what changes by more than noise is spared
            kept = share * np.clip((16.0 - cv2.blur(np.abs(frame - shown), (3, 3))) / 12.0, 0.0, 1.0)
        shown = (1 - kept) * frame + kept * shown
        if k < 0:
            continue
        result = tracker.process(np.rint(shown).astype(np.uint8), k * 10_000_000)
        if k >= 40:
            found = np.array([(marker.u_px, marker.sigma_px) for marker in result.markers])
            error = found[:, 0] - camera.columns(x)
            assert not np.any(np.abs(error) > np.fmax(6 * found[:, 1], 0.35))
            scores.append(error / found[:, 1])
    return tracker, np.sqrt(np.nanmean(np.square(scores)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "is_adaptive", "swing_px"),
    [(0.2, False, 3.0), (0.5, False, 1.0), (0.5, True, 3.0), (0.7, True, 8.0)],
)
def test_what_lags_behind_an_average_is_stated(share, is_adaptive, swing_px):
    tracker, score = film(share, is_adaptive, swing_px)
    assert tracker.lag_frames == pytest.approx(share / (1 - share), rel=0.4)
    assert 0.1 < score < 1.2


@pytest.mark.parametrize(("swing_px", "noise"), [(0.0, 2.0), (3.0, 4.0), (20.0, 1.0)])
def test_a_camera_that_shows_the_present_is_no_average(swing_px, noise):
    tracker, score = film(0.0, False, swing_px, noise)
    assert tracker.lag_frames == 0.0
    assert 0.85 < score < 1.15
