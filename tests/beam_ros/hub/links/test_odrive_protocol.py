"""Lines of ODrive's ASCII protocol against the example of its documentation, and its faults by name."""

from __future__ import annotations

import pytest

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.links import odrive_protocol
from beam_ros.hub.links.query_line import UnreadableAnswerError


def test_a_command_carries_the_checksum_of_the_documentation() -> None:
    assert odrive_protocol.encode_line("r vbus_voltage") == b"r vbus_voltage *93\n"


def test_an_answer_is_taken_with_its_checksum_only() -> None:
    assert odrive_protocol.decode_line(b"24.087744*32\r") == "24.087744"
    for line in (b"24.087744", b"24.087745*11", b"24.087744*12", b"24.087744*", b"*", b"", b"\xff\xfe*1"):
        with pytest.raises(HubProtocolError, match="expected an answer with its checksum"):
            odrive_protocol.decode_line(line)


def test_no_damage_of_one_byte_passes() -> None:
    line = b"-1.250000 0.031250*14"
    assert odrive_protocol.decode_line(line) == "-1.250000 0.031250"
    for k in range(len(line)):
        for bit in range(8):
            damaged = line[:k] + bytes([line[k] ^ 1 << bit]) + line[k + 1 :]
            with pytest.raises(HubProtocolError):
                odrive_protocol.decode_line(damaged)


@pytest.mark.parametrize("text", ["invalid property", "1.0", "1.0 2.0 3.0", "nan 0.0", "inf 1", "lu", ""])
def test_an_answer_of_another_kind_is_one_that_cannot_be_read(text: str) -> None:
    words = rf"the ODrive answered {text!r} to 'f 0': expected 2 numbers"
    with pytest.raises(UnreadableAnswerError, match=words):
        odrive_protocol.numbers(text, 2, "f 0")


def test_faults_have_the_names_of_the_documentation() -> None:
    assert odrive_protocol.fault_names("axis{}.error", 1, 0x840) == (
        "axis1.error MOTOR_FAILED",
        "axis1.error WATCHDOG_TIMER_EXPIRED",
    )
    assert odrive_protocol.fault_names("error", 0, 0x2) == ("error DC_BUS_UNDER_VOLTAGE",)
    assert odrive_protocol.fault_names("axis{}.controller.error", 0, 0x40000001) == (
        "axis0.controller.error OVERSPEED",
        "axis0.controller.error bit 0x40000000",
    )
    assert odrive_protocol.fault_names("axis{}.motor.error", 0, 0) == ()


@pytest.mark.parametrize("version", [(0, 5, 4), (0, 5, 5), (0, 5, 6)])
def test_the_firmware_of_version_3_boards_is_spoken_to(version: tuple[int, int, int]) -> None:
    assert odrive_protocol.version_objection(version) == ""
