from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError, Prior
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.responses.periodic_averaging import periodic_response
from beam_ident.transfer_function_estimation.frequency_domain import fit_frequency_transfer_function
from tests.beam_ident.periodic import LINE_PERIOD_S, LINES_HZ, PLANT, siso_record


@pytest.mark.parametrize(("hold", "step"), [("zoh", 1), ("zoh", 4), ("linear", 2), ("cubic", 1)])
def test_a_held_and_folded_response_gives_the_continuous_plant(hold, step):
    record = siso_record(noise=1e-8, hold=hold, step=step)
    found = fit_frequency_transfer_function(periodic_response(record, LINE_PERIOD_S, LINES_HZ).response, 2, 0)
    np.testing.assert_allclose(found.model.parameters[:3], PLANT.parameters[:3], rtol=1e-6)


@pytest.mark.slow
def test_intervals_cover():
    scores = []
    for seed in range(40):
        response = periodic_response(
            siso_record(noise=0.05, seed=seed, step=2), LINE_PERIOD_S, LINES_HZ
        ).response
        model = fit_frequency_transfer_function(response, 2, 0).model
        scores.append((model.parameters[:3] - PLANT.parameters[:3]) / model.standard_deviations[:3])
    scores = np.array(scores)
    assert 0.89 < np.mean(np.abs(scores) < 1.96) <= 1.0  # 120 scores: 95 +- 2 %
    assert 0.75 < np.sqrt(np.mean(scores**2)) < 1.25


def given(numerator, denominator, delay=0.0, noise=1e-4, seed=0):
    rng = np.random.default_rng(seed)
    omegas = np.geomspace(0.05, 100.0, 300)
    s = 1j * omegas
    clean = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-s * delay)
    error = noise * np.abs(clean) / np.sqrt(2) * (rng.standard_normal(300) + 1j * rng.standard_normal(300))
    return FrequencyRecord(omegas, clean + error, (noise * np.abs(clean)) ** 2)


def test_the_rao_garnier_plant_is_found_over_three_decades():
    numerator, denominator = [-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0]
    found = fit_frequency_transfer_function(given(numerator, denominator), 4, 1)
    truth = np.concatenate([denominator[1:], numerator])
    assert found.converged
    assert np.max(np.abs(found.model.parameters[:6] - truth) / found.model.standard_deviations[:6]) < 3.6
    assert found.misfit.is_noise


@pytest.mark.slow
def test_an_unknown_delay_is_found_and_a_known_one_is_kept():
    record = given([12.0], [1.0, 4.0, 4.0], delay=0.06, noise=1e-2)
    free = fit_frequency_transfer_function(record, 2, 0, Prior(0.0, np.inf)).model
    assert abs(free.delay - 0.06) < 3.3 * free.standard_deviations[-1]
    known = fit_frequency_transfer_function(record, 2, 0, 0.06).model
    assert known.delay == pytest.approx(0.06, abs=1e-15)
    assert known.standard_deviations[-1] == 0.0
    assert known.standard_deviations[0] <= free.standard_deviations[0]


def test_an_order_too_low_is_reported():
    record = given([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0])
    found = fit_frequency_transfer_function(record, 2, 1)
    assert not found.misfit.is_noise
    assert found.warnings


def test_what_cannot_be_fitted_is_refused():
    record = given([12.0], [1.0, 4.0, 4.0])
    with pytest.raises(EstimationError, match="expected 1 to 30 poles"):
        fit_frequency_transfer_function(record, 0, 0)
    with pytest.raises(EstimationError, match="no more zeros"):
        fit_frequency_transfer_function(record, 2, 3)
    short = dataclasses.replace(record, omegas=record.omegas[:3], response=record.response[:3], variance=None)
    with pytest.raises(EstimationError, match="Ask for fewer poles"):
        fit_frequency_transfer_function(short, 4, 1)
    with pytest.raises(EstimationError, match="takes one of each"):
        fit_frequency_transfer_function(FrequencyRecord(record.omegas, np.ones((300, 2))), 1, 0)


def test_a_delay_of_many_periods_is_found_from_a_start_near_it():
    record = given([12.0], [1.0, 4.0, 4.0], delay=2.0, noise=1e-3)  # 32 turns at the highest line
    found = fit_frequency_transfer_function(record, 2, 0, Prior(2.005, 0.01)).model
    assert abs(found.delay - 2.0) < 4.0 * found.standard_deviations[-1]
    assert found.parameters[:3] == pytest.approx([4.0, 4.0, 12.0], rel=1e-3)


@pytest.mark.parametrize(("n_modes", "seed", "is_known"), [(12, 2, True), (14, 1, True), (14, 1, False)])
def test_a_fit_of_high_order_reaches_the_optimum_from_poles_spread_over_the_band(n_modes, seed, is_known):
    # Structures for which the iteration of Sanathanan and Koerner leads to FIT 93 to 94 %.
    rng = np.random.default_rng([seed, 5])
    middles = np.geomspace(2.0, 40.0, n_modes)
    frequencies = middles * (middles[1] / middles[0]) ** rng.uniform(-0.3, 0.3, n_modes)
    own, zetas = 2.0 * np.pi * np.sort(frequencies), rng.uniform(0.003, 0.03, n_modes)
    gains = rng.choice([-1.0, 1.0], n_modes) * rng.uniform(0.3, 1.0, n_modes)
    omegas = 2.0 * np.pi * np.linspace(1.2, 52.0, 400)
    s = 1j * omegas[:, None]
    clean = np.sum(gains * own**2 * np.sqrt(zetas) / (s**2 + 2.0 * zetas * own * s + own**2), axis=1)
    sd = 0.01 * np.sqrt(np.mean(np.abs(clean) ** 2))
    error = sd * (rng.standard_normal((400, 2)) @ np.array([1.0, 1.0j])) / np.sqrt(2.0)
    record = FrequencyRecord(omegas, clean + error, np.full(400, sd**2) if is_known else None)
    found = fit_frequency_transfer_function(record, 2 * n_modes, 2 * n_modes)
    # Of 800 real values 4 n_modes + 1 parameters take some of the noise: what is left is below what there was.
    assert np.linalg.norm(found.residuals) < np.linalg.norm(error)
    assert found.converged
