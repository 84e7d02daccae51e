"""The short form of the study `filmed_strip`: modes of a beam without dots from sixty points, against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.ident.filmed_beam import FilmedStrip


@pytest.fixture(scope="module")
def strip() -> FilmedStrip:
    return FilmedStrip()


@pytest.mark.slow
def test_sixty_points_give_the_modes_of_a_beam_without_dots(strip):
    assert len(strip.heights) == 60
    outcome = strip.run(0)
    assert np.abs((outcome.estimate - strip.truth) / outcome.sd).max() < 4.5
    assert outcome.estimate[:2] == pytest.approx(strip.truth[:2], rel=1e-3)


@pytest.mark.verify
def test_standard_deviations_of_two_hundred_films_are_true(strip):
    figures = strip.summarise([strip.run(seed) for seed in range(200)])
    assert figures["failures"] == 0
    # 400 figures of each kind of pole: a coverage of 95 % is known to 1.1 %.
    for name in ("frequencies", "damping", "shapes"):
        assert 0.93 < figures[f"{name}, covered"] < 0.97
