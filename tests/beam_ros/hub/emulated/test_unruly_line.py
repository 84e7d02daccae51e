from __future__ import annotations

import pytest

from beam_ros.hub.emulated.injected_faults import InjectedFault
from beam_ros.hub.emulated.unruly_line import UnrulyLine

DATA = bytes(range(200)) * 50


def test_an_ideal_line_hands_everything_on_at_once():
    line = UnrulyLine(0, 1_000_000, 1)
    line.put(DATA, 5)
    assert line.next_ns == 5
    assert line.take(5) == DATA
    assert line.next_ns is None


def test_bytes_travel_at_the_baud_one_after_the_other():
    line = UnrulyLine(921_600, 1_000_000, 1)
    line.put(DATA, 0)
    # Ten bits a byte: 92 160 bytes a second.
    assert len(line.take(50_000_000)) == pytest.approx(4608, abs=1)
    assert len(line.take(100_000_000)) == pytest.approx(4608, abs=1)
    assert line.take(10**9).endswith(DATA[-700:])


def test_what_finds_no_room_is_lost_and_counted():
    line = UnrulyLine(9600, 256, 1)
    line.put(DATA, 0)
    assert line.n_lost == len(DATA) - 256
    assert line.take(10**9) == DATA[:256]


def test_a_delay_shifts_and_keeps_the_order():
    line = UnrulyLine(0, 1_000_000, 1)
    fault = InjectedFault("delay", 0.0, amounts={"seconds": 0.3})
    line.begin(fault)
    line.put(b"first", 0)
    line.end(fault)
    line.put(b"second", 100_000_000)
    assert line.take(299_999_999) == b""
    assert line.take(300_000_000) == b"firstsecond"


@pytest.mark.parametrize("share", [0.01, 0.2])
def test_a_share_of_the_bytes_is_lost(share):
    line = UnrulyLine(0, 1_000_000, 1)
    line.begin(InjectedFault("drop", 0.0, amounts={"share": share}))
    line.put(DATA, 0)
    lost = len(DATA) - len(line.take(0))
    assert lost == pytest.approx(share * len(DATA), abs=5 * (share * len(DATA)) ** 0.5)


def test_a_share_of_the_bytes_has_one_bit_flipped():
    line = UnrulyLine(0, 1_000_000, 1)
    line.begin(InjectedFault("corrupt", 0.0, amounts={"share": 0.05}))
    line.put(DATA, 0)
    flipped = [a ^ b for a, b in zip(line.take(0), DATA, strict=True) if a != b]
    assert len(flipped) == pytest.approx(500, abs=110)
    assert all(bits.bit_count() == 1 for bits in flipped)
