"""The table of transitions, read as a stranger would read it for safety."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from beam_ros.hub.simulated.transitions import (
    CAUSES,
    CONDITIONS,
    FAULT,
    IDENTIFIED,
    TRANSITION_OF,
    TRANSITIONS,
    Cause,
    Effect,
    documentation,
)

COMMANDS = ("enable", "disable", "home", "stop", "clear_fault", "set-point", "arm", "emergency stop")
PAGE = Path(__file__).parents[4] / "docs" / "protocol.md"


def changes():
    """Every transition to another condition: origin, cause, goal."""
    for (origin, cause), row in TRANSITION_OF.items():
        if row.goal not in (None, origin):
            yield origin, cause, row.goal


def test_every_command_has_a_row_in_every_condition() -> None:
    assert all((condition, command) in TRANSITION_OF for condition in CONDITIONS for command in COMMANDS)


def test_nothing_but_the_request_enables() -> None:
    enabling = {c for origin, c, goal in changes() if goal.state == "enabled" != origin.state}
    assert enabling == {"enable"}


def test_an_enabled_axis_is_disabled_only_when_it_has_been_brought_to_rest() -> None:
    ways_out = {(o.activity, c) for o, c, goal in changes() if o.state == "enabled" != goal.state}
    assert ways_out == {("stopping", "rest")}


def test_a_moving_axis_comes_to_idle_only_through_a_stop_or_at_home() -> None:
    ends = {(o.activity, c) for o, c, goal in changes() if goal.activity == "idle" != o.activity}
    assert ends == {("stopping", "rest"), ("homing", "home reached")}


def test_a_stop_goes_on_until_rest_whatever_is_asked() -> None:
    assert {c for origin, c, _ in changes() if origin.activity == "stopping"} == {"rest"}


def test_every_cause_that_is_not_a_wish_leads_to_less() -> None:
    """What the device notices never leads to a condition that follows commands."""
    alarms = ("emergency stop", "silence", "old set-point", "limit", "underrun")
    assert {goal.activity for _, cause, goal in changes() if cause in alarms} == {"stopping"}


def test_a_fault_is_left_by_clear_fault_alone_and_disabled() -> None:
    ((_, cause, goal),) = [change for change in changes() if change[0] is FAULT]
    assert (cause, goal.state) == ("clear_fault", "homed")
    assert {cause for _, cause, goal in changes() if goal.name == "stopping to fault"} == {"limit"}


def test_a_refused_command_changes_nothing() -> None:
    refusals = [row for row in TRANSITIONS if row.is_refused]
    assert refusals
    assert all(row.goal is None and not row.effects and row.answer for row in refusals)


def test_every_condition_is_reached_and_every_cause_and_effect_is_used() -> None:
    reached = {IDENTIFIED}
    for _ in CONDITIONS:
        reached |= {goal for origin, _, goal in changes() if origin in reached}
    assert reached == set(CONDITIONS)
    assert set(CAUSES) == set(get_args(Cause)) == {cause for _, cause in TRANSITION_OF}
    assert {effect for row in TRANSITIONS for effect in row.effects} == set(get_args(Effect))


def test_the_page_shows_the_table() -> None:
    assert "\n".join(documentation()) in PAGE.read_text(encoding="utf-8")
