from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beam_model import BeamModel, BeamModelError, BeamParameterError, BeamParameters, Damping, PointMass
from tests.beam_model.rigs import STRIP, strip


def test_section_gives_rigidity_and_mass_of_the_strip() -> None:
    parameters = strip()
    assert parameters.flexural_rigidity == pytest.approx(0.052083333, rel=1e-8)
    assert parameters.mass_per_length * parameters.length == pytest.approx(29.4375e-3)
    assert parameters.total_mass == pytest.approx(0.8294375)


@pytest.mark.parametrize("name", ["length", "width", "thickness", "density", "youngs_modulus", "hub_mass"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "long", None, True])
def test_a_bad_value_is_named_with_its_range(name: str, value: object) -> None:
    with pytest.raises(BeamParameterError) as caught:
        BeamParameters.from_section(**{**STRIP, name: value})
    assert caught.value.name == name
    message = str(caught.value)
    assert name in message
    assert "above 0" in message
    assert isinstance(caught.value, (BeamModelError, ValueError))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"tip_mass": -1e-3}, "tip_mass"),
        ({"tip_inertia": math.nan}, "tip_inertia"),
        ({"clamp_stiffness": 0.0}, "clamp_stiffness"),
        ({"gravity": "sideways"}, "gravity"),
        ({"gravity": False}, "gravity"),
        ({"point_masses": (PointMass(0.31, 1e-4),)}, "point_masses[0].height"),
        ({"point_masses": (0.1,)}, "point_masses[0]"),
    ],
)
def test_a_bad_option_is_named(changes: dict[str, object], name: str) -> None:
    with pytest.raises(BeamParameterError) as caught:
        strip(**changes)
    assert caught.value.name == name


def test_an_unknown_key_is_refused() -> None:
    with pytest.raises(TypeError, match="lenght"):
        BeamParameters.from_section(**{**STRIP, "lenght": 0.3})


@pytest.mark.parametrize(
    "make",
    [
        lambda: PointMass(0.0, 1e-3),
        lambda: PointMass(0.1, -1e-3),
        lambda: Damping(ratios=(0.5, 1.5)),
        lambda: Damping(viscous=-1.0),
        lambda: Damping(air=math.nan),
        lambda: Damping(internal=math.inf),
    ],
)
def test_a_bad_part_is_refused(make: object) -> None:
    with pytest.raises(BeamParameterError):
        make()  # type: ignore[operator]


@pytest.mark.parametrize("n_modes", [0, -1, 101, 2.5, True, "5"])
def test_too_few_and_too_many_modes_are_refused(n_modes: object) -> None:
    with pytest.raises(BeamParameterError, match="n_modes"):
        BeamModel(strip(), n_modes)  # type: ignore[arg-type]


def test_an_upright_strip_buckles_at_its_known_length() -> None:
    # rho g L^3/EI = 7.8373 (Greenhill 1881)
    parameters = strip()
    limit = (7.8373 / parameters.weight_ratio) ** (1 / 3) * parameters.length
    standing = BeamModel(strip(length=0.9999 * limit, gravity="upright"), 1)
    assert standing.natural_frequencies[0] < 0.05 * BeamModel(strip(length=limit), 1).natural_frequencies[0]
    with pytest.raises(BeamParameterError, match="buckles"):
        BeamModel(strip(length=1.0001 * limit, gravity="upright"), 1)
    BeamModel(strip(length=2 * limit, gravity="hanging"), 1)


@pytest.mark.parametrize("height", [-1e-9, 0.3001, math.nan])
def test_a_height_off_the_beam_is_refused(height: float) -> None:
    with pytest.raises(BeamParameterError, match=r"heights\[1\]"):
        BeamModel(strip(), 2).shape([0.1, height])


@given(st.lists(st.floats(0.0, 0.99), max_size=6))
def test_the_last_ratio_holds_for_all_modes_above(ratios: list[float]) -> None:
    damping = Damping(ratios=tuple(ratios))
    assert damping.modal_ratio(50) == (ratios[-1] if ratios else 0.0)


@pytest.mark.parametrize("name", ["viscous", "air", "internal"])
@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_a_damping_that_feeds_the_beam_is_refused(name: str, value: float) -> None:
    with pytest.raises(BeamParameterError) as caught:
        Damping(**{name: value})
    assert caught.value.name == f"damping.{name}"
    assert getattr(Damping(**{name: 0.0}), name) == 0.0
