"""Rounding is seen from the values alone; that its errors follow the signal is said, where they do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
)
from tests.beam_ident.rao_garnier import PARAMETERS, benchmark_record
from tests.beam_ident.transfer_function.test_structure_gates import record_of
from tests.beam_ident.truth import beam_record


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps_of_noise", "is_said"), [(0.05, True), (0.15, True), (0.6, False), (2.0, False)]
)
def test_errors_that_follow_the_signal_are_named(steps_of_noise, is_said):
    record = record_of(1.0)  # noise of 0.05
    step = 0.05 / steps_of_noise
    output: OutputSignal = record.outputs[0]
    rounded = dataclasses.replace(output, values=step * np.round(output.values / step))
    found = estimate_transfer_function(TimeRecord(record.inputs, (rounded,)), 1, 0)
    assert any(said.startswith("Rounding") for said in found.warnings) == is_said
    assert ("rounding" in found.records[0].noise) == is_said
    plain = estimate_transfer_function(TimeRecord(record.inputs, (rounded,)), 1, 0, method="white")
    assert any("may bias the fit" in said for said in plain.warnings) == is_said


def clipped(record: TimeRecord, low: float, high: float) -> TimeRecord:
    """Return a record whose outputs end at quantiles of their values."""
    outputs = [
        dataclasses.replace(
            o, values=np.clip(o.values, np.quantile(o.values, low), np.quantile(o.values, high))
        )
        for o in record.outputs
    ]
    return TimeRecord(record.inputs, tuple(outputs))


def test_clipped_samples_are_left_out_by_the_model_and_named():
    record = benchmark_record(0, 20.0)
    known = estimate_transfer_function(record, 4, 1).model
    spoiled = clipped(record, 0.0, 0.9)
    found = estimate_transfer_function(spoiled, 4, 1)
    (said,) = [said for said in found.warnings if said.startswith("Clipped")]
    assert "200 samples of y at" in said
    assert len(found.measured) < 1800
    scores = (found.model.parameters[:6] - PARAMETERS) / found.model.standard_deviations[:6]
    assert np.max(np.abs(scores)) < 3.3
    assert np.all(found.model.standard_deviations[:6] < 2.0 * known.standard_deviations[:6])
    joint = estimate_common_poles(spoiled, 4, 1)
    assert any(said.startswith("Clipped") for said in joint.warnings)
    np.testing.assert_allclose(joint.models[0].parameters, found.model.parameters, rtol=1e-2, atol=1.0)


@pytest.mark.slow
def test_clipped_films_keep_their_modes():
    record = beam_record(1)
    known = identify(record, n_modes=3).model
    found = identify(clipped(record, 0.03, 1.0), n_modes=3)
    assert sum(said.startswith("Clipped") for said in found.warnings) == 1
    moved = np.abs(found.model.natural_frequencies - known.natural_frequencies)
    assert np.all(moved < 3.3 * found.model.natural_frequency_sd)


@pytest.mark.first_case
@pytest.mark.parametrize("kind", ["rounded", "step"])
def test_what_stands_still_is_not_clipped(kind):
    record = benchmark_record(0, 30.0)
    output = record.outputs[0]
    values = output.values.copy()
    degrees = (4, 1)
    if kind == "rounded":
        step = np.ptp(values) / 8.0
        values = np.round(values / step) * step
    else:
        held = InputSignal("u", "", (0.0, 0.01), np.where(np.arange(2000) < 300, 0.0, 1.0), "zoh")
        plant = TransferFunctionModel(np.array([3.0]), np.array([1.0, 3.0]), 0.0, np.zeros((3, 3)), 0.0)
        clean = plant.simulate(held, 0.01 * np.arange(2000))
        steps = np.round((clean + 0.004 * np.random.default_rng(0).standard_normal(2000)) / 0.02) * 0.02
        record, values, degrees = TimeRecord((held,), record.outputs), np.minimum(steps, 1.0), (1, 0)
    seen = TimeRecord(record.inputs, (dataclasses.replace(output, values=values),))
    found = estimate_transfer_function(seen, *degrees, n_starts=1)
    assert not any(said.startswith("Clipped") for said in found.warnings)
