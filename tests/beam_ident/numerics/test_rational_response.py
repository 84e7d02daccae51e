from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from beam_ident.numerics import rational_response
from beam_ident.numerics.chain_response import chain_exponential
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.rational_response import RationalResponse, full_roots, poles_keep_apart, upper_roots
from tests.beam_ident.truth import averaged_cosine

APART = np.array([-1.0 + 0j, -2.0, -0.2 + 5.0j])


def signal(hold: str, is_regular: bool) -> PiecewisePolynomial:
    rng = np.random.default_rng(0)
    knots = 0.1 * np.arange(50) if is_regular else np.sort(rng.uniform(0.0, 5.0, 50))
    return PiecewisePolynomial.from_samples(knots, rng.standard_normal(50), hold)


def response(upper: np.ndarray, drive: PiecewisePolynomial, exposure_s: float = 0.0) -> RationalResponse:
    times = np.sort(np.random.default_rng(1).uniform(0.2, 4.7, 30))
    instants = Instants.on(drive, times, exposure_s)
    return RationalResponse(upper, 2.0, drive, drive.antiderivative(), instants, squares=True)


def test_the_exponential_of_a_chain_is_that_of_its_matrix():
    poles = np.array([0.0, 0.0, -1.0 + 4.0j, -1.0 - 4.0j, -30.0, -30.0])
    links = np.array([1.0, 2.0, 2.0, 3.0, 1.0])
    steps = np.array([1e-4, 0.03, 1.0])
    matrix = np.diag(poles) + np.diag(links, -1)
    expected = np.array([expm(matrix * h) for h in steps])
    np.testing.assert_allclose(chain_exponential(poles, links, steps), expected, atol=1e-12)


@pytest.mark.parametrize("hold", ["zoh", "linear", "cubic"])
@pytest.mark.parametrize("is_regular", [True, False])
@pytest.mark.parametrize("exposure_s", [0.0, 0.05])
def test_fractions_and_chain_are_one_response(monkeypatch, hold, is_regular, exposure_s):
    drive = signal(hold, is_regular)
    fractions = response(APART, drive, exposure_s)
    monkeypatch.setattr(rational_response, "_SEPARATION", 2.0)  # no poles are that far apart
    chain = response(APART, drive, exposure_s)
    for power in range(6):  # above the degree too: the signal and its derivative then pass through
        expected = fractions.over(power)
        np.testing.assert_allclose(chain.over(power), expected, atol=1e-10 * np.max(np.abs(expected)))
    for power in range(10):
        expected = fractions.over_square(power)
        np.testing.assert_allclose(chain.over_square(power), expected, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("exposure_s", [0.0, 0.05])
def test_free_motions_agree_in_both_forms(monkeypatch, exposure_s):
    elapsed = np.linspace(0.03, 3.0, 40)
    fractions = RationalResponse.to_impulse(APART, 2.0, elapsed, exposure_s, squares=True)
    monkeypatch.setattr(rational_response, "_SEPARATION", 2.0)
    chain = RationalResponse.to_impulse(APART, 2.0, elapsed, exposure_s, squares=True)
    for power in range(4):
        np.testing.assert_allclose(chain.over(power), fractions.over(power), atol=1e-12)
    for power in range(8):
        np.testing.assert_allclose(chain.over_square(power), fractions.over_square(power), atol=1e-11)


@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-5, 1e-3])
def test_a_pole_of_fourth_order_is_exact_however_nearly_its_roots_meet(apart):
    roots = -1.0 + apart * np.array([-1.0, -0.3, 0.4, 1.0])
    times = np.linspace(0.0, 3.0, 40)
    drive = PiecewisePolynomial.from_samples(np.array([0.0, 4.0]), np.ones(2), "zoh")
    instants = Instants.on(drive, times, 0.0)
    found = RationalResponse(roots + 0j, 2.0, drive, drive.antiderivative(), instants, squares=True)
    x = 2.0 * times
    exact = 1.0 - np.exp(-x) * (1.0 + x + x**2 / 2.0 + x**3 / 6.0)
    np.testing.assert_allclose(found.over(0), exact, atol=1e-11 + 3.0 * apart)


def test_a_derivative_of_the_response_is_the_next_power():
    drive = signal("linear", True)
    step = 1e-5
    times = np.linspace(0.52, 4.01, 25)

    def at(t: np.ndarray) -> RationalResponse:
        return RationalResponse(
            APART, 2.0, drive, drive.antiderivative(), Instants.on(drive, t, 0.0), squares=False
        )

    slope = (at(times + step).over(2) - at(times - step).over(2)) / (2.0 * step)
    np.testing.assert_allclose(slope, 2.0 * at(times).over(3), atol=1e-7)


def test_roots_are_those_of_the_polynomial():
    np.testing.assert_allclose(upper_roots(np.array([1.0, 4.0, 4.0])), [-2.0, -2.0], atol=1e-7)
    np.testing.assert_allclose(upper_roots(np.array([1.0, 3.0, 2.0])), [-2.0, -1.0])
    np.testing.assert_allclose(upper_roots(np.array([1.0, -3.0, 0.0])), [0.0, 3.0])
    polynomial = np.real(np.poly([-1.0, -3.0 + 4.0j, -3.0 - 4.0j, -0.1 + 9.0j, -0.1 - 9.0j]))
    upper = upper_roots(polynomial)
    np.testing.assert_allclose(upper, [-1.0, -3.0 + 4.0j, -0.1 + 9.0j])
    np.testing.assert_allclose(np.poly(full_roots(upper)), polynomial, atol=1e-9)
    assert poles_keep_apart(full_roots(upper))
    assert not poles_keep_apart(np.array([-2.0, -2.0 - 1e-8 + 0j]))


@pytest.mark.parametrize("separation", [None, 2.0], ids=["fractions", "chain"])
@pytest.mark.parametrize("exposure_s", [1e-5, 0.05])
def test_free_motions_are_means_of_the_textbook_over_the_exposure(monkeypatch, separation, exposure_s):
    if separation is not None:
        monkeypatch.setattr(rational_response, "_SEPARATION", separation)
    elapsed = np.linspace(0.03, 3.0, 40)
    found = RationalResponse.to_impulse(np.array([-0.2 + 5.0j]), 2.0, elapsed, exposure_s, squares=True)
    # 1/A is e^(-a t) sin(w t)/w, 1/A^2 is e^(-a t) (sin(w t) - w t cos(w t))/(2 w^3), t in units of 1/scale.
    averaged = averaged_cosine(elapsed, -0.4 + 10.0j, -0.2j, exposure_s)
    np.testing.assert_allclose(found.over(0), averaged, atol=1e-9)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    t = 2.0 * (elapsed[:, None] + 0.5 * exposure_s * nodes)
    square = np.exp(-0.2 * t) * (np.sin(5.0 * t) - 5.0 * t * np.cos(5.0 * t)) / 250.0
    np.testing.assert_allclose(found.over_square(0), 0.5 * square @ weights, atol=1e-9)
