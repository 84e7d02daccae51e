from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal_analysis import polyreference_poles
from beam_ident.modal_analysis.polyreference import residues_at
from tests.beam_ident.modal_analysis.chain import DAMPING, LINES, OMEGAS, SHAPES, noisy_record, residues

POLES = OMEGAS * (-DAMPING + 1j * np.sqrt(1.0 - DAMPING**2))


def nearest(found, pole):
    return int(np.argmin(np.abs(found.poles - pole)))


@pytest.mark.parametrize("inputs", [(0,), (0, 2)])
def test_poles_and_participation_come_back_at_a_sufficient_order(inputs):
    found = polyreference_poles(noisy_record(0, 0.0, inputs), 24)[-1]
    assert found.order == 24
    for k, pole in enumerate(POLES):
        place = nearest(found, pole)
        # The discrete-time model is a near one: 1e-4 of the distance to the axis.
        assert abs(found.poles[place] - pole) < 2e-3 * abs(pole.real)
        expected = SHAPES[list(inputs), k] / np.linalg.norm(SHAPES[list(inputs), k])
        assert abs(np.vdot(found.participation[place], expected)) > 1.0 - 1e-6


def test_a_narrow_band_far_from_zero_is_as_good():
    omegas = LINES[(2 * np.pi * 270 < LINES) & (2 * np.pi * 420 > LINES)]
    found = polyreference_poles(noisy_record(0, 0.0, (0, 2), omegas=omegas), 16)[-1]
    for pole in POLES[3:]:
        assert abs(found.poles[nearest(found, pole)] - pole) < 0.01 * abs(pole.real)


def test_residues_of_given_poles_are_exact():
    record = noisy_record(0, 0.0, (0, 1), differentiations=2)
    found = residues_at(record, POLES, differentiations=2)
    truth = np.moveaxis(residues((0, 1)), 2, 0)
    np.testing.assert_allclose(found, truth, atol=1e-9 * np.max(np.abs(truth)))


def test_what_cannot_be_analysed_is_refused():
    record = noisy_record(0, 0.0)
    with pytest.raises(EstimationError, match="max_order is 0"):
        polyreference_poles(record, 0)
    with pytest.raises(EstimationError, match="lower max_order"):
        polyreference_poles(FrequencyRecord(LINES[:10], record.response[:10, :1]), 30)
    dead = record.response * np.array([1.0, 0.0, 1.0, 1.0, 1.0])[:, None]
    with pytest.raises(EstimationError, match="'y2' to 'u1' is zero"):
        polyreference_poles(FrequencyRecord(LINES, dead), 4)
    holes = record.response.copy()
    holes[3] = np.nan
    with pytest.raises(EstimationError, match="not measured"):
        polyreference_poles(FrequencyRecord(LINES, holes), 4)
