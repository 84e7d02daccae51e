from __future__ import annotations

import math
from pathlib import Path

import pytest

from beam_ros.hub.emulated.injected_faults import (
    KINDS,
    FaultSchedule,
    InjectedFault,
    documentation,
    read_schedule,
    read_schedule_file,
)
from beam_ros.hub.errors import HubParameterError

PAGE = Path(__file__).parents[4] / "docs" / "faults-on-request.md"


def test_an_entry_takes_what_is_left_out_from_the_table():
    (fault,) = read_schedule("{at: 5, fault: corrupt, for: 2.0, direction: to_host}", "here")
    assert fault == InjectedFault("corrupt", 5.0, 2.0, "to_host", {"share": 0.01})
    (fault,) = read_schedule("{fault: drift, ppm: -200}", "here", now=7.0)
    assert fault == InjectedFault("drift", 7.0, math.inf, "both", {"ppm": -200.0})
    assert str(fault) == "drift (ppm -200)"


def test_every_kind_can_be_asked_for_by_its_name_alone():
    for name in KINDS:
        (fault,) = read_schedule(f"{{fault: {name}}}", "here")
        assert set(fault.amounts) == set(KINDS[name].amounts)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{fault: unplugg}", "did you mean unplug"),
        ("{at: -1.0, fault: reset}", "at -1.0"),
        ("{fault: reset, for: 3}", "'for'"),
        ("{fault: stall, for: .nan}", "for nan"),
        ("{fault: corrupt, share: 1.5}", "from 0 to 1"),
        ("{fault: drop, share: true}", "share True"),
        ("{fault: drop, direction: left}", "to_device"),
        ("{fault: unplug, direction: both}", "'direction'"),
        ("{at: 3}", "'None'"),
        ("[5, 6]", "expected a list"),
        ("7", "expected a list"),
        ("{fault: [", "no YAML"),
    ],
)
def test_what_no_schedule_can_hold_is_refused_with_its_place(text, word):
    with pytest.raises(HubParameterError, match="here") as refusal:
        read_schedule(text, "here")
    assert word in str(refusal.value)


def test_a_file_is_read_and_a_missing_one_is_named(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 1.0, fault: reset}\n- {at: 2.0, fault: unplug, for: 1.0}\n", encoding="utf-8")
    assert [fault.kind for fault in read_schedule_file(str(path))] == ["reset", "unplug"]
    assert read_schedule_file("") == ()
    with pytest.raises(HubParameterError, match=r"nowhere\.yaml"):
        read_schedule_file(str(tmp_path / "nowhere.yaml"))


def test_a_schedule_gives_each_change_once_and_in_time():
    late, early = InjectedFault("unplug", 3.0, 1.0), InjectedFault("drift", 1.0, amounts={"ppm": 5.0})
    schedule = FaultSchedule([late, early])
    assert list(schedule.changes(0.9)) == []
    assert list(schedule.changes(3.5)) == [(early, True), (late, True)]
    assert list(schedule.changes(9.0)) == [(late, False)]
    assert list(schedule.changes(99.0)) == []


def test_the_page_prints_the_table_and_its_example_is_a_schedule():
    text = PAGE.read_text(encoding="utf-8")
    assert "\n".join(documentation()) in text
    example = text.split("```yaml\n")[1].split("```")[0]
    assert [fault.kind for fault in read_schedule(example, "the page")] == ["corrupt", "unplug", "drift"]
