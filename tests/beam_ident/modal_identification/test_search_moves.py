from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from beam_ident import EstimationError
from beam_ident.modal_identification.search_moves import SearchMove, explored


@dataclass(frozen=True)
class _Place:
    """An end of a search that is a number, under conditions that are a number."""

    conditions: int
    reason: str = ""
    stopped_by: BaseException | None = None

    def unfinished(self, stop: BaseException, missing: str) -> _Place:
        return replace(self, reason=f"{type(stop).__name__}: {missing}")


def _estimate(conditions: int, after: Any) -> Any:
    if conditions == 13:
        raise EstimationError("nothing there")
    return _Place(conditions)


class _Step(SearchMove):
    """Goes from some conditions to others, and notes where it was asked."""

    def __init__(self, about: str, leads: dict[int, int], asked: list[tuple[str, int]]) -> None:
        self.about, self._leads, self._asked = about, leads, asked

    def end(self, present: Any, estimate: Any) -> Any:
        self._asked.append((self.about, present.conditions))
        if present.conditions not in self._leads:
            return None
        return estimate(self._leads[present.conditions], present)


def test_all_moves_are_asked_again_after_a_change():
    asked: list[tuple[str, int]] = []
    moves = _Step("first", {1: 2, 3: 4}, asked), _Step("second", {2: 3}, asked)
    end: Any = explored(_estimate, 1, moves)  # type: ignore[arg-type]
    assert (end.conditions, end.reason) == (4, "")
    assert asked == [
        ("first", 1),
        ("first", 2),
        ("second", 2),
        ("first", 3),
        ("first", 4),
        ("second", 4),
    ]


def test_a_change_under_which_nothing_can_be_estimated_is_not_made():
    end: Any = explored(_estimate, 1, [_Step("bad luck", {1: 13}, [])])  # type: ignore[arg-type]
    assert end.conditions == 1
    with pytest.raises(EstimationError, match="nothing there"):
        explored(_estimate, 13, [])  # type: ignore[arg-type]


@pytest.mark.parametrize("stop", [KeyboardInterrupt, TimeoutError, MemoryError])
def test_a_search_that_is_stopped_returns_the_best_so_far_and_says_what_is_missing(stop):
    class Stopped(_Step):
        def end(self, present: Any, estimate: Any) -> Any:
            raise stop

    moves = _Step("clocks", {1: 2}, []), Stopped("outliers", {}, []), _Step("noise", {2: 5}, [])
    end: Any = explored(_estimate, 1, moves)  # type: ignore[arg-type]
    assert (end.conditions, end.reason) == (2, f"{stop.__name__}: a further look for outliers")


def test_an_estimate_that_was_stopped_under_a_change_does_not_take_the_place_of_a_finished_one():
    def stopped(conditions: int, after: Any) -> Any:
        return replace(_estimate(conditions, after), stopped_by=TimeoutError() if conditions == 2 else None)

    end: Any = explored(stopped, 1, [_Step("clocks", {1: 2}, [])])  # type: ignore[arg-type]
    assert (end.conditions, end.reason) == (1, "TimeoutError: a further look for clocks")
