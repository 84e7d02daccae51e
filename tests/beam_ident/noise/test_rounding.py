"""The likelihood of rounded values: against numerical derivatives, and against what least squares makes of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.special import ndtr

from beam_ident import TimeRecord, estimate_common_poles, estimate_transfer_function, identify
from beam_ident.noise.rounding import RoundedNoise, quantum
from benchmarks.ident.noise_as_it_is import FewBits
from tests.beam_ident.truth import beam_record

STEP, SIGMA = 0.3, 0.05


@pytest.mark.parametrize("step", [1e-7, 0.3])
def test_the_step_of_rounded_values_is_found(step):
    values = np.random.default_rng(0).standard_normal(3000) * 12.0 * step
    assert quantum(0.1 + step * np.round(values / step)) == pytest.approx(step, rel=1e-6)
    assert quantum(values) == 0.0


@pytest.mark.parametrize("values", [np.zeros(50), np.array([0.0, 1.0]), np.full(20, np.nan)])
def test_what_shows_no_step_has_none(values):
    assert quantum(values) == 0.0


def test_slope_and_information_are_those_of_the_probability_of_the_interval():
    # Residuals of one model at place m: every level, the next ones included, with its probability.
    m, levels = 0.11, STEP * np.arange(-3, 4)
    noise = RoundedNoise(STEP, SIGMA, levels - m, is_cautious=False)

    def chances(at: float) -> np.ndarray:
        return ndtr((levels + 0.5 * STEP - at) / SIGMA) - ndtr((levels - 0.5 * STEP - at) / SIGMA)

    h = 1e-6
    slopes = (chances(m + h) - chances(m - h)) / (2.0 * h)
    information = np.sum(slopes**2 / np.maximum(chances(m), 1e-300))
    np.testing.assert_allclose(noise.weights, information * SIGMA**2, rtol=1e-6)
    moved = noise.residuals + noise.shift  # s/w
    seen = chances(m) > 1e-9
    np.testing.assert_allclose(moved[seen], slopes[seen] / chances(m)[seen] / information, rtol=1e-6)
    expected = -np.log(chances(m)[seen] / STEP)
    n = int(np.count_nonzero(seen))
    own = RoundedNoise(STEP, SIGMA, (levels - m)[seen])
    gaussian = 0.5 * n * (1.0 + np.log(2.0 * np.pi) - np.log(n))
    assert own.cost == pytest.approx(np.sum(expected) - gaussian, rel=1e-9)


def test_the_noise_before_the_rounding_is_found():
    rng = np.random.default_rng(1)
    clean = 2.0 * np.sin(0.01 * np.arange(4000))
    values = STEP * np.round((clean + SIGMA * rng.standard_normal(4000)) / STEP)
    found = RoundedNoise.of(values, values - clean)
    assert found is not None
    assert found.sigma == pytest.approx(SIGMA, rel=0.1)
    fine = 0.05 * np.round((clean + SIGMA * rng.standard_normal(4000)) / 0.05)
    assert RoundedNoise.of(fine, fine - clean) is None  # a step of noise is dither enough


@pytest.mark.slow
def test_three_bits_are_estimated_at_their_bound():
    case = FewBits(3)
    errors: list[list[np.ndarray]] = [[], []]
    for seed in range(12):
        for kind, method in enumerate(("white", "auto")):
            found = estimate_transfer_function(case.record(seed), 4, 1, method=method, n_starts=1)
            errors[kind].append((found.model.parameters[:6] - case.truth) / case.bound)
        assert found.converged
        np.testing.assert_allclose(found.model.standard_deviations[:6], case.bound, rtol=0.15)
    plain, own = np.mean(np.square(errors), axis=(1, 2))
    # 72 errors of correlated parameters: a mean square of 1 +- 0.3; least squares has 1.5 bounds of bias alone.
    assert own < 1.8
    assert plain > 2.0 * own
    joint = estimate_common_poles(case.record(0), 4, 1)
    single = estimate_transfer_function(case.record(0), 4, 1).model
    np.testing.assert_allclose(joint.models[0].parameters[:6] / single.parameters[:6], 1.0, atol=0.01)


@pytest.mark.slow
def test_modes_of_a_coarsely_rounded_film_are_better_known():
    record, step = beam_record(1, encoder=0.0), 6.0 * 4e-6
    outputs = [dataclasses.replace(o, values=step * np.round(o.values / step)) for o in record.outputs]
    found = identify(TimeRecord(record.inputs, tuple(outputs)), n_modes=3)
    assert all("rounding" in own.noise for output in found.outputs for own in output.records)
    clean = identify(record, n_modes=3).model
    moved = np.abs(found.model.natural_frequencies - clean.natural_frequencies)
    assert np.all(moved < 3.3 * found.model.natural_frequency_sd)
    # The variance of the steps, 36/12 times that of the noise, would double all deviations. The third mode is seen
    # where nothing else moves: there few samples come near an edge.
    assert np.all(found.model.natural_frequency_sd[:2] < 1.9 * clean.natural_frequency_sd[:2])
