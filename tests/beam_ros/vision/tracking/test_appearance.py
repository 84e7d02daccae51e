"""The disc behind an appearance, against moments of blurred discs that are drawn finely."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from beam_ros.vision.tracking.appearance import Appearance

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
