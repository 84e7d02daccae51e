"""The hub's samples on the host's clock."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beam_ros.hub.contract import ClockSync
from beam_ros.offline.axis_bag import device_clock, device_times

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
