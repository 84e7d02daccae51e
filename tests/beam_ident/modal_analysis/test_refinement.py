from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal_analysis import analyse_modes, stabilisation_chart
from beam_ident.modal_analysis.refinement import _residue
from tests.beam_ident.modal_analysis.chain import (
    DAMPING,
    FREQUENCIES_HZ,
    LINES,
    OMEGAS,
    SHAPES,
    noisy_record,
    residues,
)


@pytest.mark.parametrize(
    ("form", "differentiations"), [("receptance", 0), ("mobility", 1), ("accelerance", 2)]
)
def test_without_noise_the_truth_comes_back_to_1e_9(form, differentiations):
    record = noisy_record(0, 0.0, (0, 2), differentiations, omegas=LINES[::4])
    found = analyse_modes(stabilisation_chart(record, form, max_order=20))
    np.testing.assert_allclose(found.frequencies_hz, FREQUENCIES_HZ, rtol=1e-9)
    np.testing.assert_allclose(found.damping_ratios, DAMPING, rtol=1e-9)
    truth = residues((0, 2))
    np.testing.assert_allclose(found.residues, truth, atol=1e-9 * np.max(np.abs(truth)))
    np.testing.assert_allclose(found.rank_one, 1.0, atol=1e-12)
    np.testing.assert_allclose(found.collinearity, 1.0, atol=1e-9)
    np.testing.assert_allclose(
        np.einsum("om,im->oim", found.shapes, found.participation), truth, atol=1e-9 * np.max(np.abs(truth))
    )


def test_with_one_per_cent_of_noise_damping_is_within_one_per_cent():
    found = analyse_modes(stabilisation_chart(noisy_record(3)))
    np.testing.assert_allclose(found.damping_ratios, DAMPING, rtol=0.01)
    np.testing.assert_allclose(found.frequencies_hz, FREQUENCIES_HZ, rtol=1e-3)
    assert found.misfit.is_noise
    assert not found.warnings
    assert np.all(np.diag(found.assurance) > 1 - 1e-12)
    measured = found.shapes / np.linalg.norm(found.shapes, axis=0)
    assert np.all(np.abs(np.sum(np.conj(measured) * SHAPES, axis=0)) > 0.9999)


@pytest.mark.slow
@pytest.mark.parametrize("is_relative", [True, False])
def test_sigmas_cover(is_relative):
    scores, spread = [], []
    for seed in range(12):
        record = noisy_record(seed, is_relative=is_relative, has_variance=is_relative, omegas=LINES[:1600:4])
        found = analyse_modes(stabilisation_chart(record, max_order=14), FREQUENCIES_HZ)
        scores.append((found.natural_frequencies - OMEGAS) / found.natural_frequency_sd)
        scores.append((found.damping_ratios - DAMPING) / found.damping_ratio_sd)
        spread.append(np.abs(found.residues - residues()) ** 2 / found.residue_sd**2)
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2  # 120 scores: 1 +- 0.065
    assert 0.7 < np.sqrt(np.mean(spread)) < 1.3


def test_complex_shapes_and_residual_terms_are_found():
    rng = np.random.default_rng(0)
    s = 1j * LINES[:1200:2]
    pole = -6.0 + 500j
    residue = rng.standard_normal((4, 2)) @ np.diag([1.0, 1j])
    upper, lower = rng.standard_normal((4, 2)) * 1e-4, rng.standard_normal((4, 2)) * 10.0
    values = (
        residue / (s - pole)[:, None, None]
        + np.conj(residue) / (s - np.conj(pole))[:, None, None]
        + upper
        + lower / (s**2)[:, None, None]
    )
    found = analyse_modes(
        stabilisation_chart(FrequencyRecord(LINES[:1200:2], values), max_order=10), [500.1 / 2 / np.pi]
    )
    np.testing.assert_allclose(found.poles, [pole], rtol=1e-9)
    np.testing.assert_allclose(found.residues[:, :, 0], residue, rtol=1e-7)
    np.testing.assert_allclose(found.upper_terms, upper, rtol=1e-5)
    np.testing.assert_allclose(found.lower_terms, lower, rtol=1e-5)
    assert found.rank_one[0] < 0.99  # independent columns are no single mode, and that is said


def test_a_mode_too_many_is_warned_of_and_one_that_is_not_there_refused():
    chart = stabilisation_chart(noisy_record(0, omegas=LINES[:1600:4]), max_order=14)
    with pytest.raises(EstimationError, match="no stable pole within 2 % of 80"):
        analyse_modes(chart, [80.0])
    few = analyse_modes(chart, FREQUENCIES_HZ[:3])
    assert "modes or distortion" in few.warnings[0]
    unknown = FrequencyRecord(chart.record.omegas, chart.record.response)
    blind = analyse_modes(stabilisation_chart(unknown, max_order=14), FREQUENCIES_HZ[:3])
    assert any("neighbouring lines are alike" in warning for warning in blind.warnings)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((300, 2, 1)) + 1j * rng.standard_normal((300, 2, 1))
    with pytest.raises(EstimationError, match="chose no mode"):
        analyse_modes(stabilisation_chart(FrequencyRecord(LINES[:300], noise), max_order=10))


def test_the_gradient_of_a_residue_is_exact():
    place = np.array([np.log(300.0), 0.2, 2.0, -1.5])

    def residue(x):
        return _residue(float(np.exp(x[0])), x[1], x[2], x[3])[0]

    gradient = _residue(300.0, *place[1:])[1]
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-6
        slope = (residue(place + step) - residue(place - step)) / 2e-6
        assert abs(gradient[k] - slope) < 1e-8 * np.max(np.abs(gradient))


@pytest.mark.slow
def test_a_pole_of_the_chart_that_says_nothing_is_left_out_and_named():
    chart = stabilisation_chart(noisy_record(4, 0.01, (0,)), max_order=30)
    kept = analyse_modes(chart)
    # Beyond the band and nearly aperiodic, as a high order makes them up.
    junk = dataclasses.replace(
        chart,
        natural_frequencies=np.append(chart.natural_frequencies, 2.0 * LINES[-1]),
        damping_ratios=np.append(chart.damping_ratios, 0.9),
    )
    found = analyse_modes(junk)
    np.testing.assert_allclose(found.natural_frequencies, kept.natural_frequencies, rtol=1e-6)
    assert any("a mode of the chart was left out" in said for said in found.warnings)


def test_an_analysis_of_noise_has_no_mode():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((len(LINES), 2)) @ np.array([1.0, 1j])
    chart = stabilisation_chart(FrequencyRecord(LINES, noise), max_order=5)
    made_up = dataclasses.replace(chart, natural_frequencies=OMEGAS[1:2], damping_ratios=np.array([0.05]))
    with pytest.raises(EstimationError, match="no mode can be trusted"):
        analyse_modes(made_up)
