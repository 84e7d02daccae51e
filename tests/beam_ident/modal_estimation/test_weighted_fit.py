from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import InputSignal, LogChirp, ModalStructure, OutputSignal, Prior, TimeRecord, identify
from beam_ident.modal_estimation.weighted_fit import _sandwich
from beam_ident.modal_identification.time_search import TimeSearch
from benchmarks.ident.rig import Rig
from tests.beam_ident.truth import beam_record, coloured_record, z_scores


def with_encoder_noise(seed: int, sd: float, stated: float, missing: float = 0.0) -> TimeRecord:
    record = beam_record(seed, encoder=0.0)
    drive = record.inputs[0]
    rng = np.random.default_rng(1000 + seed)
    values = drive.values + sd * rng.standard_normal(len(drive.values))
    outputs = []
    for output in record.outputs:
        seen = output.values.copy()
        seen[rng.random(len(seen)) < missing] = np.nan
        outputs.append(OutputSignal(output.name, "m", output.times_s, seen, output.exposure_s))
    return TimeRecord((InputSignal("hub", "m", drive.times_s, values, "cubic", stated),), tuple(outputs))


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0.0, pytest.param(0.1, marks=pytest.mark.verify)])
def test_noise_on_a_measured_input_biases_nothing_where_its_size_is_stated(missing):
    found = identify(with_encoder_noise(3, 2e-6, 2e-6, missing), n_modes=3)
    assert found.converged
    assert np.max(np.abs(z_scores(found.model))) < 4.0
    if not missing:
        # What is not stated is seen while the hub stands still.
        undeclared = identify(with_encoder_noise(3, 2e-6, 0.0), n_modes=3)
        assert np.max(np.abs(z_scores(undeclared.model))) < 4.0
        assert any("nobody declared" in said for said in undeclared.warnings)


@pytest.mark.slow
def test_two_noisy_inputs_are_each_taken_for_what_they_are():
    records = [with_encoder_noise(1, 1e-6, 1e-6), with_encoder_noise(2, 1e-8, 1e-8)]
    both = identify(records, n_modes=3).model
    assert np.max(np.abs(z_scores(both))) < 4.0
    quiet = identify(records[1], n_modes=3).model
    # Of the first mode's damping the noisy record says next to nothing, of the third one's a third as much.
    gain = quiet.damping_ratio_sd / both.damping_ratio_sd
    assert 1.0 <= gain[0] < 1.05
    assert 1.1 < gain[2] < 1.4


@pytest.mark.slow
def test_unmodelled_motion_is_not_weighed_as_if_it_were_noise():
    moving = beam_record(8).between(3.0, 13.0)
    still = ModalStructure(has_free_response=False, has_offset=False, has_ramp=False)
    found = identify(moving, still, n_modes=3, latency=Prior(0.0), clock_rate=Prior(0.0))
    assert "weights are equal" in found.reason
    assert np.max(np.abs(z_scores(found.model))[:6]) > 10.0


@pytest.mark.slow
def test_an_input_noise_that_is_stated_far_too_large_is_not_believed():
    found = identify(with_encoder_noise(3, 1e-8, 1e-4), n_modes=3)
    assert not found.converged
    assert any("Check the sigma" in text for text in found.warnings)
    assert np.max(np.abs(z_scores(found.model)[:6])) < 4.0


def test_a_hub_that_shows_nothing_but_its_encoders_noise_stands_still():
    times = np.arange(0.0, 10.0, 0.01)
    pole = complex(-0.05, 20.0)
    rng = np.random.default_rng(0)
    values = np.real(1e-3 * np.exp(pole * times)) + 1e-6 * rng.standard_normal(len(times))
    drive = InputSignal("hub", "m", (0.0, 0.01), 1e-7 * rng.standard_normal(1001), "cubic", 1e-7)
    found = identify(TimeRecord((drive,), (OutputSignal("tip", "m", times, values),)))
    assert found.model.poles[0] == pytest.approx(pole, rel=1e-4)
    assert any("stands still" in text for text in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "mode"), [(61, "4.43 Hz"), pytest.param(75, "4.587 Hz", marks=pytest.mark.verify)]
)
def test_noise_of_the_input_is_not_taken_for_a_mode_beside_a_true_one(seed, mode, monkeypatch):
    # What a search with equal weights takes for one. The search behind the noise does not see it to begin with.
    plain = identify(Rig().record(seed, encoder_sd=1e-6))
    assert not any("weighed" in entry.refused_because for entry in plain.orders)
    monkeypatch.setattr(TimeSearch, "_is_driven_by_noise", lambda _: False)
    found = identify(Rig().record(seed, encoder_sd=1e-6))
    assert found.model.frequencies_hz == pytest.approx([4.384, 28.26, 79.34], rel=2e-3)
    assert found.converged
    (refused,) = [e.refused_because for e in found.orders if e.refused_because.startswith("weighed")]
    assert f"{mode} does not stand out" in refused
    assert [e.n_modes for e in found.orders if e.is_chosen] == [3]


def test_the_mean_of_noise_with_a_colour_scatters_more_than_that_of_white_noise():
    n, colour = 20_000, 0.5
    white, shocks = np.random.default_rng(8).standard_normal((2, n))
    coloured = np.sqrt(1.0 - colour**2) * lfilter([1.0], [1.0, -colour], shocks)
    # Two outputs of unit variance, of which a constant each is estimated.
    whitened = [[np.column_stack([np.ones(n), own]) for own in (coloured, white)]]
    touched = [np.array([0]), np.array([1])]
    places = [[slice(0, n), slice(0, n)]]
    covariance = _sandwich(np.eye(2) / n, [coloured, white], touched, lambda: whitened, (), None, places)
    variances = n * np.diag(covariance)
    # (1 + c) / (1 - c) for a first-order autoregression; 20000 samples know c to 0.006, the ratio to 0.025.
    assert variances == pytest.approx([(1.0 + colour) / (1.0 - colour), 1.0], abs=0.1)


@pytest.mark.verify
@pytest.mark.parametrize(
    "make",
    [coloured_record, lambda seed: with_encoder_noise(seed, 1e-6, 1e-6)],
    ids=["colour", "encoder"],
)
def test_intervals_cover_under_coloured_noise_and_noise_on_the_input(make):
    scores = np.array([z_scores(identify(make(seed), n_modes=3).model) for seed in range(60)])
    # 60 runs: the standard deviation of a coverage of 95 % is 2.8 %, of the mean over all about 1 %.
    assert 0.92 < np.mean(np.abs(scores) < 1.96) < 0.98
    assert np.max(np.abs(np.mean(scores, axis=0))) < 0.5


def with_shared_noise(seed: int, correlation: float, signs: tuple[int, ...] = (1, 1, 1)) -> TimeRecord:
    """Return the beam's record with noise of which all outputs have some in common."""
    record = beam_record(seed, LogChirp(), noise=0.0, encoder=0.0)
    common, *alone = np.random.default_rng(3000 + seed).standard_normal((4, len(record.outputs[0].values)))
    outputs = []
    for output, sign, own in zip(record.outputs, signs, alone, strict=True):
        noise = sign * np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * own
        outputs.append(dataclasses.replace(output, values=output.values + 4e-6 * noise))
    return dataclasses.replace(record, outputs=tuple(outputs))


@pytest.mark.slow
def test_outputs_are_weighed_by_the_noise_that_they_share():
    """Of noise that is nearly the same at all outputs, their differences know more; equal weights do not see it."""
    alone = identify(with_shared_noise(1, 0.0), n_modes=3)
    shared = identify(with_shared_noise(1, 0.97), n_modes=3)
    assert not alone.warnings
    assert not shared.warnings
    assert not any("share" in own.noise for output in alone.records for own in output)
    assert all(
        "white noise, 9" in own.noise and "of it shared" in own.noise
        for output in shared.records
        for own in output
    )
    assert np.all(shared.model.natural_frequency_sd[:2] < 0.5 * alone.model.natural_frequency_sd[:2])
    assert np.max(np.abs(z_scores(shared.model))) < 4.0


@pytest.mark.verify
@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, 1)])
@pytest.mark.parametrize("correlation", [0.3, 0.97])
def test_intervals_cover_under_noise_that_outputs_share(correlation, signs):
    results = [identify(with_shared_noise(seed, correlation, signs), n_modes=3) for seed in range(60)]
    scores = np.array([z_scores(result.model) for result in results])
    # As above: 1 % over all scores of 60 runs.
    assert 0.93 < np.mean(np.abs(scores) < 1.96) < 0.97
    assert np.mean([bool(result.warnings) for result in results]) < 0.1


def with_stamp_jitter(seed: int, sd_s: float, encoder_sd: float = 0.0) -> TimeRecord:
    record = with_encoder_noise(seed, encoder_sd, encoder_sd) if encoder_sd else beam_record(seed)
    late = sd_s * np.random.default_rng(2000 + seed).standard_normal(len(record.outputs[0].times_s))
    outputs = [OutputSignal(o.name, "m", o.times_s + late, o.values, o.exposure_s) for o in record.outputs]
    return TimeRecord(record.inputs, tuple(outputs))


@pytest.mark.slow
@pytest.mark.parametrize("encoder_sd", [pytest.param(0.0, marks=pytest.mark.verify), 2e-7])
def test_stamps_that_scatter_are_late_for_all_outputs_at_once(encoder_sd):
    scores = []
    for seed in (0, 2, 3, 4):
        found = identify(with_stamp_jitter(seed, 1e-4, encoder_sd), n_modes=3)
        model = found.model
        clock = [model.latency / model.latency_sd, model.clock_rate / model.clock_rate_sd]
        scores.append([*z_scores(model)[:6], *clock])
        # Noise of one level, as large as the jitter makes it, would leave 8 mHz.
        assert model.natural_frequency_sd[1] / (2.0 * np.pi) < 1e-3
        assert not [said for said in found.warnings if "white" in said or "Outliers" in said]
        (noise,) = {record.noise for output in found.outputs for record in output.records}
        sd_us = float(noise.removeprefix("stamps that scatter by ").removesuffix(" us"))
        assert sd_us == pytest.approx(100.0, rel=0.07)
    power = np.mean(np.square(scores), axis=0)
    # Latency, clock rate and first frequency go together: 1 +- 0.7 of chi-squared over 4. With noise that is taken
    # to be independent from output to output these seeds give 2.9 to 3.5.
    assert np.mean(power[[0, 6, 7]]) < 2.2
    assert np.mean(power) < 1.7


@pytest.mark.slow
def test_stamps_that_do_not_scatter_are_not_said_to():
    steady = identify(beam_record(1), n_modes=3)
    assert {record.noise for output in steady.outputs for record in output.records} == {""}
