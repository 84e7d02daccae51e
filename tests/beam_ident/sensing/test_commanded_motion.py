"""A motion is taken from its commands where the encoder cannot contradict them, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp
from beam_ident.sensing.commanded_motion import as_commanded

PERIOD_S = 1e-3
NOISE = 20e-6
EXCITATION = LogChirp(duration=8.0, still=4.0).sample(PERIOD_S)
COMMANDED = EXCITATION.positions
TIMES = PERIOD_S * np.arange(len(COMMANDED))


def measured(motion: np.ndarray, seed: int = 0, quantum: float = 1e-7) -> InputSignal:
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(motion))
    return InputSignal(
        "hub", "m", (0.0, PERIOD_S), quantum * np.round((motion + noise) / quantum), "cubic", NOISE
    )


def test_noise_alone_does_not_contradict_and_is_left_out():
    # What no command tells: where the hub was, and with which speed.
    reference = COMMANDED - 0.02 - 1e-3 * TIMES
    led = as_commanded(measured(COMMANDED), reference)
    assert led is not None
    assert led.sigma == 0.0
    # A constant and a drift are known to 2 sigma / sqrt(n) where they are known worst, at the ends.
    assert np.max(np.abs(led.values - COMMANDED)) < 4.0 * 2.0 * NOISE / np.sqrt(len(COMMANDED))


@pytest.mark.slow
def test_a_motion_as_commanded_is_believed_nearly_always():
    contradicted = [as_commanded(measured(COMMANDED, seed), COMMANDED) is None for seed in range(100)]
    # Two tests at 1e-3 each: 0.2 expected, four or more once in 17 000.
    assert sum(contradicted) <= 3


def lagging(time_constant: float) -> np.ndarray:
    """Return the motion of a servo of first order."""
    result, state = np.empty_like(COMMANDED), 0.0
    share = 1.0 - np.exp(-PERIOD_S / time_constant)
    for k, value in enumerate(COMMANDED):
        state += share * (value - state)
        result[k] = state
    return result


@pytest.mark.parametrize(
    "motion",
    [
        1.002 * COMMANDED,
        np.interp(TIMES - 1e-4, TIMES, COMMANDED),
        lagging(5e-4),
        np.where(TIMES > 5.0, COMMANDED + 8e-6, COMMANDED),
        COMMANDED + 5e-6 * np.sin(2.0 * np.pi * 50.0 * TIMES),
    ],
    ids=["scale", "delay", "servo", "slip", "hum"],
)
def test_a_motion_that_is_not_as_commanded_is_left_as_measured(motion):
    assert as_commanded(measured(motion), COMMANDED) is None


def test_a_coarse_encoder_that_never_counts_wrongly_does_not_contradict():
    count = 7e-5
    # Its differences are no noise: at rest they stand still.
    drive = InputSignal("hub", "m", (0.0, PERIOD_S), count * np.round(COMMANDED / count), "cubic", 2e-5)
    led = as_commanded(drive, COMMANDED)
    assert led is not None
    assert np.ptp(led.values - COMMANDED) < 1e-12
    lost = drive.values + np.where(TIMES > 6.0, count, 0.0)
    assert as_commanded(InputSignal("hub", "m", (0.0, PERIOD_S), lost, "cubic", 2e-5), COMMANDED) is None


def test_samples_that_were_lost_are_taken_from_the_command():
    drive = measured(COMMANDED)
    seen = ~((TIMES > 3.0) & (TIMES < 3.05))
    holed = InputSignal("hub", "m", (0.0, PERIOD_S), np.where(seen, drive.values, np.nan), "cubic", NOISE)
    assert holed.gaps
    led = as_commanded(holed, COMMANDED, seen)
    assert led is not None
    assert [(gap.missing, gap.sigma) for gap in led.gaps] == [(np.count_nonzero(~seen), 0.0)]
    assert np.max(np.abs(led.values - COMMANDED)) < 1.5e-6


def test_commands_that_are_not_wholly_known_say_nothing():
    reference = np.where(TIMES < 0.1, np.nan, COMMANDED)
    assert as_commanded(measured(COMMANDED), reference) is None
