"""An identification of what grows is, at the end, that of the whole, and costs no more than it may on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from beam_ident import (
    Aim,
    EstimationError,
    GrowingIdentification,
    GrowingRecord,
    InputSignal,
    OutputSignal,
    TimeRecord,
    identify,
)
from tests.beam_ident.truth import OMEGAS, SHORT_CHIRP, beam_record, z_scores


class Processor:
    """A processor that takes the same time from one look at the clock to the next."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.now = seconds, 0.0

    def __call__(self) -> float:
        self.now += self.seconds
        return self.now


def until(record: TimeRecord, end_s: float) -> TimeRecord:
    return record.between(record.inputs[0].span_s[0], end_s)


@pytest.fixture(scope="module")
def record() -> TimeRecord:
    return beam_record(1, SHORT_CHIRP)


@pytest.fixture(scope="module")
def grown(record):
    """Estimates of a record that grows step by step."""
    growing = GrowingIdentification("base_motion", processor_time=Processor(1e-6))
    seen = [growing.grown(until(record, end)) for end in np.arange(2.0, 14.0, 1.5)]
    return growing, seen


@pytest.mark.slow
def test_the_end_is_the_answer_of_the_whole_record(record, grown):
    growing, _ = grown
    found, whole = growing.searched(record).model, identify(record, "base_motion").model
    np.testing.assert_array_equal(found.parameters, whole.parameters)
    np.testing.assert_array_equal(found.covariance, whole.covariance)


@pytest.mark.slow
def test_modes_are_found_as_they_show_and_their_intervals_shrink_to_the_truth(grown):
    _, seen = grown
    modes = [0 if own is None else own.model.n_modes for own in seen]
    assert modes[0] == 0
    assert modes[-1] == 3
    sds = [own.model.natural_frequency_sd[0] for own in seen if own is not None]
    assert sds[-1] < 0.2 * sds[0]
    assert np.max(np.abs(z_scores(seen[-1].model))) < 4.0


@pytest.mark.slow
def test_a_refit_is_the_fit_of_as_many_modes_to_all_samples(record):
    growing = GrowingIdentification("base_motion", growth=100.0, processor_time=Processor(1e-6))
    growing.searched(until(record, 12.0))
    refit = growing.grown(record).model
    whole = identify(record, "base_motion", n_modes=3).model
    assert refit.n_modes == 3
    # Both end where the likelihood is flat: a hundredth of a standard deviation is the minimiser's.
    assert np.max(np.abs(refit.parameters - whole.parameters) / whole.standard_deviations) < 0.01


def test_a_new_estimate_waits_until_it_is_paid_for(record):
    growing = GrowingIdentification("base_motion", share_of_core=0.1, processor_time=Processor(0.01))
    growing.grown(until(record, 8.0))
    first, spent = growing.result, growing.spent_s
    assert first.model.n_modes == 2
    assert 0.0 < spent == growing.seconds_of_last_fit < 0.8  # so long a record pays for that
    growing.spent_s = 0.9 - spent  # what another search will take is paid before
    assert not growing.is_due(8.99)
    assert growing.grown(until(record, 8.9)) is first
    assert growing.is_due(9.01)
    assert growing.grown(until(record, 9.2)) is not first
    assert growing.spent_s == pytest.approx(0.9 - spent + growing.seconds_of_last_fit)


def test_a_search_ends_where_it_takes_more_than_the_record_pays_for(record):
    short = until(record, 8.0)
    growing = GrowingIdentification("base_motion", share_of_core=0.1, processor_time=Processor(0.3))
    first = growing.grown(short)  # there is none better
    assert "the time was up" in growing.complaint
    assert not first.converged
    assert growing.searched(short).converged
    assert growing.complaint == ""
    whole = growing.result
    assert growing.searched(short, limit_s=0.1) is whole
    assert growing.complaint


@pytest.mark.slow
def test_residuals_that_are_no_longer_white_ask_for_a_search(record):
    growing = GrowingIdentification("base_motion", growth=100.0, processor_time=Processor(1e-6))
    growing.searched(until(record, 6.0))  # before the second mode is passed
    assert growing.result.model.n_modes == 1
    assert all(own.whiteness.is_white for own in growing.result.outputs)
    growing.grown(until(record, 8.0))
    assert growing.result.model.n_modes >= 2


def test_what_shows_no_mode_says_so_and_is_asked_again_only_when_it_has_grown(record):
    rng = np.random.default_rng(1)
    outputs = tuple(
        replace(own, values=1e-6 * rng.standard_normal(len(own.values))) for own in record.outputs
    )
    noise = replace(record, outputs=outputs)
    growing = GrowingIdentification("base_motion", processor_time=Processor(1e-6))
    assert growing.grown(until(noise, 2.0)) is None
    assert growing.complaint
    spent = growing.spent_s
    assert growing.grown(until(noise, 2.4)) is None
    assert growing.spent_s == spent
    assert growing.grown(until(noise, 2.6)) is None
    assert growing.spent_s > spent
    assert not growing.knows(noise, (Aim("f", 1, 0.5),))


@pytest.mark.slow
def test_an_aim_is_believed_after_a_search_alone(record):
    growing = GrowingIdentification("base_motion", growth=100.0, processor_time=Processor(1e-6))
    growing.searched(until(record, 4.0))
    easy, longer = (Aim("f", 1, 0.01),), until(record, 6.0)
    assert growing.knows(longer, easy)
    np.testing.assert_array_equal(
        growing.result.model.parameters, identify(longer, "base_motion").model.parameters
    )
    assert not growing.knows(longer, (Aim("f", 1, 1e-9),))
    assert not growing.knows(longer, (Aim("f", 9, 0.5),))


@pytest.mark.slow
def test_samples_of_a_growing_record_are_taken_as_they_come(record):
    growing = GrowingIdentification("base_motion", processor_time=Processor(1e-6))
    begun = GrowingRecord(until(record, 4.0))
    first = growing.grown(begun).model
    for signal in (*record.inputs, *record.outputs):
        later = (signal.times_s > begun.record().inputs[0].times_s[-1]) & (signal.times_s < 6.0)
        begun.add(signal.name, signal.times_s[later], signal.values[later])
    second = growing.grown(begun).model
    assert second.natural_frequency_sd[0] < first.natural_frequency_sd[0]
    assert abs(second.natural_frequencies[0] - OMEGAS[0]) < 4.0 * second.natural_frequency_sd[0]


def drifting_record(seconds: float, hz: tuple[float, float]) -> TimeRecord:
    """A mode whose frequency goes evenly from one value to another: exact steps, the frequency new every 0.1 s."""
    tick, blocks = 1e-3, round(10 * seconds)
    times = tick * np.arange(100 * blocks + 1)
    lines = 2.0 * np.pi * np.arange(10, 81) / 10.0  # 1 to 8 Hz, again every ten seconds
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(lines))
    acceleration = 0.01 * np.cos(times[:-1, None] * lines + phases).sum(axis=1)
    hub, state = np.zeros((len(times), 2)), np.zeros((len(times), 2))
    for block, own_hz in enumerate(np.linspace(*hz, blocks)):
        omega = 2.0 * np.pi * own_hz
        steps = [
            expm(tick * np.array([[0.0, 1.0, 0.0], [-(w**2), -0.01 * w, b], [0.0, 0.0, 0.0]]))
            for w, b in ((0.0, 1.0), (omega, -1.5))
        ]
        for k in range(100 * block, 100 * block + 100):
            for motion, step in zip((hub, state), steps, strict=True):
                motion[k + 1] = step[:2, :2] @ motion[k] + step[:2, 2] * acceleration[k]
    frames = slice(10, None, 10)
    noise = 3e-5 * np.random.default_rng(2).standard_normal(len(times[frames]))
    drive = InputSignal("hub", "m", times, hub[:, 0], "cubic", 1e-9)
    return TimeRecord((drive,), (OutputSignal("tip", "m", times[frames], (hub + state)[frames, 0] + noise),))


@pytest.mark.slow
@pytest.mark.parametrize("moves", [False, True], ids=["one origin", "an origin that moves"])
def test_a_mode_that_changes_slowly_is_followed_by_what_forgets(moves):
    first_hz, last_hz, seconds = 4.400, 4.406, 30.0
    whole = drifting_record(seconds, (first_hz, last_hz))
    growing = GrowingIdentification("base_motion", processor_time=Processor(0.02))
    record, last, n_estimates = GrowingRecord(whole.between(0.0, 1.0), 8.0), 1.0, 0
    for end in np.arange(1.5, seconds, 0.5):
        for own in (*whole.inputs, *whole.outputs):
            new = (own.times_s > last) & (own.times_s <= end)
            record.add(own.name, own.times_s[new], own.values[new])
        last, before, now = end, growing.result, record.record()
        span = np.array(now.inputs[0].span_s)
        if growing.grown(now.from_instant(round(1e9 * span[0])) if moves else record) is not before:
            model, n_estimates = growing.result.model, n_estimates + (end > 10.0)
            true_hz = first_hz + (last_hz - first_hz) * span / seconds
            assert np.all(
                np.abs(model.frequencies_hz[0] - np.mean(true_hz))
                < np.ptp(true_hz) / 2 + 4.0 * model.frequency_sd_hz[0]
            )
    # As long as it is heard, and not until the memory has paid for what it may.
    assert n_estimates > 8
    assert growing.spent_s <= 0.15 * seconds + growing.seconds_of_last_fit
    assert last_hz - first_hz > 15.0 * model.frequency_sd_hz[0]


@pytest.mark.parametrize("share", [0.0, -1.0])
def test_a_share_of_nothing_is_refused(share):
    with pytest.raises(EstimationError, match="share_of_core"):
        GrowingIdentification(share_of_core=share)
