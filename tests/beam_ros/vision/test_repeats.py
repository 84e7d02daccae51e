from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.repeats import (
    STILL_FRAMES,
    RepeatedImages,
    expected_step,
    is_on_its_way,
    is_shown_again,
)

IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64)).astype(np.uint8)


def changed(row: int) -> np.ndarray:
    image = IMAGE.copy()
    image[row, 5] ^= 1
    return image


@pytest.mark.parametrize("other", [changed(0), changed(24), IMAGE.astype(np.uint16), IMAGE[:40]])
def test_only_the_same_image_is_one_that_comes_again(other):
    repeats = RepeatedImages()
    assert not repeats.is_repeated(IMAGE)
    assert repeats.is_repeated(IMAGE.copy())
    assert not repeats.is_repeated(other)
    assert repeats.is_repeated(other.copy())


def test_what_does_not_change_for_long_is_at_rest():
    repeats = RepeatedImages()
    found = [repeats.is_repeated(IMAGE.copy()) for _ in range(2 * STILL_FRAMES)]
    assert found == [False] + [True] * (STILL_FRAMES - 1) + [False] * STILL_FRAMES
    assert not repeats.is_repeated(changed(3))
    assert repeats.is_repeated(changed(3))


def test_an_image_in_the_memory_of_the_one_before_tells_nothing():
    repeats, memory = RepeatedImages(), IMAGE.copy()
    assert [repeats.is_repeated(memory[:]) for _ in range(3)] == [False] * 3


@pytest.mark.parametrize(
    ("steps", "is_moving"),
    [((0.0, 0.0, 0.0), False), ((6.0, 0.0, 0.0), False), ((0.03, 6.0, 0.02), False), ((0.0, 6.0, 5.0), True)],
)
def test_what_was_moved_once_is_not_on_its_way(steps, is_moving):
    assert is_on_its_way(steps, 0.01) == is_moving


def test_the_expected_step_is_that_of_a_parabola_and_doubted_by_the_third_difference():
    places = [(t, 0.5 * t**3 + 2.0 * t**2) for t in (0, 1, 2, 4, 5)]
    step, doubt = expected_step(places, 7, 0.0)
    truth = 0.5 * 7**3 + 2.0 * 7**2 - places[-1][1]
    # What the parabola through the last three leaves of a cubic is its third divided difference times the product.
    assert doubt == pytest.approx(0.5 * (7 - 2) * (7 - 4) * (7 - 5))
    assert truth - step == pytest.approx(doubt)


@pytest.mark.parametrize(
    ("now", "is_again"),
    [
        (2.0 * 9 + 0.01, True),  # as far as in the frame before, noise aside
        (2.0 * 10, False),
        (2.0 * 9 + 0.1, False),
    ],
)
def test_what_moves_evenly_does_not_stand_still_for_one_image(now, is_again):
    places = [(t, 2.0 * t) for t in range(10)]
    assert is_shown_again([(places, now, 0.005)], 10) == is_again


def test_what_rests_or_turns_may_stand_still():
    rest = [(t, 0.004 * (-1) ** t) for t in range(10)]
    turn = [(t, 8.0 * np.cos(0.3 * (t - 9.5))) for t in range(10)]
    assert not is_shown_again([(rest, 0.0, 0.005)], 10)
    assert not is_shown_again([(turn, turn[-1][1], 0.005)], 10)
    assert not is_shown_again([], 10)
