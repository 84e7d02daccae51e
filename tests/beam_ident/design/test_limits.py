"""Limited quantities of an excitation against the model's own simulation and the sampled motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import AxisLimits, ExcitationError, LogChirp, ModalModel
from beam_ident.design.limits import ExcitationLimits, LimitedResponse, response_to_drive
from tests.beam_ident.design.test_prediction import model

CHIRP = LogChirp(start_frequency=2.0, end_frequency=30.0, duration=4.0, still=1.0)


def limits(own: ModalModel, scale: float = 1.0) -> ExcitationLimits:
    axis = AxisLimits(travel=0.05, speed=0.5, acceleration=10.0, jerk=1e3)
    return ExcitationLimits(axis, (LimitedResponse(own, {"tip": 0.02}),), scale)


@pytest.mark.parametrize("structure", ["base_motion", "acceleration", "velocity"])
def test_shares_of_a_moved_base_are_peaks_over_limits(structure):
    own = model(structure)
    sampled = CHIRP.sample()
    shares = limits(own).shares(CHIRP)
    peaks = sampled.peaks()
    for name, limit in (("travel", 0.05), ("speed", 0.5), ("acceleration", 10.0), ("jerk", 1e3)):
        assert shares[name] == pytest.approx(peaks[name][0] / limit, rel=1e-3)
    ticks = 1e-3 * np.arange(1, 4990)
    quantity = {"base_motion": "position"}.get(structure, structure)
    seen = np.abs(own.simulate(sampled.input_signal(quantity), ticks)[:, 1])
    assert shares["tip"] == pytest.approx(np.max(seen) / 0.02, rel=1e-3)


@pytest.mark.parametrize("structure", ["force", "receptance", "mobility", "accelerance"])
def test_shares_under_a_force_are_peaks_over_limits(structure):
    own = replace(model(structure), residual_terms=np.zeros(2))
    held = CHIRP.sample_input(1e-3, 2.0)
    seen = np.abs(own.simulate(held.input_signal(), 1e-3 * np.arange(1, 4990))[:, 1])
    # A mobility's and an accelerance's drive is read in the middle of a tick: half a tick of 30 Hz is a tenth.
    assert limits(own, 2.0).shares(CHIRP)["tip"] == pytest.approx(np.max(seen) / 0.02, rel=0.02)


@pytest.mark.parametrize("structure", ["force", "receptance", "mobility", "accelerance"])
def test_the_response_to_the_drive_is_the_models_own(structure):
    own = model(structure)
    omegas = 2.0 * np.pi * np.array([2.0, 4.0, 17.0])
    np.testing.assert_allclose(
        response_to_drive(own, omegas), own.frequency_response(omegas).response, rtol=1e-12
    )


def test_gains_are_what_lines_move_and_follow_the_poles():
    own = model("base_motion")
    known = limits(own)
    omegas = 2.0 * np.pi * np.array([2.0, 4.0, 17.0])
    of_motion = np.abs(own.frequency_response(omegas).response[:, 1]) / omegas**2
    np.testing.assert_allclose(known.gains(omegas)[:, 4], (of_motion / 0.02) ** 2, rtol=1e-12)
    np.testing.assert_allclose(known.gains(omegas)[:, 0], (omegas**-2 / 0.05) ** 2, rtol=1e-12)
    moved = replace(own, natural_frequencies=1.02 * own.natural_frequencies)
    assert known.with_poles(own, moved).gains(omegas)[1, 4] < known.gains(omegas)[1, 4]


def test_limits_of_what_is_not_there_are_refused():
    with pytest.raises(ExcitationError, match="not an output"):
        LimitedResponse(model(), {"top": 1.0})
    with pytest.raises(ExcitationError, match="expected a number > 0"):
        LimitedResponse(model(), {"tip": -1.0})
    with pytest.raises(ExcitationError, match="scale"):
        ExcitationLimits(AxisLimits(), scale=0.0)
    rough = replace(model("mobility"), residual_terms=np.ones(2))
    with pytest.raises(ExcitationError, match="residual terms"):
        LimitedResponse(rough, {"tip": 1.0})
