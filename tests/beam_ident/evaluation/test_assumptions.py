"""Records that keep or break one assumption each, from an independent simulation of known modes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from beam_ident import TimeRecord, assumptions, estimate_common_poles, fit_free_decay, identify
from tests.beam_ident import result_cases
from tests.beam_ident.truth import beam_record

NAMES = ("colour", "independent", "steady", "driven")


def louder(record: TimeRecord, seed: int) -> TimeRecord:
    """Return a record whose noise has doubled by its end."""
    rng = np.random.default_rng(seed)
    outputs = tuple(
        dataclasses.replace(
            own,
            values=own.values
            + 4e-5 * np.linspace(0.0, 1.0, len(own.values)) * rng.standard_normal(len(own.values)),
        )
        for own in record.outputs
    )
    return dataclasses.replace(record, outputs=outputs)


def test_assumptions_that_hold_are_not_said_to_fail():
    for seed in range(3):
        record = beam_record(seed)
        found = assumptions(identify(record), [record])
        assert [own.verdict for own in found] == ["holds"] * 4, found


def test_a_mode_that_was_left_out_is_seen_to_follow_the_input():
    record = beam_record(1)
    found = dict(zip(NAMES, assumptions(identify(record, n_modes=1), [record]), strict=True))
    assert found["driven"].verdict == "fails"


def test_noise_that_grows_is_not_called_steady():
    record = louder(beam_record(2), 7)
    found = dict(zip(NAMES, assumptions(identify(record), [record]), strict=True))
    assert found["steady"].verdict == "fails"
    assert [found[name].verdict for name in ("colour", "independent", "driven")] == ["holds"] * 3


def test_noise_that_outputs_share_fails_where_nobody_models_it():
    # Transfer functions with common poles take the outputs for independent.
    record = result_cases.record()
    common = 0.02 * np.random.default_rng(3).standard_normal(len(record.outputs[0].values))
    outputs = tuple(dataclasses.replace(own, values=own.values + common) for own in record.outputs)
    shaken = dataclasses.replace(record, outputs=outputs)
    verdicts = {}
    for own in (record, shaken):
        found = assumptions(estimate_common_poles(own, 2, 0), [own])
        verdicts[own is shaken] = dict(zip(NAMES, found, strict=True))["independent"].verdict
    assert verdicts == {False: "holds", True: "fails"}


def test_what_cannot_be_tested_is_said_not_to_be():
    found = assumptions(fit_free_decay(result_cases.decay()))
    assert {own.verdict for own in found} == {"not tested"}
    assert all(math.isnan(own.p_value) for own in found)
    one = assumptions(result_cases.result("srivc"))
    assert dict(zip(NAMES, one, strict=True))["driven"].test == "the records were not given"
