"""The growing estimate over a bag that was recorded."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.writing import BagWriter
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.recorded_estimates import RecordedEstimates, estimates_of_bag
from beam_ros.rig.rig import Rig
from tests.beam_ros.bags.small_bags import BATCH, PERIOD, START, batch
from tests.graph import HANG_S

BAGS = Path(__file__).resolve().parents[3] / "bags"


def write_hub_alone(path: Path) -> Path:
    with BagWriter(path) as writer:
        for k in range(10):
            writer.write_batch("hub/measured", START + (k + 1) * BATCH * PERIOD, batch(k))
    return path


@pytest.mark.slow
def test_the_estimate_grows_with_the_bag_and_ends_at_its_truth():
    said = list(estimates_of_bag(BAGS / "chirp_6s", Rig.from_file().live))
    times = [at_s for at_s, _ in said]
    assert times == sorted(times)
    assert all(live.record_s <= at_s for at_s, live in said)
    known = [live for _, live in said if live.modes]
    assert known[-1].modes[0].frequency_sd_hz < 0.5 * known[0].modes[0].frequency_sd_hz
    assert known[-1].state == "ended"
    truth = json.loads((BAGS / "expected.json").read_text())["chirp_6s"]["truth"]
    expected = np.array(truth["natural_frequencies"][:2]) / (2 * math.pi)
    found = np.array([mode.frequency_hz for mode in known[-1].modes[:2]])
    sds = np.array([mode.frequency_sd_hz for mode in known[-1].modes[:2]])
    # Four standard deviations: once in 8000 such bags for each of the two.
    assert (np.abs(found - expected) < 4.0 * sds).all()
    report = identification_of_bags(BAGS / "chirp_6s").result.model
    np.testing.assert_allclose(found, report.natural_frequencies[:2] / (2 * math.pi), rtol=1e-9)


def test_a_bag_without_what_is_needed_says_so(tmp_path: Path):
    ((at_s, live),) = estimates_of_bag(write_hub_alone(tmp_path / "bag"), Rig.from_file().live)
    assert (at_s, live.state) == (0.0, "failed")
    assert "nothing on beam/displacement" in live.sentence


@pytest.mark.slow
def test_estimates_come_from_a_process_of_their_own_and_are_found_by_the_time_of_the_bag(tmp_path: Path):
    estimates = RecordedEstimates(write_hub_alone(tmp_path / "bag"), Rig.from_file().live)
    try:
        end = time.monotonic() + HANG_S
        while estimates.at(1.0) is None:
            assert time.monotonic() < end
            time.sleep(0.05)
        assert estimates.at(-1.0) is None
        assert estimates.at(0.0) == estimates.at(1.0)
    finally:
        estimates.close()


@pytest.mark.slow
def test_estimates_that_nobody_waits_for_are_given_up_at_once():
    estimates = RecordedEstimates(BAGS / "chirp_6s", Rig.from_file().live)
    estimates.close()
    assert estimates.at(0.0) is None
