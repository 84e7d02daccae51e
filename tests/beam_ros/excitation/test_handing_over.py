"""A hub that dies under a sequence is missed, in whichever way it shows."""

from __future__ import annotations

import pytest

from beam_ros.excitation.handing_over import HandingOver

START_NS, END_NS = 102 * 10**9, 110 * 10**9


def handing_over(n_hubs: int = 1, n_chunks: int = 10) -> HandingOver:
    chunks = (bytes([k]) for k in range(n_chunks))
    return HandingOver("s", chunks, START_NS, END_NS, now_s=100.0, n_hubs=n_hubs)


def live(sequence: HandingOver, begin_s: float, end_s: float, n_hubs: int = 1, hears: bool = True) -> float:
    """Look for the hub every 20 ms; return when it is missed, or infinity."""
    for k in range(round((end_s - begin_s) / 0.02)):
        now_s = begin_s + 0.02 * k
        if hears:
            sequence.hear(now_s)
        if sequence.check(now_s, round(now_s * 1e9), n_hubs):
            return now_s
    return float("inf")


def test_a_sequence_that_runs_to_its_end_is_not_missed() -> None:
    sequence = handing_over()
    assert [len(sequence.take_chunks(4)) for _ in range(4)] == [4, 4, 2, 0]
    assert sequence.verdict is None
    sequence.note({"id": "another", "state": "refused", "reason": "no"})
    assert sequence.verdict is None
    for state in ("loading", "ready", "running"):
        sequence.note({"id": "s", "state": state, "reason": ""})
    assert sequence.verdict == (True, "s starts")
    assert live(sequence, 100.0, 112.0) == float("inf")
    sequence.note({"id": "s", "state": "done", "reason": ""})
    assert not sequence.is_under_way
    assert live(sequence, 112.0, 200.0, n_hubs=0, hears=False) == float("inf")


def test_a_refusal_ends_the_handing_over() -> None:
    sequence = handing_over()
    sequence.note({"id": "s", "state": "refused", "reason": "too far"})
    assert sequence.verdict == (False, "the hub refused s: too far")
    assert sequence.take_chunks(4) == []


def test_only_a_refusal_for_its_time_alone_is_late() -> None:
    for report, is_late in (
        ({"state": "refused", "reason": "old", "late": True}, True),
        ({"state": "refused", "reason": "too far", "late": False}, False),
        ({"state": "refused", "reason": "of a hub that says no more"}, False),
        ({"state": "aborted", "reason": "stop was asked for", "late": True}, False),
    ):
        sequence = handing_over()
        sequence.note({"id": "s", **report})
        assert sequence.is_late is is_late
    sequence = handing_over()
    sequence.note({"id": "another", "state": "refused", "late": True})
    assert not sequence.is_late


def test_a_hub_that_falls_silent_is_missed_after_three_seconds() -> None:
    sequence = handing_over()
    sequence.note({"id": "s", "state": "running"})
    live(sequence, 100.0, 103.0)
    assert live(sequence, 103.0, 120.0, hears=False) == pytest.approx(106.0, abs=0.1)
    assert sequence.state == "lost"
    success, words = sequence.verdict
    assert not success
    assert "silent for 3.0 s" in words
    assert "start it again" in words
    # If it was only asleep, its word counts again.
    sequence.note({"id": "s", "state": "running"})
    assert sequence.is_under_way


def test_a_hub_that_leaves_the_graph_is_missed_at_once() -> None:
    sequence = handing_over()
    live(sequence, 100.0, 101.0)
    assert live(sequence, 101.0, 102.0, n_hubs=0) == 101.0
    assert "left the graph" in sequence.reason


def test_a_hub_that_is_discovered_late_is_not_missed() -> None:
    sequence = handing_over(n_hubs=0)
    assert live(sequence, 100.0, 100.5, n_hubs=0, hears=False) == float("inf")
    live(sequence, 100.5, 101.0)
    assert live(sequence, 101.0, 102.0, n_hubs=0) == 101.0


def test_a_hub_that_comes_back_quickly_is_a_new_one() -> None:
    sequence = handing_over()
    live(sequence, 100.0, 101.0)
    live(sequence, 101.0, 102.0, hears=False)
    assert live(sequence, 102.0, 103.0, n_hubs=2) < 102.1
    assert "started anew" in sequence.reason
    # A second hub beside one that speaks all the time, such as a bag that is replayed, is none of that.
    assert live(handing_over(), 100.0, 105.0, n_hubs=2) == float("inf")


def test_a_frozen_excitation_does_not_blame_the_hub() -> None:
    sequence = handing_over()
    sequence.note({"id": "s", "state": "running"})
    live(sequence, 100.0, 101.0)
    assert live(sequence, 109.0, 109.5, hears=False) == float("inf")


def test_a_hub_that_says_nothing_of_it_is_missed() -> None:
    assert live(handing_over(), 100.0, 130.0) == pytest.approx(112.0, abs=0.1)
    sequence = handing_over()
    sequence.note({"id": "s", "state": "running"})
    assert live(sequence, 100.0, 130.0) == pytest.approx(120.0, abs=0.1)
    assert "should have ended" in sequence.reason


def test_a_stop_on_this_side_ends_it() -> None:
    sequence = handing_over()
    sequence.give_up("asked for")
    assert sequence.take_chunks(4) == []
    assert sequence.verdict == (False, "s aborted: asked for")
