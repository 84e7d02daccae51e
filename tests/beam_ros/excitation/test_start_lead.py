"""A start that was too soon is followed by later ones, but not by one that nobody waits for any more."""

from __future__ import annotations

import pytest

from beam_ros.excitation.start_lead import MAX_TRIES, StartLead, first_lead, longest_wait


def test_every_lead_is_longer_than_the_one_before_and_there_is_a_last_one() -> None:
    lead, now_s, leads = StartLead(2.0, 100.0), 100.0, [2.0]
    while True:
        now_s += lead.lead_s + 0.3  # each is refused a moment after its start
        if not lead.lengthen(now_s):
            break
        leads.append(lead.lead_s)
    assert leads == sorted(set(leads))
    assert len(leads) == MAX_TRIES
    assert now_s - 100.0 == pytest.approx(longest_wait(2.0), abs=1.0)
    assert "2 s and 4 s and 8 s" in lead.history()


def test_nothing_is_handed_over_again_long_after_it_was_asked_for() -> None:
    """The hub was frozen for longer than all leads together: who asked has given up."""
    lead = StartLead(2.0, 100.0)
    assert not lead.lengthen(100.0 + longest_wait(2.0))


def test_a_first_start_that_was_late_enough_has_no_history() -> None:
    assert StartLead(2.0, 100.0).history() == ""


def test_the_first_lead_is_what_is_wanted_unless_the_handing_over_takes_longer() -> None:
    assert first_lead(30_000, 5.0) == 5.0
    half_an_hour = first_lead(1_800_000, 5.0)
    assert 5.0 < half_an_hour < 60.0
    assert first_lead(3_600_000, 5.0) > half_an_hour
