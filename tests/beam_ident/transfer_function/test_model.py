"""What a transfer function can tell of itself, with its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, freqresp

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.transfer_function.model import TransferFunctionModel

OMEGAS = np.geomspace(0.3, 100.0, 25)


def model(numerator, denominator, delay: float = 0.0, sd: float = 0.0) -> TransferFunctionModel:
    parameters = np.concatenate([denominator[1:], numerator, [delay]])
    covariance = np.diag((sd * parameters) ** 2)
    return TransferFunctionModel(np.array(numerator), np.array(denominator), delay, covariance, 0.0)


CASES = {
    "two modes": model([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0], sd=0.01),
    "biproper": model([2.0, 3.0, 50.0], [1.0, 2.0, 90.0], sd=0.01),
    "integrator": model([3.0, 5.0], [1.0, 2.0, 30.0, 0.0]),
    "delay": model([3.0, 50.0], [1.0, 2.0, 90.0], delay=0.13, sd=0.01),
}


def value(case: TransferFunctionModel, omegas: np.ndarray) -> np.ndarray:
    s = 1j * omegas
    return np.polyval(case.numerator, s) / np.polyval(case.denominator, s)


@pytest.mark.parametrize("name", CASES)
def test_every_form_is_the_same_system(name):
    case = CASES[name]
    s = 1j * OMEGAS
    expected = value(case, OMEGAS)
    zeros, poles, gain = case.zpk()
    by_zpk = gain * np.prod(s[:, None] - zeros, axis=1) / np.prod(s[:, None] - poles, axis=1)
    np.testing.assert_allclose(by_zpk, expected, rtol=1e-9)
    residues, poles, direct = case.residues()
    by_residues = np.sum(residues / (s[:, None] - poles), axis=1) + np.polyval(direct, s)
    np.testing.assert_allclose(by_residues, expected, rtol=1e-9)
    _, by_states = freqresp(StateSpace(*case.state_space()), OMEGAS)
    np.testing.assert_allclose(by_states, expected, rtol=1e-9)
    np.testing.assert_allclose(
        case.frequency_response(OMEGAS)[0], expected * np.exp(-s * case.delay), rtol=1e-12
    )


def test_the_state_space_keeps_its_digits_at_high_order():
    poles = np.concatenate([w * np.array([-0.01 + 1j, -0.01 - 1j]) for w in 10.0 ** np.linspace(0.0, 3.0, 6)])
    case = model([1.0], np.real(np.poly(poles)))
    matrix = case.state_space()[0]
    assert np.linalg.cond(matrix) < 1e16
    found = np.sort_complex(np.linalg.eigvals(matrix))
    np.testing.assert_allclose(found, np.sort_complex(poles), rtol=1e-5)


def test_coincident_poles_have_no_fractions_but_a_state_space():
    double = model([12.0], [1.0, 4.0, 4.0])
    with pytest.raises(EstimationError, match="coincide"):
        double.residues()
    _, by_states = freqresp(StateSpace(*double.state_space()), OMEGAS)
    np.testing.assert_allclose(by_states, value(double, OMEGAS), rtol=1e-10)


@pytest.mark.parametrize("name", ["two modes", "delay"])
def test_bands_of_the_simulation_are_those_of_a_changed_model(name):
    case = CASES[name]
    rng = np.random.default_rng(0)
    drive = InputSignal("u", "", (0.0, 0.05), rng.standard_normal(100), "linear")
    times = np.linspace(0.5, 4.5, 30)
    gradient = []
    for i, parameter in enumerate(case.parameters):
        ends = []
        for sign in (1.0, -1.0):
            changed = case.parameters.copy()
            changed[i] += sign * 1e-6 * abs(parameter)
            n = case.n_poles
            again = model(changed[n:-1], np.concatenate([[1.0], changed[:n]]), changed[-1])
            ends.append(again.simulate(drive, times))
        gradient.append((ends[0] - ends[1]) / max(2e-6 * abs(parameter), 1e-300))
    gradient = np.where(case.parameters[:, None] == 0.0, 0.0, gradient)
    expected = np.sqrt(np.einsum("at,ab,bt->t", gradient, case.covariance, gradient))
    np.testing.assert_allclose(case.simulation_sd(drive, times), expected, rtol=1e-3, atol=1e-6)
    assert np.all(case.step_response_sd(times) > 0.0)


def test_prediction_fits_what_belongs_to_the_record():
    case = CASES["two modes"]
    rng = np.random.default_rng(1)
    drive = InputSignal("u", "", (0.0, 0.02), rng.standard_normal(600), "zoh")
    times = np.linspace(0.1, 11.5, 500)
    output = OutputSignal("y", "", times, case.simulate(drive, times) + 3.0)
    record = TimeRecord((drive,), (output,)).between(4.0, 11.0)
    predicted = case.predict(record)
    np.testing.assert_allclose(predicted, record.outputs[0].values, atol=1e-8)
    values = record.outputs[0].values.copy()
    values[10:20] = np.nan
    holed = TimeRecord(record.inputs, (OutputSignal("y", "", record.outputs[0].times_s, values),))
    np.testing.assert_allclose(case.predict(holed), record.outputs[0].values, atol=1e-8)


def test_python_control_agrees():
    control = pytest.importorskip("control")
    case = CASES["two modes"]
    np.testing.assert_allclose(case.to_control()(1j * OMEGAS), value(case, OMEGAS), rtol=1e-9)
    assert isinstance(case.to_control(), control.TransferFunction)
    late = CASES["delay"]
    slow = np.array([0.5, 3.0, 8.0])  # a Pade approximation holds while the phase of the delay is small
    expected = late.frequency_response(slow)[0]
    np.testing.assert_allclose(late.to_control(pade_order=5)(1j * slow), expected, rtol=1e-6)


def test_conversions_without_delays_say_so():
    with pytest.raises(EstimationError, match="no delays"):
        CASES["delay"].to_scipy()
    with pytest.raises(EstimationError, match=r"pade_order|not installed"):
        CASES["delay"].to_control()
    with pytest.raises(EstimationError, match="improper"):
        model([1.0, 2.0, 3.0], [1.0, 2.0]).state_space()


@pytest.mark.parametrize("exposure_s", [0.0, 0.02])
def test_a_late_step_is_zero_before_its_delay_and_the_textbooks_after(exposure_s):
    late = model([5.0], [1.0, 5.0], delay=0.5)
    drive = InputSignal("u", "", (0.0, 0.1), np.ones(30), "zoh")
    times = np.array([0.02, 0.3, 0.48, 0.52, 0.7, 2.0])
    nodes, weights = np.polynomial.legendre.leggauss(10)
    seen = times[:, None] - 0.5 + 0.5 * exposure_s * nodes
    truth = np.where(seen > 0.0, 1.0 - np.exp(-5.0 * np.maximum(seen, 0.0)), 0.0) @ weights / 2
    np.testing.assert_allclose(late.simulate(drive, times, exposure_s), truth, atol=1e-9)
