"""How old, how early and how late a command may be."""

from __future__ import annotations

MAX_AGE_NS = 200_000_000
"""Stamps older than this are refused: a replayed bag must never move a live axis."""
MAX_LEAD_NS = 600_000_000_000
"""Stamps further ahead than this are refused: they come from another clock."""
MIN_START_LEAD_NS = 100_000_000
"""A sequence must be complete this long before its start, so that the device's buffer can be filled."""
READY_LEAD_NS = 50_000_000
"""A sequence must be complete and checked this long before its start."""


def is_past(stamp_ns: int, now_ns: int) -> bool:
    """Tell whether a start stamp [ns, UNIX] that somebody gave is over now."""
    return 0 < stamp_ns < now_ns


def stale(stamp_ns: int, now_ns: int, ahead_ns: int) -> str | None:
    """Return why a command with this stamp [ns, UNIX] is too old or too far ahead now, or None."""
    if stamp_ns <= 0:
        return "stamp 0; expected the time at which it was made"
    age_ns = now_ns - stamp_ns
    if age_ns > MAX_AGE_NS:
        return f"its stamp is {age_ns * 1e-9:.3f} s old; expected at most {MAX_AGE_NS * 1e-9:g} s"
    if -age_ns > ahead_ns:
        return f"its stamp is {-age_ns * 1e-9:.3f} s ahead; expected at most {ahead_ns * 1e-9:g} s"
    return None
