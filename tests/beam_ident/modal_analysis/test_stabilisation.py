from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, RecordError
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal_analysis import StabilityCriteria, stabilisation_chart
from tests.beam_ident.modal_analysis.chain import DAMPING, FREQUENCIES_HZ, LINES, noisy_record


@pytest.mark.parametrize(
    ("form", "differentiations"), [("receptance", 0), ("mobility", 1), ("accelerance", 2)]
)
def test_the_modes_are_chosen_and_nothing_else(form, differentiations):
    record = noisy_record(1, 0.01, (0, 2), differentiations)
    chart = stabilisation_chart(record, form, max_order=20)
    np.testing.assert_allclose(chart.frequencies_hz, FREQUENCIES_HZ, rtol=2e-3)
    # Linearised and unweighted, the chart is biased where a mode is small: the refinement starts from it.
    np.testing.assert_allclose(chart.damping_ratios, DAMPING, rtol=0.1)
    assert np.all(chart.lasting >= 8)


def test_lines_that_were_not_measured_are_left_out():
    whole = noisy_record(1, 0.01, (0, 2))
    holes = whole.response.copy()
    holes[:: len(LINES) // 20] = np.nan
    found = stabilisation_chart(FrequencyRecord(LINES, holes), max_order=20)
    np.testing.assert_allclose(found.frequencies_hz, FREQUENCIES_HZ, rtol=2e-3)
    with pytest.raises(RecordError, match="no line was measured"):
        stabilisation_chart(FrequencyRecord(LINES, np.full_like(holes, np.nan)), max_order=20)


def test_two_modes_at_one_frequency_are_told_apart_with_two_inputs():
    s = 1j * LINES[:1500]
    shapes = np.array([[1.0, 0.2], [0.3, -1.0], [0.8, 0.7]])
    modes = np.stack([1.0 / (s**2 + 2 * z * w * s + w**2) for w, z in ((600.0, 0.02), (600.5, 0.03))], axis=1)
    clean = np.einsum("lm,om,im->loi", modes, shapes, shapes[:2])
    rng = np.random.default_rng(0)
    noise = 0.01 * np.abs(clean) * rng.standard_normal(clean.shape)
    chart = stabilisation_chart(FrequencyRecord(LINES[:1500], clean + noise), max_order=12)
    np.testing.assert_allclose(chart.natural_frequencies, [600.0, 600.5], atol=0.3)
    np.testing.assert_allclose(np.sort(chart.damping_ratios), [0.02, 0.03], rtol=0.05)


def test_noise_alone_has_no_modes():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((600, 4, 1)) + 1j * rng.standard_normal((600, 4, 1))
    assert (
        len(stabilisation_chart(FrequencyRecord(LINES[:600], noise), max_order=20).natural_frequencies) == 0
    )


def test_poles_become_stable_with_the_order():
    chart = stabilisation_chart(noisy_record(0, 0.0), max_order=16)
    share = [np.mean([p.stability == 3 for p in chart.poles if p.order == order]) for order in range(2, 17)]
    assert share[-1] > 0.6 > share[0]
    assert chart.indicator.shape == (5000, 1)


def test_wrong_criteria_are_refused():
    with pytest.raises(EstimationError, match=r"damping is 1\.5"):
        StabilityCriteria(damping=1.5)
    with pytest.raises(EstimationError, match="form is 'compliance'"):
        stabilisation_chart(noisy_record(0), "compliance")  # type: ignore[arg-type]
