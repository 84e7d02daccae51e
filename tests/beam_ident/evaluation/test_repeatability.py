"""Scatter over records against the stated standard deviations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError, ModalModel, TransferFunctionModel
from beam_ident.evaluation.repeatability import ParameterScatter, assess_repeatability

CORRELATED = np.array(
    [[1.0, 0.0, 0.6, 0.0], [0.0, 1.0, 0.0, -0.3], [0.6, 0.0, 1.0, 0.0], [0.0, -0.3, 0.0, 1.0]]
)
SD = np.array([0.01, 0.05, 2e-4, 1e-4])
TRUTH = np.array([27.6, 177.8, 0.005, 0.004])


def drawn(rng: np.random.Generator, factor: float = 1.0, modes: tuple[int, ...] = (0, 1)) -> ModalModel:
    """A model whose estimates scatter ``factor`` times as much as its covariance says."""
    covariance = CORRELATED * np.outer(SD, SD)
    estimate = rng.multivariate_normal(TRUTH, covariance * factor**2)
    n = len(modes)
    places = [*modes, *(2 + k for k in modes)]
    whole = np.zeros((3 * n + 4, 3 * n + 4))
    whole[: 2 * n, : 2 * n] = covariance[np.ix_(places, places)]
    return ModalModel(
        structure="base_motion",
        input_name="hub",
        output_names=("tip",),
        natural_frequencies=estimate[list(modes)],
        damping_ratios=estimate[[2 + k for k in modes]],
        residues=np.ones((1, n)),
        residual_terms=np.zeros(1),
        gains=np.ones(1),
        latency=0.0,
        clock_rate=0.0,
        covariance=whole,
        noise_sd=np.ones(1),
    )


@pytest.mark.slow
def test_the_statistic_is_chi_squared_where_the_covariances_are_right():
    rng = np.random.default_rng(1)
    studies = [assess_repeatability([drawn(rng) for _ in range(4)]) for _ in range(300)]
    assert all(study.degrees_of_freedom == 12 for study in studies)
    p = np.array([study.p_value for study in studies])
    # Uniform: mean 1/2 with sd 1/sqrt(12 * 300) = 0.017, and 1 % outside the verdict's tails.
    assert np.mean(p) == pytest.approx(0.5, abs=0.06)
    assert np.mean(p < 0.1) == pytest.approx(0.1, abs=0.06)
    assert np.mean([study.is_as_stated for study in studies]) > 0.96
    single = np.array([parameter.p_value for study in studies for parameter in study.parameters])
    assert np.mean(single) == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize(
    ("factor", "word"), [(1.0, "as stated"), (3.0, "more than stated"), (0.2, "less than")]
)
def test_the_verdict_says_which_way_it_is_off(factor, word):
    rng = np.random.default_rng(7)
    study = assess_repeatability([drawn(rng, factor) for _ in range(8)])
    assert study.verdict.startswith(word)
    assert study.ratio == pytest.approx(factor, rel=0.35)
    assert study.is_as_stated == (factor == 1.0)


def test_the_parameter_that_changed_is_named():
    rng = np.random.default_rng(2)
    models = [drawn(rng) for _ in range(5)]
    changed = dataclasses.replace(models[0], damping_ratios=models[0].damping_ratios + np.array([0.0, 0.002]))
    study = assess_repeatability([changed, *models[1:]])
    assert "zeta_2 most" in study.verdict
    assert [parameter.name for parameter in study.parameters] == ["omega_1", "omega_2", "zeta_1", "zeta_2"]


def test_a_difference_against_the_correlations_alone_is_told_as_such():
    rng = np.random.default_rng(8)
    one = drawn(rng)
    covariance = one.covariance.copy()
    covariance[0, 2] = covariance[2, 0] = 0.999 * SD[0] * SD[2]
    first, second = (
        dataclasses.replace(
            one,
            covariance=covariance,
            natural_frequencies=TRUTH[:2] + np.array([sign * 0.7 * SD[0], 0.0]),
            damping_ratios=TRUTH[2:] - np.array([sign * 0.7 * SD[2], 0.0]),
        )
        for sign in (1, -1)
    )
    assert "all together, none by itself" in assess_repeatability([first, second]).verdict


def test_modes_are_paired_by_frequency_and_the_others_counted():
    rng = np.random.default_rng(3)
    study = assess_repeatability([drawn(rng, modes=(1,)), drawn(rng), drawn(rng, modes=(1, 0))])
    assert [parameter.name for parameter in study.parameters] == ["omega_1", "zeta_1"]
    np.testing.assert_allclose(study.parameters[0].values, TRUTH[1], rtol=2e-3)
    np.testing.assert_allclose(study.parameters[1].values, TRUTH[3], atol=6e-4)  # six deviations
    assert study.n_unmatched == 2
    assert "2 modes are not in every model" in study.verdict


def test_the_mean_is_weighted_by_the_stated_variances():
    scatter = ParameterScatter.of("f", np.array([1.0, 4.0]), np.array([1.0, 2.0]))
    assert scatter.mean == pytest.approx(1.6)
    assert scatter.mean_sd == pytest.approx(np.sqrt(0.8))
    assert scatter.ratio == pytest.approx(np.sqrt(0.6**2 + 1.2**2))
    assert scatter.scatter == pytest.approx(3 / np.sqrt(2))


def transfer_function(values, sd, n_zeros=0):
    return TransferFunctionModel(
        numerator=values[2:],
        denominator=np.concatenate([[1.0], values[:2]]),
        delay=0.0,
        covariance=np.diag(np.append(sd, 0.0) ** 2),
        noise_sd=1.0,
    )


def test_coefficients_of_transfer_functions_are_compared_too():
    rng = np.random.default_rng(5)
    truth, sd = np.array([0.4, 4.0, 2.0]), np.array([0.01, 0.02, 0.05])
    study = assess_repeatability(
        [transfer_function(truth + sd * rng.standard_normal(3), sd) for _ in range(6)]
    )
    assert study.is_as_stated
    assert study.degrees_of_freedom == 15  # the delay was not estimated
    assert len(study.parameters) == 3


def test_what_cannot_be_compared_is_refused():
    rng = np.random.default_rng(6)
    one, two = drawn(rng), drawn(rng)
    rational = transfer_function(np.array([0.4, 4.0, 2.0]), np.ones(3))
    far = dataclasses.replace(two, natural_frequencies=two.natural_frequencies * 10)
    exact = dataclasses.replace(two, covariance=np.zeros_like(two.covariance))
    longer = transfer_function(np.array([0.4, 4.0, 2.0, 1.0]), np.ones(4))
    for models, says in (
        ([one], "1 given"),
        ([one, rational], "expected one kind"),
        ([one, far], "no mode in common"),
        ([one, exact], "omega_1 has no stated standard deviation"),
        ([rational, longer], "different orders"),
    ):
        with pytest.raises(EstimationError, match=says):
            assess_repeatability(models)
