"""The disc behind an appearance, at rest and smeared, against moments of blurred discs that are drawn finely."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter1d

from beam_ros.vision.tracking.appearance import Appearance, SmearedLooks

FINE = 10
"""Points per pixel."""


def drawn(radius: float, edge: float, level: float) -> tuple[float, float]:
    """Area and second moment of a disc with a blurred rim above a level, over its height there [px^2]."""
    y, x = (np.mgrid[: 30 * FINE, : 30 * FINE] - 15 * FINE) / FINE
    seen = gaussian_filter((np.hypot(x, y) < radius).astype(float), edge * FINE) - level
    seen = np.clip(seen, 0.0, None) / (1.0 - level)
    return float(seen.sum()) / FINE**2, float((seen * x * x).sum() / seen.sum())


@pytest.mark.parametrize("edge", [0.6, 1.2])
@pytest.mark.parametrize("level", [0.15, 0.3])
def test_what_another_level_leaves_of_a_disc_is_foretold(edge, level):
    area, variance = drawn(6.0, edge, 0.05)
    seen = Appearance(area, variance, variance, 0.0, 0.0, 0.0, level=0.05)
    assert seen.changes(0.05) == (0.0, 0.0)
    expected = drawn(6.0, edge, level)
    more_area, more_variance = seen.changes(level)
    # Half of the narrowest tolerances of a spot: 4 % of the area, 3 % of the moments.
    assert area + more_area == pytest.approx(expected[0], rel=0.02)
    assert variance + more_variance == pytest.approx(expected[1], rel=0.015)


def smeared(radius: float, length: float, level: float) -> tuple[float, float, float, float]:
    """Area, plateau, and second moments along v and u of a smeared disc whose rim is blurred by 0.8 px."""
    y, x = (np.mgrid[: 40 * FINE, : 40 * FINE] - 20 * FINE) / FINE
    light = gaussian_filter((np.hypot(x, y) < radius).astype(float), 0.8 * FINE)
    light = uniform_filter1d(light, round(length * FINE) + 1, axis=1) if length else light
    middle = 20 * FINE
    plateau = np.mean(
        [light[middle + FINE * j, middle + FINE * i] for i, j in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]]
    )
    above = np.clip(light - level, 0.0, None)
    mass = above.sum()
    area = mass / FINE**2 / (plateau - level)
    return area, plateau, (above * y * y).sum() / mass, (above * x * x).sum() / mass


@pytest.mark.parametrize(("radius", "length"), [(3.0, 5.0), (3.0, 9.0), (4.0, 9.0), (8.0, 16.0)])
@pytest.mark.parametrize("level", [0.06, 0.28])
def test_what_a_smear_makes_of_a_disc_is_foretold_by_its_second_moment(radius, length, level):
    rest, seen = smeared(radius, 0.0, level), smeared(radius, length, level)
    look = SmearedLooks(rest[0], rest[2], level, 0.001, 20.0).at(seen[3] - rest[3])
    # Half of the narrowest tolerances of a spot: 4 % of the area, 3 % of the moments.
    assert look.area == pytest.approx(seen[0] / rest[0], rel=0.02)
    assert look.plateau == pytest.approx(seen[1] / rest[1], rel=0.02)
    assert look.variance_v == pytest.approx(seen[2] / rest[2], rel=0.015)


def test_a_disc_at_rest_loses_nothing_and_no_smear_is_longer_than_the_longest():
    looks = SmearedLooks(27.0, 2.6, 0.06, 0.01, 9.0)
    assert looks.at(0.0) == looks.at(-0.3) == (1.0, 1.0, 1.0, 1.0)
    assert looks.at(1e6) == looks.at(1e3)
    assert 0.6 < looks.at(1e6).plateau < 0.7
