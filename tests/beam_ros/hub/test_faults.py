from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.hub.contract import HubStatus
from beam_ros.hub.faults import DEVICE_FAULTS, FAULTS, HOST_FAULTS, documentation, fault, fault_of
from beam_ros.hub.simulated.transitions import (
    FAULT,
    HOMED,
    HOMING,
    IDENTIFIED,
    TRANSITION_OF,
    Cause,
    Condition,
)

PAGE = Path(__file__).parents[3] / "docs" / "hub-faults.md"


def test_every_row_has_its_own_number_and_name_a_sentence_and_a_remedy():
    rows = [*DEVICE_FAULTS, *HOST_FAULTS]
    assert len({row.number for row in rows}) == len({row.name for row in rows}) == len(rows)
    assert all(row.sentence and row.remedy for row in rows)
    assert all(0 < row.number < 32 for row in DEVICE_FAULTS)
    assert all(64 <= row.number < 256 and row.is_of_host for row in HOST_FAULTS)


def test_the_page_prints_the_table():
    assert "\n".join(documentation()) in PAGE.read_text(encoding="utf-8")


def test_rows_are_found_by_name_and_by_number():
    assert fault("underrun") is FAULTS[3] is fault_of(3)


def test_a_device_may_have_faults_of_its_own():
    own = fault_of(40)
    assert (own.number, own.name) == (40, "fault_40")
    assert "firmware" in own.remedy


CAUSES: dict[str, Cause] = {
    "host_silent": "silence",
    "setpoint_old": "old set-point",
    "underrun": "underrun",
    **{f"{kind}_limit": "limit" for kind in ("travel", "speed", "acceleration", "effort")},
    "command_not_finite": "limit",
}
"""What brings a device's fault about; the rest are emergency stops."""


def at_rest_after(name: str) -> set[Condition]:
    """The conditions in which an axis stands that was stopped by a fault, by the table of transitions."""
    cause = CAUSES.get(name, "emergency stop")
    stops = {
        row.goal
        for (_, seen), row in TRANSITION_OF.items()
        if seen == cause and "reason kept" in row.effects and row.goal is not None
    }
    return {IDENTIFIED} if name == "own_watchdog" else {TRANSITION_OF[stop, "rest"].goal for stop in stops}


@pytest.mark.parametrize("row", DEVICE_FAULTS, ids=lambda row: row.name)
def test_the_way_back_is_taken_step_by_step_in_every_state_that_follows_a_fault(row):
    conditions = at_rest_after(row.name)
    assert conditions
    for condition in conditions:
        status = HubStatus(condition.state, fault=row, reason="seen")
        homed_anew = False
        for step in status.way_back:
            answer = TRANSITION_OF[condition, step]
            assert not answer.is_refused, (condition.name, step)
            assert answer.goal not in (None, condition), (condition.name, step, "does nothing")
            condition = answer.goal
            if condition is HOMING:
                condition, homed_anew = TRANSITION_OF[HOMING, "home reached"].goal, True
        assert condition.state == "enabled"
        assert homed_anew or not row.needs_home
        assert status.remedy.startswith(f"{row.remedy}; then hub/")
        assert status.remedy.endswith("hub/enable")


def test_no_remedy_names_a_service_by_itself():
    words = ("clear", "home again", "enable", "home the axis", "home and")
    assert not [(row.name, word) for row in FAULTS.values() for word in words if word in row.remedy]


def test_a_limit_is_cleared_and_what_only_disabled_the_axis_is_not():
    assert at_rest_after("speed_limit") == {FAULT}
    assert HubStatus("fault", fault=fault("speed_limit")).way_back == ("clear_fault", "enable")
    assert at_rest_after("end_switch") == {HOMED, IDENTIFIED}
    assert HubStatus("homed", fault=fault("end_switch")).way_back == ("home", "enable")
    assert HubStatus("disconnected", fault=fault("port_lost")).remedy == fault("port_lost").remedy
    assert HubStatus("homed").remedy == ""
