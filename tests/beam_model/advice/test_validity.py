"""What is said of a theory's limits, against the theory that has them not."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from beam_model import BeamModel, Damping, StillAir
from beam_model.advice.validity import validity
from tests.beam_model.rigs import strip


def test_a_slender_strip_that_hardly_bends_has_no_limits_to_tell() -> None:
    assert validity(BeamModel(strip(damping=Damping(ratios=(0.005,))), 5), 5, 1e-4) == ()


@pytest.mark.parametrize("thickness", [0.01, 0.03])
def test_the_error_of_bending_alone_is_the_one_that_timoshenko_mends(thickness: float) -> None:
    plain = strip(thickness=thickness)
    (said,) = validity(BeamModel(plain, 3), 3, 0.0)
    percent = float(re.search(r"about ([\d.]+) %", said).group(1))  # type: ignore[union-attr]
    full = BeamModel(replace(plain, theory="timoshenko"), 3).natural_frequencies[2]
    truth = 100.0 * (BeamModel(plain, 3).natural_frequencies[2] / full - 1.0)
    # First order in the squared ratio of thickness and wavelength.
    assert percent == pytest.approx(truth, rel=0.25)
    assert "take beam.theory:=timoshenko" in said
    assert validity(BeamModel(replace(plain, theory="timoshenko"), 3), 3, 0.0) == ()


def test_a_block_is_no_beam() -> None:
    block = strip(thickness=0.15, theory="timoshenko")
    assert any("no theory of beams" in line for line in validity(BeamModel(block, 5), 5, 0.0))


def test_large_swings_and_heavy_damping_are_named() -> None:
    (said,) = validity(BeamModel(strip(), 3), 1, 0.10)
    assert "mode 1: a swing of 100 mm at the tip changes its frequency by +0.22 %" in said
    heavy = BeamModel(strip(damping=Damping(internal=0.00125)), 5)
    assert any(line.startswith("modes 2, 3, 4, 5: damping") for line in validity(heavy, 5, 0.0))
    given = BeamModel(strip(damping=Damping(ratios=(0.3,))), 2)
    assert any("light damping only" in line for line in validity(given, 2, 0.0))


def test_still_air_names_swing_reynolds_number_and_width() -> None:
    said = " ".join(validity(BeamModel(strip(air=StillAir()), 5), 5, 0.0))
    assert "above 0.52 mm of swing vortices" in said
    assert "from mode 4 on the Reynolds number" in said
    assert "from mode 3 on the strip is wide" in said
    assert "thin blade" in " ".join(validity(BeamModel(strip(air=StillAir(), thickness=0.01), 2), 2, 0.0))
