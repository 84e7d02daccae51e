from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import jv

from beam_model import BeamModel, BeamParameterError, BeamParameters, PointMass
from beam_model.continuum import spectral_elements
from beam_model.continuum.mode_shapes import UniformBeamShapes
from beam_model.continuum.spectral_elements import SpectralElements
from beam_model.parameters import STANDARD_GRAVITY
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


L, EI = 0.3, 0.05  # [m], [N m^2]


def column(weight: float, **carried) -> BeamParameters:
    """A column whose own weight [N per metre] may be next to nothing."""
    return BeamParameters(L, EI, weight / STANDARD_GRAVITY, 1.0, gravity="upright", **carried)


def test_columns_buckle_at_the_loads_of_the_textbook():
    # Under its own weight w L^3/EI = 9/4 j^2 with J_-1/3(j) = 0 (Greenhill 1881); under a weight at height a
    # at (pi/2)^2 EI/a^2 (Euler 1744), the part above it carrying nothing.
    greenhill = 2.25 * brentq(lambda x: jv(-1.0 / 3.0, x), 1.5, 2.2) ** 2
    assert greenhill == pytest.approx(7.8373, abs=1e-4)
    own = greenhill * EI / L**3
    euler = [(np.pi / 2) ** 2 * EI / a**2 / STANDARD_GRAVITY for a in (L, 0.2)]
    light = 1e-9 * own
    for critical in (
        lambda share: column(share * own),
        lambda share: column(light, tip_mass=share * euler[0]),
        lambda share: column(light, point_masses=(PointMass(0.2, share * euler[1]),)),
        lambda share: column(light, point_masses=(PointMass(L, share * euler[0]),)),
    ):
        BeamModel(critical(1.0 - 1e-6), 2)
        with pytest.raises(BeamParameterError, match="buckles"):
            BeamModel(critical(1.0 + 1e-6), 2)


@pytest.mark.parametrize("at_tip", [True, False])
def test_a_hanging_mass_on_a_light_strip_is_a_beam_column_under_tension(at_tip):
    # Static stiffness of a cantilever at its loaded end under tension P: P/(L (1 - tanh(kL)/(kL))), k^2 = P/EI.
    mass = 0.08  # 57 % of the buckling load
    carried = {"tip_mass": mass} if at_tip else {"point_masses": (PointMass(L, mass),)}
    hanging = BeamParameters(L, EI, 1e-9, 1.0, gravity="hanging", **carried)
    pull = mass * STANDARD_GRAVITY
    turn = L * np.sqrt(pull / EI)
    stiffness = pull / (L * (1.0 - np.tanh(turn) / turn))
    assert BeamModel(hanging, 1).natural_frequencies[0] == pytest.approx(np.sqrt(stiffness / mass), rel=1e-6)
    upright = BeamParameters(L, EI, 1e-9, 1.0, gravity="upright", **carried)
    softness = pull / (L * (np.tan(turn) / turn - 1.0))
    assert BeamModel(upright, 1).natural_frequencies[0] == pytest.approx(np.sqrt(softness / mass), rel=1e-6)
