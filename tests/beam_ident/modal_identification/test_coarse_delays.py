"""Delays far beyond what a search about zero can find, of records from an independent simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import Prior, TimeRecord, identify
from beam_ident.modal_identification.coarse_delays import coarse_delays
from benchmarks.ident.changing_modes import ChangingModes
from tests.beam_ident.truth import OMEGAS, beam_record


def later(record: TimeRecord, by_s: float) -> TimeRecord:
    """Return a record whose outputs are all stamped later."""
    outputs = tuple(dataclasses.replace(own, times_s=own.times_s + by_s) for own in record.outputs)
    return dataclasses.replace(record, outputs=outputs)


@pytest.mark.parametrize("delay", [0.0, 0.35, -1.3])
def test_phases_alone_tell_when_outputs_were_stamped(delay):
    found = coarse_delays([later(beam_record(1), delay)], "hub")
    assert found
    # Within a period of the slowest mode that moves much, which phases near its resonance blur.
    assert list(found.values()) == pytest.approx([delay] * len(found), abs=0.1)


def test_nothing_is_said_where_noise_hides_the_input_or_periods_repeat():
    record = beam_record(1)
    rng = np.random.default_rng(1)
    noise = tuple(dataclasses.replace(o, values=rng.standard_normal(len(o.values))) for o in record.outputs)
    assert coarse_delays([dataclasses.replace(record, outputs=noise)], "hub") == {}
    (drive,) = record.inputs
    still = dataclasses.replace(drive, values=np.zeros_like(drive.values))
    assert coarse_delays([dataclasses.replace(record, inputs=(still,))], "hub") == {}
    times = np.arange(len(drive.values)) * 1e-3
    again = np.tile(rng.standard_normal(2000), len(times) // 2000 + 1)[: len(times)]
    output = dataclasses.replace(record.outputs[0], times_s=times[5::10], values=again[5::10])
    periodic = TimeRecord((dataclasses.replace(drive, times_s=times, values=again),), (output,))
    assert coarse_delays([periodic], "hub") == {}


@pytest.mark.parametrize("delay", [0.0, 0.5, -1.0])
@pytest.mark.parametrize("cut", [0, 20])
def test_lines_that_nothing_drives_do_not_tell_when_outputs_were_stamped(delay, cut):
    """All but 14 of 80 Hz show only where input and outputs end: at once, or the outputs 0.2 s sooner."""
    record = ChangingModes(None, 10.0).record(1)
    shorter = tuple(
        dataclasses.replace(
            own, times_s=own.times_s[: len(own.times_s) - cut], values=own.values[: len(own.values) - cut]
        )
        for own in record.outputs
    )
    found = coarse_delays([later(dataclasses.replace(record, outputs=shorter), delay)], "base", 0.15, 2)
    # The two modes blur the peak of so narrow a band by a third of the slow one's period.
    assert list(found.values()) == pytest.approx([delay] * len(found), abs=0.12)
    assert bool(found) == bool(delay)


@pytest.mark.slow
@pytest.mark.parametrize("latency", [None, Prior(0.0, 2.0)])
def test_a_latency_of_seconds_is_found_where_nobody_knew_it(latency):
    model = identify(later(beam_record(1), -1.3), latency=latency).model
    assert abs(model.latency + 1.3) < 4.0 * model.latency_sd
    assert np.max(np.abs(model.natural_frequencies - OMEGAS) / model.natural_frequency_sd) < 4.0
