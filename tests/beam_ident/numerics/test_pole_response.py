from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from beam_ident.numerics import pole_response
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import PoleResponses, phi_functions

POLE = complex(-1.5, 180.0)
HOLDS = ["zoh", "linear", "cubic"]


def make_signal(hold: str, irregular: bool) -> PiecewisePolynomial:
    rng = np.random.default_rng(3)
    times = np.arange(400) * 1e-3
    if irregular:
        times = times + rng.uniform(-4e-4, 4e-4, 400)
    return PiecewisePolynomial.from_samples(times, rng.standard_normal(400), hold)


def test_phi_functions_agree_with_their_integrals_on_both_sides_of_the_switch():
    # phi_k(z) = int_0^1 e^((1-s) z) s^(k-1) / (k-1)! ds
    for z in (1e-9, 0.3 + 0.2j, 0.999, 1.001j, -4.0 + 9.0j):
        values = phi_functions(np.array([z]), 4)
        assert values[0][0] == pytest.approx(np.exp(z), rel=1e-14)
        for k, factorial in ((1, 1), (2, 1), (3, 2), (4, 6)):
            parts = [
                quad(
                    lambda s, k=k, z=z, p=p: getattr(np.exp((1 - s) * z) * s ** (k - 1), p),
                    0,
                    1,
                    epsabs=1e-14,
                )[0]
                for p in ("real", "imag")
            ]
            assert values[k][0] == pytest.approx(complex(*parts) / factorial, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("hold", HOLDS)
def test_the_state_solves_the_differential_equation(hold, irregular):
    signal = make_signal(hold, irregular)
    end = 0.0537
    knots = signal.knots[signal.knots < end]
    state = 0.0 + 0.0j
    for first, last in zip(knots, [*knots[1:], end], strict=True):
        middle = 0.5 * (first + last)
        index, _ = signal.locate(np.array([middle]))
        coefficients = signal.coefficients[index[0]]

        def slope(t, x, coefficients=coefficients, first=first):
            return POLE * x + np.polyval(coefficients[::-1], t - first)

        state = solve_ivp(slope, (first, last), [state], rtol=1e-11, atol=1e-15).y[0, -1]
    found = PoleResponses(np.array([POLE]), signal).sample(Instants.on(signal, np.array([end]), 0.0))
    assert found.values[0, 0] == pytest.approx(state, rel=1e-7)  # the ODE solver's own error


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("hold", HOLDS)
def test_box_averages_are_exact(hold, irregular):
    signal = make_signal(hold, irregular)
    response = PoleResponses(np.array([POLE]), signal)
    centre, exposure = 0.2004, 5e-3
    edges = np.concatenate(
        [
            [centre - exposure / 2],
            signal.knots[np.abs(signal.knots - centre) < exposure / 2],
            [centre + exposure / 2],
        ]
    )
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total = 0.0
    for first, last in itertools.pairwise(edges):
        times = 0.5 * (first + last) + 0.5 * (last - first) * nodes
        total = total + 0.5 * (last - first) * np.sum(
            weights * response.sample(Instants.on(signal, times, 0.0)).values[0]
        )
    found = response.sample(Instants.on(signal, np.array([centre]), exposure)).values[0, 0]
    assert found == pytest.approx(total / exposure, rel=1e-10)


@pytest.mark.parametrize("exposure", [0.0, 5e-3])
@pytest.mark.parametrize("hold", HOLDS)
def test_derivatives_are_exact(hold, exposure):
    signal = make_signal(hold, irregular=True)
    times = np.linspace(0.05, 0.35, 50)

    def values(pole, shift):
        instants = Instants.on(signal, times + shift, exposure)
        return PoleResponses(np.array([pole]), signal).sample(instants)

    found = values(POLE, 0.0)
    step = 1e-4
    numeric = (values(POLE + step, 0.0).values - values(POLE - step, 0.0).values) / (2 * step)
    np.testing.assert_allclose(found.pole_slopes, numeric, rtol=1e-5, atol=1e-7 * np.max(np.abs(numeric)))
    step = 1e-8  # shorter than any distance between an instant and a knot
    numeric = (values(POLE, step).values - values(POLE, -step).values) / (2 * step)
    np.testing.assert_allclose(found.time_slopes, numeric, rtol=1e-5, atol=1e-5 * np.max(np.abs(numeric)))


@pytest.mark.parametrize("hold", HOLDS)
def test_the_response_is_smooth_where_instants_cross_a_knot(hold):
    signal = make_signal(hold, irregular=False)
    knot = float(signal.knots[200])
    times = knot + 1e-10 * np.arange(-40.0, 41.0)
    response = PoleResponses(np.array([POLE]), signal)
    sampled = response.sample(Instants.on(signal, times, 0.0))
    # The imaginary part is a mode's displacement: its slope has no jump, whatever the hold.
    steps = np.diff(sampled.values[0].imag)
    np.testing.assert_allclose(steps, 1e-10 * sampled.time_slopes[0].imag[1:], rtol=1e-2)


@pytest.mark.parametrize("n_poles", [2, 13])  # a filter for each, and steps of all together
def test_a_long_input_is_passed_through_the_poles_piece_by_piece(n_poles, monkeypatch):
    poles = POLE * np.linspace(0.5, 1.5, n_poles)
    signal = make_signal("cubic", irregular=False)
    instants = Instants.on(signal, np.linspace(0.01, 0.39, 57), 2e-3)
    whole = PoleResponses(poles, signal).sample(instants)
    monkeypatch.setattr(pole_response, "_BLOCKS_AT_ONCE", 7)
    parts = PoleResponses(poles, signal).sample(instants)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-12)
    np.testing.assert_allclose(parts.pole_slopes, whole.pole_slopes, rtol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 10, 99, 1000])
def test_a_recursion_whose_factor_changes_is_that_step_by_step(n):
    rng = np.random.default_rng(n)
    factors = rng.uniform(0.2, 1.0, n) * np.exp(1j * rng.uniform(-3.0, 3.0, n))
    drives = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    states = [0.7 - 0.2j]
    for factor, drive in zip(factors, drives, strict=True):
        states.append(factor * states[-1] + drive)
    found = pole_response.recursion(factors, drives, 0.7 - 0.2j)
    np.testing.assert_allclose(found, states, rtol=1e-12, atol=1e-13)
