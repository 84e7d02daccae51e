from __future__ import annotations

import contextlib
import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beam_ros.hub.errors import HubParameterError, HubProtocolError
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

TICKS = TickBatch(
    123_456_789_012,
    np.array([0.1, -1e-300, 9.75]),
    np.array([-500_000, 0, 499_999]),
    np.array([5000, -1, 0]),
    np.array([1.5, -2.25, 0.0], dtype=np.float32),
)
LIMITS = protocol.DeviceLimits(0.1, 0.5, 10.0, 20.0, 8.0, 0.05, 0.5, 0.02, 0.2, 250_000_000)
IDENTITY = protocol.Identity(2, 1, 3, 0xDEADBEEF, 1_000_000, 20, 512, "velocity", 1e-7, LIMITS, "emulator")
STATUS = protocol.Status(
    *(7, 10**15, "fault", "idle", -12, 34, 4, 65534, 10**14),
    *(4, 65535, 9, "underrun", 2**31, 512, "limit: ±50 mm", "it was slow"),
)
MESSAGES = [
    protocol.Hello(1, 4),
    protocol.Heartbeat(),
    protocol.ClockQuery(65535),
    protocol.Request(12, "clear_fault"),
    protocol.Setpoint(65535, -0.125),
    protocol.Arm(3, 2**63, 4_000_000_000),
    protocol.Samples(3, 500, np.array([1.0, -0.0, 1e-17])),
    protocol.Goodbye(),
    protocol.SetLimits(4, LIMITS),
    IDENTITY,
    protocol.ClockReply(1, 2**60, 2**60 + 1),
    protocol.RequestReply(12, "failure", "home it first"),
    protocol.ArmReply(3, False, "its start was 0.100 s ago"),
    protocol.Telemetry(TICKS),
    STATUS,
    protocol.LimitsReply(4, protocol.DeviceLimits()),
]


def plain(value):
    """Return a message's fields with arrays as bytes, so that they compare bit for bit."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.tobytes()
    if dataclasses.is_dataclass(value):
        return type(value), [plain(getattr(value, f.name)) for f in dataclasses.fields(value)]
    return value


def ids(message):
    return type(message).__name__


@pytest.mark.parametrize("message", MESSAGES, ids=ids)
def test_every_message_survives_the_line_bit_for_bit(message):
    (payload,) = FrameDecoder().feed(protocol.encode(message))
    assert plain(protocol.decode(payload)) == plain(message)


@pytest.mark.parametrize("message", MESSAGES, ids=ids)
def test_no_truncated_or_extended_body_passes_for_the_message(message):
    payload = protocol.encode_payload(message)
    for length in range(len(payload)):
        with_length = payload[:length]
        # Fewer whole samples are still samples; the frame's CRC is what guards those.
        if isinstance(message, protocol.Samples) and length in (7 + 8, 7 + 16):
            continue
        with pytest.raises(HubProtocolError):
            protocol.decode(with_length)
    if not isinstance(message, protocol.Hello):
        with pytest.raises(HubProtocolError):
            protocol.decode(payload + b"\x01")


@given(st.binary(max_size=600))
@settings(deadline=None, derandomize=True, max_examples=500)
def test_random_payloads_are_messages_or_protocol_errors(payload):
    try:
        message = protocol.decode(payload)
    except HubProtocolError:
        return
    protocol.encode_payload(message)


@pytest.mark.slow
@given(st.sampled_from(MESSAGES), st.data())
@settings(deadline=None, derandomize=True, max_examples=500)
def test_changed_bodies_are_messages_or_protocol_errors(message, data):
    payload = bytearray(protocol.encode_payload(message))
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(HubProtocolError):
        protocol.decode(bytes(payload))


def test_hello_of_a_later_version_is_understood():
    # A later host may append fields; the head is frozen.
    hello = protocol.decode(protocol.encode_payload(protocol.Hello(5, 9)) + b"something new")
    assert hello == protocol.Hello(5, 9)


def test_the_frozen_bytes_of_the_handshake():
    assert protocol.encode_payload(protocol.Hello(1, 1)).hex() == "01" + b"BEAM".hex() + "0101"
    head = protocol.encode_payload(IDENTITY)[:12]
    assert head.hex() == "81" + b"BEAM".hex() + "020103" + "efbeadde"


def test_identity_of_another_version_says_which_versions_the_device_speaks():
    head = protocol.encode_payload(protocol.Identity(0, 3, 4, 77))
    assert protocol.decode(head) == protocol.Identity(0, 3, 4, 77)
    assert protocol.decode(head + b"whatever comes with version 4").highest_version == 4


def test_long_texts_are_cut_at_a_character():
    reply = protocol.decode(protocol.encode_payload(protocol.RequestReply(1, "failure", "µ" * 150)))
    assert reply.text == "µ" * 100


@pytest.mark.parametrize(
    "text", ["\x1b[2J\x1b[31mall is well", "one\nline: error", "bell\a", "\u202eback", "\x85next"]
)
def test_the_texts_of_a_device_steer_no_terminal_and_break_no_line(text):
    reply = protocol.decode(protocol.encode_payload(protocol.RequestReply(1, "failure", text)))
    assert reply.text.isprintable()
    assert len(reply.text) == len(text)
    assert [own for own in reply.text if own != "\N{REPLACEMENT CHARACTER}"] == [
        own for own in text if own.isprintable()
    ]


@pytest.mark.parametrize(
    "message",
    [
        protocol.ClockQuery(65536),
        protocol.Arm(1, -1, 10),
        protocol.Samples(1, 0, np.zeros(101)),
        protocol.Samples(1, 0, np.zeros(0)),
        protocol.Hello(1, 256),
    ],
)
def test_what_does_not_fit_its_field_is_refused_before_it_is_sent(message):
    with pytest.raises(HubProtocolError, match=type(message).__name__):
        protocol.encode(message)


def test_an_unknown_type_names_the_version():
    with pytest.raises(HubProtocolError, match=r"0x7f.*version"):
        protocol.decode(b"\x7f")


@pytest.mark.parametrize("message", [protocol.Setpoint(1, 0.5), protocol.Arm(1, 10, 20)])
def test_number_0_stands_for_none_and_names_no_setpoint_and_no_sequence(message):
    with pytest.raises(HubProtocolError, match="stands for none"):
        protocol.encode(replace(message, number=0))
    payload = protocol.encode_payload(message)
    with pytest.raises(HubProtocolError, match="stands for none"):
        protocol.decode(payload[:1] + b"\0\0" + payload[3:])


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_limit_that_is_no_number_leaves_none_that_an_axis_can_have(value):
    limits = replace(protocol.DeviceLimits.of(AxisParameters()), stop_deceleration=value)
    with pytest.raises(HubParameterError):
        limits.narrowed(AxisParameters())
