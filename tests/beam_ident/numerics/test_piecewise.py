from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from beam_ident.numerics import piecewise
from beam_ident.numerics.piecewise import BAND_LIMITED_DEGREE, PiecewisePolynomial, regular_period
from beam_ident.responses.periods import hold_gain

PERIOD_S = 1e-3


def tone(share: float, hold: str, jitter: float = 0.0) -> tuple[PiecewisePolynomial, float]:
    """Return a sine at a share of the sampling rate, sampled and held, and its angular frequency."""
    times = PERIOD_S * np.arange(400)
    times[1:-1] += PERIOD_S * np.random.default_rng(0).uniform(-jitter, jitter, 398)
    omega = 2.0 * np.pi * share / PERIOD_S
    return PiecewisePolynomial.from_samples(times, np.sin(omega * times + 0.3), hold), omega


@pytest.mark.parametrize("share", [0.1, 0.25, 0.333])
@pytest.mark.parametrize(("hold", "degree"), [("cubic", 3), ("band_limited", BAND_LIMITED_DEGREE)])
def test_splines_miss_a_tone_by_no_more_than_is_stated(hold, degree, share):
    signal, omega = tone(share, hold)
    inside = np.linspace(0.1, 0.3, 3001)
    truth = np.sin(omega * inside + 0.3)
    ratio = share / (1.0 - share)
    assert np.max(np.abs(signal(inside) - truth)) < 3.0 * ratio ** (degree + 1)
    assert np.max(np.abs(signal(inside, 2) / omega**2 + truth)) < 3.0 * ratio ** (degree - 1)


def test_a_band_limited_hold_is_a_polynomial_that_passes_smoothly_through_every_sample():
    signal, omega = tone(0.2, "band_limited", jitter=0.1)
    assert signal.degree == BAND_LIMITED_DEGREE
    assert signal.period is None
    before = signal.evaluate(np.arange(100, 300), np.diff(signal.knots)[100:300], 3)
    after = signal.evaluate(np.arange(101, 301), np.zeros(200), 3)
    np.testing.assert_allclose(before, after, atol=1e-6 * omega**3)
    np.testing.assert_allclose(signal(signal.knots), np.sin(omega * signal.knots + 0.3), atol=1e-12)


def test_few_samples_are_joined_by_a_cubic():
    times = np.arange(6.0)
    few = PiecewisePolynomial.from_samples(times, times**2, "band_limited")
    np.testing.assert_allclose(few(np.array([2.5])), 6.25)


@pytest.mark.parametrize("hold", ["cubic", "band_limited"])
def test_the_fourier_gain_of_a_spline_is_that_of_the_signal(hold):
    n = 64
    for line in (5, 20, 5 + n, n - 20):
        times = np.arange(40 * n + 1.0)
        omega = 2.0 * np.pi * (line % n) / n
        signal = PiecewisePolynomial.from_samples(times, np.cos(omega * times), hold)
        fine = 20.0 * n + np.arange(16 * n) / 16.0
        found = 2.0 * np.mean(signal(fine) * np.exp(-2j * np.pi * line / n * fine))
        assert found == pytest.approx(hold_gain(hold, 2.0 * np.pi * line / n, 1.0), abs=1e-5)


def test_the_derivative_of_held_values_is_zero_inside_the_steps():
    held = PiecewisePolynomial.from_samples(np.array([0.0, 1.0, 3.0]), np.array([2.0, -1.0, 4.0]), "zoh")
    times = np.array([0.5, 1.5, 2.5])
    np.testing.assert_array_equal(held.derivative()(times), 0.0)
    np.testing.assert_array_equal(held.derivative().antiderivative()(times), 0.0)


@pytest.mark.parametrize("period", [1e-7, 1e-3, 10.0])
def test_stamps_are_regular_within_a_nanosecond_and_a_thousandth_of_the_period(period):
    times = period * np.arange(100)
    assert regular_period(times) == pytest.approx(period, rel=1e-12)
    allowed = min(1e-9, 1e-3 * period)
    for share, is_regular in ((0.9, True), (1.1, False)):
        moved = times.copy()
        moved[50] += share * allowed
        assert (regular_period(moved) is not None) is is_regular


@pytest.mark.parametrize("n", [16, 17, 300])
def test_the_spline_of_a_regular_grid_is_the_one_without_a_knot_at_the_second_sample(n, monkeypatch):
    monkeypatch.setattr(piecewise, "_AT_ONCE", 7)
    times = 3.0 + PERIOD_S * np.arange(n)
    values = 5.0 + np.random.default_rng(n).standard_normal(n)
    found = PiecewisePolynomial.from_samples(times, values, "cubic")
    assert found.period == pytest.approx(PERIOD_S)
    expected = CubicSpline(times, values, bc_type="not-a-knot")
    inside = np.linspace(times[0] + 1e-6, times[-1] - 1e-6, 2000)
    for derivative in range(4):
        truth = expected(inside, derivative)
        # Rounding of the stamps, which scipy takes one by one.
        np.testing.assert_allclose(found(inside, derivative), truth, atol=1e-9 * np.max(np.abs(truth)))


@pytest.mark.parametrize(("lead", "before"), [("constant", 2.0), ("zero", 0.0)])
def test_the_spline_of_a_regular_grid_is_continued_on_both_sides(lead, before):
    values = 2.0 + np.sin(0.3 * np.arange(50))
    signal = PiecewisePolynomial.from_samples(PERIOD_S * np.arange(50), values, "cubic", 0.01, lead)
    np.testing.assert_allclose(signal(np.array([-0.0095, -1e-6])), before)
    np.testing.assert_allclose(signal(np.array([0.0491, 0.0585])), values[-1])
    np.testing.assert_allclose(signal(PERIOD_S * np.arange(1, 50)), values[1:], atol=1e-12)


def test_seconds_since_1970_are_regular_as_far_as_their_rounding_goes():
    stamps = 1.7e9 + 2e-3 * np.arange(5000)
    assert regular_period(stamps) == pytest.approx(2e-3, rel=1e-6)
    jitter = 2e-6 * np.random.default_rng(0).standard_normal(5000)
    assert regular_period(stamps + jitter) is None
