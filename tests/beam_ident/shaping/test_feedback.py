"""What feedback through a camera could damp, against simulated controllers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ident.errors import EstimationError
from beam_ident.shaping.feedback import dampable_modes
from tests.beam_ident.shaping.beams import beam_model


def envelope(gain: float, tau: float, own_decay: float, length_s: float) -> np.ndarray:
    """Return a mode's envelope under feedback that comes late, step by step."""
    step = tau / 200.0
    values = [1.0] * 201
    for _ in range(int(length_s / step)):
        values.append(values[-1] - step * (own_decay * values[-1] + gain * values[-201]))
    return np.array(values[200:])


def test_the_decay_that_is_promised_is_the_quickest_without_overshoot() -> None:
    first = dampable_modes(beam_model(), delay_s=0.01, delay_sd_s=1e-4, frame_rate_hz=100.0)[0]
    tau = 0.01 + 0.005
    assert first.is_dampable
    best = envelope(1.0 / (math.e * tau), tau, 0.0, 10 * tau)
    assert np.min(best) > 0.0
    assert np.min(envelope(1.3 / (math.e * tau), tau, 0.0, 10 * tau)) < 0.0
    late = best[len(best) // 2 :]
    rate = -np.polyfit(np.arange(len(late)) * tau / 200.0, np.log(late), 1)[0]
    assert first.largest_decay - first.own_decay == pytest.approx(rate, rel=0.25)


def test_a_camera_too_slow_and_a_delay_that_nobody_knows_are_told_apart() -> None:
    slow = dampable_modes(beam_model(), delay_s=0.005, delay_sd_s=0.0, frame_rate_hz=50.0)
    assert [mode.is_dampable for mode in slow] == [True, False]
    assert "frames in a period" in slow[1].verdict
    vague = dampable_modes(beam_model(), delay_s=0.005, delay_sd_s=5e-3, frame_rate_hz=200.0)
    assert [mode.is_dampable for mode in vague] == [True, False]
    assert "uncertain delay" in vague[1].verdict
    assert vague[1].phase_margin < vague[0].phase_margin


def test_without_looking_ahead_a_late_answer_drives_the_second_mode() -> None:
    modes = dampable_modes(beam_model(), delay_s=0.01, delay_sd_s=1e-4, frame_rate_hz=100.0)
    assert modes[0].phase_margin_plain > 0.0 > modes[1].phase_margin_plain
    assert modes[1].delay_phase == pytest.approx(2 * np.pi * 28.0 * 0.015)


@pytest.mark.parametrize("wrong", [{"frame_rate_hz": 0.0}, {"exposure_s": 0.02}, {"delay_s": math.nan}])
def test_numbers_that_no_camera_has_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(EstimationError):
        dampable_modes(beam_model(), **{"delay_s": 0.01, "delay_sd_s": 0.0, "frame_rate_hz": 100.0} | wrong)
