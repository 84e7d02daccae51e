"""DYNAMIXEL Protocol 2.0 against the examples of its documentation, every truncation, damage and noise."""

from __future__ import annotations

import random

import pytest

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.links import dynamixel_protocol as protocol

PING_OF_1 = bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E")
PONG = bytes.fromhex("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
"""Model 1030, firmware 38."""
PLACE = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
"""Present Position 166."""


def test_instructions_are_those_of_the_documentation() -> None:
    position = protocol.Register("Present Position", 132, 4)
    goal = protocol.GOAL_POSITION
    assert protocol.encode(1, protocol.PING) == PING_OF_1
    assert protocol.encode_read(1, position).hex(" ").upper() == "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"
    written = protocol.encode_write(1, goal, 512).hex(" ").upper()
    assert written == "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"
    assert protocol.encode(1, protocol.REBOOT).hex(" ").upper() == "FF FF FD 00 01 03 00 08 2F 4E"
    both = bytes.fromhex("74 00 04 00 01 96 00 00 00 02 AA 00 00 00")
    synced = protocol.encode(protocol.EVERYBODY, protocol.SYNC_WRITE, both).hex(" ").upper()
    assert synced == f"FF FF FD 00 FE 11 00 83 {both.hex(' ').upper()} 82 87"
    alone = protocol.encode_sync_write(1, goal, 150)
    assert alone[7:-2] == bytes([protocol.SYNC_WRITE]) + both[:9]


def test_answers_are_read_as_the_documentation_does() -> None:
    assert protocol.take_status(PONG + b"\xff") == (PONG, b"\xff")
    status = protocol.decode(PONG)
    assert (status.servo_id, status.error, status.refusal) == (1, 0, "")
    assert status.parameters == (1030).to_bytes(2, "little") + bytes([38])
    assert int.from_bytes(protocol.decode(PLACE).parameters, "little") == 166


def test_a_header_among_the_parameters_is_stuffed_and_comes_back() -> None:
    parameters = bytes.fromhex("00 FF FF FD FF FF FD FD FF FF FD")
    packet = protocol.encode(7, protocol.STATUS, parameters)
    assert packet.count(protocol.HEADER[:3]) == 1 + 3
    assert packet[7:-2].count(b"\xff\xff\xfd\xfd") == 3
    assert int.from_bytes(packet[5:7], "little") == len(packet) - 7
    status = protocol.decode(packet)
    assert bytes([status.error]) + status.parameters == parameters


def test_a_negative_goal_is_written_in_two_complement() -> None:
    packet = protocol.encode_write(1, protocol.GOAL_POSITION, -3)
    assert int.from_bytes(packet[10:14], "little", signed=True) == -3


def test_half_an_answer_is_none_yet() -> None:
    for k in range(len(PLACE)):
        assert protocol.take_status(PLACE[:k]) is None
        assert protocol.take_status(PLACE[:k] + PLACE) == (PLACE, b"")


def test_no_damage_of_one_byte_passes() -> None:
    for k in range(len(PLACE)):
        for bit in range(8):
            damaged = PLACE[:k] + bytes([PLACE[k] ^ 1 << bit]) + PLACE[k + 1 :]
            taken = protocol.take_status(damaged)
            if taken is not None:
                with pytest.raises(HubProtocolError, match="expected a status packet with its CRC"):
                    protocol.decode(taken[0])


def test_noise_is_no_answer_and_hides_none() -> None:
    rng = random.Random(1)
    likely = [*protocol.HEADER, 1, 7, 0x55]
    for _ in range(2000):
        noise = bytes(rng.choice([*likely, rng.randrange(256)]) for _ in range(rng.randrange(30)))
        taken = protocol.take_status(noise)
        assert taken is None or not protocol.is_sound(taken[0])
        assert protocol.take_status(noise + PONG) == (PONG, b"")


def test_another_hosts_instruction_is_no_answer() -> None:
    with pytest.raises(HubProtocolError, match="another host on the bus"):
        protocol.decode(PING_OF_1)


@pytest.mark.parametrize(
    ("error", "words"),
    [(0x00, ""), (0x80, ""), (0x04, "Data Range Error"), (0x87, "Access Error"), (0x0B, "error 11")],
)
def test_the_alert_is_no_refusal(error: int, words: str) -> None:
    assert protocol.decode(protocol.encode(1, protocol.STATUS, bytes([error]))).refusal == words


def test_hardware_errors_have_their_names() -> None:
    assert protocol.hardware_errors(0) == ()
    assert protocol.hardware_errors(0x25) == ("Input Voltage Error", "Overheating Error", "Overload Error")
    assert protocol.hardware_errors(0x58) == ("Motor Encoder Error", "Electrical Shock Error", "bit 0x40")


def test_only_the_x_series_with_a_watchdog_is_spoken_to() -> None:
    assert protocol.model_objection(1060, 38) == ""
    assert protocol.model_objection(1110, 50) == ""
    assert "of model 350: expected one of the X series" in protocol.model_objection(350, 45)
    assert "XM430-W350 has firmware 37: expected 38 or later" in protocol.model_objection(1020, 37)
