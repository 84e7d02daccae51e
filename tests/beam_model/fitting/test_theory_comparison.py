from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, PointMass
from beam_model.fitting.theory_comparison import UncertaintyBudget, compare_with_theory
from tests.beam_model.rigs import strip

RIG = strip(gravity="upright", tip_mass=1e-3, point_masses=(PointMass(0.225, 2e-4),))


def test_the_budget_has_the_known_sensitivities() -> None:
    # A bare strip: omega ~ h sqrt(E/rho)/L^2
    bare = compare_with_theory(strip(), BeamModel(strip(), 3).natural_frequencies, np.zeros(3))
    found = bare.contributions
    assert found["thickness"] == pytest.approx(0.02, rel=1e-6)
    assert found["Young's modulus"] == pytest.approx(0.01, rel=0.01)
    assert found["density"] == pytest.approx(-0.0025, rel=0.01)
    assert found["length"] == pytest.approx(-2 * 0.0005 / 0.30, rel=0.01)
    assert found["temperature"] == pytest.approx(-3.75e-4)
    assert not np.any(found["tip mass"])
    assert bare.combined == pytest.approx(
        np.sqrt(0.02**2 + 0.01**2 + 0.0025**2 + 0.0033**2 + 0.0018**2), rel=0.01
    )


def test_millihertz_alone_would_condemn_the_theory() -> None:
    true = 1.01 * BeamModel(RIG, 3).natural_frequencies
    comparison = compare_with_theory(RIG, true, 1e-5 * true)
    assert np.all(np.abs(comparison.z_scores) < 3.0)
    assert np.all(np.abs(comparison.deviations / comparison.statistical) > 100.0)


def test_chi_squared_is_distributed_as_such() -> None:
    budget = UncertaintyBudget()
    base = BeamModel(RIG, 3).natural_frequencies
    probe = compare_with_theory(RIG, base, 1e-3 * base, budget)
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        relative = 1e-3 * rng.standard_normal(3)
        for contribution in probe.contributions.values():
            relative = relative + contribution * rng.standard_normal()
        measured = probe.predicted * (1.0 + relative)
        deviation = measured / probe.predicted - 1.0
        covariance = np.diag(probe.statistical**2) + sum(np.outer(c, c) for c in probe.contributions.values())
        found.append(deviation @ np.linalg.solve(covariance, deviation))
    # The mean of 400 draws with 3 degrees of freedom has a standard deviation of sqrt(6/400) = 0.12.
    assert np.mean(found) == pytest.approx(3.0, abs=0.5)
    measured = probe.predicted * 1.02
    assert compare_with_theory(RIG, measured, 1e-3 * base, budget).chi_squared < 3.0


@pytest.mark.parametrize(
    ("frequencies", "deviations", "name"),
    [
        ([-1.0], [0.1], "frequencies"),
        ([1.0, 2.0], [0.1], "standard_deviations"),
        ([1.0], [np.nan], "standard_dev"),
    ],
)
def test_bad_measurements_are_refused(frequencies: list[float], deviations: list[float], name: str) -> None:
    with pytest.raises(BeamParameterError, match=name):
        compare_with_theory(RIG, frequencies, deviations)


def test_a_bad_budget_is_refused() -> None:
    with pytest.raises(BeamParameterError, match=r"budget\.length"):
        UncertaintyBudget(length=-1.0)
