"""What every result has, by the same name and with the same meaning."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, OutputSignal, Scores, TimeRecord, Whiteness, subspace_model
from tests.beam_ident import result_cases


@pytest.mark.parametrize("name", result_cases.ALL)
def test_every_result_says_how_it_ended(name):
    found = result_cases.result(name)
    assert found.converged is True
    assert isinstance(found.reason, str)
    assert isinstance(found.iterations, int)
    assert isinstance(found.warnings, tuple)


@pytest.mark.parametrize("name", result_cases.OVER_ONE_OUTPUT)
def test_measured_is_modelled_and_residuals(name):
    found = result_cases.result(name)
    assert found.times_s.shape == found.measured.shape
    np.testing.assert_allclose(found.measured - found.modelled, found.residuals, rtol=0.0, atol=1e-12)
    assert found.scores == Scores.of(found.measured, found.residuals)
    assert isinstance(found.whiteness, Whiteness)
    assert found.scores.fit_percent > 90.0


@pytest.mark.parametrize("name", result_cases.OVER_SEVERAL_OUTPUTS)
def test_measured_is_modelled_and_residuals_of_every_output(name):
    found = result_cases.result(name)
    rows = zip(
        found.times_s,
        found.measured,
        found.modelled,
        found.residuals,
        found.scores,
        found.whiteness,
        strict=True,
    )
    count = 0
    for times, measured, modelled, residuals, scores, whiteness in rows:
        assert times.shape == measured.shape
        np.testing.assert_allclose(measured - modelled, residuals, rtol=0.0, atol=1e-12)
        assert scores.fit_percent == pytest.approx(Scores.of(measured, residuals).fit_percent)
        assert isinstance(whiteness, Whiteness)
        count += 1
    assert count == (1 if name == "fit_free_decay" else 2)


@pytest.mark.parametrize("name", ["identify", "estimate_common_poles"])
def test_records_say_what_belongs_to_each_of_them_for_every_output(name):
    found = result_cases.result(name)
    assert len(found.records) == len(found.measured)
    for parts, measured in zip(found.records, found.measured, strict=True):
        np.testing.assert_array_equal(np.concatenate([own.measured for own in parts]), measured)


@pytest.mark.parametrize("name", result_cases.OVER_LINES)
def test_the_response_is_modelled_and_residuals(name):
    found = result_cases.result(name)
    own = found.records[0] if name == "fit_frequency_modes" else found.record
    modelled, residuals = found.modelled, found.residuals
    if name == "fit_frequency_modes":
        modelled, residuals = modelled[0], residuals[0]
    np.testing.assert_allclose((modelled + residuals).ravel(), own.response.ravel(), rtol=1e-12)
    assert found.misfit.chi_squared == pytest.approx(
        np.sum(np.abs(residuals) ** 2 / (0.5 * own.variance.reshape(residuals.shape))), rel=1e-6
    )


def test_a_subspace_of_noise_is_said_to_be_one():
    rng = np.random.default_rng(5)
    drive = InputSignal("u", "", (0.0, 0.01), rng.standard_normal(1000), "zoh")
    noise = OutputSignal("y", "", 0.01 * np.arange(1, 1000), rng.standard_normal(999))
    assert "no more than chance" in subspace_model(TimeRecord((drive,), (noise,)), 4).warnings[0]
    assert result_cases.result("subspace_model").warnings == ()
