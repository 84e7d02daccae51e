"""Whether the other side answers: its silence, as far as this process could hear, and the report of its loss."""

from __future__ import annotations

from beam_ros.hub.faults import fault
from beam_ros.hub.host.contact import Contact
from beam_ros.hub.host.waking_time import MOST_NS
from beam_ros.hub.journal import Journal

MS = 1_000_000


def _contact() -> tuple[Contact, Journal]:
    journal = Journal(["connections"])
    return Contact(journal, 500 * MS), journal


def _silent_from(contact: Contact, start_ms: int, end_ms: int, step_ms: int = 10) -> int | None:
    """Look regularly; return when it is too long for the first time [ms]."""
    looks = range(start_ms, end_ms, step_ms)
    return next((now_ms for now_ms in looks if contact.is_silent(now_ms * MS)), None)


def test_a_silence_is_too_long_after_the_patience_and_ends_with_a_word() -> None:
    contact, _ = _contact()
    # Who never spoke is not missed.
    assert _silent_from(contact, 1000, 3000) is None
    contact.make("a board")
    assert _silent_from(contact, 3000, 3400) is None
    contact.hear()
    assert _silent_from(contact, 3400, 5000) == 3390 + 510
    contact.lose(fault("controller_silent"), "no word")
    assert not contact.is_made
    assert _silent_from(contact, 5000, 7000) is None


def test_time_in_which_nobody_looked_counts_little() -> None:
    contact, _ = _contact()
    contact.make("a board")
    assert _silent_from(contact, 0, 410) is None
    # 400 ms were heard before the process was frozen, 50 ms count of the freeze, and 50 ms are left.
    assert MOST_NS == 50 * MS
    assert _silent_from(contact, 60_000, 61_000) == 60_060


def _told(journal: Journal) -> list[str]:
    return [event.text for event in journal.take_events() if event.level == "error"]


def test_a_loss_is_told_once_until_it_is_another_one_or_was_mended() -> None:
    contact, journal = _contact()
    lost, silent = fault("port_lost"), fault("controller_silent")
    for cause, text in ((lost, "a"), (lost, "b"), (silent, "c"), (lost, "d")):
        contact.lose(cause, text)
        assert (contact.status.fault, contact.status.reason) == (cause, text)
    assert _told(journal) == ["a", "c", "d"]
    contact.lose(lost, "e", is_news=True)
    contact.make("a board", is_lasting=False)
    contact.lose(lost, "f")
    assert _told(journal) == ["e"]
    contact.make("a board")
    contact.lose(lost, "g")
    assert _told(journal) == ["g"]
    assert journal.counters["connections"] == 2
