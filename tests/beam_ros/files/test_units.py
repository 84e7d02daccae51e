"""Units in headings."""

from __future__ import annotations

import math

import pytest

from beam_ros.files.units import find_unit, split_heading


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [
        ("tip [mm]", "tip", "mm"),
        ("tip (mm)", "tip", "mm"),
        ("tip_mm", "tip", "mm"),
        ("tip / mm", "tip", "mm"),
        ("time (ms)", "time", "ms"),
        ("t_s", "t", "s"),
        ("force_N", "force", "N"),
        ("hub_acceleration_m_s2", "hub_acceleration", "m_s2"),
        ("velocity_m_s", "velocity", "m_s"),
        ("accel [furlong]", "accel", "furlong"),
        ("left_tip", "left_tip", ""),
        ("accel_x", "accel_x", ""),
        ("u/v", "u/v", ""),
        ("x_min", "x_min", ""),
        ("x [in]", "x", "in"),
        ("[mm]", "[mm]", "mm"),
    ],
)
def test_a_heading_is_a_name_with_a_unit(heading: str, name: str, unit: str) -> None:
    assert split_heading(heading) == (name, unit)


@pytest.mark.parametrize(
    ("text", "si", "factor"),
    [
        ("mm", "m", 1e-3),
        ("µm", "m", 1e-6),
        ("in", "m", 0.0254),
        ("m_s2", "m/s^2", 1.0),
        ("mm/s²", "m/s^2", 1e-3),
        ("m/s**2", "m/s^2", 1.0),
        ("m/s/s", "m/s^2", 1.0),
        ("mm_s", "m/s", 1e-3),
        ("g", "m/s^2", 9.80665),
        ("kN", "N", 1e3),
        ("Nm", "N m", 1.0),
        ("mNm", "N m", 1e-3),
        ("°", "rad", math.pi / 180),
        ("us", "s", 1e-6),
        ("sec", "s", 1.0),
    ],
)
def test_a_unit_is_worth_so_much_of_the_si_unit(text: str, si: str, factor: float) -> None:
    found = find_unit(text)
    assert found is not None
    assert (found.si, found.factor) == (si, pytest.approx(factor, rel=1e-15))


@pytest.mark.parametrize("text", ["", "x", "kg", "s^2", "volts"])
def test_what_is_no_unit_is_none(text: str) -> None:
    assert find_unit(text) is None
