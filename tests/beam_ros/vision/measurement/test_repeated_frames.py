"""Frames that show another frame's image are found, and which of them was taken at its time; no others are."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.measurement.repeated_frames import RepeatedFrames, find_repeated_frames

PERIOD = 0.01
SIGMA = 0.01


def swing(rng: np.random.Generator, n: int = 400) -> np.ndarray:
    """Three points that a hub and two modes move, at rest at first and in the end [px]."""
    k = np.arange(n)
    driven = np.where((k > 60) & (k < n - 60), np.sin(np.pi * (k - 60) / (n - 120)) ** 2, 0.0)
    moves = [
        np.sin(0.06 * k),
        np.sin(0.21 * k + rng.uniform(0, 6)),
        0.2 * np.sin(1.1 * k + rng.uniform(0, 6)),
    ]
    shapes = np.array([[6.0, 6.0, 6.0], [0.5, 6.0, 9.0], [0.2, -4.0, 6.0]])
    return driven[:, None] * (np.stack(moves, axis=1) @ shapes)


def filled_up(missing: np.ndarray, way: str) -> np.ndarray:
    """Numbers of the images that frames show: of the one before, or of the one behind a gap."""
    shown = np.arange(len(missing))
    order = shown[1:] if way == "before" else shown[-2::-1]
    for k in order:
        if missing[k]:
            shown[k] = shown[k - 1 if way == "before" else k + 1]
    return shown


def found_in(places: np.ndarray, is_known: np.ndarray | None = None) -> RepeatedFrames:
    known = np.zeros(len(places), dtype=bool) if is_known is None else is_known
    return find_repeated_frames(np.arange(len(places)) * PERIOD, places, np.full(places.shape, SIGMA), known)


@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize("way", ["before", "behind"])
def test_of_frames_that_share_an_image_those_at_another_time_are_found(way: str, is_known: bool) -> None:
    for seed in range(5):
        rng = np.random.default_rng([1, seed])
        truth = swing(rng)
        missing = rng.random(len(truth)) < 0.06
        missing[1:] &= ~missing[:-1]
        missing[[0, 1, -2, -1]] = False
        shown = filled_up(missing, way)
        images = truth + SIGMA * rng.standard_normal(truth.shape)
        # What a codec leaves of a difference.
        places = images[shown] + (0.0 if is_known else 0.1 * SIGMA) * rng.standard_normal(truth.shape)
        copies = np.concatenate([[False], np.diff(shown) == 0])
        found = found_in(places, copies if is_known else None)
        is_off = np.abs(places - truth).max(axis=1) > 0.3
        assert np.count_nonzero(is_off) > 5
        assert not np.any(is_off & ~found.is_wrong)
        assert np.count_nonzero(found.is_wrong & ~missing) <= 2
        assert not np.any(found.is_copy & ~copies)


def test_images_whose_own_time_nobody_can_tell_are_all_left_out() -> None:
    # A gap of one is filled from behind, one of two from both sides: what is unclear has no way to follow.
    rng = np.random.default_rng(3)
    truth, shown = swing(rng), np.arange(400)
    for k in (100, 130, 160, 190, 220):
        shown[k] = k + 1
    for k in (115, 145, 205):
        shown[k : k + 2] = k - 1, k + 2
    found = found_in(truth[shown] + 1e-4 * rng.standard_normal(truth.shape))
    is_off = np.abs(truth[shown] - truth).max(axis=1) > 0.3
    assert not np.any(is_off & ~found.is_wrong)


@pytest.mark.parametrize("is_known", [False, True])
def test_of_images_that_all_come_twice_the_first_ones_stay(is_known: bool) -> None:
    rng = np.random.default_rng(4)
    truth = swing(rng)
    places = np.repeat(truth + SIGMA * rng.standard_normal(truth.shape), 2, axis=0)
    found = found_in(places, np.arange(len(places)) % 2 == 1 if is_known else None)
    assert not found.is_wrong[::2].any()
    moves = np.abs(np.diff(truth, axis=0)).max(axis=1) > 0.3
    assert np.count_nonzero(moves) > 100
    assert found.is_wrong[3::2][moves].mean() > 0.9


@pytest.mark.slow
def test_turning_points_rest_and_a_sudden_start_are_no_repeated_images() -> None:
    k = np.arange(500)
    for seed in range(60):
        rng = np.random.default_rng([2, seed])
        places = np.zeros((500, 3))
        for _ in range(rng.integers(1, 4)):
            omega = 2 * np.pi * rng.uniform(0.01, 0.49)
            decay = np.exp(-rng.uniform(0, 0.01) * k)
            places += np.outer(np.cos(omega * k + rng.uniform(0, 6)) * decay, rng.standard_normal(3))
        if seed % 3 == 0:
            places[:200] = places[200]
        places += SIGMA * rng.standard_normal(places.shape)
        # Single markers may turn at once by chance.
        assert not found_in(places * 10 ** rng.uniform(0, 1.5)).is_copy.any()
