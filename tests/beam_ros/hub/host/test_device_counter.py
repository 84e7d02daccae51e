"""Narrow counters of time."""

from __future__ import annotations

import pytest

from beam_ros.hub.host.device_counter import WRAPS_NS, DeviceCounter

MS = 1_000_000


@pytest.mark.parametrize("width_ns", WRAPS_NS)
def test_a_counter_of_32_bits_goes_on_over_every_wrap(width_ns):
    counter = DeviceCounter()
    step_ns = width_ns // 7 + 12_345
    for k in range(40):
        true_ns = 3 * MS + k * step_ns
        assert counter.read(true_ns % width_ns, true_ns - MS, true_ns + MS) == true_ns
    assert counter.width_ns == width_ns
    assert counter.shown_ns(5 * width_ns + 77) == 77


def test_what_no_wrap_explains_is_not_extended():
    counter = DeviceCounter()
    now_ns = 3_000_000_000_000
    for shown_ns in (
        0,
        now_ns - 10 * MS,
        now_ns + 10 * MS,
        1 << 63,
        now_ns - WRAPS_NS[1] // 3,
        now_ns + WRAPS_NS[1],
    ):
        assert counter.read(shown_ns, now_ns - MS, now_ns + MS) is None
    assert counter.read(now_ns, now_ns - MS, now_ns + MS) == now_ns
    assert counter.width_ns is None


def test_a_wrap_is_not_believed_where_almost_anything_is_possible():
    counter = DeviceCounter()
    # After a pause of an hour nobody knows how often a counter of 4.3 s has wrapped.
    assert counter.read(5 * MS, 3_602_000 * MS, 3_604_000 * MS) is None


def test_only_one_width_is_believed_of_a_counter():
    counter = DeviceCounter()
    assert counter.read(5 * MS, WRAPS_NS[1], WRAPS_NS[1] + 10 * MS) == WRAPS_NS[1] + 5 * MS
    later_ns = 5 * MS + WRAPS_NS[1] + 7 * WRAPS_NS[2]
    assert counter.read(5 * MS, later_ns - MS, later_ns + MS) is None


def test_ticks_that_do_not_wrap_are_laid_beside_a_clock_that_has_wrapped():
    counter = DeviceCounter()
    # The clock of 32 bits in microseconds stands at 10 ms, the ticks have counted on.
    ahead_ns = 3 * WRAPS_NS[1] + 10 * MS
    assert counter.read(ahead_ns, 9 * MS, 11 * MS) is None
    assert counter.read(ahead_ns, 9 * MS, 11 * MS, may_be_ahead=True) == 10 * MS
    assert counter.extended_ns(3 * WRAPS_NS[1] + 30 * MS) == 30 * MS


def test_numbers_that_a_wrap_tears_are_put_right_from_then_on():
    counter = DeviceCounter()
    assert counter.read(0, WRAPS_NS[2] - MS, WRAPS_NS[2]) == WRAPS_NS[2]
    counter.shift(32_704)
    assert counter.read(MS, WRAPS_NS[2], WRAPS_NS[2] + 2 * MS) == WRAPS_NS[2] + MS + 32_704
