"""How late stamps are, known while the camera runs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ros.vision.measurement.lateness import ENOUGH_S, LatenessWatch

START = 1_700_000_000_000_000_000


def run(
    watch: LatenessWatch, late_s: float, seconds: float, rng: np.random.Generator, moves_from: float = 3.0
) -> int:
    """Feed a hub at 100 Hz that begins to chirp, and frames at 200 Hz; return the second in which all is known."""

    def hub(t: float) -> float:
        since = max(0.0, t - moves_from)
        return 3e-3 * min(1.0, since) * math.sin(2 * math.pi * (0.8 + 0.2 * since) * since)

    known = 0
    for tick in range(round(seconds * 200)):
        t = tick / 200
        if tick % 2 == 0:
            watch.add_hub(START + round(t * 1e9), hub(t))
        seen = hub(t) + 5e-6 * rng.standard_normal() if tick % 17 else math.nan
        watch.add_frame(START + round((t + late_s) * 1e9), seen)
        if tick % 200 == 199:
            watch.look()
            known = known or (tick // 200 + 1 if watch.late_sd_s <= ENOUGH_S else 0)
    return known


@pytest.mark.parametrize("late_s", [0.0, 0.012, 0.35, 0.9])
def test_the_first_seconds_of_motion_tell_how_late_stamps_are(late_s: float) -> None:
    watch = LatenessWatch(200.0)
    known = run(watch, late_s, 9.0, np.random.default_rng(1))
    assert 4 <= known <= 8
    assert watch.late_s == pytest.approx(late_s, abs=4 * watch.late_sd_s + 5e-5)


@pytest.mark.parametrize("back_s", [0.5, 1000.0])
def test_a_clock_that_is_set_back_begins_anew(back_s: float) -> None:
    """What was known by the old clock is as wrong as the clock was set back by."""
    watch = LatenessWatch(200.0)
    run(watch, 2.0, 9.0, np.random.default_rng(4))
    assert watch.late_s == pytest.approx(2.0, abs=1e-3)
    watch.add_frame(START + round((9.0 + 2.0 - back_s) * 1e9), 0.0)
    assert math.isnan(watch.late_s)


def test_a_hub_at_rest_tells_nothing_and_another_camera_begins_anew() -> None:
    watch = LatenessWatch(200.0)
    assert run(watch, 0.2, 3.0, np.random.default_rng(2)) == 0
    assert math.isnan(watch.late_s)
    run(watch, 0.2, 12.0, np.random.default_rng(2))
    assert watch.late_s == pytest.approx(0.2, abs=1e-3)
    watch.restart()
    assert math.isnan(watch.late_s)
    run(watch, 0.7, 9.0, np.random.default_rng(3))
    assert watch.late_s == pytest.approx(0.7, abs=1e-3)
