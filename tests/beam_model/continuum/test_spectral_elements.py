from __future__ import annotations

import numpy as np
import pytest

from beam_model import PointMass
from beam_model.continuum import spectral_elements
from beam_model.continuum.mode_shapes import UniformBeamShapes
from beam_model.continuum.spectral_elements import SpectralElements
from tests.beam_model.rigs import strip

MARKERS = tuple(PointMass(height, 2e-4) for height in (0.010, 0.225, 0.285))


@pytest.mark.parametrize("n_modes", [5, 20, 60])
def test_polynomials_find_the_closed_form_roots(n_modes: int) -> None:
    parameters = strip(tip_mass=3e-3, tip_inertia=1e-6, clamp_stiffness=30.0)
    squared, _ = SpectralElements(parameters, n_modes).modes(n_modes)
    closed = UniformBeamShapes(
        n_modes, parameters.tip_mass_ratio, parameters.tip_inertia_ratio, parameters.clamp_compliance
    )
    assert squared**0.25 == pytest.approx(closed.roots, rel=1e-12)


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_polynomials_find_the_closed_form_shapes(derivative: int) -> None:
    parameters = strip(tip_mass=3e-3, tip_inertia=1e-6, clamp_stiffness=30.0)
    elements = SpectralElements(parameters, 5)
    _, vectors = elements.modes(5)
    closed = UniformBeamShapes(
        5, parameters.tip_mass_ratio, parameters.tip_inertia_ratio, parameters.clamp_compliance
    )
    x = np.linspace(0.0, 1.0, 40)
    found = elements.basis(x, derivative) @ vectors * np.sqrt(1.0 + parameters.tip_mass_ratio)
    expected = closed.evaluate(x, derivative)
    sign = np.sign(np.sum(found * expected, axis=0))
    # Each derivative of a polynomial of degree 35 costs two to three digits.
    tolerance = (1e-12, 1e-11, 1e-10, 1e-8)[derivative]
    assert np.abs((found * sign - expected) / closed.roots**derivative).max() < tolerance


@pytest.mark.parametrize("gravity", ["off", "upright", "hanging"])
def test_more_polynomials_change_nothing(gravity: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = strip(gravity=gravity, point_masses=MARKERS, tip_mass=1e-3)
    squared, _ = SpectralElements(parameters, 10).modes(10)
    monkeypatch.setattr(spectral_elements, "_DEGREES_BEYOND_WAVES", 40)
    more, _ = SpectralElements(parameters, 10).modes(10)
    assert np.sqrt(squared) == pytest.approx(np.sqrt(more), rel=1e-10)


def test_a_point_mass_at_the_tip_is_a_tip_mass() -> None:
    as_marker = strip(point_masses=(PointMass(0.30, 3e-3),), gravity="upright")
    as_tip = strip(tip_mass=3e-3, gravity="upright")
    found, _ = SpectralElements(as_marker, 6).modes(6)
    expected, _ = SpectralElements(as_tip, 6).modes(6)
    assert found == pytest.approx(expected, rel=1e-12)
