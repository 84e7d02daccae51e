"""The three-mode beam under force, at two points: common poles, drift, jitter and a foreign clock."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import ModalStructure, Prior, identify
from benchmarks.ident.forced_beam import DRIFTING, PLAIN, ForcedBeam, foreign_clock, jittered

FREE = Prior(0.0, np.inf)


@pytest.fixture(scope="module")
def beam() -> ForcedBeam:
    return ForcedBeam()


def z_scores(model, truth) -> np.ndarray:
    estimate = np.concatenate([model.natural_frequencies, model.damping_ratios])
    return (estimate - truth) / np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])


@pytest.mark.parametrize("snr_db", [20.0, 0.0])
def test_all_modes_and_nothing_spurious_are_found_without_hints(beam, snr_db):
    model = identify(beam.record(3, snr_db), PLAIN).model
    assert model.n_modes == 3
    assert np.max(np.abs(z_scores(model, beam.truth))) < 4.0


def test_common_poles_pay(beam):
    record = beam.record(4, 20.0)
    both = identify(record, PLAIN, 3).model
    tip = identify(record.select(["tip"]), PLAIN, 3).model
    gain = (tip.natural_frequency_sd / both.natural_frequency_sd) ** 2
    assert gain[2] > 4.0
    assert ((tip.damping_ratio_sd / both.damping_ratio_sd) ** 2)[2] > 3.0


def test_stamps_are_taken_where_they_are(beam):
    model = identify(jittered(60.0)(beam, 5, 1.0), PLAIN).model
    assert model.n_modes == 3
    assert np.max(np.abs(z_scores(model, beam.truth))) < 4.0


@pytest.mark.slow
def test_an_unknown_start_with_offset_and_ramp_costs_little(beam):
    record = beam.record(6, 20.0, drift=(20.0, 30.0), start_s=3.0)
    model = identify(record, DRIFTING).model
    assert model.n_modes == 3
    assert np.max(np.abs(z_scores(model, beam.truth))) < 4.0
    known = identify(
        beam.record(6, 20.0, start_s=3.0), ModalStructure("receptance", False, False, False), 3
    ).model
    # At least 0.7 of the information is left beside offset and ramp.
    assert np.all((known.natural_frequency_sd / model.natural_frequency_sd) ** 2 > 0.7)


@pytest.mark.slow
def test_a_late_and_fast_camera_that_drops_frames_is_told_from_the_beam_without_hints(beam):
    found = identify(foreign_clock(beam, 2, 1.0), PLAIN, None, FREE, FREE)
    model = found.model
    assert model.n_modes == 3
    assert np.max(np.abs(z_scores(model, beam.truth))) < 4.0
    assert abs(model.clock_rate - 1e-3) < 4.0 * model.clock_rate_sd
    assert min(output.scores.r_squared for output in found.outputs) > 0.989  # the ceiling at 20 dB is 0.990


@pytest.mark.verify
def test_no_cycle_traps_the_search_for_a_foreign_clock(beam):
    scores = []
    for seed in range(100, 130):
        model = identify(foreign_clock(beam, seed, 1.0), PLAIN, None, FREE, FREE).model
        assert model.n_modes == 3
        scores.append(z_scores(model, beam.truth))
    assert np.max(np.abs(scores)) < 4.5
