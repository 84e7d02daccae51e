"""Rounding is seen from the values alone; that its errors follow the signal is said, where they do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import OutputSignal, TimeRecord, estimate_transfer_function
from beam_ident.noise.quantisation import quantum
from tests.beam_ident.transfer_function.test_structure_gates import record_of


@pytest.mark.parametrize("step", [1e-7, 0.3])
def test_the_step_of_rounded_values_is_found(step):
    values = np.random.default_rng(0).standard_normal(3000) * 12.0 * step
    assert quantum(0.1 + step * np.round(values / step)) == pytest.approx(step, rel=1e-6)
    assert quantum(values) == 0.0


@pytest.mark.parametrize("values", [np.zeros(50), np.array([0.0, 1.0]), np.full(20, np.nan)])
def test_what_shows_no_step_has_none(values):
    assert quantum(values) == 0.0


@pytest.mark.parametrize(
    ("steps_of_noise", "is_said"), [(0.05, True), (0.15, True), (0.5, False), (2.0, False)]
)
def test_errors_that_follow_the_signal_are_named(steps_of_noise, is_said):
    record = record_of(1.0)  # noise of 0.05
    step = 0.05 / steps_of_noise
    output: OutputSignal = record.outputs[0]
    rounded = dataclasses.replace(output, values=step * np.round(output.values / step))
    found = estimate_transfer_function(TimeRecord(record.inputs, (rounded,)), 1, 0)
    assert any(said.startswith("Rounding") for said in found.warnings) == is_said
