from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("matplotlib")

from beam_ident import identify, validate
from beam_ident.report.evidence import Unseen
from beam_ident.report.gates import Gate
from beam_ident.report.verdict import judge
from tests.beam_ident.truth import beam_record


@pytest.fixture(scope="module")
def found():
    return identify(beam_record(1), n_modes=3)


@pytest.fixture(scope="module")
def unseen(found):
    return Unseen("another", (validate(found.model, beam_record(2)),))


@pytest.mark.slow
def test_a_model_that_predicts_unseen_data_can_be_relied_on(found, unseen):
    verdict = judge(found, [Gate("clock", "passed", "1 us", "below 50 us")], [unseen])
    assert (verdict.tone, verdict.reasons) == ("good", ())


def test_without_unseen_data_the_verdict_asks_for_them(found):
    verdict = judge(found)
    assert verdict.tone == "doubt"
    assert "validate it" in verdict.text


def test_a_gate_that_failed_or_is_doubtful_is_named(found, unseen):
    bad = judge(found, [Gate("frames", "failed", "900 of 1000 lost", "none lost")], [unseen])
    assert bad.tone == "bad"
    assert "900 of 1000 lost" in bad.reasons[0]
    doubtful = judge(found, [Gate("frames", "doubtful", "62 lost", "none lost")], [unseen])
    assert doubtful.tone == "doubt"
    assert doubtful.reasons == ("doubtful data: frames, 62 lost",)


def test_a_fit_that_did_not_end_or_a_poor_prediction_condemns_the_model(found, unseen):
    assert judge(replace(found, converged=False), [], [unseen]).tone == "bad"
    detuned = replace(found.model, natural_frequencies=1.05 * found.model.natural_frequencies)
    verdict = judge(found, [], [Unseen("another", (validate(detuned, beam_record(2)),))])
    assert verdict.tone == "bad"
    assert "poor prediction" in verdict.reasons[0]


def test_warnings_of_the_estimator_are_reservations(found, unseen):
    verdict = judge(replace(found, warnings=("the residuals are not white",)), [], [unseen])
    assert verdict.tone == "doubt"
    assert "one reservation" in verdict.text
