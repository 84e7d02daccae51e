"""The plant port's messages, against the table of docs/firmware.md written out by hand."""

from __future__ import annotations

import struct

import pytest

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.firmware.plant_port import (
    Boot,
    Drive,
    Reading,
    decode,
    encode_reading,
    encode_setup,
)
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters


def payload_of(frame):
    (payload,) = FrameDecoder().feed(frame)
    return payload


def test_a_setup_names_the_axis_and_its_widest_limits():
    axis = AxisParameters(
        travel=0.2,
        max_speed=0.4,
        max_acceleration=9.0,
        max_effort=15.0,
        stop_deceleration=8.0,
        move_speed=0.06,
        move_acceleration=0.7,
        homing_speed=0.03,
        homing_acceleration=0.3,
        watchdog_s=0.3,
        command_mode="position",
        encoder_resolution=2e-6,
    )
    head = b"\x01" + struct.pack("<IBB", 1_000_000, 20, 2) + struct.pack("<d", 2e-6)
    limits = struct.pack("<9d", 0.2, 0.4, 9.0, 15.0, 8.0, 0.06, 0.7, 0.03, 0.3) + struct.pack(
        "<I", 300_000_000
    )
    assert payload_of(encode_setup(axis, 0.002)) == head + limits + struct.pack("<d", 0.002)


@pytest.mark.parametrize(
    ("names", "flags"),
    [
        ((), 1),
        (("has_home_counter",), 3),
        (("is_below_home",), 5),
        (("is_at_low_end",), 9),
        (("is_at_high_end",), 17),
        (("has_drive_alarm",), 33),
        (("has_lost_steps",), 65),
    ],
)
def test_a_reading_carries_counters_modulo_2_to_the_32_and_a_bit_for_each_switch(names, flags):
    reading = Reading(7, -3, 2**32 + 5, effort=0.5, **dict.fromkeys(names, True))
    body = struct.pack("<QIIfB", 7, 0xFFFFFFFD, 5, 0.5, flags)
    assert payload_of(encode_reading(reading)) == b"\x02" + body


def test_what_a_board_says_is_read():
    assert decode(b"\x81" + struct.pack("<I", 77)) == Boot(77)
    body = struct.pack("<QBddddi", 12, 3, 0.01, -0.2, 3.0, 1.5, -40)
    assert decode(b"\x82" + body) == Drive(12, True, True, 0.01, -0.2, 3.0, 1.5, -40)


@pytest.mark.parametrize("payload", [b"\x81", b"\x82" + bytes(53), b"\x82" + bytes(40), b"\x07abc"])
def test_another_length_or_type_is_refused_with_what_was_expected(payload):
    with pytest.raises(HubProtocolError, match="build firmware and suite from the same source"):
        decode(payload)
