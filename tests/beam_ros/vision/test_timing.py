from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.timing import FrameTiming, exposure_weights
from tests.beam_ros.vision.packaged_rig import packaged_camera

START = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("meaning", "after_start_ns"),
    [("start", 0), ("mid", 4_500_000), ("end", 9_000_000), ("arrival", 9_000_000)],
)
def test_every_meaning_of_the_stamp_leads_back_to_the_same_exposure(meaning, after_start_ns):
    camera = packaged_camera(exposure_s=0.005, readout_s=0.004, stamp=meaning, latency_s=0.001)
    timing = FrameTiming(camera)
    stamp = timing.stamp(START)
    assert stamp == START + after_start_ns + 1_000_000
    assert timing.start(stamp) == START
    assert timing.end(stamp) == START + 9_000_000


def test_rows_are_read_one_after_the_other():
    camera = packaged_camera(height=481, exposure_s=0.002, readout_s=0.008, stamp="start")
    timing = FrameTiming(camera)
    assert timing.row_middle(START, 0.0) == START + 1_000_000
    assert timing.row_middle(START, 480.0) == START + 9_000_000
    assert timing.row_middle(START, 240.0) == START + 5_000_000


def test_the_middle_stamp_is_the_middle_of_a_global_exposure():
    timing = FrameTiming(packaged_camera(exposure_s=0.005, stamp="mid"))
    assert timing.row_middle(START, 17.0) == START


@pytest.mark.parametrize("frequency_hz", [4.5, 28.0, 80.0])
def test_the_instants_average_exactly_over_the_exposure(frequency_hz):
    exposure = 0.010
    timing = FrameTiming(packaged_camera(exposure_s=exposure, stamp="mid", rate_hz=100))
    instants = timing.exposure_instants(START, [0.225])[:, 0]
    t = (instants - START) / 1e9
    mean = exposure_weights() @ np.cos(2 * np.pi * frequency_hz * t + 0.3)
    exact = np.cos(0.3) * np.sinc(frequency_hz * exposure)
    # Nanosecond rounding of the instants leaves 2 pi f 0.5 ns, below 3e-7 at 80 Hz.
    assert mean == pytest.approx(exact, abs=3e-7)


def test_markers_at_different_rows_are_exposed_at_different_times():
    camera = packaged_camera(readout_s=0.008, exposure_s=0.002)
    instants = FrameTiming(camera).exposure_instants(START, [0.010, 0.285])
    rows = camera.rows([0.010, 0.285])
    expected = 0.008 * (rows[0] - rows[1]) / 479 * 1e9
    assert instants.shape == (6, 2)
    assert (instants[:, 0] - instants[:, 1]) == pytest.approx(expected, abs=2)
