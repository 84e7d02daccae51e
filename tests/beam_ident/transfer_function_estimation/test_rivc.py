from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    select_transfer_function,
)
from beam_ident.noise.noise_model import Whitening
from benchmarks.ident.forced_beam import ForcedBeam
from benchmarks.ident.noise_models import coloured
from tests.beam_ident.rao_garnier import PARAMETERS, PERIOD_S, benchmark_record, noise_level, prbs, response

NOISE = np.array([1.0, -1.6, 0.8])


def noisy_record(seed: int, snr_db: float = 10.0) -> TimeRecord:
    clean = response(prbs(2000))
    values = clean + noise_level(clean, snr_db) * coloured(seed, 2000, [1.0], NOISE.tolist())
    return TimeRecord(benchmark_record(0, 10.0).inputs, (OutputSignal("y", "", (0.0, PERIOD_S), values),))


def test_whitening_is_the_inverse_root_of_the_noise_covariance():
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    shape = lfilter([1.0], NOISE, impulse)
    covariance = toeplitz([float(shape[k:] @ shape[: 4000 - k]) for k in range(30)])
    columns = np.random.default_rng(0).standard_normal((30, 2))
    expected = solve_triangular(cholesky(covariance, lower=True), columns, lower=True)
    found = Whitening(NOISE, 0.1 * np.arange(30)).apply(columns)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_gap_begins_a_new_run():
    times = 0.1 * np.delete(np.arange(40), [17, 18])
    columns = np.random.default_rng(1).standard_normal((38, 1))
    found = Whitening(NOISE, times).apply(columns)
    np.testing.assert_allclose(found[:17], Whitening(NOISE, times[:17]).apply(columns[:17]))
    np.testing.assert_allclose(found[17:], Whitening(NOISE, times[17:]).apply(columns[17:]))


@pytest.mark.slow
def test_the_noise_is_identified_beside_the_system():
    found = estimate_transfer_function(noisy_record(2), 4, 1, method="rivc")
    assert found.converged
    assert found.method == "rivc"
    np.testing.assert_allclose(found.noise_coefficients[1:3], NOISE[1:], atol=0.08)
    assert found.whiteness.is_white
    assert found.model.noise_sd == pytest.approx(np.std(found.residuals))
    np.testing.assert_allclose(found.modelled + found.residuals, found.measured)
    plain = estimate_transfer_function(noisy_record(2), 4, 1, method="white")
    assert not plain.whiteness.is_white
    assert found.bic < plain.bic - 1000.0
    scores = (found.model.parameters[:6] - PARAMETERS) / found.model.standard_deviations[:6]
    assert np.max(np.abs(scores)) < 4.0


@pytest.mark.slow
def test_the_fast_mode_of_a_beam_gains_what_its_noise_lacks():
    beam = ForcedBeam()
    clean = beam.model.simulate(beam.drive, beam.period * np.arange(beam.n))[:, 0]
    errors = []
    for seed in range(2):
        values = clean + 0.1 * np.std(clean) * coloured(seed, beam.n, [1.0], [1.0, -0.95])
        record = TimeRecord((beam.drive,), (OutputSignal("tip", "m", (0.0, beam.period), values),))
        models = [estimate_transfer_function(record, 6, 4, method).model for method in ("white", "auto")]
        errors.append([abs(model.modes()[0][2] / beam.omegas[2] - 1.0) for model in models])
    plain, refined = np.sqrt(np.mean(np.square(errors), axis=0))
    # AR(1) of 0.95 leaves 7 % of white noise's power at 40 Hz: deviations fall to a quarter.
    assert refined < 0.6 * plain


def test_white_noise_gets_no_model_and_the_same_estimate():
    found = estimate_transfer_function(benchmark_record(1, 10.0), 4, 1, method="rivc")
    plain = estimate_transfer_function(benchmark_record(1, 10.0), 4, 1)
    assert len(found.noise_coefficients) == 1
    np.testing.assert_allclose(
        found.model.parameters, plain.model.parameters, atol=2e-3 * np.max(plain.model.standard_deviations)
    )


def scattered(seed: int, correlation_s: float, share_missing: float = 0.0) -> TimeRecord:
    """Return Rao-Garnier at 10 dB under slow noise, at stamps anywhere or at a clock's that misses some."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0.0, 19.98, 2000))
    if share_missing:
        times = PERIOD_S * np.flatnonzero(rng.uniform(size=2000) > share_missing)
    drive = benchmark_record(0, 10.0).inputs[0]
    plant = TransferFunctionModel(PARAMETERS[4:], np.append(1.0, PARAMETERS[:4]), 0.0, np.zeros((7, 7)), 0.0)
    clean, noise = plant.simulate(drive, times), rng.standard_normal(len(times))
    kept = np.exp(-np.diff(times) / correlation_s)
    for k, share in enumerate(kept, start=1):
        noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
    values = clean + noise_level(clean, 10.0) * noise
    return TimeRecord((drive,), (OutputSignal("y", "", times, values),))


@pytest.mark.slow
@pytest.mark.parametrize("share_missing", [0.0, 0.3])
def test_coloured_noise_at_any_stamps_is_weighed_by_default(share_missing):
    errors, scores = [], []
    for seed in range(4):
        record = scattered(seed, 1.0, share_missing)
        plain = estimate_transfer_function(record, 4, 1, method="white").model
        found = estimate_transfer_function(record, 4, 1)
        assert found.whiteness.is_white
        assert any("Ornstein-Uhlenbeck noise of" in said for said in found.warnings)
        assert "Ornstein-Uhlenbeck" in found.records[0].noise
        errors.append([model.parameters[:6] - PARAMETERS for model in (plain, found.model)])
        scores.append([errors[-1][k] / m.standard_deviations[:6] for k, m in enumerate((plain, found.model))])
    plain_rms, rms = np.sqrt(np.mean(np.square(errors), axis=0))
    # The noise is slow: what is left of it at the fast mode is a hundredth of its power.
    assert rms[0] < 0.6 * plain_rms[0]
    # Both are honest: 24 scores of an honest estimate have a mean square of 1 +- 0.29 times their correlation.
    assert np.all(np.mean(np.square(scores), axis=(0, 2)) < 2.2)


@pytest.mark.slow
def test_coloured_noise_does_not_pass_for_poles():
    values = benchmark_record(0, 10.0).outputs[0].values.copy()
    white = np.random.default_rng(4).standard_normal(2000)
    values = response(prbs(2000)) + noise_level(values, 10.0) * lfilter([0.3], [1.0, -0.95], white)
    drive = benchmark_record(0, 10.0).inputs[0]
    record = TimeRecord((drive,), (OutputSignal("y", "", (0.0, PERIOD_S), values),))
    chosen = select_transfer_function(record, (2, 3, 4, 5), (0, 1, 2)).chosen
    assert (chosen.model.n_poles, len(chosen.model.numerator) - 1) == (4, 1)
    assert chosen.method == "auto"


@pytest.mark.slow
def test_outputs_with_common_poles_have_noise_of_their_own_colour():
    slow, fast = scattered(7, 1.0), scattered(8, 0.05)
    outputs = (slow.outputs[0], OutputSignal("z", "", fast.outputs[0].times_s, fast.outputs[0].values))
    found = estimate_common_poles(TimeRecord(slow.inputs, outputs), 4, 1)
    assert all(own.is_white for own in found.whiteness)
    assert sum("weighed by their noise" in said for said in found.warnings) == 2
    for model in found.models:
        assert np.max(np.abs((model.parameters[:6] - PARAMETERS) / model.standard_deviations[:6])) < 4.0


@pytest.mark.slow
def test_what_the_model_misses_is_not_weighed_away():
    # A second order for a system of the fourth: residuals are the fast mode, not noise.
    record = benchmark_record(0, 60.0)
    plain = estimate_transfer_function(record, 2, 1, method="white")
    found = estimate_transfer_function(record, 2, 1)
    np.testing.assert_allclose(found.model.parameters, plain.model.parameters)
    assert any("unmodelled" in said for said in found.warnings)


@pytest.mark.slow
def test_structures_are_compared_under_the_noise_as_it_is_also_where_their_weights_stay_equal():
    # Slow steps that a second order without zeros cannot follow: its misfit has a colour that no weighing believes.
    rng, times = np.random.default_rng(0), 0.01 * np.arange(4000)
    drive = InputSignal("u", "V", times, np.repeat(rng.choice([-1.0, 1.0], 100), 40), "zoh")
    plant = TransferFunctionModel(PARAMETERS[4:], np.append(1.0, PARAMETERS[:4]), 0.0, np.zeros((7, 7)), 0.0)
    seen = np.sort(rng.choice(times, 800, replace=False))
    clean = plant.simulate(drive, seen)
    values = clean + 0.02 * np.std(clean) * rng.standard_normal(800)
    record = TimeRecord((drive,), (OutputSignal("y", "", seen, values),))
    one, two, three = (
        estimate_transfer_function(record, *degrees, has_free_response=False)
        for degrees in ((1, 0), (2, 0), (2, 1))
    )
    assert one.records[0].noise
    assert not two.records[0].noise
    assert three.bic < two.bic < one.bic
