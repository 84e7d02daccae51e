"""Samples that no noise explains are named; noise of any colour, and what a model misses, is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    fit_free_decay,
    identify,
)
from beam_ident.noise.outliers import outlier_warning
from beam_ident.noise.record_fit import RecordFit
from beam_ident.noise.scores import Scores, Whiteness
from tests.beam_ident.periodic import modal_record
from tests.beam_ident.transfer_function.test_structure_gates import PLANT, STAMPS, record_of
from tests.beam_ident.truth import beam_record


def spoiled(record: TimeRecord, share: float, size: float, seed: int = 0) -> TimeRecord:
    """Return a record with errors of one size and either sign at some samples of every output."""
    rng = np.random.default_rng(seed)
    outputs = []
    for output in record.outputs:
        values = np.array(output.values)
        at = rng.choice(len(values), max(1, round(share * len(values))), replace=False)
        values[at] += size * rng.choice([-1.0, 1.0], len(at))
        outputs.append(dataclasses.replace(output, values=values))
    return TimeRecord(record.inputs, tuple(outputs))


def named(warnings: tuple[str, ...]) -> list[str]:
    return [said for said in warnings if "Outliers" in said]


@pytest.mark.parametrize("size", [0.5, 2.0])  # noise of 0.05
def test_one_sample_in_a_hundred_is_counted_and_named(size):
    found = estimate_transfer_function(spoiled(record_of(1.0), 0.01, size), 1, 0)
    (said,) = named(found.warnings)
    assert "6 of 599 samples of y0" in said
    assert "Student's t" in said
    assert named(estimate_common_poles(spoiled(record_of(1.0), 0.01, size), 1, 0).warnings)
    assert not named(estimate_transfer_function(record_of(1.0), 1, 0).warnings)


@pytest.mark.slow
def test_identify_names_every_output_in_one_warning():
    record = beam_record(1)
    assert not named(identify(record, n_modes=3).warnings)
    said = named(identify(spoiled(record, 0.01, 2e-4), n_modes=3).warnings)
    assert [own.count(" of 1398 samples of z") for own in said if "left out" in own] == [3]


def test_a_student_t_likelihood_is_as_good_as_leaving_out_what_was_named():
    clean, record = record_of(1.0), spoiled(record_of(1.0), 0.05, 2.0)
    known = estimate_transfer_function(clean, 1, 0).model
    plain = estimate_transfer_function(record, 1, 0, method="white")
    robust = estimate_transfer_function(record, 1, 0)
    assert "NaN" in named(plain.warnings)[0]
    assert abs(robust.model.poles[0] - known.poles[0]) < 0.5 * known.standard_deviations[0]
    assert robust.model.standard_deviations[0] == pytest.approx(known.standard_deviations[0], rel=0.1)
    assert plain.model.standard_deviations[0] > 5.0 * known.standard_deviations[0]


def test_outliers_in_coloured_noise_are_left_out():
    drive = InputSignal("u", "N", (0.0, 0.005), np.random.default_rng(7).standard_normal(1300), "zoh")
    noise = 0.02 * lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(len(STAMPS)))
    clean = TimeRecord((drive,), (OutputSignal("y0", "m", STAMPS, PLANT.simulate(drive, STAMPS) + noise),))
    known = estimate_transfer_function(clean, 1, 0).model
    found = estimate_transfer_function(spoiled(clean, 0.02, 3.0), 1, 0)
    assert "without 12 outliers" in named(found.warnings)[0]
    assert abs(found.model.poles[0] - known.poles[0]) < 0.7 * known.standard_deviations[0]
    assert found.model.standard_deviations[0] == pytest.approx(known.standard_deviations[0], rel=0.2)


def test_a_single_gross_one_is_worth_a_word():
    assert (
        "1 of 599" in named(estimate_transfer_function(spoiled(record_of(1.0), 0.001, 3.0), 1, 0).warnings)[0]
    )


def warned(residuals: np.ndarray) -> bool:
    fit = RecordFit(
        "r",
        np.arange(len(residuals)),
        10.0 * np.ones(len(residuals)),
        np.ones(len(residuals)),
        residuals,
        1.0,
        Scores(0.0, 0.0),
        Whiteness.of(residuals),
        0.0,
        0.0,
    )
    return outlier_warning([("y", [fit])]) != ""


def swelling(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return noise that is ten times as strong in a tenth of the record."""
    return rng.standard_normal(n) * np.where(np.abs(np.arange(n) - 0.5 * n) < 0.05 * n, 10.0, 1.0)


def resonance(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return noise and a mode that the model misses, passed by a sweep."""
    times = np.arange(n) - 0.5 * n
    return rng.standard_normal(n) + 40.0 * np.exp(-((times / (0.02 * n)) ** 2)) * np.cos(0.9 * times)


NOISES = {
    "gaussian": lambda rng, n: rng.standard_normal(n),
    "uniform": lambda rng, n: rng.uniform(-1.0, 1.0, n),
    "rounded": lambda rng, n: np.round(0.6 * rng.standard_normal(n)),
    "coloured": lambda rng, n: lfilter([1.0], [1.0, -0.9], rng.standard_normal(n)),
    "slow": lambda rng, n: np.cumsum(rng.standard_normal(n)),
    "narrow": lambda rng, n: lfilter([1.0], [1.0, -1.6, 0.98], rng.standard_normal(n)),
    "swelling": swelling,
    "resonance": resonance,
}


@pytest.mark.parametrize("kind", list(NOISES))
def test_noise_is_no_outlier_whatever_its_colour_and_distribution(kind):
    rng = np.random.default_rng(11)
    # Six of sixty samples that are strong are no swelling that could be told from outliers.
    short = [] if kind in ("swelling", "resonance") else [60] * 60
    alarms = [warned(NOISES[kind](rng, n)) for n in short + [2000] * 60 + [30000] * 3]
    assert not any(alarms)


@pytest.mark.slow
def test_noise_free_data_have_residuals_of_rounding_and_no_warning():
    drive = InputSignal("u", "N", (0.0, 0.005), np.random.default_rng(7).standard_normal(1300), "zoh")
    record = TimeRecord((drive,), (OutputSignal("y", "m", STAMPS, PLANT.simulate(drive, STAMPS)),))
    resonant = TransferFunctionModel(
        np.array([3.0, 900.0]), np.array([1.0, 0.4, 900.0]), 0.0, np.zeros((5, 5)), 1.0, "u", "y"
    )
    ringing = TimeRecord((drive,), (OutputSignal("y", "m", STAMPS, resonant.simulate(drive, STAMPS)),))
    for method in ("auto", "rivc"):
        assert estimate_transfer_function(record, 1, 0, method=method).warnings == ()
        assert estimate_transfer_function(ringing, 2, 1, method=method).warnings == ()
    assert estimate_common_poles(ringing, 2, 1).warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("n_modes", [2, None])
def test_identify_finds_the_modes_of_noise_free_data_without_a_warning(n_modes):
    found = identify(modal_record(noise=0.0), n_modes=n_modes)
    np.testing.assert_allclose(found.model.frequencies_hz, [4.4, 28.3], rtol=1e-9)
    assert found.warnings == ()
    assert found.converged


def test_a_noise_free_decay_is_no_less_clean():
    times = 0.01 * np.arange(300)
    signal = OutputSignal("tip", "m", times, np.exp(-0.5 * times) * np.cos(27.0 * times))
    assert fit_free_decay(signal).warnings == ()


def test_coloured_noise_is_still_said():
    drive = InputSignal("u", "N", (0.0, 0.005), np.random.default_rng(7).standard_normal(1300), "zoh")
    noise = 1e-6 * lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(len(STAMPS)))
    record = TimeRecord((drive,), (OutputSignal("y", "m", STAMPS, PLANT.simulate(drive, STAMPS) + noise),))
    assert any("not white" in said for said in estimate_transfer_function(record, 1, 0).warnings)
