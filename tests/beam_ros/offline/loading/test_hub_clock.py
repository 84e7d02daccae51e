"""The hub's samples on the host's clock."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beam_ros.bags.errors import BagError
from beam_ros.bags.signals import HubSamples, Unreadable, join_batches
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.offline.loading.hub_clock import device_clock, device_times, in_stretch, stretches_of

START = 1_700_000_000_000_000_000
PERIOD = 1_000_000
RATE = 1.0 - 35e-6  # host seconds per device second


def test_ticks_lie_on_one_line_whatever_their_stamps_wander() -> None:
    ticks = np.delete(np.arange(1000), [400, 401])  # two samples are lost, which ticks count
    wander = np.rint(3_000.0 * np.sin(0.05 * ticks)).astype(np.int64)
    stamps = START + np.rint(ticks * PERIOD * RATE).astype(np.int64) + wander
    samples = SimpleNamespace(stamps_ns=stamps, period_ns=PERIOD)
    found = device_times(samples, slice(None), RATE, START)
    # The wander has a mean of its own, 3 us over 8 turns: less than 0.1 us.
    np.testing.assert_allclose(found, ticks * PERIOD * RATE * 1e-9, rtol=0.0, atol=1e-7)


def test_samples_without_ticks_lie_where_their_stamps_say() -> None:
    stamps = START + np.array([0, 5_300_000, 9_100_000, 15_000_001])
    samples = SimpleNamespace(stamps_ns=stamps, period_ns=0)
    found = device_times(samples, slice(1, 4), 1.0, START)
    np.testing.assert_allclose(found, [5.3e-3, 9.1e-3, 15.000001e-3], rtol=1e-12)


@pytest.mark.parametrize(("n_syncs", "rtt_ns"), [(2, 800_000), (3, 800_000), (20, 800_000), (20, 0)])
def test_the_rate_of_the_devices_clock_comes_from_three_exchanges_and_more(n_syncs: int, rtt_ns: int) -> None:
    host = START + 100_000_000 * np.arange(n_syncs)
    syncs = [ClockSync(int(t), round((int(t) - START) / RATE), 1, rtt_ns) for t in host]
    foreign = [ClockSync(START + 5, 10**15, 2, rtt_ns)]  # of another epoch
    samples = SimpleNamespace(epochs=np.ones(10, dtype=int))
    rate, left = device_clock(samples, [*syncs, *foreign], slice(0, 10))
    assert rate == pytest.approx(1.0 if n_syncs < 3 else RATE, rel=1e-8)
    assert left.mean == 0.0
    if n_syncs < 3:
        assert left.sd == 50e-6
    else:
        assert (left.sd == 0.0) is (rtt_ns == 0)


def samples_of(*batches: tuple[float, int]) -> HubSamples:
    """Batches of 20 ms, by their starts [s] and epochs."""
    made = [
        SampleBatch(START + round(1e9 * start), PERIOD, epoch, positions=np.zeros(20))
        for start, epoch in batches
    ]
    return join_batches("hub/measured", made, Unreadable())


def test_a_restart_and_a_hole_longer_than_everything_begin_stretches_and_a_shorter_hole_does_not() -> None:
    notes: list[str] = []
    samples = samples_of((0.0, 1), (0.02, 1), (0.06, 1), (0.0803, 2), (4.0, 2), (4.02, 2))
    found = stretches_of(samples, START, notes)
    assert found == (slice(0, 60), slice(80, 120), slice(60, 80))
    assert "restarted 1 times and 1 holes" in notes[0]
    command = samples_of((0.04, 1), (0.1003, 2), (4.02, 2), (9.0, 2))
    assert [in_stretch(command, samples, part) for part in found] == [
        slice(0, 20),
        slice(40, 60),
        slice(20, 40),
    ]


def test_the_samples_of_two_recordings_in_one_bag_are_refused() -> None:
    with pytest.raises(BagError, match=r"1 of 61 samples.*two recordings"):
        stretches_of(samples_of((0.0, 1), (0.0203, 1), (0.0401, 1), (0.0204, 1)), START, [])
