from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal_analysis import circle_fit
from tests.beam_ident.modal_analysis.chain import DAMPING, FREQUENCIES_HZ, noisy_record, residues

OMEGA, ZETA = 300.0, 0.01


def single(differentiations, noise=0.0, rest=0.0, seed=0):
    omegas = np.linspace(280.0, 320.0, 161)
    s = 1j * omegas
    values = 2.0 / (s**2 + 2 * ZETA * OMEGA * s + OMEGA**2) + rest / s
    rng = np.random.default_rng(seed)
    error = noise * np.max(np.abs(values)) * (rng.standard_normal(161) + 1j * rng.standard_normal(161))
    return FrequencyRecord(omegas, (values + error) * s**differentiations)


@pytest.mark.parametrize(
    ("form", "differentiations"), [("receptance", 0), ("mobility", 1), ("accelerance", 2)]
)
def test_a_single_mode_runs_along_its_circle_exactly(form, differentiations):
    # A constant in the mobility, as far modes add it, moves the circle and nothing else.
    found = circle_fit(single(differentiations, rest=3e-4 - 2e-4j), OMEGA / 2 / np.pi, 5.0, form)
    assert found.natural_frequency == pytest.approx(OMEGA, rel=1e-9)
    assert found.damping_ratio == pytest.approx(ZETA, rel=1e-8)
    assert found.residue == pytest.approx(2.0 / (2j * OMEGA * np.sqrt(1 - ZETA**2)), rel=1e-8)
    assert found.roundness < 1e-9


def test_noise_leaves_damping_within_a_few_per_cent():
    found = circle_fit(single(0, noise=0.01), OMEGA / 2 / np.pi, 2.0)
    assert found.damping_ratio == pytest.approx(ZETA, rel=0.03)
    assert 0.005 < found.roundness < 0.05


def test_its_standard_deviations_are_those_of_many_repetitions():
    found = [circle_fit(single(0, noise=0.005, seed=seed), OMEGA / 2 / np.pi, 2.0) for seed in range(150)]
    for name in ("natural_frequency", "damping_ratio"):
        scatter = np.std([getattr(own, name) for own in found])
        assert np.mean([getattr(own, f"{name}_sd") for own in found]) == pytest.approx(scatter, rel=0.15), (
            name
        )


def test_a_mode_among_others_is_read_roughly():
    found = circle_fit(noisy_record(0, 0.0), FREQUENCIES_HZ[0], 4.0, output_name="y2")
    assert found.natural_frequency / (2 * np.pi) == pytest.approx(FREQUENCIES_HZ[0], rel=1e-3)
    assert found.damping_ratio == pytest.approx(DAMPING[0], rel=0.01)
    assert abs(found.residue / residues()[1, 0, 0] - 1.0) < 0.02


def test_a_band_without_resonance_is_refused():
    with pytest.raises(EstimationError, match="at least 5"):
        circle_fit(single(0), OMEGA / 2 / np.pi, 0.1)
    with pytest.raises(EstimationError, match="centre"):
        circle_fit(single(0), 285.0 / 2 / np.pi, 0.8)
