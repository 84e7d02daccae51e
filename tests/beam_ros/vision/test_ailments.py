from __future__ import annotations

import numpy as np

from beam_ros.vision.ailments import Ailments
from beam_ros.vision.repeats import LATELY


def way(n_frames: int) -> list[tuple[int, float]]:
    return [(k, 100.0 + 3.0 * k) for k in range(n_frames)]


def test_a_healthy_film_is_left_as_it_is_and_spreads_nothing():
    ailments, rng = Ailments(), np.random.default_rng(4)
    for k in range(40):
        image = rng.normal(60.0, 2.0, (80, 90)).round().astype(np.uint8)
        assert not ailments.is_repeated(image)
        assert ailments.mended(image, k, lambda: 150.0) is image
    assert ailments.spread_px((40.0, 40.0), (6.0, 0.8), (150.0, 2.0), (3.0, 0.5), 0.1) == 0.0


def test_defective_pixels_are_looked_for_when_asked_and_mended_ever_after():
    ailments, rng = Ailments(), np.random.default_rng(5)
    asked = []
    for k in range(200):
        image = rng.normal(60.0, 1.0, (80, 90)).round().astype(np.uint8)
        image[30, 40] = 255
        if k == 150:
            ailments.watch(k)
        mended = ailments.mended(image, k, lambda k=k: asked.append(k) or 150.0)
    assert abs(int(mended[30, 40]) - 60) < 10
    assert asked[0] == 0
    assert 150 in asked
    assert 140 not in asked


def test_what_stands_still_for_longer_than_a_few_images_has_stopped():
    ailments = Ailments()
    again = [ailments.is_shown_again([(way(10), 127.0, 0.01)], 10 + k) for k in range(LATELY + 1)]
    assert again == [True] * LATELY + [False]
    assert not ailments.is_shown_again([(way(10), 130.0, 0.01)], 10)
