from __future__ import annotations

import numpy as np
import pytest

from beam_ident.amplitude.decay_fit import DecayProblem, Law
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
    sd = np.sqrt(np.diag(fit.covariance))[2:]
    assert np.all(np.abs(fit.point.rate_terms - expected) < 4.0 * sd + 0.02 * np.abs(expected))
    assert fit.point.omega_terms[1] == pytest.approx(0.01 * OMEGA * (unit / UNIT) ** 2, rel=0.01)


def test_stated_deviations_are_the_scatter() -> None:
    weak = Oscillator(hardening=1e-3, quadratic=1e-3)
    estimates, stated = [], []
    for seed in range(12):
        problem = DecayProblem([[noisy(weak, 2e-4, seed, 8.0)]], 0)
        fit = problem.fit(problem.start(4.4))
        estimates.append(np.concatenate([fit.point.omega_terms, fit.point.rate_terms]))
        stated.append(np.sqrt(np.diag(fit.covariance)))
    ratio = np.std(estimates, axis=0, ddof=1) / np.mean(stated, axis=0)
    # Twelve draws: their scatter is known to a fifth; units differ by the windows' largest amplitude.
    assert np.all((ratio > 0.45) & (ratio < 1.7))


def test_one_pole_has_two_coefficients_and_costs_more_where_it_is_wrong() -> None:
    problem = DecayProblem([[noisy(STRONG, 2e-5, 1)]], 0)
    fit = problem.fit(problem.start(None))
    alone = problem.fit(fit.point.of_one_pole())
    assert alone.covariance.shape == (2, 2)
    assert alone.point.rate_terms[0] == 0.0
    assert alone.cost > fit.cost + 1000.0
