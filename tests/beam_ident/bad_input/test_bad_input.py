"""The table of bad input, a part of it: each case an error, a warning that names its cause, or the right answer.

Hopeless input is quick for every estimator. ``python -m benchmarks.ident_bad_input`` runs the whole table.
"""

from __future__ import annotations

import pytest

from tests.beam_ident.bad_input.estimators import ESTIMATORS
from tests.beam_ident.bad_input.faults import HOPELESS, cases
from tests.beam_ident.bad_input.judgement import judge, sound

ALWAYS = (
    "estimate_transfer_function, auto",
    "subspace_model",
    "fit_free_decay",
    "fit_frequency_transfer_function",
    "hammer_response",
    "periodic_response",
    "welch_response",
    "stepped_sine_response",
    "validate",
)
FITTED = {"an input that moves when all is over", "a hundredth of a second in common"}
"""Hopeless as well, but a fit finds that out."""

TABLE = [
    pytest.param(name, fault, marks=() if fault in set(HOPELESS) - FITTED else pytest.mark.slow)
    for name, fault in cases(ESTIMATORS)
    if name in ALWAYS or fault in HOPELESS
]


def test_the_table_has_more_than_three_hundred_cases():
    assert len(TABLE) > 300


@pytest.mark.parametrize("name", ALWAYS)
def test_a_sound_record_is_neither_refused_nor_doubted(name):
    found = sound(name)
    assert found.converged
    known = ("neighbouring lines", "held between its samples")  # of how responses are made, and true
    assert all(any(words in said for words in known) for said in found.warnings)


@pytest.mark.parametrize(("name", "fault"), TABLE)
def test_bad_input_is_refused_or_named_or_does_no_harm(name, fault):
    verdict = judge(name, fault)
    assert not verdict.is_failure, f"{verdict.kind}: {verdict.text}"


@pytest.mark.parametrize(
    ("name", "fault", "word"),
    [
        ("identify, receptance", "a saturating actuator", "cube"),
        ("half_power_damping", "spikes", "Outliers"),
        ("welch_response", "spikes", "Outliers"),
        pytest.param("identify, accelerance", "input and output swapped", "swapped", marks=pytest.mark.slow),
        ("identify, accelerance", "an output wired to the input", "copy"),  # a rigid body alone is found
    ],
)
def test_a_fault_is_named_by_its_cause_and_a_sound_record_is_not_said_to_have_it(name, fault, word):
    verdict = judge(name, fault)
    assert verdict.kind == "named"
    assert word in verdict.text
    assert not any(word in said for said in sound(name).warnings)
