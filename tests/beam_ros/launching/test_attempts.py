"""What came too late is tried again with more patience, and at last made without real time; and it is said."""

from __future__ import annotations

import pytest

from beam_ros.errors import NodeFallenError, RigUnavailableError, UsageError
from beam_ros.launching.attempts import PATIENCE, Attempt, Failure, persist

LATE = "its stamp is 0.202 s old; expected at most 0.2 s"


class Rig:
    """Attempts whose ends are given, and what was said of them."""

    def __init__(self, *ends: Exception | None) -> None:
        self.ends = list(ends)
        self.attempts: list[Attempt] = []
        self.said: list[tuple[Failure, str]] = []
        self.stood_in = 0

    def carry_out(self, attempt: Attempt) -> dict[str, object]:
        self.attempts.append(attempt)
        end = self.ends.pop(0)
        if end is not None:
            attempt.circumstances = "the computer is busy"
            raise end
        return {"by": "nodes"}

    def stand_in(self) -> dict[str, object]:
        self.stood_in += 1
        return {"by": "core"}

    def persist(self):
        return persist(self.carry_out, self.stand_in, lambda failure, step: self.said.append((failure, step)))


def test_an_attempt_that_goes_well_is_the_only_one() -> None:
    rig = Rig(None)
    outcome = rig.persist()
    assert outcome.is_by_nodes
    assert outcome.result == {"by": "nodes"}
    assert len(rig.attempts) == 1
    assert not rig.said
    assert not rig.stood_in


def test_what_was_too_late_is_tried_again_with_more_patience() -> None:
    rig = Rig(RigUnavailableError(LATE), None)
    outcome = rig.persist()
    assert outcome.is_by_nodes
    assert [attempt.number for attempt in rig.attempts] == [1, 2]
    assert rig.attempts[1].patience > rig.attempts[0].patience
    ((failure, step),) = rig.said
    assert failure.lines() == (LATE, "the excitation did not begin: nothing moved", "the computer is busy")
    assert "trying again" in step
    assert not rig.stood_in


def test_at_last_the_core_does_it_and_it_is_not_said_to_be_the_nodes() -> None:
    rig = Rig(*(RigUnavailableError(LATE) for _ in PATIENCE))
    outcome = rig.persist()
    assert not outcome.is_by_nodes
    assert outcome.result == {"by": "core"}
    assert len(outcome.failures) == len(rig.said) == len(PATIENCE)
    assert "beam simulate" in rig.said[-1][1]
    assert rig.stood_in == 1


def test_a_node_that_fell_is_not_started_again() -> None:
    rig = Rig(NodeFallenError("node tracker ended with status 2: no OpenCV"), None)
    outcome = rig.persist()
    assert not outcome.is_by_nodes
    assert len(rig.attempts) == 1
    assert "beam simulate" in rig.said[-1][1]


def test_a_mistake_of_the_users_is_no_reason_to_try_again() -> None:
    rig = Rig(UsageError("the excitation leaves a limit"))
    with pytest.raises(UsageError):
        rig.persist()
    assert not rig.stood_in


def test_an_axis_that_had_begun_to_move_is_not_said_to_have_stood_still() -> None:
    failure = Failure(Attempt(1, 1.0, has_moved=True), "underrun: sample 25050 of 30002 did not come in time")
    _, moved = failure.lines()
    assert "nothing moved" not in moved
    assert "stopped by itself" in moved
