from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError, Prior
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.frequency_domain import fit_frequency_modes
from beam_ident.responses.periodic_averaging import periodic_response
from tests.beam_ident import result_cases
from tests.beam_ident.periodic import (
    LINE_PERIOD_S,
    LINES_HZ,
    NAMES,
    OMEGAS,
    RESIDUAL_TERMS,
    RESIDUES,
    ZETAS,
    modal_plant,
    modal_record,
)

TRUTH = np.concatenate([OMEGAS, ZETAS, RESIDUES.ravel(), RESIDUAL_TERMS])


def flat(model):
    parts = (model.natural_frequencies, model.damping_ratios, model.residues.ravel(), model.residual_terms)
    sds = (
        model.natural_frequency_sd,
        model.damping_ratio_sd,
        model.residue_sd.ravel(),
        model.residual_term_sd,
    )
    return np.concatenate(parts), np.concatenate(sds)


def fitted(record, structure="base_motion", **keywords):
    return fit_frequency_modes(
        periodic_response(record, LINE_PERIOD_S, LINES_HZ).response, structure, **keywords
    )


@pytest.mark.parametrize(
    ("structure", "hold"),
    [
        ("base_motion", "cubic"),
        ("velocity", "linear"),
        ("acceleration", "zoh"),
        ("force", "zoh"),
        ("receptance", "zoh"),
    ],
)
def test_every_structure_is_recovered_exactly_without_hints(structure, hold):
    found = fitted(modal_record(structure, noise=1e-14, hold=hold), structure).model
    estimate, _ = flat(found)
    assert found.n_modes == 2
    # What is left is the transient after 20 s, e^-16 of the slow mode's response.
    np.testing.assert_allclose(estimate[:8], TRUTH[:8], rtol=2e-6)
    np.testing.assert_allclose(estimate[8:], TRUTH[8:], rtol=1e-2 if structure == "base_motion" else 1e-3)


def test_modes_above_half_the_frame_rate_are_found_where_they_are():
    found = fitted(modal_record(noise=1e-6, step=50))  # 20 frames a second: 28.3 Hz folds to 8.3 Hz
    estimate, sd = flat(found.model)
    assert np.max(np.abs(estimate - TRUTH) / sd) < 3.9  # ten numbers, 1 in 1000
    np.testing.assert_allclose(found.model.frequencies_hz, [4.4, 28.3], rtol=1e-3)


@pytest.mark.slow
def test_intervals_cover_and_the_misfit_is_that_of_noise():
    scores, misfits = [], []
    for seed in range(16):
        found = fitted(modal_record(seed=seed), n_modes=2)
        estimate, sd = flat(found.model)
        scores.append((estimate - TRUTH) / sd)
        misfits.append((found.misfit.chi_squared - found.misfit.expected) / found.misfit.sd)
    # 16 x 10 scores: 95 +- 2.5 % of correlated ones inside 1.96.
    assert 0.88 < np.mean(np.abs(scores) < 1.96) <= 1.0
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2
    assert abs(np.mean(misfits)) < 0.8
    assert np.max(np.abs(misfits)) < 4.0


def test_a_latency_is_estimated_when_it_is_free():
    found = fitted(modal_record(latency=0.002), latency=Prior(0.0, np.inf)).model
    assert abs(found.latency - 0.002) < 3.3 * found.latency_sd
    assert found.latency_sd < 1e-4
    assert np.max(np.abs(flat(found)[0] - TRUTH) / flat(found)[1]) < 3.9


def test_a_mode_left_out_is_reported():
    found = fitted(modal_record(), n_modes=1)
    assert not found.misfit.is_noise
    assert "modes or distortion" in found.warnings[0]


def given_record(noise=None, names=NAMES):
    rng = np.random.default_rng(0)
    omegas = 2 * np.pi * np.linspace(1.0, 40.0, 400)
    response = modal_plant("receptance").frequency_response(omegas).response
    sd = 1e-6 if noise is None else noise
    error = sd / np.sqrt(2) * (rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape))
    return FrequencyRecord(omegas, response + error, None, names, ("u",))


def test_a_response_from_elsewhere_needs_no_variances():
    found = fit_frequency_modes(given_record(), "receptance")
    estimate, sd = flat(found.model)
    assert np.max(np.abs(estimate - TRUTH) / sd) < 3.9
    np.testing.assert_allclose(found.model.noise_sd, 1e-6, rtol=0.1)
    assert np.isnan(found.misfit.chi_squared)
    assert [entry.n_modes for entry in found.orders if entry.is_chosen] == [2]


def test_several_experiments_share_one_model():
    records = [periodic_response(modal_record(seed=s), LINE_PERIOD_S, LINES_HZ).response for s in (1, 2)]
    one, both = fit_frequency_modes(records[0]), fit_frequency_modes(records)
    ratio = both.model.natural_frequency_sd / one.model.natural_frequency_sd
    np.testing.assert_allclose(ratio, np.sqrt(0.5), rtol=0.1)


def test_what_cannot_be_fitted_is_refused():
    record = given_record()
    with pytest.raises(EstimationError, match="different outputs"):
        fit_frequency_modes([record, given_record(names=("a", "b"))], "receptance")
    with pytest.raises(EstimationError, match="n_modes is 0"):
        fit_frequency_modes(record, "receptance", n_modes=0)
    with pytest.raises(EstimationError, match="Ask for fewer modes"):
        fit_frequency_modes(record.between(1.0, 1.5), "receptance", n_modes=4)
    for factor, message in (
        (0.0, "zero at every line"),
        (np.nan, "missing at every line"),
        (1e200, "other units"),
    ):
        with pytest.raises(EstimationError, match=message):
            fit_frequency_modes(FrequencyRecord(record.omegas, factor * record.response), "receptance")
    wide = FrequencyRecord(record.omegas, np.ones((400, 1, 2)))
    with pytest.raises(EstimationError, match="a modal model has one"):
        fit_frequency_modes(wide, "receptance")
    noise = FrequencyRecord(record.omegas, record.response - given_record(noise=0.0).response)
    with pytest.raises(EstimationError, match="no mode between 1 and 40 Hz stands out"):
        fit_frequency_modes(noise, "receptance")
    held = periodic_response(modal_record("receptance", hold="zoh"), LINE_PERIOD_S, LINES_HZ).response
    with pytest.raises(EstimationError, match="comes from a held input"):
        fit_frequency_modes(held, ModalStructure("base_motion"))


def test_a_mode_below_half_the_rate_is_not_taken_for_its_image():
    # The held input's images share the bins: 96.8 Hz, 100 Hz less 3.2 Hz, bends these lines almost alike.
    found = fit_frequency_modes(result_cases.lines(), "receptance")
    assert found.model.n_modes == 1
    assert found.model.frequencies_hz[0] == pytest.approx(20.0 / (2.0 * np.pi), rel=1e-3)
    assert found.misfit.is_noise


def test_the_noise_is_what_the_record_says_or_what_the_fit_leaves():
    response = periodic_response(modal_record(noise=2e-6), LINE_PERIOD_S, LINES_HZ).response
    told = fit_frequency_modes(response, n_modes=2).model
    np.testing.assert_allclose(told.noise_sd, np.sqrt(np.mean(response.variance[:, :, 0], axis=0)), rtol=1e-9)
    silent = fit_frequency_modes(dataclasses.replace(response, variance=None), n_modes=2).model
    # Lines of one weight: the root mean square of both parts of the complex residuals, 2 x 100 numbers to 7 %.
    np.testing.assert_allclose(silent.noise_sd, told.noise_sd, rtol=0.5)
