"""How long the other side has said nothing, as far as this process could hear."""

from __future__ import annotations

from beam_ros.hub.host.silence import Silence
from beam_ros.hub.host.waking_time import MOST_NS

MS = 1_000_000


def _silent_from(silence: Silence, start_ms: int, end_ms: int, step_ms: int = 10) -> int | None:
    """Look regularly; return when it is too long for the first time [ms]."""
    looks = range(start_ms, end_ms, step_ms)
    return next((now_ms for now_ms in looks if silence.is_too_long(now_ms * MS)), None)


def test_a_silence_is_too_long_after_the_patience_and_ends_with_a_word() -> None:
    silence = Silence(500 * MS)
    # Who never spoke is not missed.
    assert _silent_from(silence, 1000, 3000) is None
    silence.end()
    assert _silent_from(silence, 3000, 3400) is None
    silence.end()
    assert _silent_from(silence, 3400, 5000) == 3390 + 510
    silence.lose()
    assert not silence.is_connected
    assert _silent_from(silence, 5000, 7000) is None


def test_time_in_which_nobody_looked_counts_little() -> None:
    silence = Silence(500 * MS)
    silence.end()
    assert _silent_from(silence, 0, 410) is None
    # 400 ms were heard before the process was frozen, 50 ms count of the freeze, and 50 ms are left.
    assert MOST_NS == 50 * MS
    assert _silent_from(silence, 60_000, 61_000) == 60_060
