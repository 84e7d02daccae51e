"""Outputs whose stamps are late by themselves, beside a latency that all share."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping

import numpy as np
import pytest

from beam_ident import ModalModel, TimeRecord, identify, validate
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record


def late(seed: int, delays: Mapping[str, float]) -> TimeRecord:
    """Return a record in which the stamps of some outputs are late."""
    record = beam_record(seed)
    outputs = [
        dataclasses.replace(own, times_s=own.times_s + delays.get(own.name, 0.0)) for own in record.outputs
    ]
    return TimeRecord(record.inputs, tuple(outputs))


@pytest.mark.parametrize("delay", [3e-3, -20e-3, 30e-6])
def test_a_delay_of_one_output_is_found_and_costs_nothing(delay: float) -> None:
    model = identify(late(1, {"z225": delay})).model
    assert model.n_modes == 3
    assert abs(model.output_delays[1] - delay) < 4.0 * model.output_delay_sd[1]
    assert 0.0 < model.output_delay_sd[1] < 5e-6
    np.testing.assert_array_equal(model.output_delays[[0, 2]], 0.0)
    z = np.concatenate(
        [
            (model.natural_frequencies - OMEGAS) / model.natural_frequency_sd,
            (model.damping_ratios - ZETAS) / model.damping_ratio_sd,
        ]
    )
    assert np.max(np.abs(z)) < 4.0
    stored = ModalModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(stored.output_delays, model.output_delays)
    unseen = validate(stored, late(5, {"z225": delay})).outputs
    assert min(own.scores.fit_percent for own in unseen) > 99.5


def test_outputs_that_share_a_clock_have_no_delays() -> None:
    # One record in a thousand.
    for seed in range(4):
        found = identify(beam_record(seed, latency=2e-3), n_modes=3)
        np.testing.assert_array_equal(found.model.output_delays, 0.0)
        assert not any("stamps of" in said for said in found.warnings)


def test_a_file_of_an_earlier_version_has_no_delays() -> None:
    stored = identify(beam_record(1), n_modes=3).model.to_dict()
    del stored["output_delays_s"], stored["output_delay_sd_s"]
    np.testing.assert_array_equal(ModalModel.from_dict(stored).output_delays, np.zeros(3))
