from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.repeats import STILL_FRAMES, RepeatedImages, is_on_its_way

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
