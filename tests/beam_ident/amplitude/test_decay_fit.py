from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import OutputSignal
from beam_ident.amplitude.decay_fit import LINEAR, DecayProblem, Law, _packed, _unpacked
from tests.beam_ident.amplitude.oscillators import OMEGA, UNIT, Oscillator, noisy

STRONG = Oscillator(hardening=0.01, quadratic=0.003)


def test_a_start_stands_near_the_law() -> None:
    """Fifteen seconds of hardening by 1 % is many turns from any single frequency: the windows must follow it."""
    start = DecayProblem([[noisy(STRONG, 1e-6, 1)]], 0).start(None)
    scale = (start.reference / UNIT) ** 2
    assert start.law == Law(2, 3)
    assert start.omega_terms[0] == pytest.approx(OMEGA, rel=2e-4)
    assert start.omega_terms[1] == pytest.approx(0.01 * OMEGA * scale, rel=0.05)
    assert start.amplitudes[0] * start.reference == pytest.approx(UNIT, rel=0.02)


def test_the_law_is_found_and_its_noise() -> None:
    problem = DecayProblem([[noisy(STRONG, 2e-5, 1)]], 0)
    fit = problem.fit(problem.start(None))
    unit = fit.point.reference
    assert fit.converged
    assert fit.noise_sd[0] == pytest.approx(2e-5, rel=0.06)
    expected = [0.0, 0.004 * OMEGA, 0.003 * OMEGA * unit / UNIT]
    sd = np.sqrt(np.diag(fit.covariance))[2:5]
    assert np.all(np.abs(fit.point.rate_terms - expected) < 4.0 * sd + 0.02 * np.abs(expected))
    assert fit.point.omega_terms[1] == pytest.approx(0.01 * OMEGA * (unit / UNIT) ** 2, rel=0.01)


@pytest.mark.slow
def test_stated_deviations_are_the_scatter() -> None:
    weak = Oscillator(hardening=1e-3, quadratic=1e-3)
    estimates, stated = [], []
    for seed in range(12):
        problem = DecayProblem([[noisy(weak, 2e-4, seed, 8.0)]], 0)
        fit = problem.fit(problem.start(4.4))
        estimates.append(np.concatenate([fit.point.omega_terms, fit.point.rate_terms]))
        stated.append(np.sqrt(np.diag(fit.covariance))[:-1])
    ratio = np.std(estimates, axis=0, ddof=1) / np.mean(stated, axis=0)
    # Twelve draws: their scatter is known to a fifth; units differ by the windows' largest amplitude.
    assert np.all((ratio > 0.45) & (ratio < 1.7))


@pytest.mark.slow
def test_one_pole_has_two_coefficients_and_costs_more_where_it_is_wrong() -> None:
    problem = DecayProblem([[noisy(STRONG, 2e-5, 1)]], 0)
    fit = problem.fit(problem.start(None))
    alone = problem.fit(problem.start(None, LINEAR))
    assert alone.covariance.shape == (3, 3)  # with the third harmonic's
    assert alone.point.rate_terms[0] == 0.0
    assert alone.cost > fit.cost + 1000.0


@pytest.mark.slow
def test_the_third_harmonic_is_found_with_the_law() -> None:
    """A cubic spring's is w_2 A^2/(12 w_0); an exposure of an eighth of the period takes a fifth of it."""
    t, x = Oscillator(hardening=0.01).swing(15.0, 4000.0)
    exposed = np.convolve(x, np.ones(114) / 114.0, mode="same")[200:-200:40]
    signal = OutputSignal("z285", "m", t[200:-200:40], exposed, exposure_s=114 / 4000.0)
    for seen in (noisy(Oscillator(hardening=0.01), 1e-6, 1), signal):
        problem = DecayProblem([[seen]], 0)
        fit = problem.fit(problem.start(None))
        own = fit.point.omega_terms
        # To first order: eta is 0.01.
        assert fit.point.third == pytest.approx(own[1] / own[0] / 12.0, rel=0.03)


@pytest.mark.slow
def test_derivatives_are_those_of_the_residuals() -> None:
    signal = noisy(STRONG, 2e-5, 1)
    other = OutputSignal("z225", "m", signal.times_s, 0.5 * signal.values[::-1])
    problem = DecayProblem([[signal, other]], 0)
    start = problem.start(None).extended(Law(3, 4))
    point = replace(start, third=2e-3, others=np.array([[170.0, 0.01]]))
    theta, ones, step = _packed(point), np.ones(2), 1e-6
    J = problem._jacobian(point, ones)
    n = len(signal.values)
    for k in range(point.law.n_terms + 1):
        ahead, behind = (
            problem._whitened(_unpacked(theta + sign * step * np.eye(len(theta))[k], point), ones)[0]
            for sign in (1.0, -1.0)
        )
        found = (ahead - behind) / (2.0 * step)
        # Where the residuals are small, the projection may be held.
        assert J[:n, k] == pytest.approx(found, abs=0.02 * np.abs(found).max()), k
