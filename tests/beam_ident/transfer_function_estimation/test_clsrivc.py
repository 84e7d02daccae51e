from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, estimate_transfer_function
from beam_ident.transfer_function.sampled_controller import SampledController
from beam_ident.transfer_function_estimation.clsrivc import estimate_in_closed_loop
from benchmarks.ident.closed_loop import CONTROLLER, PARAMETERS, PERIOD_S, LoopCase, loop_record


def estimate(record, controller=CONTROLLER, **options):
    return estimate_in_closed_loop(record, controller, 3, 1, "reference", "drive", **options)


def test_without_noise_the_plant_is_exact():
    found = estimate(loop_record(0, 0.0, 300.0, 1500))
    np.testing.assert_allclose(found.model.parameters[:5], PARAMETERS, rtol=1e-6)
    assert found.converged
    assert found.model.input_name == "drive"


@pytest.mark.slow
def test_coloured_noise_in_the_loop_biases_the_open_loop_estimate_and_not_this_one():
    case = LoopCase(0.9, 5.0)
    outcomes = [case.run(seed) for seed in range(3)]
    scores = np.array([(o.estimate - PARAMETERS) / o.sd for o in outcomes])
    plain = np.array([list(o.figures.values()) for o in outcomes])
    sd = np.median([o.sd for o in outcomes], axis=0)
    # The mean of three scores scatters by 0.58; the open-loop estimate of b0 is off by almost three deviations.
    assert np.max(np.abs(scores.mean(axis=0))) < 2.0
    assert (plain - PARAMETERS).mean(axis=0)[3] / sd[3] < -2.0


@pytest.mark.slow
def test_a_gap_leaves_the_colour_and_the_estimate_without_bias():
    errors = []
    for seed in range(3):
        record = loop_record(seed, 0.9, 5.0)
        seen = record.outputs[0].values.copy()
        seen[1000:1010] = np.nan
        gapped = TimeRecord(record.inputs, (OutputSignal("position", "", record.outputs[0].times_s, seen),))
        found = estimate(gapped)
        assert found.noise_coefficients[1] == pytest.approx(-0.9, abs=0.05)
        open_loop = TimeRecord((record.input("drive"),), gapped.outputs)
        plain = estimate_transfer_function(open_loop, 3, 1, method="white")
        errors.append([found.model.numerator[0] - 40.0, plain.model.numerator[0] - 40.0])
    ours, plain_error = np.mean(errors, axis=0)
    assert abs(ours) < 0.5 * abs(plain_error)


@pytest.mark.slow
def test_the_noise_is_whitened_and_its_model_is_returned():
    found = estimate(loop_record(3, 0.9, 10.0))
    assert found.noise_coefficients[1] == pytest.approx(-0.9, abs=0.03)
    assert found.whiteness.is_white


def test_a_reference_added_to_the_input_is_another_loop():
    record = loop_record(0, 0.0, 300.0, 1500)
    # The same loop, its reference filtered by the controller in advance.
    filtered = lfilter(CONTROLLER.numerator, CONTROLLER.denominator, record.input("reference").values)
    moved = TimeRecord(
        (InputSignal("reference", "", (0.0, PERIOD_S), filtered), record.input("drive")), record.outputs
    )
    controller = dataclasses.replace(CONTROLLER, reference_enters="input")
    np.testing.assert_allclose(estimate(moved, controller).model.parameters[:5], PARAMETERS, rtol=1e-6)


def test_irregular_stamps_and_an_offset_are_allowed():
    record = loop_record(1, 0.0, 40.0, 1500)
    output = record.outputs[0]
    keep = np.random.default_rng(0).uniform(size=1500) > 0.2
    seen = OutputSignal("position", "", output.times_s[keep], output.values[keep] + 3.0)
    found = estimate(TimeRecord(record.inputs, (seen,)), has_offset=True)
    scores = (found.model.parameters[:5] - PARAMETERS) / found.model.standard_deviations[:5]
    assert np.max(np.abs(scores)) < 4.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"numerator": np.array([])}, "finite coefficients"),
        ({"denominator": np.array([0.0, 1.0])}, "begins with 0"),
        ({"period_s": 0.0}, "expected a time > 0"),
        ({"reference_enters": "output"}, "expected 'error' or 'input'"),
    ],
)
def test_a_controller_that_cannot_be_is_refused(change, says):
    with pytest.raises(EstimationError, match=says):
        dataclasses.replace(CONTROLLER, **change)


def test_what_does_not_belong_to_the_loop_is_refused():
    record = loop_record(0, 0.0, 20.0, 1000)
    with pytest.raises(EstimationError, match="expected that of the controller"):
        estimate(record, dataclasses.replace(CONTROLLER, period_s=0.01))
    with pytest.raises(EstimationError, match="fewer zeros than poles"):
        estimate_in_closed_loop(record, CONTROLLER, 3, 3, "reference", "drive")
    wrong = SampledController(-20.0 * CONTROLLER.numerator, CONTROLLER.denominator, PERIOD_S)
    with pytest.raises(EstimationError, match="is unstable; check the sign"):
        estimate(record, wrong)
    drive = record.input("drive")
    smooth = InputSignal("drive", "", drive.times_s, drive.values, "linear")
    with pytest.raises(EstimationError, match="a sampled controller holds"):
        estimate(TimeRecord((record.input("reference"), smooth), record.outputs))
    later = InputSignal("drive", "", drive.times_s[1:], drive.values[1:])
    with pytest.raises(EstimationError, match="not sampled at the same instants"):
        estimate(TimeRecord((record.input("reference"), later), record.outputs))


def test_a_controller_may_be_written_with_any_leading_coefficient():
    record = loop_record(0, 0.0, 300.0, 1500)
    twice = dataclasses.replace(
        CONTROLLER, numerator=2.5 * CONTROLLER.numerator, denominator=2.5 * CONTROLLER.denominator
    )
    np.testing.assert_allclose(estimate(record, twice).model.parameters[:5], PARAMETERS, rtol=1e-6)


def test_offset_and_ramp_are_told_at_the_middle_and_over_the_length():
    record = loop_record(1, 0.0, 60.0, 1500)
    output = record.outputs[0]
    late = output.times_s + 0.0
    share = (late - np.mean(late)) / (late[-1] - late[0])
    seen = OutputSignal("position", "", late, output.values + 3.0 - 2.0 * share)
    drifting = TimeRecord(record.inputs, (seen,))
    both = estimate(drifting, has_offset=True, has_ramp=True).records[0]
    assert (both.offset, both.ramp) == pytest.approx((3.0, -2.0), abs=0.02)
    neither = estimate(record).records[0]
    assert (neither.offset, neither.ramp) == (0.0, 0.0)


@pytest.mark.slow
def test_noise_has_its_colour_at_stamps_of_any_spacing_too():
    scores, gains = [], []
    for seed in range(8):
        record = loop_record(seed, 0.9, 10.0, 1500)
        output, kept = record.outputs[0], np.random.default_rng(seed).uniform(size=1500) < 0.6
        seen = OutputSignal(output.name, output.unit, output.times_s[kept], output.values[kept])
        found = estimate(TimeRecord(record.inputs, (seen,)))
        assert found.converged
        assert "Ornstein-Uhlenbeck" in found.records[0].noise
        assert found.whiteness.is_white
        assert any("weighed by their noise" in said for said in found.warnings)
        scores.append((found.model.parameters[:5] - PARAMETERS) / found.model.standard_deviations[:5])
        whole = estimate(record)
        gains.append(found.model.standard_deviations[:5] / whole.model.standard_deviations[:5])
    # 40 correlated scores of an honest estimate have a mean square of 1 +- 0.35; slow noise loses little by gaps.
    assert 0.4 < np.mean(np.square(scores)) < 2.0
    assert np.all(np.median(gains, axis=0) < 1.6)
