from __future__ import annotations

import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lsim

from beam_ident import EstimationError, InputSignal, ModelFormatError, OutputSignal, TimeRecord
from beam_ident.evaluation.hold_out import validate
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function_estimation.estimation import estimate_transfer_function, pooled_level
from tests.beam_ident.rao_garnier import (
    PARAMETERS,
    PERIOD_S,
    benchmark_record,
    bound,
    noise_level,
    prbs,
    response,
)

ROBOT_ARM = os.environ.get("ROBOT_ARM_DATA", "")


@pytest.fixture(scope="module")
def result():
    return estimate_transfer_function(benchmark_record(0, 10.0), 4, 1)


def efficiencies(snr_db: float, runs: int) -> tuple[np.ndarray, int, np.ndarray]:
    drive = prbs(2000)
    limit = bound(drive, noise_level(response(drive), snr_db))
    errors, scores, failures = [], [], 0
    for seed in range(runs):
        found = estimate_transfer_function(benchmark_record(seed, snr_db), 4, 1)
        error = found.model.parameters[:6] - PARAMETERS
        errors.append(error)
        scores.append(error / found.model.standard_deviations[:6])
        failures += int(not found.converged or np.any(np.abs(error) > 8.0 * limit))
    return limit**2 / np.mean(np.square(errors), axis=0), failures, np.array(scores)


def test_the_bound_is_the_published_one():
    drive = prbs(2000)
    published = np.array([0.0998, 1.5876, 6.722, 15.05, 76.8, 160.9])
    np.testing.assert_allclose(bound(drive, noise_level(response(drive), 10.0)), published, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [10.0, 0.0])
def test_rao_garnier_is_solved_without_hints_near_the_bound(snr_db):
    efficiency, failures, scores = efficiencies(snr_db, 20)
    assert failures == 0
    # 20 runs: one efficiency scatters by sqrt(2/20) = 32 %, the mean over six by about 15 %.
    assert np.all(efficiency > 0.4)
    assert 0.65 < np.mean(efficiency) < 1.6
    assert np.max(np.abs(scores)) < 4.0


@pytest.mark.verify
@pytest.mark.parametrize(("snr_db", "low", "high"), [(10.0, 0.75, 1.35), (0.0, 0.75, 1.35)])
def test_rao_garnier_is_efficient_in_every_parameter(snr_db, low, high):
    efficiency, failures, scores = efficiencies(snr_db, 300)
    assert failures == 0
    assert np.all((efficiency > low) & (efficiency < high))
    covered = np.mean(np.abs(scores) < 1.96, axis=0)
    assert np.all((covered > 0.92) & (covered < 0.98))


@pytest.mark.slow
def test_without_noise_every_estimator_that_is_exact_finds_the_truth():
    record = benchmark_record(0, 300.0)
    for method in ("auto", "srivc"):
        found = estimate_transfer_function(record, 4, 1, method)
        np.testing.assert_allclose(found.model.parameters[:6], PARAMETERS, rtol=1e-6)


def test_state_variable_filters_come_near_and_are_named(result):
    for method in ("lssvf", "ivsvf"):
        found = estimate_transfer_function(benchmark_record(0, 30.0), 4, 1, method)
        assert found.method == method
        assert found.scores.fit_percent > 80.0
    assert result.method == "auto"


@pytest.mark.slow
def test_initial_state_offset_and_ramp_are_estimated_when_asked():
    rng = np.random.default_rng(5)
    drive = prbs(3000)
    clean = response(drive)[800:2800]
    times = PERIOD_S * np.arange(2000)
    noisy = clean + 5.0 + 0.1 * times + noise_level(clean, 20.0) * rng.standard_normal(2000)
    record = TimeRecord(
        (InputSignal("u", "", (0.0, PERIOD_S), drive[800:2800]),),
        (OutputSignal("y", "", (0.0, PERIOD_S), noisy),),
    )
    found = estimate_transfer_function(record, 4, 1, has_offset=True, has_ramp=True, has_free_response=True)
    z = (found.model.parameters[:6] - PARAMETERS) / found.model.standard_deviations[:6]
    assert np.max(np.abs(z)) < 4.0
    assert found.ramp == pytest.approx(0.1 * 20.0, rel=0.2)
    without = estimate_transfer_function(record, 4, 1, n_starts=1)
    assert without.scores.fit_percent < found.scores.fit_percent - 20.0


def test_irregular_stamps_are_taken_where_they_are():
    rng = np.random.default_rng(2)
    drive = prbs(2000)
    times = np.sort(rng.uniform(0.0, 19.99, 1500))
    signal = InputSignal("u", "", (0.0, PERIOD_S), drive)
    truth = TransferFunctionModel(
        PARAMETERS[4:], np.concatenate([[1.0], PARAMETERS[:4]]), 0.0, np.zeros((7, 7)), 0.0
    )
    clean = truth.simulate(signal, times)
    noisy = clean + noise_level(clean, 20.0) * rng.standard_normal(1500)
    found = estimate_transfer_function(TimeRecord((signal,), (OutputSignal("y", "", times, noisy),)), 4, 1)
    z = (found.model.parameters[:6] - PARAMETERS) / found.model.standard_deviations[:6]
    assert np.max(np.abs(z)) < 4.0


def test_simulation_is_exact_between_samples_and_for_a_double_pole():
    model = TransferFunctionModel(np.array([12.0]), np.array([1.0, 4.0, 4.0]), 0.0, np.zeros((4, 4)), 0.0)
    times = np.linspace(0.0, 3.0, 50)
    exact = 12.0 * (0.25 - 0.25 * np.exp(-2 * times) - 0.5 * times * np.exp(-2 * times))
    np.testing.assert_allclose(model.step_response(times), exact, atol=1e-12)


def test_modes_carry_the_uncertainty_of_the_coefficients(result):
    omega, zeta, sd_omega, sd_zeta = result.model.modes()
    true_poles = np.roots(np.concatenate([[1.0], PARAMETERS[:4]]))
    truth = np.sort(np.abs(true_poles[true_poles.imag > 0]))
    assert np.all(np.abs(omega - truth) < 4.0 * sd_omega)
    assert np.all(sd_zeta > 0.0)
    assert np.all((zeta > 0.0) & (zeta < 1.0))


def test_the_frequency_response_has_bands_that_cover_the_truth(result):
    omegas = np.geomspace(0.5, 60.0, 30)
    s = 1j * omegas
    truth = np.polyval(PARAMETERS[4:], s) / np.polyval(np.concatenate([[1.0], PARAMETERS[:4]]), s)
    response_found, sd = result.model.frequency_response(omegas)
    assert np.max(np.abs(np.abs(response_found) - np.abs(truth)) / sd) < 4.5


def test_a_model_survives_json_and_goes_to_scipy(result):
    model = result.model
    again = TransferFunctionModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(again.parameters, model.parameters)
    np.testing.assert_array_equal(again.covariance, model.covariance)
    with pytest.raises(ModelFormatError, match="expected a 'transfer_function'"):
        TransferFunctionModel.from_dict({"type": "modal_model", "schema": 1})
    times = np.linspace(0.0, 5.0, 400)
    _, expected, _ = lsim(model.to_scipy(), np.ones(400), times)
    np.testing.assert_allclose(model.step_response(times), expected, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"n_poles": 0, "n_zeros": 0}, "expected 1 to 20 poles"),
        ({"n_poles": 40, "n_zeros": 0}, "expected 1 to 20 poles"),
        ({"n_poles": 2, "n_zeros": 3}, "no more zeros than poles"),
        ({"n_poles": 2, "n_zeros": 1, "method": "magic"}, "method is 'magic'"),
    ],
)
def test_impossible_requests_are_refused(change, says):
    with pytest.raises(EstimationError, match=says):
        estimate_transfer_function(benchmark_record(0, 10.0), **change)


def test_records_that_say_nothing_are_refused():
    drive = InputSignal("u", "", (0.0, 0.01), np.zeros(500))
    noise = np.random.default_rng(0).standard_normal(500)
    with pytest.raises(EstimationError, match="excites nothing"):
        estimate_transfer_function(TimeRecord((drive,), (OutputSignal("y", "", (0.0, 0.01), noise),)), 2, 1)
    drive = InputSignal("u", "", (0.0, 0.01), noise)
    with pytest.raises(EstimationError, match="is constant"):
        estimate_transfer_function(
            TimeRecord((drive,), (OutputSignal("y", "", (0.0, 0.01), np.ones(500)),)), 2, 1
        )


def test_output_error_alone_ends_where_the_whole_chain_ends(result):
    alone = estimate_transfer_function(benchmark_record(0, 10.0), 4, 1, "output_error")
    assert alone.converged
    sd = result.model.standard_deviations[:6]
    np.testing.assert_allclose(
        alone.model.parameters[:6], result.model.parameters[:6], atol=2e-2 * np.max(sd)
    )
    assert np.max(np.abs((alone.model.parameters - result.model.parameters)[:6] / sd)) < 0.02


@pytest.mark.parametrize("method", ["auto", "output_error"])
def test_dropped_and_scattered_stamps_cost_no_more_than_their_samples(method):
    rng = np.random.default_rng(6)
    drive = InputSignal("u", "", (0.0, PERIOD_S), prbs(2000))
    truth = TransferFunctionModel(
        PARAMETERS[4:], np.concatenate([[1.0], PARAMETERS[:4]]), 0.0, np.zeros((7, 7)), 0.0
    )
    stamps = PERIOD_S * (np.arange(1, 1990) + rng.uniform(-0.4, 0.4, 1989))
    stamps = stamps[rng.uniform(size=len(stamps)) > 0.2]
    clean = truth.simulate(drive, stamps)
    noisy = clean + noise_level(clean, 20.0) * rng.standard_normal(len(clean))
    found = estimate_transfer_function(
        TimeRecord((drive,), (OutputSignal("y", "", stamps, noisy),)), 4, 1, method
    ).model
    sd = found.standard_deviations[:6]
    assert np.max(np.abs((found.parameters[:6] - PARAMETERS) / sd)) < 4.0
    everything = bound(drive.values, noise_level(clean, 20.0))
    np.testing.assert_allclose(sd, everything / np.sqrt(len(stamps) / 2000), rtol=0.15)


POOR = {
    "noise": lambda u, n: (u, n),
    "a sine": lambda u, n: (
        np.sin(0.1 * np.arange(len(u))),
        np.sin(0.1 * np.arange(len(u)) - 0.3) + 0.01 * n,
    ),
    "the input": lambda u, n: (u, u.copy()),
    "one impulse": lambda u, n: (np.eye(1, len(u))[0], np.exp(-0.05 * np.arange(len(u)))),
    "huge and tiny": lambda u, n: (1e12 * u, 1e-12 * n),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("record", "options"),
    [
        ("noise", {}),
        ("noise", {"delay": "estimate"}),
        ("a sine", {"n_integrators": 1, "has_free_response": True}),
        ("the input", {"delay": "estimate"}),
        ("one impulse", {}),
        ("huge and tiny", {"n_integrators": 1, "has_free_response": True}),
    ],
)
def test_poor_records_end_in_numbers_that_say_how_far_they_came(record, options):
    rng = np.random.default_rng(1)
    values = POOR[record](rng.standard_normal(120), rng.standard_normal(120))
    drive, output = (
        InputSignal("u", "", (0.0, 0.01), values[0]),
        OutputSignal("y", "", (0.0, 0.01), values[1]),
    )
    found = estimate_transfer_function(TimeRecord((drive,), (output,)), 2, 1, **options)
    assert np.all(np.isfinite(found.model.parameters))
    assert np.all(np.isfinite(found.model.covariance))
    assert np.all(found.model.poles.real <= 0.0)
    assert found.iterations <= 75
    assert found.converged or found.reason.startswith(("stopped", "stalled", "the data", "no step"))


@pytest.mark.slow
def test_an_order_far_too_high_is_flagged_or_fits_and_never_hangs():
    found = estimate_transfer_function(benchmark_record(0, 10.0, 500), 7, 6)
    assert np.all(found.model.poles.real < 0.0)
    assert (
        not found.converged
        or np.max(np.abs(found.model.standard_deviations[:7] / found.model.denominator[1:])) > 0.5
    )


@pytest.mark.skipif(
    not ROBOT_ARM, reason="the DaISy robot arm data are not part of this project (set ROBOT_ARM_DATA)"
)
@pytest.mark.parametrize(("order", "least"), [(4, 96.0), (6, 96.5)])
def test_the_flexible_robot_arm_is_predicted_on_its_unseen_half(order, least):
    torque, acceleration = np.loadtxt(ROBOT_ARM).T
    record = TimeRecord(
        (InputSignal("torque", "", (0.0, 0.008), torque, "linear"),),
        (OutputSignal("acceleration", "", (0.0, 0.008), acceleration),),
    )
    first, second = record.between(0.0, 4.088), record.between(4.096, 9.0)
    found = estimate_transfer_function(first, order, order, has_free_response=True)
    prediction = validate(found.model, second).output("acceleration")
    assert prediction.scores.fit_percent >= least


@pytest.mark.slow
def test_offset_and_ramp_are_told_at_the_middle_and_over_the_length():
    rng = np.random.default_rng(0)
    drive = InputSignal("u", "", (0.0, 0.01), rng.standard_normal(1500), "zoh")
    stamps = 0.01 * np.arange(2, 1400)
    plant = TransferFunctionModel(np.array([8.0]), np.array([1.0, 4.0]), 0.0, np.zeros((3, 3)), 0.0)
    clean = plant.simulate(drive, stamps)
    share = (stamps - np.mean(stamps)) / (stamps[-1] - stamps[0])
    seen = OutputSignal("y", "", stamps, clean + 3.0 - 2.0 * share + 1e-3 * rng.standard_normal(len(stamps)))
    record = TimeRecord((drive,), (seen,))
    for method in ("auto", "rivc"):
        both = estimate_transfer_function(
            record, 1, 0, method=method, has_offset=True, has_ramp=True
        ).records[0]
        assert (both.offset, both.ramp) == pytest.approx((3.0, -2.0), abs=0.01)
        neither = estimate_transfer_function(record, 1, 0, method=method).records[0]
        assert (neither.offset, neither.ramp) == (0.0, 0.0)


def test_the_level_of_several_records_counts_every_sample_alike():
    records = [
        SimpleNamespace(noise_sd=sd, residuals=np.zeros(n)) for sd, n in ((1.0, 300), (2.0, 100), (5.0, 100))
    ]
    # Variances 1, 4 and 25, three fifths and twice one fifth of the samples.
    assert pooled_level(records) == pytest.approx(np.sqrt((3 * 1 + 4 + 25) / 5), rel=1e-12)
    assert pooled_level(records[1:2]) == 2.0
