from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import identify, validate
from beam_ident.report.evidence import Theory, Unseen, beside_theory, mode_rows
from beam_ident.report.gates import Gate
from beam_ident.report.verdict import Verdict, judge, worst_of
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record


@pytest.fixture(scope="module")
def found():
    return identify(beam_record(1), n_modes=3)


@pytest.fixture(scope="module")
def unseen(found):
    return Unseen("another", (validate(found.model, beam_record(2)),))


def following(output):
    """An output whose residuals follow the input, by far, though it is predicted well."""
    own = output.input_correlation
    strong = np.full(len(own.lags), 0.9)
    said = "the residuals follow the input"
    return replace(
        output, input_correlation=replace(own, is_independent=False, correlation=strong, verdict=said)
    )


def test_residuals_that_follow_the_input_are_a_reservation_of_a_good_prediction(found, unseen):
    first = unseen.results[0]
    adverse = replace(first, outputs=(following(first.outputs[0]), *first.outputs[1:]))
    verdict = judge(found, (), [Unseen("another", (adverse,))])
    assert verdict.tone == "doubt"
    assert verdict.reasons == (f"another, {first.outputs[0].name}: the residuals follow the input",)


def test_frequencies_that_theory_cannot_make_are_a_reservation(found, unseen):
    modes = mode_rows((found.model,))
    near = Theory("A beam.", np.array(OMEGAS), np.array(ZETAS), np.array(OMEGAS), is_exact=True)
    assert not beside_theory(modes, near).is_doubtful
    assert judge(found, (), [unseen], beside_theory(modes, near)).tone == "good"
    far = replace(near, predicted=1.001 * near.predicted)
    verdict = judge(found, (), [unseen], beside_theory(modes, far))
    assert verdict.tone == "doubt"
    assert "p = " in verdict.reasons[0]
    # Each mode well within the common uncertainty, while their pattern fits no mixture of it.
    common = {"thickness": np.full(len(OMEGAS), 0.02)}
    bent = near.predicted * (1.0 + 0.005 * np.array([1.0, -1.0, 1.0]))
    agreement = beside_theory(modes, replace(near, predicted=bent, contributions=common, is_exact=False))
    assert all(abs(one.z) < 0.5 for one in agreement.beside)
    assert agreement.is_doubtful
    assert "pattern" in agreement.verdict


def test_several_models_are_judged_by_the_worst_and_every_reason_is_kept_once():
    good, bad = Verdict("good", "It can.", ()), Verdict("bad", "It cannot.", ("noise",))
    together = worst_of([("A", good), ("B", bad), ("C", bad)])
    assert together.tone == "bad"
    assert together.text.startswith("2 of 3 models")
    assert together.reasons == ("B, C: noise",)
    assert worst_of([("A", good)]).tone == "good"
    assert worst_of([]).tone == "doubt"


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
