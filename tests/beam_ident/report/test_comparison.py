from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import identify
from beam_ident.errors import ReportError
from beam_ident.report.comparison import comparison_page, differences, format_comparison
from beam_ident.report.evidence import Trial
from tests.beam_ident.truth import beam_record


@pytest.fixture(scope="module")
def trials():
    return [Trial(f"run {k}", identify(beam_record(k), n_modes=2).model, 1e-3 * k) for k in (1, 2)]


@pytest.fixture(scope="module")
def detuned(trials):
    model = trials[1].model
    return Trial("detuned", replace(model, natural_frequencies=1.001 * model.natural_frequencies))


@pytest.mark.slow
def test_records_of_one_beam_agree_and_another_beam_differs(trials, detuned):
    same, other = differences([*trials, detuned])
    assert all(abs(z) < 4.0 for mode in same.modes for z in (mode.frequency_z, mode.damping_z))
    assert same.p_value > 0.001
    hertz = trials[0].model.frequencies_hz
    # A thousandth of the frequency, and nothing of the damping.
    assert other.modes[0].frequency_hz == pytest.approx(
        1e-3 * hertz[0] + same.modes[0].frequency_hz, rel=1e-2
    )
    assert other.modes[0].damping_ratio == same.modes[0].damping_ratio
    assert abs(other.modes[0].frequency_z) > 30.0
    assert other.p_value < 1e-9


def test_z_is_the_difference_over_both_standard_deviations(trials):
    first, second = (trial.model for trial in trials)
    found = differences(trials)[0].modes[1]
    sd = np.hypot(first.natural_frequency_sd[1], second.natural_frequency_sd[1])
    step = second.natural_frequencies[1] - first.natural_frequencies[1]
    assert found.frequency_z == pytest.approx(step / sd)


@pytest.mark.slow
def test_modes_that_one_of_two_lacks_are_counted(trials):
    richer = Trial("three", identify(beam_record(2), n_modes=3).model)
    assert differences([trials[0], richer])[0].n_alone == 1


def test_fewer_than_two_models_and_what_has_no_modes_are_refused(trials):
    with pytest.raises(ReportError, match="at least two"):
        differences(trials[:1])
    with pytest.raises(ReportError, match="no modes"):
        differences([trials[0], Trial("odd", object())])


@pytest.mark.slow
def test_the_page_lays_the_models_over_each_other(trials, detuned):
    page = comparison_page("Comparison", [*trials, detuned], {"Software": {"numpy": "1"}})
    text = page.text()
    assert "differ: the largest difference" in text
    assert {"modes", "response-z010", "response-z225", "response-z285", "linearity"} <= set(page.figures)
    legend = re.findall(r">([^<]*: z225)</text>", page.figures["response-z225"])
    assert legend == ["run 1: z225", "run 2: z225", "detuned: z225"]
    assert 'class="number bad"' in text


def test_the_terminal_has_a_line_for_every_mode_of_every_model(trials, detuned):
    every = [*trials, detuned]
    lines = format_comparison(every, differences(every)).splitlines()
    assert len(lines) == 1 + 2 * 3
    assert lines[1].startswith("run 1")
    assert lines[1].split()[-1] == "-"
    assert abs(float(lines[3].split()[-1])) < 6.0
