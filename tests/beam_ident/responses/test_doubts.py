"""A response that is no more than chance says so, in every way to measure one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import (
    TimeRecord,
    fit_frequency_transfer_function,
    local_polynomial_response,
    periodic_response,
    welch_response,
)
from tests.beam_ident import result_cases

WAYS = {
    "welch": welch_response,
    "local polynomial": local_polynomial_response,
    "periods": lambda record: periodic_response(record, 2.56, start_s=2.56).response,
}


def noise_for_outputs(seed: int) -> TimeRecord:
    """Return a record whose outputs have nothing to do with its input."""
    record = result_cases.record(5)
    rng = np.random.default_rng(seed)
    outputs = tuple(replace(own, values=rng.standard_normal(len(own.values))) for own in record.outputs)
    return TimeRecord(record.inputs, outputs)


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_outputs_of_noise_are_named_and_sound_ones_are_not(way):
    named = sum("no more than chance" in " ".join(WAYS[way](noise_for_outputs(k)).warnings) for k in range(5))
    assert named == 5
    said = WAYS[way](result_cases.record(5)).warnings
    # Of a held input and of segments as short as these, which are named rightly.
    known = ("held between its samples", "biased by what leaks", "too short for it")
    assert not [own for own in said if not any(text in own for text in known)]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("rate", [1, 10])
def test_a_hold_that_bends_the_response_is_named_and_one_that_does_not_is_not(way, rate):
    """The record's input is held for a tenth of a cycle of its mode, or for a hundredth."""
    record = result_cases.record(5)
    drive, output = record.inputs[0], record.outputs[0]
    finer = replace(drive, times_s=np.arange(rate * len(drive.values)) * drive.period_s / rate,
                    values=np.repeat(drive.values, rate))  # fmt: skip
    own = WAYS[way](TimeRecord((finer,), (output,)))
    said = [said for said in own.warnings if "held between its samples" in said]
    assert bool(said) == (rate == 1 and way != "periods")
    if said:
        assert "which delays it by 5 ms" in said[0]


def test_a_fit_passes_on_what_its_response_says():
    lines = WAYS["periods"](noise_for_outputs(0)).select(["y"])
    found = fit_frequency_transfer_function(lines, 2, 0)
    assert any("no more than" in said for said in found.warnings)
