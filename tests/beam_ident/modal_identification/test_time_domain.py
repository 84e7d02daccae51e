from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lsim, sosfilt

from beam_ident import (
    EstimationError,
    InputSignal,
    LogChirp,
    ModalModel,
    ModalStructure,
    ModelFormatError,
    Multisine,
    OutputSignal,
    Prior,
    TimeRecord,
    compare_models,
    identify,
    validate,
)
from beam_ident.modal_estimation import mode_search
from beam_ident.modal_estimation.variable_projection import fit_modes
from benchmarks.ident.gaps import Gaps
from tests.beam_ident.truth import (
    OMEGAS,
    RESIDUAL_TERMS,
    RESIDUES,
    ZETAS,
    beam_record,
    coloured_record,
    z_scores,
)

EXACT_CLOCK = {"latency": Prior(0.0), "clock_rate": Prior(0.0)}


@pytest.fixture(scope="module")
def result():
    return identify(beam_record(1, LogChirp()))


@pytest.mark.slow
def test_three_modes_are_found_without_hints_the_third_above_half_the_frame_rate(result):
    assert result.converged
    np.testing.assert_allclose(result.model.natural_frequencies, OMEGAS, rtol=1e-3)
    assert np.max(np.abs(z_scores(result.model))) < 4.0
    assert not result.warnings


def test_the_order_table_marks_the_choice_and_says_why_others_were_refused(result):
    chosen = [entry for entry in result.orders if entry.is_chosen]
    assert [entry.n_modes for entry in chosen] == [3]
    assert all(entry.refused_because for entry in result.orders if entry.n_modes > 3)


def test_scores_are_given_on_the_deflection_too(result):
    root = result.output("z010")
    assert root.scores.r_squared > 0.9999
    assert root.deflection_scores.r_squared < root.scores.r_squared
    assert root.noise_sd == pytest.approx(4e-6, rel=0.06)  # 3000 samples: 1.3 %


@pytest.mark.slow
def test_without_noise_the_command_gives_the_truth_to_rounding():
    model = identify(beam_record(0, noise=0.0, quantity="acceleration"), "acceleration", n_modes=3).model
    np.testing.assert_allclose(model.natural_frequencies, OMEGAS, rtol=1e-9)
    np.testing.assert_allclose(model.damping_ratios, ZETAS, rtol=1e-5)
    np.testing.assert_allclose(model.residues, RESIDUES, rtol=1e-5)
    assert abs(model.latency) < 1e-9


@pytest.mark.slow
def test_a_latency_of_the_stamps_is_estimated_and_does_not_move_the_poles():
    late = identify(beam_record(2, latency=3.1e-3), n_modes=3).model
    assert abs(late.latency - 3.1e-3) < 4.0 * late.latency_sd
    assert late.latency_sd < 20e-6
    assert np.max(np.abs(z_scores(late))) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("known", [Prior(0.62, 0.05), Prior(0.7, np.inf), Prior(-0.5, 0.1)])
def test_a_latency_far_from_zero_that_is_roughly_known_is_found_there(known):
    late = np.copysign(0.6031, known.mean) * (1.0 if known.mean > 0 else 0.8)
    record = beam_record(2)
    stamps = [replace(own, times_s=own.times_s + late) for own in record.outputs]
    found = identify(replace(record, outputs=tuple(stamps)), n_modes=3, latency=known)
    model = found.model
    assert abs(model.latency - late) < 4.0 * model.latency_sd
    assert model.latency_sd < 20e-6
    assert np.max(np.abs(z_scores(model))) < 4.0
    used, all_of_them = found.outputs[0].times_s, stamps[0].times_s
    np.testing.assert_allclose(used, all_of_them[np.searchsorted(all_of_them, used - 1e-6)], atol=1e-9)


@pytest.mark.slow
def test_a_latency_that_ends_where_the_search_does_is_named():
    """Stamps late by 0.3 s, of a mode of 1 Hz: half a cycle less late is a crest beyond the search as well."""
    rng = np.random.default_rng(7)
    force = rng.standard_normal(3000)
    omega, zeta = 2 * np.pi, 0.05
    damped = omega * np.sqrt(1.0 - zeta**2)
    kernel = np.exp(-zeta * omega * 0.01 * np.arange(3000)) * np.sin(damped * 0.01 * np.arange(3000))
    swing = np.convolve(force, kernel)[:3000]
    noisy = swing + 0.02 * np.std(swing) * rng.standard_normal(3000)
    record = TimeRecord(
        (InputSignal("force", "N", (0.0, 0.01), force),),
        (OutputSignal("x", "m", 0.3 + 0.01 * np.arange(3000), noisy),),
    )
    free = identify(record, "receptance", n_modes=1, latency=Prior(0.0, np.inf)).model
    # The sum stands for blows at the samples, which a force held from there is later than by half of one.
    assert abs(free.latency - 0.295) < 4.0 * free.latency_sd
    found = identify(record, "receptance", n_modes=1, latency=Prior(0.0, 0.1))
    assert abs(found.model.latency) > 0.19
    assert any("where the search does" in said for said in found.warnings)
    known = identify(record, "receptance", n_modes=1, latency=Prior(0.35, 0.1))
    assert known.model.frequencies_hz[0] == pytest.approx(1.0, abs=2e-4)
    assert not any("where the search does" in said for said in known.warnings)


@pytest.mark.slow
def test_a_prior_on_the_clock_reaches_the_stated_uncertainty():
    record = beam_record(3)
    fixed = identify(record, n_modes=3, **EXACT_CLOCK).model
    loose = identify(record, n_modes=3, latency=Prior(0.0), clock_rate=Prior(0.0, np.inf)).model
    tight = identify(record, n_modes=3, latency=Prior(0.0), clock_rate=Prior(0.0, 1e-7)).model
    sd = [model.natural_frequency_sd[0] for model in (fixed, tight, loose)]
    assert sd[0] < sd[1] < sd[2]
    assert fixed.clock_rate_sd == 0.0
    assert tight.clock_rate_sd < 1e-7


@pytest.mark.slow
def test_samples_that_were_not_seen_are_left_out():
    record = beam_record(4)
    rng = np.random.default_rng(0)
    outputs = []
    for output in record.outputs:
        values = output.values.copy()
        values[rng.random(len(values)) < 0.2] = np.nan
        outputs.append(OutputSignal(output.name, "m", output.times_s, values, output.exposure_s))
    model = identify(TimeRecord(record.inputs, tuple(outputs)), n_modes=3).model
    assert np.max(np.abs(z_scores(model))) < 4.0


@pytest.mark.slow
def test_an_irregular_input_gives_the_same_model_as_a_regular_one():
    record = beam_record(5, encoder=0.0)
    drive = record.inputs[0]
    scatter = np.random.default_rng(0).uniform(-0.3e-3, 0.3e-3, len(drive.values))
    scatter[[0, -1]] = 0.0
    times = drive.times_s + scatter
    irregular = InputSignal("hub", "m", times, CubicSpline(drive.times_s, drive.values)(times), "cubic")
    assert irregular.period_s is None
    assert not irregular.gaps
    model = identify(TimeRecord((irregular,), record.outputs), n_modes=3).model
    assert np.max(np.abs(z_scores(model))) < 4.0


@pytest.mark.slow
def test_an_input_that_lacks_three_hundred_samples_gives_the_same_model_as_a_whole_one():
    record = beam_record(5)
    drive = record.inputs[0]
    keep = np.ones(len(drive.values), dtype=bool)
    keep[np.random.default_rng(0).choice(np.arange(10, len(keep) - 10), 300, replace=False)] = False
    holed = InputSignal("hub", "m", drive.times_s[keep], drive.values[keep], "cubic")
    assert sum(gap.missing for gap in holed.gaps) == 300
    model = identify(TimeRecord((holed,), record.outputs), n_modes=3).model
    assert np.max(np.abs(z_scores(model))) < 4.0


@pytest.mark.slow
def test_a_long_hole_at_the_beginning_is_no_reason_to_take_outputs_for_late():
    """Filled badly, it looks like a passage of the sweep, and what a mode answers to that like its answer."""
    study = Gaps()
    model = identify(study.record(25)).model
    assert not model.own_clocks
    np.testing.assert_allclose(model.natural_frequencies, study.truth[:3], rtol=1e-3)


@pytest.mark.slow
def test_a_band_limited_hold_makes_up_for_an_input_sampled_at_three_times_its_band():
    record = beam_record(5, encoder=0.0, noise=1e-6)
    drive = record.inputs[0]
    scores = {}
    for hold in ("cubic", "band_limited"):
        slow = InputSignal("hub", "m", drive.times_s[::4], drive.values[::4], hold)
        model = identify(TimeRecord((slow,), record.outputs), n_modes=3).model
        scores[hold] = np.max(np.abs(z_scores(model)[6:15]))
    # At 250 Hz a cubic spline leaves 95 % of a tone of 79 Hz, one of degree 9 all but 0.05 %.
    assert scores["band_limited"] < 4.0
    assert scores["cubic"] > 5.0


@pytest.mark.slow
def test_two_records_share_a_model_and_halve_its_variance():
    one = identify(beam_record(6), n_modes=3, **EXACT_CLOCK).model
    both = identify([beam_record(6), beam_record(7)], n_modes=3, **EXACT_CLOCK).model
    ratio = one.natural_frequency_sd / both.natural_frequency_sd
    np.testing.assert_allclose(ratio, np.sqrt(2.0), rtol=0.05)
    assert np.max(np.abs(z_scores(both))) < 4.0


def drifted(record: TimeRecord, offset: float, drift_per_s: float) -> TimeRecord:
    outputs = tuple(
        OutputSignal(o.name, "m", o.times_s, o.values + offset + drift_per_s * o.times_s, o.exposure_s)
        for o in record.outputs
    )
    return TimeRecord(record.inputs, outputs)


@pytest.mark.slow
def test_experiments_of_different_kinds_share_the_beam_and_keep_their_own_offset_drift_and_start():
    multisine = Multisine(n_periods=1, line_period=8.0, still=4.0)
    records = [
        drifted(beam_record(10).between(2.0, 12.0), 1e-3, 5e-5),
        drifted(beam_record(11, multisine).between(1.0, 10.0).select(["z225", "z285"]), -2e-3, -1e-4),
    ]
    found = identify(records, n_modes=3, **EXACT_CLOCK)
    assert np.max(np.abs(z_scores(found.model))) < 4.0
    assert len(found.output("z225").residuals) > len(found.output("z010").residuals)
    for output in found.outputs:
        assert output.noise_sd == pytest.approx(4e-6, rel=0.08)  # 900 samples: 2.4 %


@pytest.mark.slow
def test_one_part_of_a_record_is_validated_by_the_other():
    record = beam_record(12)
    model = identify(record.between(0.0, 10.0), n_modes=3).model
    for output in validate(model, record.between(10.0, 17.0)).outputs:
        assert 0.85 < output.noise_ratio < 1.15


@pytest.mark.slow
def test_offset_ramp_and_a_moving_start_do_not_bias_the_poles():
    record = beam_record(8).between(3.0, 13.0)
    moved = drifted(record, 1e-3, 5e-5)
    model = identify(moved, n_modes=3).model
    assert np.max(np.abs(z_scores(model))) < 4.0
    without = identify(
        moved, ModalStructure(has_free_response=False, has_offset=False, has_ramp=False), n_modes=3
    )
    assert np.max(np.abs(z_scores(without.model)[:6])) > 10.0


@pytest.mark.slow
def test_models_of_two_records_agree_and_a_changed_model_does_not(result):
    other = identify(beam_record(9), n_modes=3).model
    same = compare_models(result.model, other)
    assert same.degrees_of_freedom == 6
    assert same.p_value > 1e-3
    moved = {**other.to_dict(), "damping_ratios": (1.2 * other.damping_ratios).tolist()}
    assert compare_models(result.model, ModalModel.from_dict(moved)).p_value < 1e-6


def test_a_model_survives_json_exactly(result):
    model = result.model
    again = ModalModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(again.parameters, model.parameters)
    np.testing.assert_array_equal(again.covariance, model.covariance)
    assert again.parameter_names == model.parameter_names
    with pytest.raises(ModelFormatError, match="schema 99"):
        ModalModel.from_dict({**model.to_dict(), "schema": 99})
    short = model.to_dict()
    del short["gains"]
    with pytest.raises(ModelFormatError, match="'gains' is missing"):
        ModalModel.from_dict(short)


def test_simulation_reproduces_the_fit(result):
    record = beam_record(1, LogChirp())
    output = result.output("z285")
    simulated = result.model.simulate(record.inputs[0], output.times_s - result.model.latency, 5e-3)[:, 2]
    # What is left: offset, ramp, free response and clock rate, all at the level of the noise.
    assert np.std(simulated - output.modelled) < 1e-6


def test_the_frequency_response_has_bands_that_cover_the_truth(result):
    omegas = 2.0 * np.pi * np.geomspace(2.0, 90.0, 40)
    s = 1j * omegas[:, None]
    truth = 1.0 - s**2 * (
        sum(RESIDUES[:, i] / (s**2 + 2 * ZETAS[i] * OMEGAS[i] * s + OMEGAS[i] ** 2) for i in range(3))
        + RESIDUAL_TERMS
    )
    found = result.model.frequency_response(omegas)
    z = (np.abs(found.response) - np.abs(truth)) / found.magnitude_sd
    assert np.max(np.abs(z)) < 4.5
    assert np.max(np.abs(np.angle(found.response / truth)) / found.phase_sd) < 4.5


@pytest.mark.slow
def test_input_noise_that_matters_is_flagged():
    record = beam_record(1, encoder=0.0)
    for sigma, is_flagged in ((1e-9, False), (1e-6, True)):
        drive = InputSignal("hub", "m", record.inputs[0].times_s, record.inputs[0].values, "cubic", sigma)
        found = identify(TimeRecord((drive,), record.outputs), n_modes=3)
        assert any("Noise on the input" in text for text in found.warnings) is is_flagged


def test_a_free_decay_is_identified_and_said_to_be_one():
    times = np.arange(0.0, 10.0, 0.01)
    pole = complex(-0.05, 20.0)
    rng = np.random.default_rng(0)
    values = np.real(1e-3 * np.exp(pole * times)) + 1e-6 * rng.standard_normal(len(times))
    drive = InputSignal("hub", "m", (0.0, 0.01), np.zeros(1001), "linear")
    found = identify(TimeRecord((drive,), (OutputSignal("tip", "m", times, values),)))
    assert found.model.n_modes == 1
    assert found.model.poles[0] == pytest.approx(pole, rel=1e-4)
    assert any("stands still" in text for text in found.warnings)


def make_small(values, n_input=2000):
    drive = InputSignal("hub", "m", (0.0, 0.001), np.sin(np.arange(n_input) * 0.03), "cubic")
    return TimeRecord((drive,), (OutputSignal("tip", "m", (0.0, 0.01), values),))


def still_record() -> TimeRecord:
    """Return a record of noise under an input that does not move."""
    drive = InputSignal("hub", "m", (0.0, 0.001), np.full(2000, 0.1), "linear")
    noise = np.random.default_rng(0).normal(size=190)
    return TimeRecord((drive,), (OutputSignal("tip", "m", (0.0, 0.01), noise),))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: identify(make_small(np.ones(150))), "is constant"),
        (lambda: identify(make_small(np.arange(10.0))), "has 10 samples"),
        (lambda: identify(make_small(np.random.default_rng(0).normal(size=60)), n_modes=5), "for 5 modes"),
        (lambda: identify(make_small(np.arange(150.0)), n_modes=0), "n_modes is 0"),
        (lambda: identify(make_small(np.arange(150.0)), n_modes=41), "n_modes is 41"),
        (lambda: identify(make_small(np.arange(150.0)), "torque"), "structure is 'torque'"),
        (lambda: identify(make_small(1e200 * np.random.default_rng(0).normal(size=190))), "reaches 2.4e"),
        (lambda: identify(make_small(1e-200 * np.random.default_rng(0).normal(size=190))), "reaches 2.4e"),
        (lambda: identify(still_record()), "no mode between"),
        (
            lambda: identify(still_record(), ModalStructure(has_free_response=False), n_modes=1),
            "leaves out motion at the beginning",
        ),
        (lambda: identify(make_small(np.arange(150.0)), max_modes=0), "max_modes is 0"),
        (lambda: identify([]), "no record"),
        (lambda: identify(make_small(np.random.default_rng(0).normal(size=190))), "stands out of the noise"),
        (lambda: Prior(0.0, -1.0), "expected a finite mean and sd >= 0"),
    ],
)
def test_hopeless_requests_are_refused_with_what_is_wrong(call, says):
    with pytest.raises(EstimationError, match=says):
        call()


@pytest.mark.slow
def test_more_modes_than_there_are_end_with_a_warning_for_each_that_is_not_there():
    found = identify(beam_record(1), n_modes=5)
    assert found.model.n_modes == 5
    assert sum(text.startswith("Mode ") for text in found.warnings) >= 2
    real = [int(np.argmin(np.abs(found.model.natural_frequencies - omega))) for omega in OMEGAS]
    np.testing.assert_allclose(found.model.natural_frequencies[real], OMEGAS, rtol=2e-3)


@pytest.mark.verify
def test_the_highest_order_ends():
    found = identify(beam_record(1), n_modes=40)
    assert found.model.n_modes <= 40
    assert found.warnings


def test_a_held_position_is_refused_as_it_makes_the_deflection_jump():
    drive = InputSignal("hub", "m", (0.0, 0.001), np.sin(np.arange(2000) * 0.03), "zoh")
    record = TimeRecord((drive,), (OutputSignal("tip", "m", (0.0, 0.01), np.arange(190.0)),))
    with pytest.raises(EstimationError, match="hold='linear', 'cubic' or 'band_limited'"):
        identify(record)


@pytest.mark.verify
def test_intervals_cover_the_truth_over_many_records():
    scores = np.array([z_scores(identify(beam_record(seed), n_modes=3).model) for seed in range(200)])
    covered = np.mean(np.abs(scores) < 1.96, axis=0)
    # 200 runs: the standard deviation of a coverage of 95 % is 1.5 %, and of 21 such one is below 89 % once in 100.
    assert np.all(covered >= 0.89)
    assert 0.93 < np.mean(covered) < 0.97
    assert np.max(np.abs(np.mean(scores, axis=0))) < 0.3


def test_a_model_predicts_a_record_that_it_has_not_seen(result):
    prediction = validate(result.model, beam_record(20, Multisine(n_periods=1, line_period=8.0, still=4.0)))
    for output in prediction.outputs:
        assert 0.9 < output.noise_ratio < 1.1
        assert output.input_correlation.is_independent
    wrong = ModalModel.from_dict(
        {
            **result.model.to_dict(),
            "natural_frequencies_rad_s": (1.01 * result.model.natural_frequencies).tolist(),
        }
    )
    assert validate(wrong, beam_record(21)).output("z225").noise_ratio > 10.0
    with pytest.raises(EstimationError, match="the model goes from hub to"):
        validate(result.model, make_small(np.arange(150.0)))


@pytest.mark.slow
def test_coloured_noise_is_seen_and_widens_the_intervals_of_slow_modes():
    found = identify(coloured_record(1), n_modes=3, **EXACT_CLOCK)
    assert any("not white" in text for text in found.warnings)
    white = identify(beam_record(1, noise=float(found.outputs[0].noise_sd)), n_modes=3, **EXACT_CLOCK).model
    # An AR(1) noise of 0.8 has 3.6 times the mean density at 4.4 Hz, 1.9 in standard deviation,
    # and 0.3 times at the alias of 79 Hz.
    ratio = found.model.natural_frequency_sd / white.natural_frequency_sd
    assert 1.7 < ratio[0] < 2.1
    assert ratio[2] < 0.9
    assert np.max(np.abs(z_scores(found.model))) < 4.0


@pytest.mark.slow
def test_offset_and_ramp_are_told_at_the_middle_and_over_the_length():
    record = beam_record(2, noise=1e-7, encoder=0.0)
    outputs = []
    for j, output in enumerate(record.outputs):
        share = (output.times_s - np.mean(output.times_s)) / np.ptp(output.times_s)
        values = output.values + (j + 1) * (2e-4 - 3e-4 * share)
        outputs.append(OutputSignal(output.name, "m", output.times_s, values, output.exposure_s))
    found = identify(TimeRecord(record.inputs, tuple(outputs)), n_modes=3, **EXACT_CLOCK)
    for j, output in enumerate(found.outputs):
        own = output.records[0]
        assert (own.offset, own.ramp) == pytest.approx(((j + 1) * 2e-4, -(j + 1) * 3e-4), rel=0.02)
    plain = identify(record, ModalStructure(has_offset=False, has_ramp=False), n_modes=3, **EXACT_CLOCK)
    assert {(output.records[0].offset, output.records[0].ramp) for output in plain.outputs} == {(0.0, 0.0)}


@pytest.mark.slow
def test_no_order_is_tried_twice_where_a_sensor_has_a_filter_that_the_model_lacks():
    """A fit that nothing follows from is not searched on from again; a filter takes many orders to explain."""
    rng = np.random.default_rng(2)
    t = 0.01 * np.arange(400)
    force = sosfilt(butter(4, (0.01, 0.4), "band", output="sos"), rng.standard_normal(len(t)))
    omega, zeta = 2.0 * np.pi * 3.1, 0.02
    plant = ([1.0], [1.0, 2.0 * zeta * omega, omega**2])
    seen = sosfilt(butter(3, 0.6, output="sos"), lsim(plant, force, t)[1])
    seen += 1e-3 * np.std(seen) * rng.standard_normal(len(t))
    record = TimeRecord((InputSignal("force", "N", t, force),), (OutputSignal("tip", "m", t, seen),))
    result = identify(record, "receptance")
    tried = [(entry.n_modes, round(entry.bic, 6)) for entry in result.orders]
    assert len(tried) > 4
    assert len(set(tried)) == len(tried)
    assert np.min(np.abs(result.model.natural_frequencies / omega - 1.0)) < 0.02


@pytest.mark.slow
def test_what_no_mode_explains_is_left_alone_after_a_few_steps(monkeypatch):
    """Channels that were swapped in mid-record leave much that no number of modes explains."""
    rng = np.random.default_rng(3)
    t = 0.005 * np.arange(1500)
    force = sosfilt(butter(4, (0.01, 0.6), "band", output="sos"), rng.standard_normal(len(t)))
    seen = np.zeros((len(t), 2))
    for hertz, zeta, shape in (
        (3.1, 0.008, (1.0, 0.6)),
        (11.7, 0.02, (-30.0, 40.0)),
        (29.0, 0.005, (80.0, 20.0)),
    ):
        omega = 2.0 * np.pi * hertz
        seen += np.outer(lsim(([1.0], [1.0, 2.0 * zeta * omega, omega**2]), force, t)[1], shape)
    seen += 3e-3 * np.std(seen, axis=0) * rng.standard_normal(seen.shape)
    seen[len(t) // 2 :] = seen[len(t) // 2 :, ::-1]
    outputs = tuple(OutputSignal(name, "m", t, seen[:, j]) for j, name in enumerate("ab"))
    steps = []

    def counted(problem, omegas, *rest, **options):
        fit = fit_modes(problem, omegas, *rest, **options)
        steps.append(len(omegas) * fit.iterations)
        return fit

    monkeypatch.setattr(mode_search, "fit_modes", counted)
    result = identify(
        TimeRecord((InputSignal("force", "N", t, force),), outputs), "receptance", latency=Prior(0.0, 0.01)
    )
    assert 500 < sum(steps) < 2500  # 5000 where each of many orders is refined in full
    assert result.model.natural_frequencies / (2.0 * np.pi) == pytest.approx([29.0], rel=1e-3)
    assert any("Misfit" in warning for warning in result.warnings)


def test_motion_at_the_beginning_is_found_behind_frames_from_long_before_the_input():
    rng = np.random.default_rng(5)
    force = 0.02 * rng.standard_normal(1200)
    times = 0.01 * np.arange(1, 1200)
    plant = ModalModel(
        "receptance", "u", ("y",), np.array([20.0]), np.array([0.03]), np.array([[400.0]]), *np.zeros((2, 1)),
        0.0, 0.0, np.zeros((7, 7)), np.ones(1),
    )  # fmt: skip
    drive = InputSignal("u", "N", (0.0, 0.01), force, "zoh")
    ringing = np.exp(-0.6 * times) * np.cos(20.0 * np.sqrt(1.0 - 0.03**2) * times)
    seen = plant.simulate(drive, times)[:, 0] + ringing + 0.002 * rng.standard_normal(len(times))
    early = 0.01 * np.arange(-100_000, -99_900)
    output = OutputSignal("y", "m", np.r_[early, times], np.r_[0.01 * rng.standard_normal(100), seen])
    found = identify(TimeRecord((drive,), (output,)), "receptance", n_modes=1)
    assert abs(found.model.natural_frequencies[0] - 20.0) < 4.0 * found.model.natural_frequency_sd[0]
    assert abs(found.model.damping_ratios[0] - 0.03) < 4.0 * found.model.damping_ratio_sd[0]
    assert found.outputs[0].scores.r_squared > 0.99
