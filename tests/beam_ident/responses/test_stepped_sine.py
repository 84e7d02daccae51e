from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.responses.stepped_sine import fit_sine, stepped_sine_response
from beam_ident.transfer_function.model import TransferFunctionModel

PLANT = TransferFunctionModel(np.array([900.0]), np.array([1.0, 3.0, 900.0]), 0.0, np.zeros((4, 4)), 0.0)
TICK_S = 1e-3
STEP_S, WAIT_S = 9.0, 6.0
FREQUENCIES_HZ = np.array([2.0, 4.3, 4.7, 5.1, 8.37])
STARTS = STEP_S * np.arange(len(FREQUENCIES_HZ))


def stamps_of(seed):
    rng = np.random.default_rng(seed)
    return np.sort(rng.uniform(0.0, STEP_S * len(FREQUENCIES_HZ) - 0.1, 2500))


def stepped_record(noise=0.0, input_noise=0.0, hold="zoh", exposure=0.0, seed=0):
    ticks = TICK_S * np.arange(round(STEP_S * len(FREQUENCIES_HZ) / TICK_S))
    playing = np.minimum((ticks / STEP_S).astype(int), len(FREQUENCIES_HZ) - 1)
    played = np.sin(2 * np.pi * FREQUENCIES_HZ[playing] * ticks)
    rng = np.random.default_rng(seed)
    stamps = stamps_of(seed)
    keep = (stamps > exposure) & (stamps < ticks[-1] - exposure)
    clean = PLANT.simulate(InputSignal("u", "", (0.0, TICK_S), played, hold), stamps[keep], exposure)
    seen = InputSignal("u", "", (0.0, TICK_S), played + input_noise * rng.standard_normal(len(ticks)), hold)
    values = clean + noise * rng.standard_normal(len(clean)) + 3.0
    return TimeRecord((seen,), (OutputSignal("y", "", stamps[keep], values, exposure),))


def exact(hertz):
    s = 2j * np.pi * hertz
    return np.polyval(PLANT.numerator, s) / np.polyval(PLANT.denominator, s)


@pytest.mark.parametrize(("hold", "exposure"), [("zoh", 0.0), ("linear", 0.02), ("cubic", 0.02)])
def test_hold_and_exposure_are_taken_into_account_at_irregular_stamps(hold, exposure):
    record = stepped_record(hold=hold, exposure=exposure)
    found = stepped_sine_response(record, FREQUENCIES_HZ, STARTS + WAIT_S, STARTS + STEP_S - 0.05)
    # Left is the transient after 6 s, e^-9 of the response, seen through a fit over 3 s.
    np.testing.assert_allclose(found.response[:, 0, 0], exact(FREQUENCIES_HZ), rtol=2e-4)


def test_the_variance_is_that_of_output_and_input_noise():
    scores = []
    for seed in range(8):
        record = stepped_record(noise=0.02, input_noise=0.3, seed=seed)
        found = stepped_sine_response(record, FREQUENCIES_HZ, STARTS + WAIT_S, STARTS + STEP_S - 0.05)
        error = found.response[:, 0, 0] - exact(FREQUENCIES_HZ)
        scores.extend(np.abs(error) ** 2 / found.variance[:, 0, 0])
    assert 0.65 < np.mean(scores) < 1.4  # 40 scores of mean 1 and scatter 1


@pytest.mark.parametrize("rate", [-3e-4, 1e-4])
def test_a_clock_too_slow_to_be_seen_in_one_step_is_seen_in_all(rate):
    record = stepped_record(noise=0.001)
    (output,) = record.outputs
    other = OutputSignal("y", "", (1.0 + rate) * output.times_s, output.values)
    windows = FREQUENCIES_HZ, STARTS + WAIT_S, STARTS + STEP_S - 0.05
    (said,) = stepped_sine_response(TimeRecord(record.inputs, (other,)), *windows).fit_warnings
    assert "the sines of all 5 steps" in said
    assert "clocks run at different rates" in said


@pytest.mark.parametrize("wait_s", [1.0, WAIT_S])
def test_transients_that_are_still_there_are_no_clock(wait_s):
    for seed in range(6):
        record = stepped_record(noise=0.001, seed=seed)
        found = stepped_sine_response(record, FREQUENCIES_HZ, STARTS + wait_s, STARTS + STEP_S - 0.05)
        assert not any("all 5 steps" in said for said in found.fit_warnings)


def test_a_sine_of_unknown_frequency_is_found_at_the_bound():
    scores, times = [], np.sort(np.random.default_rng(0).uniform(5.0, 7.0, 300))
    for seed in range(60):
        noise = 0.1 * np.random.default_rng(seed).standard_normal(300)
        found = fit_sine(times, 1.5 * np.cos(30.0 * times + 0.4) + 2.0 + noise, 29.6, is_frequency_free=True)
        assert found.converged
        truth = 1.5 * np.exp(0.4j)
        error = [found.amplitude.real - truth.real, found.amplitude.imag - truth.imag, found.offset - 2.0]
        scores.append(np.array([*error, found.omega - 30.0]) / np.sqrt(np.diag(found.covariance)))
    # The bound of the frequency, a = 1.5 in noise of 0.1: sqrt(24 s^2 / (a^2 n T^2)).
    assert found.omega_sd == pytest.approx(np.sqrt(24 * 0.01 / (2.25 * 300 * 4.0)), rel=0.15)  # random stamps
    np.testing.assert_allclose(np.std(scores, axis=0), 1.0, atol=0.3)


def test_what_is_no_sine_or_no_step_is_refused():
    times = np.arange(20) * 0.1
    with pytest.raises(EstimationError, match="expected at least 8"):
        fit_sine(times[:5], times[:5], 3.0)
    with pytest.raises(EstimationError, match="omega is 0"):
        fit_sine(times, times, 0.0)
    with pytest.raises(EstimationError, match="cannot separate a sine of 5 Hz"):
        fit_sine(times, np.cos(times), 2 * np.pi * 5.0)  # half the rate
    record = stepped_record()
    with pytest.raises(EstimationError, match="one of each per step"):
        stepped_sine_response(record, FREQUENCIES_HZ, STARTS[1:], STARTS)
    with pytest.raises(EstimationError, match=r"'y' at 2 Hz: .* samples"):
        stepped_sine_response(record, FREQUENCIES_HZ, STARTS, STARTS + 0.02)
    still = TimeRecord((InputSignal("u", "", (0.0, TICK_S), np.zeros(45000)),), record.outputs)
    with pytest.raises(EstimationError, match="does not move"):
        stepped_sine_response(still, FREQUENCIES_HZ, STARTS, STARTS + 3.0)


def test_an_input_that_stands_still_during_one_step_is_refused_by_its_frequency():
    record = stepped_record()
    drive = record.inputs[0]
    values = np.where((drive.times_s >= STARTS[2]) & (drive.times_s < STARTS[3]), 0.0, drive.values)
    still = TimeRecord((InputSignal("u", "", drive.times_s, values),), record.outputs)
    with pytest.raises(EstimationError, match=r"does not move at 4\.7 Hz from 24\.000 s"):
        stepped_sine_response(still, FREQUENCIES_HZ, STARTS + WAIT_S, STARTS + STEP_S - 0.05)
