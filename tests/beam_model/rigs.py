"""Beams that several tests measure themselves against."""

from __future__ import annotations

from typing import Any

from beam_model import BeamParameters

STRIP: dict[str, Any] = {
    "length": 0.30,
    "width": 0.025,
    "thickness": 0.0005,
    "density": 7850.0,
    "youngs_modulus": 200e9,
    "hub_mass": 0.8,
}
HEIGHTS = (0.010, 0.225, 0.285)


def strip(**changes: Any) -> BeamParameters:
    """The default rig's spring-steel strip, with changes."""
    return BeamParameters.from_section(**{**STRIP, **changes})
