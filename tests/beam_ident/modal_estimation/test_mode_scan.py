from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import Prior
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal.line_basis import LineBasis
from beam_ident.modal.regression import ClockState
from beam_ident.modal.stacked_regression import Part, StackedRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.free_decay import _DecayBasis
from beam_ident.modal_estimation.mode_scan import likelihood_gains
from beam_ident.modal_estimation.variable_projection import fit_modes


@pytest.mark.parametrize("is_noise_known", [True, False])
def test_a_candidate_lowers_the_cost_as_much_as_a_fit_with_it_does(is_noise_known):
    times = np.arange(400) * 0.01
    ringing = np.exp(-0.1 * times) * np.cos(20.0 * times) + 0.4 * np.exp(-0.5 * times) * np.sin(55.0 * times)
    values = ringing + 0.05 * np.random.default_rng(0).standard_normal(400)
    basis = _DecayBasis(times, 0.0)
    problem = StackedRegression([basis], [[Part(0, values, np.full(400, 20.0))]], is_noise_known)
    one = fit_modes(problem, np.array([20.0]), np.array([0.005]), ClockState(), Prior(), Prior())
    omegas, zetas = np.array([54.0, 55.0, 90.0]), np.array([0.01, 0.009, 0.02])
    found = likelihood_gains(problem, one, omegas, zetas)
    fixed = [basis.fixed(0.0).value, basis.modal(one.omegas[0], one.zetas[0], 0.0).value]

    def cost(columns):
        matrix = 20.0 * np.concatenate(columns, axis=1)
        left = 20.0 * values - matrix @ np.linalg.lstsq(matrix, 20.0 * values, rcond=None)[0]
        rss = float(left @ left)
        return 0.5 * rss if is_noise_known else 0.5 * len(values) * np.log(rss)

    for gain, omega, zeta in zip(found, omegas, zetas, strict=True):
        expected = cost(fixed) - cost([*fixed, basis.modal(omega, zeta, 0.0).value])
        # The scan's ridge is 1e-6 of a column, and the logarithm multiplies by what is explained over what is left.
        assert gain == pytest.approx(expected, rel=1e-5)


def test_columns_that_depend_on_those_before_take_nothing_from_those_behind():
    times = np.arange(400) * 0.01
    ringing = np.exp(-0.1 * times) * np.cos(20.0 * times) + 0.4 * np.exp(-0.5 * times) * np.sin(55.0 * times)
    values = ringing + 0.05 * np.random.default_rng(0).standard_normal(400)
    problem = StackedRegression([_DecayBasis(times, 0.0)], [[Part(0, values, np.full(400, 20.0))]], True)
    start = np.array([20.0, 55.0]), np.array([0.005, 0.009])
    two = fit_modes(problem, *start, ClockState(), Prior(), Prior(), max_iterations=0)
    first_twice = dataclasses.replace(two, omegas=two.omegas[[0, 0, 1]], zetas=two.zetas[[0, 0, 1]])
    candidates = np.array([30.0, 90.0]), np.array([0.01, 0.02])
    expected = likelihood_gains(problem, two, *candidates)
    np.testing.assert_allclose(likelihood_gains(problem, first_twice, *candidates), expected, rtol=1e-9)


def test_a_candidate_of_a_late_response_counts_as_much_as_a_fit_with_it():
    omegas, latency = np.linspace(1.0, 100.0, 300), 0.004
    s = 1j * omegas
    late = np.exp(-s * latency)
    response = late * (1.0 / (s**2 + 0.2 * s + 400.0) + 0.5 / (s**2 + 1.0 * s + 3025.0))
    noise = 1e-4 * np.random.default_rng(0).standard_normal((2, 300))
    values = np.concatenate([response.real, response.imag]) + noise.ravel()
    record = FrequencyRecord(omegas, response)
    basis = LineBasis(record, ModalStructure("receptance", has_residual=False), is_late=True)
    problem = StackedRegression([basis], [[Part(0, values, np.full(600, 1e4))]], is_noise_known=True)
    one = fit_modes(problem, np.array([20.0]), np.array([0.005]), ClockState(), Prior(latency), Prior())
    candidates = np.array([54.0, 55.0, 90.0, one.omegas[0]]), np.array([0.01, 0.009, 0.02, one.zetas[0]])
    found = likelihood_gains(problem, one, *candidates)

    def column(omega, zeta):
        lines = late / (s**2 + 2.0 * zeta * omega * s + omega**2)
        return 1e4 * np.concatenate([lines.real, lines.imag])

    def cost(*poles):
        matrix = np.stack([column(*pole) for pole in poles], axis=1)
        left = 1e4 * values - matrix @ np.linalg.lstsq(matrix, 1e4 * values, rcond=None)[0]
        return 0.5 * float(left @ left)

    present = (one.omegas[0], one.zetas[0])
    for gain, *pole in list(zip(found, *candidates, strict=True))[:-1]:
        assert gain == pytest.approx(cost(present) - cost(present, pole), rel=3e-6)
    # What is there already lowers nothing: the scan's ridge keeps rounding from being divided by rounding.
    assert abs(found[-1]) < 1e-9 * found[0], found


def test_the_cost_is_the_misfit_and_what_was_known_of_the_latency():
    omegas = np.linspace(1.0, 100.0, 300)
    s = 1j * omegas
    response = np.exp(-0.004 * s) / (s**2 + 0.2 * s + 400.0)
    values = np.concatenate([response.real, response.imag])
    values = values + 1e-4 * np.random.default_rng(1).standard_normal(600)
    structure = ModalStructure("receptance", has_residual=False)
    basis = LineBasis(FrequencyRecord(omegas, response), structure, is_late=True)
    prior = Prior(0.003, 2e-4)  # five deviations from the truth
    problem = StackedRegression([basis], [[Part(0, values, np.full(600, 1e4))]], is_noise_known=True)
    found = fit_modes(problem, np.array([20.0]), np.array([0.005]), ClockState(prior.mean), prior, Prior())
    left, latency = float(found.residuals[0] @ found.residuals[0]), found.clock.latency
    assert 0.003 < latency <= 0.004 + 1e-5
    expected = 0.5 * left + 0.5 * ((latency - 0.003) / 2e-4) ** 2
    assert found.cost == pytest.approx(expected, rel=1e-9)
