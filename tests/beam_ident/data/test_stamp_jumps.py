"""Clocks that jump in the middle of a record."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, identify, validate
from beam_ident.data.stamp_jumps import ClockJump, is_after, possible_jumps, without_jumps
from benchmarks.ident.delay import JumpingClock
from benchmarks.ident.forced_beam import FIXED, FREE, PLAIN
from benchmarks.ident.gaps import Gaps

PERIOD = 0.01


def record(stamps: np.ndarray) -> TimeRecord:
    drive = InputSignal("u", "N", 1e-3 * np.arange(5000), np.zeros(5000))
    return TimeRecord((drive,), (OutputSignal("y", "m", stamps, np.zeros(len(stamps))),))


def test_every_number_of_lost_samples_leaves_another_size_to_a_jump() -> None:
    stamps = PERIOD * np.arange(300) + 0.024 * (np.arange(300) >= 100)
    (sizes,) = possible_jumps(record(stamps), 0, ["u"])
    assert {jump.at_s for jump in sizes} == {stamps[100]}
    np.testing.assert_allclose([jump.size_s for jump in sizes], [0.024, 0.014, 0.004, -0.006], atol=1e-12)


@pytest.mark.parametrize("scatter", [0.0, 1e-4])
def test_steady_and_scattered_stamps_are_not_suspected(scatter: float) -> None:
    stamps = PERIOD * np.arange(300) + scatter * np.random.default_rng(1).standard_normal(300)
    assert possible_jumps(record(stamps), 0, ["u"]) == []


def test_where_many_samples_are_lost_no_interval_says_anything() -> None:
    kept = np.random.default_rng(1).random(1000) > 0.1
    assert possible_jumps(record(PERIOD * np.arange(1000)[kept]), 0, ["u"]) == []


@pytest.mark.slow
def test_a_lost_sample_where_nothing_is_found_ends_in_a_word_of_that() -> None:
    rng = np.random.default_rng(0)
    stamps = np.delete(PERIOD * np.arange(400), 100)
    drive = InputSignal(
        "u", "m", 1e-3 * np.arange(4000), np.cumsum(rng.standard_normal(4000)) * 1e-4, "cubic"
    )
    noise = OutputSignal("y", "m", stamps, rng.standard_normal(len(stamps)))
    with pytest.raises(EstimationError, match=r"no more than chance|no mode"):
        identify(TimeRecord((drive,), (noise,)))


def test_stamps_are_corrected_from_each_jump_on() -> None:
    steady = PERIOD * np.arange(300)
    stamps = steady + 0.024 * (np.arange(300) >= 100) - 0.004 * (np.arange(300) >= 200)
    jumps = [
        ClockJump(0, ("y",), float(stamps[100]), 0.024),
        ClockJump(0, ("y",), float(stamps[200]), -0.004),
    ]
    corrected = without_jumps(record(stamps), 0, jumps).outputs[0].times_s
    np.testing.assert_allclose(corrected, steady, atol=1e-12)
    assert without_jumps(record(stamps), 1, jumps).outputs[0].times_s[-1] == stamps[-1]
    for jump, first in zip(jumps, (100, 200), strict=True):
        np.testing.assert_array_equal(is_after(jump, jumps, corrected), np.arange(300) >= first)


def _without_samples(drive: InputSignal, *places: slice) -> InputSignal:
    kept = np.ones(len(drive.values), dtype=bool)
    for place in places:
        kept[place] = False
    return dataclasses.replace(drive, times_s=drive.times_s[kept], values=drive.values[kept])


def test_a_gap_of_whole_periods_in_an_input_may_be_a_jump_of_its_clock() -> None:
    times = PERIOD * np.arange(300)
    kept = (times < 1.995) | (times > 2.045)  # five samples are lost

    def driven(late: np.ndarray) -> InputSignal:
        return InputSignal("u", "m", (times + late)[kept], np.sin(times)[kept], "cubic")

    drive = driven(0.12 * (times > 0.995))  # none are, where the clock jumps
    assert [gap.missing for gap in drive.gaps] == [12, 5]
    seen = TimeRecord((drive,), (OutputSignal("y", "m", times, np.zeros(300)),))
    (jump,), (other,) = possible_jumps(seen, 0, ["u"])
    np.testing.assert_allclose([jump.size_s, other.size_s], [0.12, 0.05], atol=1e-9)
    assert possible_jumps(seen, 0, ["u"], at_gaps=False) == []
    (found,) = without_jumps(seen, 0, [jump]).inputs
    expected = driven(np.zeros(300))
    np.testing.assert_allclose(found.times_s, expected.times_s, atol=1e-12)
    np.testing.assert_allclose(found.values, expected.values, atol=1e-6)  # a bridge, from elsewhere
    (left,) = found.gaps
    np.testing.assert_allclose([left.start_s, left.end_s], [1.99, 2.05], atol=1e-12)


@pytest.fixture(scope="module")
def case() -> JumpingClock:
    return JumpingClock()


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [1, 7, 115]
)  # the camera's clock, the input's, that by nearly a whole period
def test_a_jump_is_found_at_its_place_and_size_and_does_not_move_the_poles(
    case: JumpingClock, seed: int
) -> None:
    at_s, size, is_input = case.jump(seed)
    result = case.found(seed)
    (jump,) = result.clock_jumps
    assert jump.signals == (("force",) if is_input else ("tip", "root"))
    assert abs(jump.at_s - at_s - size) < 2.0 * case.beam.period
    assert abs(jump.size_s - size) < 4.0 * jump.size_sd < 1e-4
    values, sds = case.flat(result.model)
    assert np.max(np.abs(values - case.truth) / sds) < 4.0
    assert any("jumps by" in said for said in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 7])  # the camera's clock, the input's
def test_validation_takes_a_jump_out_of_an_unseen_record(case: JumpingClock, seed: int) -> None:
    model = case.found(0).model
    steady, unseen = validate(model, case.record(2)), validate(model, case.record(seed))
    assert steady.clock_jumps == ()
    (jump,) = unseen.clock_jumps
    assert abs(jump.size_s - case.jump(seed)[1]) < 4.0 * 2e-5 * np.sqrt(2.0)  # stamps scatter by 20 us
    for own, other in zip(unseen.outputs, steady.outputs, strict=True):
        assert own.scores.fit_percent > other.scores.fit_percent - 0.5
        assert "jumps by" in own.verdict


@pytest.mark.slow
def test_frames_that_were_lost_are_no_jump(case: JumpingClock) -> None:
    whole = case.record(0)
    outputs = [
        dataclasses.replace(
            own, times_s=np.delete(own.times_s, [4000, 4001]), values=np.delete(own.values, [4000, 4001])
        )
        for own in whole.outputs
    ]
    lost = TimeRecord(whole.inputs, tuple(outputs))
    assert possible_jumps(lost, 0, ["force"])
    assert identify(lost, PLAIN, None, FREE, FIXED).clock_jumps == ()


@pytest.mark.slow
@pytest.mark.parametrize("first", [3000, 9000])
def test_samples_of_the_input_that_were_lost_are_no_jump(case: JumpingClock, first: int) -> None:
    whole = case.record(0)
    drive = _without_samples(whole.inputs[0], slice(first, first + 4))
    lost = TimeRecord((drive,), whole.outputs)
    assert possible_jumps(lost, 0, ["force"])
    result = identify(lost, PLAIN, None, FREE, FIXED)
    assert result.clock_jumps == ()
    assert result.model.n_modes == 3
    assert any("Input force has 1 gap" in said for said in result.warnings)


# The longest stretch without a lost message shows two modes of three (24), or little but their ringing (20). Messages
# lost at rest tell nothing of a clock, but that it had jumped would leave other samples out (159).
@pytest.mark.slow
@pytest.mark.parametrize("seed", [24, 20, 159])
def test_lost_messages_while_an_input_sweeps_are_no_jumps_nor_lead_the_search_astray(seed: int) -> None:
    case, phrases = Gaps(), set[str]()
    result = identify(case.record(seed), progress=lambda phrase, _: phrases.add(phrase))
    assert result.clock_jumps == ()
    assert result.model.n_modes == 3
    truth = case.rig.full
    for own, true, sd in (
        (result.model.natural_frequencies, truth.natural_frequencies, result.model.natural_frequency_sd),
        (result.model.damping_ratios, truth.damping_ratios, result.model.damping_ratio_sd),
    ):
        assert np.all(np.abs(own - true[:3]) < 4.0 * sd)
    assert not any("mode 5" in phrase for phrase in phrases)
