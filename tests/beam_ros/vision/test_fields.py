"""Two instants in even and odd rows of an image."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.fields import InterlacedFields, rows_apart
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.moments import beyond
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)
N_FRAMES = 90


@pytest.mark.parametrize("top", [20, 21])
@pytest.mark.parametrize("is_dark", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_rows_of_a_comb_are_as_far_apart_as_they_were_moved(top, is_dark, dtype):
    v, u = np.mgrid[:64, :64]
    shift = np.where(v % 2 == 1, 1.5, -1.0)
    disc = 60.0 * (1 + np.tanh((6.0 - np.hypot(u - 32.3 - shift, v - 31.7)) / 0.9))
    image = np.rint(200 - disc if is_dark else 30 + disc).astype(dtype)
    level = 195.0 if is_dark else 35.0
    assert rows_apart(beyond(image[top:46, 14:52], (level,), is_dark=is_dark), top) == pytest.approx(
        2.5, abs=0.02
    )
    assert rows_apart(beyond(np.full_like(image, 30), (35.0,), is_dark=False), top) == 0.0


def found_of(apart: float, rng: np.random.Generator) -> float:
    """What a test finds of rows that are so far apart [frames], by steps of 0.6 px and with noise of 0.13 px."""
    fields = InterlacedFields()
    for frame in range(0, 40, 2):
        step = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0))
        image = np.zeros((20, 40), np.uint8)
        for row in range(20):
            at = 20.0 + (apart * step if row % 2 else 0.0) + 0.3 * rng.standard_normal()
            left = int(np.floor(at))
            image[row, left], image[row, left + 1] = round(200 * (1 - at + left)), round(200 * (at - left))
        fields.look(frame, 0, image.copy, 0, 0.0, step, 0.005)
        fields.look(frame + 1, 0, image.copy, 0, step, step, 0.005)
    assert fields.next_frame > 0
    return fields.apart


def test_noise_alone_is_hardly_ever_two_fields():
    rng = np.random.default_rng(8)
    assert all(found_of(0.0, rng) == 0.0 for _ in range(100))
    assert found_of(-1.0, rng) == pytest.approx(1.0, abs=0.2)


def film(
    apart: float,
    is_woven: bool,
    noise: float,
    swing_px: float,
    readout_s: float = 0.0,
    turn: float = 0.23,
    seed: int = 9,
):
    """A chain's tracker after a film whose odd rows come so much later [frames], and its last results with truth."""
    camera = packaged_camera(noise_grey=noise, readout_s=readout_s)
    renderer, rng = SceneRenderer(camera, HEIGHTS), np.random.default_rng(seed)
    timing = FrameTiming(camera)
    tracker = MarkerTracker(packaged_tracker(camera, HEIGHTS), len(HEIGHTS), timing)
    shares = np.array([0.2, 0.8, 1.0]) * swing_px / camera.pixels_per_metre

    def place(instant: float) -> np.ndarray:
        x = [
            np.sin(turn * (instant + e)) * shares for e in camera.exposure_s * 100 * np.linspace(-0.5, 0.5, 6)
        ]
        return np.array(x)

    found = []
    for k in range(N_FRAMES):
        image = renderer.render(place(k), rng)
        if apart:
            first = k % 2 if is_woven else 1
            image[first::2] = renderer.render(place(k + apart), rng)[first::2]
        result = tracker.process(image, k * 10_000_000)
        middle = camera.columns(np.sin(turn * (k + apart / 2)) * shares)
        found.append((k, result, middle))
    return tracker, found


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("apart", "is_woven", "noise", "swing_px"),
    [(0.5, False, 2.0, 4.0), (-0.5, False, 5.0, 12.0), (1.0, True, 2.0, 5.0)],
)
def test_two_fields_are_found_and_their_mean_is_stated_for_the_middle_instant(
    apart, is_woven, noise, swing_px
):
    tracker, found = film(apart, is_woven, noise, swing_px)
    assert tracker.fields_apart == pytest.approx(abs(apart), abs=0.06)
    scores = []
    for k, result, middle in found:
        error = np.array([marker.u_px for marker in result.markers]) - middle
        sigma = np.array([marker.sigma_px for marker in result.markers])
        if k > 70:
            assert not np.any(np.abs(error) > np.fmax(6 * sigma, 0.35))
            scores.append(error / sigma)
    assert 0.2 < np.sqrt(np.nanmean(np.square(scores))) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.8, 1.0])
def test_what_is_not_known_to_be_two_instants_yet_is_in_the_standard_deviation(turn):
    scores = []
    for seed in range(5):
        _, found = film(1.0, True, 1.0, 2.5, turn=turn, seed=seed)
        for _, result, middle in found[5:20]:
            sigma = np.array([marker.sigma_px for marker in result.markers])
            scores.append((np.array([marker.u_px for marker in result.markers]) - middle) / sigma)
    assert 0.5 < np.sqrt(np.nanmean(np.square(scores))) < 1.5


@pytest.mark.first_case
@pytest.mark.parametrize(("noise", "swing_px", "readout_s"), [(2.0, 4.0, 0.0), (5.0, 30.0, 0.008)])
def test_one_instant_is_no_interlacing_nor_is_a_rolling_shutter(noise, swing_px, readout_s):
    tracker, _ = film(0.0, False, noise, swing_px, readout_s)
    assert tracker.fields_apart == 0.0
