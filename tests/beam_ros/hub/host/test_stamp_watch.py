from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.host.stamp_watch import StampWatch

PERIOD_NS = 10_000_000


class Source:
    """Samples every 10 ms on a line with hiccups, from a clock that may be changed."""

    def __init__(self) -> None:
        self.found: list[str] = []
        self.watch = StampWatch(lambda name, _reason: self.found.append(name))
        self.rng = np.random.default_rng(5)
        self.now_ns, self.offset_ns = 10**18, 0

    def sample(self, error_ns: int = 0) -> bool:
        self.now_ns += PERIOD_NS
        delay_ns = int(self.rng.exponential(2e6)) + (200_000_000 if self.rng.random() < 0.01 else 0)
        return self.watch.is_credible(self.now_ns + self.offset_ns + error_ns, self.now_ns + delay_ns)


def test_a_line_with_hiccups_and_a_clock_that_is_an_hour_off_are_no_fault():
    source = Source()
    source.offset_ns = 3600 * 10**9
    assert all(source.sample() for _ in range(2000))
    assert source.found == []


@pytest.mark.parametrize("error_ns", [-(10**10), 10**10, 1 << 61])
def test_one_absurd_stamp_is_left_out_and_blinds_nothing(error_ns):
    source = Source()
    source.sample()
    for _ in range(50):
        source.sample()
    assert not source.sample(error_ns)
    assert all(source.sample() for _ in range(50))
    assert source.found == []


@pytest.mark.parametrize(("offset_ns", "name"), [(-(10**9), "clock_backwards"), (10**9, "clock_jumped")])
def test_a_clock_that_jumps_is_named_once_and_followed_from_there(offset_ns, name):
    source = Source()
    for _ in range(50):
        source.sample()
    source.offset_ns = offset_ns
    assert [source.sample() for _ in range(5)] == [False, False, True, True, True]
    assert source.found == [name]


def test_what_waited_for_a_frozen_process_is_late_and_no_fault():
    source = Source()
    for _ in range(50):
        source.sample()
    frozen_ns = 3 * 10**9
    source.now_ns += frozen_ns
    # Twenty samples waited, and come at once; then it goes on as before.
    stamps = source.now_ns - np.arange(20, 0, -1) * PERIOD_NS
    assert all(source.watch.is_credible(int(stamp), source.now_ns) for stamp in stamps)
    assert all(source.sample() for _ in range(100))
    assert source.found == []


def test_a_first_stamp_that_is_absurd_is_no_fault():
    source = Source()
    source.sample(10**12)
    assert [source.sample() for _ in range(4)] == [False, False, True, True]
    assert source.found == []


def test_the_same_sample_twice_is_left_out():
    source = Source()
    assert source.sample()
    assert not source.sample(-PERIOD_NS)
    assert source.sample()
