"""The studies of the frequency domain at a length that can tell, for `make verify`."""

from __future__ import annotations

import pytest

from benchmarks.ident import best_linear, distortion, frequency_domain, modal_analysis
from benchmarks.ident.study import figures


@pytest.mark.verify
@pytest.mark.parametrize(
    ("name", "runs"),
    [("frequency-domain", 250), ("frequency-domain-0", 150), ("frequency-domain-folded", 150)],
)
def test_multisines_reach_the_bound_and_intervals_cover(name, runs):
    found = figures(frequency_domain.STUDIES[name], runs)
    assert found["failures"] == 0
    # The scatter of an efficiency is sqrt(2 / runs): three of them, and the loss of estimated weights.
    margin = 3.0 * (2.0 / runs) ** 0.5
    assert all(0.93 - margin < e < 1.0 + margin for e in found["efficiency"])
    assert 0.92 < found["coverage"] < 0.98


@pytest.mark.verify
def test_a_nonlinear_plant_is_flagged_and_a_linear_one_hardly_ever():
    assert figures(distortion.STUDIES["distortion-linear"], 300)["flagged"] <= 0.05
    assert figures(distortion.STUDIES["distortion-cubic"], 20)["flagged"] == 1.0


@pytest.mark.verify
@pytest.mark.parametrize(
    "name",
    [
        "best-linear-cubic",
        "best-linear-noisy-input",
        "best-linear-cubic-loop",
        "best-linear-friction",
        "best-linear-friction-loop",
    ],
)
def test_bands_of_noise_and_distortion_hold_the_truth(name):
    found = figures(best_linear.STUDIES[name], 200)
    assert 0.93 < found["noise held, excited"] < 0.97
    assert 0.93 < found["distortion held, excited"] < 0.97
    # (M - 1) / (M - 2) of 7 realisations
    assert 1.1 < found["squared z of the response"] < 1.3


@pytest.mark.verify
@pytest.mark.parametrize("name", ["modal-analysis", "modal-analysis-level"])
def test_the_modal_analysis_covers_and_keeps_damping_within_one_per_cent(name):
    found = figures(modal_analysis.STUDIES[name], 100)
    assert found["failures"] == 0
    assert 0.92 < found["coverage"] < 0.98
    assert found["worst damping error %"] < (1.0 if name == "modal-analysis" else 3.0)
