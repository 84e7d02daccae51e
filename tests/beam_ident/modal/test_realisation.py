from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, freqresp

from beam_ident import EstimationError, InputSignal, ModalModel

OMEGAS = np.geomspace(2.0, 700.0, 40)
KINDS = ["base_motion", "velocity", "acceleration", "force", "receptance"]


def model(kind: str, has_residual: bool = True) -> ModalModel:
    size = 2 * 2 + 2 + 2 * 4
    rng = np.random.default_rng(2)
    root = rng.standard_normal((size, size))
    root[4:6] = 0.0  # the clock is known
    own = ModalModel(
        kind,
        "hub",
        ("low", "tip"),
        np.array([28.0, 177.0]),
        np.array([0.01, 0.004]),
        np.array([[0.1, -0.4], [1.5, -0.7]]),
        np.array([1e-4, -3e-4]) * has_residual,
        np.array([1.0, 0.98]) * (kind != "receptance"),
        0.0,
        0.0,
        np.zeros((size, size)),
        np.ones(2),
    )
    scale = 1e-3 * np.abs(own.parameters)[:, None] * root
    return ModalModel.from_dict(own.to_dict() | {"covariance": (scale @ scale.T).tolist()})


@pytest.mark.parametrize("kind", KINDS)
def test_polynomials_and_zpk_are_the_frequency_response(kind):
    own = model(kind)
    expected = own.frequency_response(OMEGAS).response
    s = 1j * OMEGAS
    numerators, denominator = own.polynomials()
    for j, name in enumerate(own.output_names):
        by_polynomials = np.polyval(numerators[j], s) / np.polyval(denominator, s)
        np.testing.assert_allclose(by_polynomials, expected[:, j], rtol=1e-7)
        zeros, poles, gain = own.zpk(name)
        by_zpk = gain * np.prod(s[:, None] - zeros, axis=1) / np.prod(s[:, None] - poles, axis=1)
        np.testing.assert_allclose(by_zpk, expected[:, j], rtol=1e-6)
    with pytest.raises(EstimationError, match="no output 'middle'"):
        own.zpk("middle")


@pytest.mark.parametrize("kind", KINDS)
def test_the_state_space_is_the_frequency_response(kind):
    own = model(kind, has_residual=kind not in ("base_motion", "velocity"))
    expected = own.frequency_response(OMEGAS).response
    matrices = own.state_space()
    for j in range(2):
        _, found = freqresp(StateSpace(*matrices[:2], matrices[2][j : j + 1], matrices[3][j : j + 1]), OMEGAS)
        np.testing.assert_allclose(found, expected[:, j], rtol=1e-8)


def test_a_residual_term_of_a_displacement_has_no_states_but_one_of_an_acceleration_has():
    own = model("base_motion")
    with pytest.raises(EstimationError, match="driven_by"):
        own.state_space()
    from_acceleration = own.driven_by("acceleration")
    expected = own.frequency_response(OMEGAS).response / (-(OMEGAS**2))[:, None]
    np.testing.assert_allclose(from_acceleration.frequency_response(OMEGAS).response, expected, rtol=1e-10)
    assert from_acceleration.to_scipy().A.shape == (6, 6)
    with pytest.raises(EstimationError, match="cannot be driven"):
        own.driven_by("force")


@pytest.mark.parametrize("kind", ["acceleration", "force", "receptance"])
def test_the_step_response_is_a_simulated_step(kind):
    own = model(kind)
    times = np.linspace(1e-3, 0.8, 50)
    step = InputSignal("hub", "", (0.0, 0.1), np.ones(12), "zoh")
    np.testing.assert_allclose(own.step_response(times), own.simulate(step, times), atol=1e-12)


def test_the_step_response_of_a_displacement_is_the_second_derivative_of_the_accelerations():
    times, h = np.linspace(0.01, 0.3, 30), 1e-5
    from_acceleration, from_velocity = model("acceleration"), model("velocity")
    slope = (from_acceleration.step_response(times + h) - from_acceleration.step_response(times - h)) / (
        2 * h
    )
    np.testing.assert_allclose(from_velocity.step_response(times), slope, rtol=1e-5, atol=1e-6)
    slope = (from_velocity.step_response(times + h) - from_velocity.step_response(times - h)) / (2 * h)
    np.testing.assert_allclose(model("base_motion").step_response(times), slope, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_the_band_of_the_step_response_is_the_scatter_of_drawn_models():
    own = model("acceleration")
    times = np.array([0.02, 0.2, 0.5])
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(own.parameters, own.covariance, 4000, method="eigh")
    responses = []
    for parameters in drawn:
        rows = parameters[6:].reshape(2, 4)
        data = own.to_dict() | {
            "natural_frequencies_rad_s": parameters[:2],
            "damping_ratios": parameters[2:4],
            "gains": rows[:, 0],
            "residual_terms": rows[:, 1],
            "residues": rows[:, 2:],
        }
        responses.append(ModalModel.from_dict(data).step_response(times))
    # 4000 draws know a standard deviation to 1.1 %; the rest is curvature.
    np.testing.assert_allclose(own.step_response_sd(times), np.std(responses, axis=0), rtol=0.06)


def test_mode_shapes_are_relative_to_the_largest_residue():
    own = model("base_motion")
    shapes, sds = own.mode_shapes()
    np.testing.assert_allclose(shapes, [[0.1 / 1.5, 0.4 / 0.7], [1.0, 1.0]])
    np.testing.assert_allclose(sds[1], 0.0, atol=1e-12)
    index = [6 + 2, 10 + 2]  # r_1 of both outputs
    drawn = np.random.default_rng(0).multivariate_normal(
        own.residues[:, 0], own.covariance[np.ix_(index, index)], 4000
    )
    assert sds[0, 0] == pytest.approx(np.std(drawn[:, 0] / drawn[:, 1]), rel=0.05)


def test_python_control_gets_named_signals():
    pytest.importorskip("control")
    system = model("force").to_control()
    assert list(system.output_labels) == ["low", "tip"]
    np.testing.assert_allclose(
        system(30j)[:, 0], model("force").frequency_response([30.0]).response[0], rtol=1e-9
    )
