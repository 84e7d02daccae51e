"""A fit of noise converges too, and then says that it means nothing."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import (
    FrequencyRecord,
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    fit_free_decay,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    select_transfer_function,
)
from beam_ident.transfer_function.structure_gates import structure_complaint

STAMPS = 0.01 * np.arange(1, 600)
PLANT = TransferFunctionModel(np.array([8.0]), np.array([1.0, 4.0]), 0.0, np.zeros((3, 3)), 1.0, "u", "y")


def record_of(gain: float, n_integrators: int = 0, offset: float = 0.0, n_outputs: int = 1) -> TimeRecord:
    rng = np.random.default_rng(7)
    drive = InputSignal("u", "N", (0.0, 0.005), rng.standard_normal(1300), "zoh")
    plant = TransferFunctionModel(
        PLANT.numerator, np.append(PLANT.denominator, np.zeros(n_integrators)), 0.0,
        np.zeros((3 + n_integrators, 3 + n_integrators)), 1.0, "u", "y",
    )  # fmt: skip
    outputs = [
        OutputSignal(f"y{j}", "m", STAMPS, offset + gain * plant.simulate(drive, STAMPS) + noise)
        for j, noise in enumerate(0.05 * rng.standard_normal((n_outputs, len(STAMPS))))
    ]
    return TimeRecord((drive,), tuple(outputs))


@pytest.mark.slow
@pytest.mark.parametrize("has_offset", [False, True])
def test_pure_noise_leaves_no_model_without_a_warning(has_offset):
    record = record_of(0.0, offset=5.0 * has_offset)
    found = estimate_transfer_function(record, 1, 0, has_offset=has_offset)
    assert any("explains no more than chance" in said for said in found.warnings)


def test_a_plant_that_is_there_passes_without_a_word():
    for method in ("auto", "rivc"):
        found = estimate_transfer_function(record_of(1.0), 1, 0, method=method)
        assert found.converged
        assert found.warnings == ()


@pytest.mark.slow
def test_too_many_poles_are_named():
    found = estimate_transfer_function(record_of(1.0), 3, 2)
    assert any("rad/s" in said or "did not converge" in said for said in found.warnings)


def test_every_output_of_a_common_denominator_is_judged():
    assert estimate_common_poles(record_of(1.0, n_outputs=2), 1, 0).warnings == ()
    said = " ".join(estimate_common_poles(record_of(0.0, n_outputs=2), 1, 0).warnings)
    assert "Output y0: The model explains no more than chance" in said
    assert "Output y1" in said


def test_known_integrators_are_no_reason_to_refuse_a_structure():
    selection = select_transfer_function(record_of(1.0, n_integrators=1), range(1, 3), n_integrators=1)
    assert selection.chosen.model.poles[selection.chosen.model.poles != 0.0].real == pytest.approx(
        -4.0, rel=0.1
    )


def test_responses_of_noise_are_flagged():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal(300) + 1j * rng.standard_normal(300)
    record = FrequencyRecord(np.linspace(6.0, 126.0, 300), noise, output_names=("y",), input_names=("u",))
    found = fit_frequency_transfer_function(record, 2, 0)
    assert any("no more than chance" in said for said in found.warnings)
    assert fit_frequency_modes(record, "receptance", n_modes=1).warnings


def test_what_is_no_free_decay_is_flagged():
    rng = np.random.default_rng(3)
    times = 0.01 * np.arange(400)
    growing = np.exp(0.5 * times) * np.cos(20.0 * times)
    for seen in (rng.standard_normal(400), growing, np.cumsum(rng.standard_normal(400))):
        assert fit_free_decay(OutputSignal("y", "m", times, seen), n_modes=1).warnings
    ringing = np.exp(-0.5 * times) * np.cos(20.0 * times) + 0.02 * rng.standard_normal(400)
    assert fit_free_decay(OutputSignal("y", "m", times, ringing)).warnings == ()


@pytest.mark.parametrize(("deviations", "is_cancelled"), [(1.0, True), (20.0, False)])
def test_a_pair_of_zeros_cancels_a_mode_within_its_deviations_and_not_beyond(deviations, is_cancelled):
    # Zeros at -0.4 +- 20.1j beside poles at -0.4 +- 20j: the last coefficient moves them by 1/(2 * 20.1).
    numerator = np.array([1.0, 0.8, 0.4**2 + 20.1**2])
    denominator = np.polymul([1.0, 0.8, 0.4**2 + 20.0**2], [1.0, 5.0])
    covariance = np.zeros((7, 7))
    covariance[5, 5] = (2.0 * 20.1 * 0.1 / deviations) ** 2
    covariance[:3, :3] = 1e-12 * np.eye(3)
    model = TransferFunctionModel(numerator, denominator, 0.0, covariance, 1.0, "u", "y")
    complaint = structure_complaint(model)
    assert ("a zero cancels the pole at 20 rad/s" in complaint) is is_cancelled
    assert bool(complaint) is is_cancelled
