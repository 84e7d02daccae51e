"""The points' scatter over that of white noise, from points whose scatter is known."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.strip.scatter import PointScatter

N_POINTS, SIGMA = 45, 0.01
_BASIS = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, N_POINTS), 9)
LEFT = np.eye(N_POINTS) - _BASIS @ np.linalg.pinv(_BASIS)


def factor(scatter_px: float, seed: int, offset_px: float = 0.0, hidden: slice = slice(0)) -> float:
    """After two hundred frames of points that scatter so much, each beside the curve by an offset of its own."""
    rng = np.random.default_rng(seed)
    scatter, offsets = PointScatter(N_POINTS, 10), offset_px * rng.standard_normal(N_POINTS)
    is_ok = np.ones(N_POINTS, dtype=bool)
    is_ok[hidden] = False
    for _ in range(200):
        points = offsets + scatter_px * rng.standard_normal(N_POINTS)
        points[hidden] += 1.0
        scatter.learn(LEFT @ np.where(is_ok, points, offsets), LEFT, np.full(N_POINTS, SIGMA), is_ok)
    return scatter.factor


@pytest.mark.parametrize("true", [1.0, 1.5, 3.0])
def test_scatter_beyond_white_noise_is_found(true):
    # 1500 degrees of freedom: a standard deviation is known to 1.8 %.
    assert factor(true * SIGMA, 1) == pytest.approx(true, rel=0.06)


def test_points_that_scatter_less_are_not_believed_better():
    assert factor(0.3 * SIGMA, 2) == 1.0


def test_what_a_point_always_has_and_points_that_are_not_valid_are_no_scatter():
    assert factor(SIGMA, 3, offset_px=0.1, hidden=slice(20, 24)) == pytest.approx(1.0, abs=0.06)


def test_few_points_of_few_rows_keep_their_white_noise():
    scatter = PointScatter(12, 1)
    scatter.learn(np.zeros(12), np.eye(12), np.full(12, SIGMA), np.ones(12, dtype=bool))
    assert scatter.factor == 1.0
