from __future__ import annotations

from pathlib import Path

from beam_ros.bags.summary import BagInfo, ClockSummary, SignalSummary
from beam_ros.cli.offline.info import _text


def test_every_signal_and_clock_is_listed_though_one_could_not_be_read() -> None:
    text = _text(
        BagInfo(
            path=Path("run"),
            storage="mcap",
            namespace="",
            start_ns=1_700_000_000_000_000_000,
            duration_ns=2_000_000_000,
            message_count=7,
            topics=(),
            signals=(
                SignalSummary("/hub/applied", 0, 0.0, 0.0, 0, 0, 0, unreadable=3),
                SignalSummary("/hub/measured", 40, 0.039, 1000.0, 1, 2, 0, unreadable=0),
            ),
            clocks=(ClockSummary(1, 2, float("nan"), float("nan"), 5e5), ClockSummary(2, 9, 35.0, 2e3, 8e5)),
            sequences=("chirp-1: done",),
            excitation=None,
        )
    )
    assert "run: 7 messages in 2.0 s (mcap), 2023-11-14 22:13:20 UTC" in text
    assert "/hub/applied: 3 messages, none" in text
    assert "/hub/measured: 40 samples over 0.039 s at 1000.000 Hz, 1 gaps, 2 lost" in text
    assert "clock epoch 1" not in text  # too few points for a rate
    assert "clock epoch 2: +35.000 ppm against the host, residual 2.0 us, median round trip 800 us" in text
    assert "chirp-1: done" in text
