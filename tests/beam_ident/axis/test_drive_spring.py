"""Springs that are looked for in what a stiff axis leaves: where they are, and which of them cannot be."""

from __future__ import annotations

import math

import pytest

from beam_ident.axis.axis_output_error import AxisOutputError, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord
from beam_ident.axis.drive_spring import SpringLook, SpringSearch
from beam_ident.axis.inverse_dynamics import NAMES
from benchmarks.ident.driven_axis import CompliantAxis, DrivenAxis


def looked(axis: DrivenAxis, is_of_drive: bool, drive_mass: float | None) -> SpringLook:
    whole = axis.record(1)
    record = AxisRecord(whole.inputs[0], whole.outputs[0], is_of_drive=is_of_drive)
    problem = AxisOutputError([(record, own) for own in record.pieces], MassAndFriction(*axis.truth), NAMES)
    return SpringSearch(problem, problem.minimum().state, drive_mass, 1.0).look()


@pytest.mark.first_case
@pytest.mark.parametrize(("is_of_drive", "drive_mass"), [(True, None), (True, 20.0), (False, 20.0)])
def test_the_search_begins_near_the_resonance_of_drive_and_hub(is_of_drive, drive_mass) -> None:
    gains = {} if is_of_drive else {"speed_gain": 8.0, "place_gain": 6.0}
    axis = CompliantAxis(duration_s=8.0, is_of_drive=is_of_drive, **gains)
    look = looked(axis, is_of_drive, drive_mass)
    omega = math.sqrt(1e6 * (1.0 / 20.0 + 1.0 / (axis.mass - 20.0)))
    # Twice the gain of chi-square with three degrees of freedom, at one in a million.
    assert look.gain > 30.0
    assert min(abs(start.resonance / omega - 1.0) for start in look.starts) < 0.3
    assert look.stiffer_than < 1e6


def test_a_ringing_below_the_noise_is_searched_finely_enough_to_be_met() -> None:
    # In steps of a tenth, wider than such a resonance, every search of this record ended at 0.46 or 0.74 of it.
    axis = CompliantAxis(duration_s=8.0, speed=0.2, speed_gain=8.0, place_gain=6.0)
    omega = math.sqrt(1e6 * (1.0 / 20.0 + 1.0 / (axis.mass - 20.0)))
    assert min(abs(start.resonance / omega - 1.0) for start in looked(axis, False, 20.0).starts) < 0.05


def test_a_stiff_axis_excludes_soft_springs_and_shows_none() -> None:
    look = looked(DrivenAxis(duration_s=4.0, speed=0.3), True, 20.0)
    assert look.gain < 6.0
    assert 1e6 < look.stiffer_than < math.inf
