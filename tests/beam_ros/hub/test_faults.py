from __future__ import annotations

from pathlib import Path

from beam_ros.hub.faults import DEVICE_FAULTS, FAULTS, HOST_FAULTS, documentation, fault, fault_of

PROTOCOL = Path(__file__).parents[3] / "docs" / "protocol.md"


def test_every_row_has_its_own_number_and_name_a_sentence_and_a_remedy():
    rows = [*DEVICE_FAULTS, *HOST_FAULTS]
    assert len({row.number for row in rows}) == len({row.name for row in rows}) == len(rows)
    assert all(row.sentence and row.remedy for row in rows)
    assert all(0 < row.number < 32 for row in DEVICE_FAULTS)
    assert all(64 <= row.number < 256 and row.is_of_host for row in HOST_FAULTS)


def test_the_protocols_page_prints_the_table():
    assert "\n".join(documentation()) in PROTOCOL.read_text(encoding="utf-8")


def test_rows_are_found_by_name_and_by_number():
    assert fault("underrun") is FAULTS[3] is fault_of(3)


def test_a_device_may_have_faults_of_its_own():
    own = fault_of(40)
    assert (own.number, own.name) == (40, "fault_40")
    assert "firmware" in own.remedy
