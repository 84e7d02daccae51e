"""The strip is told from still lines by its motion, and until then nothing is valid."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.strip.following import REASONS
from beam_ros.vision.strip.moving_line import StripFollower
from tests.beam_ros.vision.strip.filmed_strip import Strip, camera_of, film
from tests.beam_ros.vision.strip.test_following import followed, made

N_FRAMES = 40
DOUBTFUL = REASONS.index("doubtful")


@pytest.fixture(scope="module")
def swinging() -> Strip:
    return made(100.0, 2.0, 3.0, n_frames=N_FRAMES)


def bars(*places: tuple[float, float]) -> np.ndarray:
    """Light of upright bars at these columns, with these grey levels, 3 px wide and behind the lens."""
    pixels = np.arange(160.0)
    edge = 1.7 * 0.8  # of the logistic function that is as steep as the lens's Gaussian
    light = np.zeros(160)
    for column, grey in places:
        left, right = (1.0 / (1.0 + np.exp(-1.7 * (pixels - column + side * 1.5) / edge)) for side in (1, -1))
        light += grey * (left - right)
    return light


def is_wrong(u: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.abs(u - truth) > np.maximum(6 * sigma, 0.35)


@pytest.mark.slow
@pytest.mark.parametrize(
    "lines",
    [
        [(100.0, 100.0)],
        [(55.3, 200.0)],
        [(110.0, 60.0)],
        [(100.0, 100.0), (50.0, 120.0)],
    ],
)
def test_of_lines_that_look_like_the_strip_the_one_that_moves_is_taken(swinging, lines):
    light = swinging.light + bars(*lines)
    noise = 2.0 * np.random.default_rng(1).standard_normal(light.shape)
    u, sigma, reasons = followed(swinging, np.clip(np.rint(light + noise), 0, 255).astype(np.uint8))
    assert np.all(reasons[0] == DOUBTFUL)
    assert not np.any(is_wrong(u, sigma, swinging.truth))
    assert np.isfinite(u[6:]).mean() > 0.95
    # It is found again without the still line, which has nothing to say any more.
    assert not np.any(reasons[6:] == DOUBTFUL)


@pytest.mark.slow
@pytest.mark.parametrize("column", [90.5, 93.0, 96.0])
def test_a_line_that_the_strip_comes_near_is_never_the_strip(swinging, column):
    light = np.maximum(swinging.light, 20.0 + bars((column, 100.0)))
    noise = 2.0 * np.random.default_rng(2).standard_normal(light.shape)
    u, sigma, _ = followed(swinging, np.clip(np.rint(light + noise), 0, 255).astype(np.uint8))
    assert not np.any(is_wrong(u, sigma, swinging.truth))


@pytest.mark.first_case
@pytest.mark.parametrize(("columns", "grey"), [(slice(86, 87), 128), (slice(96, 98), 255)])
def test_a_bright_line_close_to_a_dim_strip_is_not_taken_for_it(columns, grey):
    parameters, camera = made(80.0, 2.0, 0.75, n_frames=1).parameters, camera_of(80.0, 2.0, 0.75)
    rows = StripFollower(parameters, (camera.height, camera.width)).rows_px
    strip = film(12, rows, parameters, camera, swing_m=0.0005, hub_m=0.0003)
    frames = strip.frames(np.random.default_rng(5))
    frames[:, :, columns] = grey
    u, sigma, _ = followed(strip, frames)
    assert not np.any(is_wrong(u, sigma, strip.truth))
    # The first is in the way of the strip's own pixels; the second is white, and no grey levels.
    assert np.isfinite(u).mean() > 0.9 or grey < 255


def test_before_anything_moves_two_lines_are_in_doubt_and_one_is_not(swinging):
    rng = np.random.default_rng(3)
    still = np.repeat(swinging.light[:1], 12, axis=0)
    shaken = np.array(
        [
            np.roll(frame + bars((105.0, 90.0)), shift, axis=1)
            for frame, shift in zip(still, [0, 1] * 6, strict=True)
        ]
    )
    for light, is_doubtful in ((still, False), (still + bars((105.0, 90.0)), True), (shaken, True)):
        frames = np.clip(np.rint(light + 2.0 * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)
        _, _, reasons = followed(swinging, frames)
        assert np.all((reasons == DOUBTFUL) == is_doubtful)


def test_the_edge_of_something_wide_is_no_line(swinging):
    light = swinging.light + np.where(np.arange(160) > 105, 180.0, 0.0)
    frames = np.clip(np.rint(light + np.random.default_rng(4).normal(0, 2, light.shape)), 0, 255).astype(
        np.uint8
    )
    follower = StripFollower(swinging.parameters, frames.shape[1:])
    found = np.array([follower.process(frame).u_px for frame in frames])
    assert np.isfinite(found).mean() > 0.95
    assert np.nanmax(np.abs(found - swinging.truth)) < 0.35


def cable(shapes: np.ndarray) -> np.ndarray:
    """Light of a line at 55 px that moves by shapes (n_frames, n_rows) [px], 3 px wide and behind the lens."""
    edge = 1.7 * 0.8
    x = np.arange(160.0) - 55.0 - shapes[:, :, None]
    right, left = (1.0 / (1.0 + np.exp(-1.7 * (x + side * 1.5) / edge)) for side in (1, -1))
    return 100.0 * (right - left)


@pytest.mark.parametrize(
    "of_height", [lambda z: 1.0 - 0.8 * z, lambda z: np.sin(np.pi * z), lambda z: 1.0 + z**2]
)
def test_a_line_that_swings_while_the_strip_rests_is_never_the_strip(swinging, of_height):
    rest = 20
    at_rest = np.repeat(swinging.light[:1], rest, axis=0)
    truth = np.concatenate([np.repeat(swinging.truth[:1], rest, axis=0), swinging.truth])
    frames = np.arange(len(truth))[:, None]
    # The last bends as a strip does, but goes on above the tip; the others are hinged above or at both ends.
    moved = (
        4.0
        * np.sin(0.11 * frames + 0.3)
        * of_height(1.0 - np.arange(swinging.light.shape[1])[None, :] / 480.0)
    )
    light = np.concatenate([at_rest, swinging.light]) + cable(moved)
    noise = 2.0 * np.random.default_rng(6).standard_normal(light.shape)
    u, sigma, reasons = followed(swinging, np.clip(np.rint(light + noise), 0, 255).astype(np.uint8))
    assert not np.any(is_wrong(u, sigma, truth))
    assert np.all(reasons[:rest] == DOUBTFUL)
    assert np.isfinite(u[rest + 12 :]).mean() > 0.9


def test_a_line_that_goes_on_above_the_tip_is_doubtful_alone_until_it_bends(swinging):
    hidden = np.full_like(swinging.light, swinging.light[0, -1, 0])
    for moved in (0.0, 4.0):
        shift = moved * np.sin(0.11 * np.arange(N_FRAMES))[:, None] * np.ones((1, hidden.shape[1]))
        light = hidden + cable(shift) + 2.0 * np.random.default_rng(7).standard_normal(hidden.shape)
        _, _, reasons = followed(swinging, np.clip(np.rint(light), 0, 255).astype(np.uint8))
        assert np.all(reasons == DOUBTFUL)
