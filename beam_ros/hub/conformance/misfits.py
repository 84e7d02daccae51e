"""Frames that a device must drop: each is wrong in one way only, and none may keep an axis alive."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import MAX_PAYLOAD, cobs_encode, encode_frame


def misfits(limits: protocol.DeviceLimits) -> dict[str, bytes]:
    """Return frames that do not fit, by what is wrong with them.

    Parameters
    ----------
    limits : DeviceLimits
        What a whole SetLimits would ask for.
    """
    heartbeat = protocol.encode(protocol.Heartbeat())
    wrong_check = heartbeat[:-2] + bytes((heartbeat[-2] ^ 1,)) + heartbeat[-1:]
    hello = protocol.encode_payload(protocol.Hello())
    bodies = {
        "an unknown type": b"\x0a\1\2\3",
        "a type of the device's own": protocol.encode_payload(protocol.ClockReply(1, 0, 0)),
        "a Hello without BEAM": hello[:1] + b"MAEB" + hello[5:],
        "a Hello that is too short": hello[:-1],
        "a Request of kind 5": struct.pack("<BHB", protocol.REQUEST, 1, 5),
        "a Setpoint with number 0": struct.pack("<BHd", protocol.SETPOINT, 0, 0.0),
        "an Arm with number 0": struct.pack("<BHQI", protocol.ARM, 0, 0, 10),
        "Samples without a value": struct.pack("<BHI", protocol.SAMPLES, 0, 0),
        "Samples with a part of a value": struct.pack("<BHI", protocol.SAMPLES, 0, 0) + bytes(12),
        "101 Samples": struct.pack("<BHI", protocol.SAMPLES, 0, 0) + bytes(8 * (protocol.MAX_SAMPLES + 1)),
    }
    whole = (
        protocol.Heartbeat(),
        protocol.ClockQuery(1),
        protocol.Request(1, "clear_fault"),
        protocol.Setpoint(1, 0.0),
        protocol.Arm(1, 0, 10),
        protocol.Goodbye(),
        protocol.SetLimits(1, limits),
    )
    for message in whole:
        payload = protocol.encode_payload(message)
        name = type(message).__name__
        bodies[f"a {name} with a byte too many"] = payload + b"\1"
        if len(payload) > 1:
            bodies[f"a {name} with a byte too few"] = payload[:-1]
    return {
        "a wrong CRC": wrong_check,
        "a COBS block beyond the frame's end": b"\0\xfe\1\2\3\4\5\6\0",
        "a frame without room for a CRC": b"\0\2\1\0",
        "a Hello that is too long": _frame(hello + bytes((1,)) * MAX_PAYLOAD),
        **{name: encode_frame(body) for name, body in bodies.items()},
    }


def _frame(payload: bytes) -> bytes:
    """Return the frame of a payload of any length."""
    return b"\0" + cobs_encode(payload + zlib.crc32(payload).to_bytes(4, "little")) + b"\0"


def valid_frames(limits: protocol.DeviceLimits, number: int) -> dict[str, bytes]:
    """Return a frame of every type that a session knows, which changes nothing at a resting axis."""
    messages = (
        protocol.Heartbeat(),
        protocol.ClockQuery(number),
        protocol.Request(number, "clear_fault"),
        protocol.Setpoint(number, 0.0),
        protocol.Arm(number, 0, 10),
        protocol.Samples(0, 0xFFFFFFFF, np.zeros(1)),
        protocol.SetLimits(number, limits),
    )
    return {type(message).__name__: protocol.encode(message) for message in messages}
