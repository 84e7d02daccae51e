"""Curves of models of every kind against the polynomials that the models are."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident.figures.response_curves import drawing_lines, response_curves
from beam_ident.summary import models_of
from tests.beam_ident.result_cases import result

OMEGAS = np.array([5.0, 19.9, 60.0])


@pytest.mark.parametrize(
    "name", ["identify", "estimate_transfer_function", "several inputs", "subspace_model"]
)
def test_every_kind_of_model_follows_the_plant(name):
    s = 1j * OMEGAS
    plant = 400.0 / (s**2 + 4.0 * s + 400.0)
    curves = [curve for model in models_of(result(name)) for curve in response_curves(model, OMEGAS, "A")]
    for curve in curves:
        gain = -0.5 if curve.output_name == "z" else 1.0
        assert np.allclose(curve.response, gain * plant, atol=0.03)
        assert curve.label == "A"
    assert curves


def test_what_states_no_uncertainty_has_no_bands_and_what_is_no_model_no_curve():
    assert np.all(np.isnan(response_curves(models_of(result("subspace_model"))[0], OMEGAS)[0].magnitude_sd))
    assert response_curves(object(), OMEGAS) == ()


def test_lines_lie_close_about_a_resonance_so_that_its_peak_is_drawn():
    model = models_of(result("identify"))[0]
    omega, zeta = float(model.natural_frequencies[0]), float(model.damping_ratios[0])
    lines = drawing_lines((model,), 1.0, 100.0, 50)
    near = lines[np.abs(lines - omega) < zeta * omega]
    assert len(near) > 10
    assert (lines[0], lines[-1]) == pytest.approx((1.0, 100.0))
