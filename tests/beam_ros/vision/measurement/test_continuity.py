from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.measurement.continuity import FrameContinuity

PERIOD = 10_000_000


def test_frames_in_line_are_next_whatever_their_jitter():
    rng = np.random.default_rng(1)
    watch = FrameContinuity(PERIOD)
    steps = [watch.observe(10**18 + k * PERIOD + int(rng.integers(-(10**6), 10**6))) for k in range(500)]
    assert [step.step for step in steps] == ["first"] + ["next"] * 499
    assert (watch.frames, watch.missing) == (500, 0)


def test_a_camera_that_runs_beside_its_nominal_rate_is_followed():
    watch = FrameContinuity(PERIOD)
    assert all(watch.observe(k * 10_700_000).missing == 0 for k in range(1, 1000))
    assert watch.rate_hz == pytest.approx(1e9 / 10_700_000, rel=1e-3)


@pytest.mark.parametrize("rate_hz", [25, 50, 60, 200, 400])
def test_the_period_is_measured_where_it_is_another_than_was_believed(rate_hz):
    watch = FrameContinuity(PERIOD)
    rng = np.random.default_rng(2)
    period = 10**9 // rate_hz
    stamps = [10**18 + k * period + int(rng.integers(-period // 20, period // 20)) for k in range(60)]
    steps = [watch.observe(stamp) for stamp in stamps]
    assert [step.missing for step in steps[10:]] == [0] * 50
    assert watch.missing == 0  # nor those that were believed to be missing at first
    assert watch.rate_hz == pytest.approx(rate_hz, rel=0.03)
    assert watch.observe(stamps[-1] + 4 * period).missing == 3


def stamps_of(ticks, period, jitter, seed):
    """Stamps at these multiples of a period, each off by up to so much of it."""
    off = np.random.default_rng(seed).uniform(-jitter, jitter, len(ticks))
    return (10**18 + ((np.asarray(ticks) + off) * period).astype(np.int64)).tolist()


@pytest.mark.parametrize("rate_hz", [15, 30, 60, 240, 400, 1000])
@pytest.mark.parametrize("jitter", [0.2, 0.4])
def test_the_period_is_measured_of_stamps_that_jitter(rate_hz, jitter):
    """As those that a driver takes at the arrival of a webcam's frames: a mean over a hundred is known to 2 %."""
    watch = FrameContinuity(PERIOD)
    stamps = stamps_of(np.arange(600), 10**9 // rate_hz, jitter, rate_hz)
    for stamp in stamps[:200]:
        watch.observe(stamp)
    known = watch.missing
    for stamp in stamps[200:]:
        watch.observe(stamp)
    assert watch.rate_hz == pytest.approx(rate_hz, rel=0.08)
    # Nothing is lost; a late frame that counts as missing is given back as the next one is early.
    assert (known, watch.missing) == (pytest.approx(0, abs=8), pytest.approx(0, abs=16))


@pytest.mark.parametrize("rate_hz", [60, 900, 5000])
def test_frames_that_come_at_random_come_at_their_mean_rate(rate_hz):
    """Of a flood, of which some are lost and others wait, nobody can say which: the rate is that of what came."""
    watch = FrameContinuity(PERIOD)
    for stamp in 10**18 + np.cumsum(np.random.default_rng(6).exponential(1e9 / rate_hz, 2000)).astype(
        np.int64
    ):
        watch.observe(int(stamp))
    assert rate_hz / 2 < watch.rate_hz < 2 * rate_hz


@pytest.mark.parametrize("longest", [4, 20])
def test_frames_that_wait_and_come_all_at_once_are_not_missing(longest):
    """A computer that is held up for some frames, again and again, stamps them as it finds them."""
    rng = np.random.default_rng(4)
    watch = FrameContinuity(PERIOD)
    arrival, now = [k * PERIOD for k in range(100)], 99
    while len(arrival) < 900:
        now += int(rng.integers(1, longest + 1))
        arrival += (now * PERIOD + np.cumsum(rng.integers(50_000, 150_000, now + 1 - len(arrival)))).tolist()
    steps = [watch.observe(10**18 + stamp) for stamp in arrival]
    assert watch.missing == pytest.approx(0, abs=4)
    assert watch.rate_hz == pytest.approx(100.0, rel=0.03)
    assert sum(step.missing for step in steps) > 100  # nobody knew yet that these would come


def test_frames_that_are_lost_unevenly_are_missing_though_their_stamps_jitter():
    watch = FrameContinuity(PERIOD)
    ticks = np.cumsum(np.random.default_rng(3).choice([1, 2, 3], 300))
    for stamp in stamps_of(ticks, PERIOD, 0.2, 5):
        watch.observe(stamp)
    assert watch.missing == ticks[-1] - ticks[0] - 299
    assert watch.rate_hz == pytest.approx(100.0, rel=0.02)


def test_frames_that_are_lost_unevenly_are_missing():
    watch = FrameContinuity(PERIOD)
    ticks = np.cumsum(np.random.default_rng(3).choice([1, 2, 3], 300))
    for tick in ticks:
        watch.observe(int(tick) * PERIOD)
    assert watch.missing == ticks[-1] - ticks[0] - 299
    assert watch.rate_hz == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("missing", [1, 2, 7])
def test_dropped_frames_are_counted_from_stamps(missing):
    watch = FrameContinuity(PERIOD)
    watch.observe(0)
    step = watch.observe((missing + 1) * PERIOD + 300_000)
    assert (step.step, step.missing, step.is_usable) == ("gap", missing, True)
    assert watch.missing == missing


def test_the_cameras_own_numbers_come_before_the_stamps():
    watch = FrameContinuity(PERIOD)
    watch.observe(0, sequence=5)
    assert watch.observe(2 * PERIOD, sequence=6).missing == 0
    assert watch.observe(3 * PERIOD, sequence=9).missing == 2
    assert watch.observe(4 * PERIOD, sequence=9).step == "repeated"


def test_repeated_and_past_frames_are_not_usable_and_change_nothing():
    watch = FrameContinuity(PERIOD)
    watch.observe(PERIOD)
    for step in (watch.observe(PERIOD), watch.observe(0)):
        assert not step.is_usable
    assert watch.observe(2 * PERIOD).step == "next"
    assert (watch.frames, watch.repeated, watch.backwards, watch.missing) == (2, 1, 1, 0)


def test_a_restarted_number_is_no_gap():
    watch = FrameContinuity(PERIOD)
    watch.observe(0, sequence=900)
    assert watch.observe(PERIOD, sequence=0).step == "next"


def test_reset_starts_anew():
    watch = FrameContinuity(PERIOD)
    watch.observe(10**18)
    watch.reset()
    assert watch.observe(5).step == "first"
    with pytest.raises(VisionParameterError, match="0 ns"):
        FrameContinuity(0)
