"""Channels that are stuck, repeated or copied are named from their samples alone, sound ones are not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    RecordError,
    TimeRecord,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
)
from beam_ident.sensing.damage import damage_warnings, without_repeated

N = 800
TIMES = 0.01 * np.arange(N)
MOVING = np.sin(9.0 * TIMES) + 0.3 * np.sin(23.0 * TIMES + 1.0)
DRIVE = InputSignal("u", "m", (0.0, 0.01), np.cos(TIMES), "linear")
DECAY = np.exp(-1.5 * TIMES) * np.sin(20.0 * TIMES)


def said_of(*channels: np.ndarray, drives: tuple[InputSignal, ...] = ()) -> str:
    """Return what is said of channels at common stamps."""
    return " ".join(
        damage_warnings([OutputSignal(f"y{k}", "m", TIMES, y) for k, y in enumerate(channels)], drives)
    )


def test_a_channel_that_sticks_while_it_moves_is_named_with_its_instant():
    stuck = np.where(np.arange(N) < 500, MOVING, MOVING[500])
    assert "y0 is stuck at" in said_of(stuck)
    assert "from 5 s to 7.99 s (300 samples)" in said_of(stuck)
    counts = np.round(stuck * 200.0)
    assert "is stuck at" in said_of(counts)


@pytest.mark.parametrize("kept", [0.0, None])
def test_a_line_that_drops_out_for_some_samples_is_named(kept):
    dropped = MOVING + 1e-3 * np.random.default_rng(1).standard_normal(N)
    for first in (200, 430, 610):
        dropped[first : first + 8] = dropped[first] if kept is None else kept
    said = said_of(dropped)
    assert "is stuck at" in said
    assert "and 2 times more" in said


@pytest.mark.parametrize("bits", [None, 12])
def test_a_counter_that_overflows_is_named_with_what_unwraps_it(bits):
    counts = 1000.0 * (MOVING + 1e-3 * np.random.default_rng(2).standard_normal(N))
    counts = counts if bits is None else np.round(counts)
    wrapped = (counts + 512.0) % 1024.0 - 512.0
    said = said_of(wrapped)
    period = float(re.search(r"period=([\d.]+)", said).group(1))
    assert period == pytest.approx(1024.0, rel=0.02)
    drive = InputSignal("u", "m", (0.0, 0.01), wrapped, "linear")
    assert "Input u wraps round" in said_of(MOVING, drives=(drive,))


@pytest.mark.parametrize("colour", [0.0, 0.5, -0.5, 0.9, 0.99])
def test_noise_wraps_round_nowhere(colour):
    for seed in range(100):
        noise = lfilter([1.0], [1.0, -colour], np.random.default_rng(seed).standard_normal(N))
        assert not said_of(noise)
        assert not said_of(np.clip(noise, -1.0, 1.0) + 1e-3 * noise)


def test_an_identification_that_fails_names_the_damage():
    rng = np.random.default_rng(3)
    wrapped = (MOVING + 0.5) % 1.0 - 0.5
    record = TimeRecord(
        (InputSignal("u", "N", (0.0, 0.01), rng.standard_normal(N), "zoh"),),
        (OutputSignal("y", "m", TIMES, wrapped),),
    )
    with pytest.raises(EstimationError, match="y wraps round"):
        identify(record, "receptance")


@pytest.mark.parametrize(
    "sound",
    [
        MOVING,
        np.round(MOVING * 200.0),  # rounded
        np.round(MOVING * 4.0),  # coarsely
        DECAY,
        np.round(DECAY * 50.0),  # comes to rest within a step
        np.concatenate([np.zeros(400), MOVING[:400]]),  # begins at rest
        np.where(TIMES < 4.0, 0.0, 1.0),  # a step
        np.sign(np.sin(9.0 * TIMES)) + 0.05 * np.cos(61.0 * TIMES),  # switched to and fro
        np.sign(MOVING) + 0.05 * np.random.default_rng(4).standard_normal(N),
        (2.0 * TIMES) % 1.0,  # a saw
    ],
)
def test_rest_and_rounding_are_no_damage(sound):
    assert not said_of(sound)


def test_frames_that_are_shown_twice_are_named():
    assert "repeat the one before" in said_of(np.repeat(MOVING[::2], 2))
    now_and_then = MOVING.copy()
    now_and_then[20::20] = now_and_then[19::20][: len(now_and_then[20::20])]
    assert "repeat the one before" in said_of(now_and_then)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_frames_that_are_shown_twice_are_left_out(share):
    is_repeated = np.random.default_rng(3).random(N) < share
    is_repeated[0] = False
    shown = np.maximum.accumulate(np.where(is_repeated, 0, np.arange(N)))
    record = TimeRecord((DRIVE,), tuple(OutputSignal(f"y{k}", "m", TIMES, MOVING[shown]) for k in range(2)))
    ((cleaned,), said) = without_repeated([record], ["y1"])
    np.testing.assert_array_equal(cleaned.output("y0").values, MOVING[shown])
    np.testing.assert_array_equal(cleaned.output("y1").is_valid, ~is_repeated)
    assert said == (
        f"Output y1: {np.count_nonzero(is_repeated)} samples repeat the one before, in the middle of a motion, too, "
        "as of a camera that shows a frame twice, or of a sensor that is slower than its stamps. They are left out.",
    )


def test_clipping_rounding_and_rest_are_no_repeated_frames():
    for values in (np.clip(MOVING, -0.5, 0.5), np.round(MOVING * 50.0), np.where(TIMES < 4.0, 0.0, MOVING)):
        record = TimeRecord((DRIVE,), (OutputSignal("y", "m", TIMES, values),))
        assert without_repeated([record], ["y"]) == ([record], ())


@pytest.mark.parametrize(
    ("estimate", "structure"),
    [(identify, ("receptance",)), (estimate_transfer_function, (2, 0)), (estimate_common_poles, (2, 0))],
)
def test_a_sensor_of_half_the_rate_of_its_stamps_is_as_good_as_its_own_samples(estimate, structure):
    rng = np.random.default_rng(0)
    force = np.repeat(rng.standard_normal(N // 10), 10)
    numerator, denominator, _ = cont2discrete(([400.0], [1.0, 0.8, 400.0]), 0.01, "zoh")
    moved = lfilter(np.squeeze(numerator), denominator, force) + 0.01 * rng.standard_normal(N)
    drive = InputSignal("f", "N", (0.0, 0.01), force, "zoh")
    found = []
    for times, values in ((TIMES[::2], moved[::2]), (TIMES, np.repeat(moved[::2], 2))):
        result = estimate(TimeRecord((drive,), (OutputSignal("y", "m", times, values),)), *structure)
        assert any("repeat the one before" in said for said in result.warnings) == (len(times) == N)
        found.append((result.models[0] if estimate is estimate_common_poles else result.model).poles)
    np.testing.assert_allclose(*found, rtol=1e-6)


def test_copies_of_a_channel_or_of_the_input_are_named():
    assert "Outputs y0 and y1 hold the same samples" in said_of(MOVING, MOVING)
    drive = InputSignal("u", "m", (0.0, 0.01), MOVING, "linear")
    assert "Input u and y0 hold the same samples" in said_of(MOVING, drives=(drive,))
    assert not said_of(MOVING, -0.5 * MOVING)
    echo = np.concatenate([np.zeros(3), MOVING[:-3]])
    assert "Input u and y0 hold the same samples, these 3 samples later" in said_of(echo, drives=(drive,))
    assert not said_of(echo + 1e-9 * MOVING, drives=(drive,))


@pytest.mark.parametrize("level", [0.0, 2.5])
def test_an_input_that_never_changes_is_named(level):
    drive = InputSignal("u", "V", (0.0, 0.01), np.full(N, level))
    assert ("Input u is constant (2.5)" in said_of(MOVING, drives=(drive,))) == (level != 0.0)


def test_masked_samples_are_missing_ones_and_no_numbers():
    masked = np.ma.MaskedArray(np.where(TIMES < 1.0, -999.0, MOVING), TIMES < 1.0)
    output = OutputSignal("y", "m", TIMES, masked)
    assert np.count_nonzero(~output.is_valid) == 100
    assert np.array_equal(output.values[output.is_valid], MOVING[100:])
    counts = np.ma.MaskedArray(np.arange(N), TIMES == 0.05)
    assert InputSignal("u", "m", TIMES, counts, "linear").gaps
    with pytest.raises(RecordError, match="complex"):
        OutputSignal("y", "m", TIMES, masked + 0j)


def test_a_force_at_the_end_of_its_sensor_is_named_and_a_commanded_one_is_not():
    blow = 200.0 * np.sin(np.pi * np.clip((TIMES - 1.0) / 0.12, 0.0, 1.0)) ** 2
    clipped = np.minimum(blow, 120.0)
    said = said_of(DECAY, drives=(InputSignal("hammer", "N", TIMES, clipped, "linear"),))
    assert said.startswith("Clipped: 5 samples of input hammer stand at 120")
    assert not said_of(DECAY, drives=(InputSignal("hammer", "N", TIMES, blow, "linear"),))
    assert not said_of(DECAY, drives=(InputSignal("drive", "N", TIMES, clipped, "zoh"),))
    assert not said_of(DECAY, drives=(InputSignal("hub", "m", TIMES, clipped, "cubic"),))
