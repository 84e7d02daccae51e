"""The line protocol's messages: typed values to payloads and back. docs/protocol.md is its specification.

``Hello`` and the head of ``Identity`` never change, so that host and device of any two versions can tell each
other which versions they speak. Everything else belongs to ``VERSION``. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import AXIS_STATES, REQUEST_KINDS, AxisState, RequestKind
from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.line.framing import encode_frame
from beam_ros.hub.parameters import COMMAND_MODES, MAX_BATCH_TICKS, CommandMode
from beam_ros.hub.ticks import TickBatch

MAGIC = b"BEAM"
VERSION = 1
MAX_SAMPLES = 100
"""Most samples in one ``Samples`` message."""
MAX_TEXT = 200
"""Longest text [bytes of UTF-8]."""

DeviceSequenceState = Literal["none", "armed", "running", "done", "aborted", "underrun"]
DEVICE_SEQUENCE_STATES: tuple[DeviceSequenceState, ...] = (
    "none",
    "armed",
    "running",
    "done",
    "aborted",
    "underrun",
)
ReplyPhase = Literal["pending", "success", "failure"]
REPLY_PHASES: tuple[ReplyPhase, ...] = ("pending", "success", "failure")


# Host to device -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hello:
    """The host opens a session: the device stops whatever an earlier one left, and answers ``Identity``."""

    lowest_version: int = VERSION
    highest_version: int = VERSION


@dataclass(frozen=True)
class Heartbeat:
    """A sign of life, where there is nothing else to send."""


@dataclass(frozen=True)
class ClockQuery:
    """Asks what the device's clock reads; answered at once by ``ClockReply``."""

    number: int


@dataclass(frozen=True)
class Request:
    """Asks for a change of state; repeated with the same number it is done once and answered again."""

    number: int
    kind: RequestKind


@dataclass(frozen=True)
class Setpoint:
    """One set-point in the command mode's unit; repeated with the same number it is the same one."""

    number: int
    value: float


@dataclass(frozen=True)
class Arm:
    """Announces a sequence of ``n_samples``, to start at ``start_ns`` of device time."""

    number: int
    start_ns: int
    n_samples: int


@dataclass(frozen=True)
class Samples:
    """Samples ``first``, ``first`` + 1, ... of the armed sequence, in the command mode's unit."""

    number: int
    first: int
    values: FloatArray


@dataclass(frozen=True)
class Goodbye:
    """The host closes the session: the device stops, and falls silent."""


# Device to host -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Identity:
    """Who the device is. Only the first four fields can be relied on in every version.

    Parameters
    ----------
    version : int
        The version that both speak, 0 if there is none.
    lowest_version, highest_version : int
        What the device speaks.
    boot_id : int
        Another one after every start of the device.
    period_ns, batch_ticks, buffer_samples : int
        Tick, ticks in a telemetry batch, room for samples.
    command_mode : str
        What set-points and samples mean.
    encoder_resolution, travel, max_speed, max_acceleration, max_effort : float
        The axis, as the device guards it.
    watchdog_ns : int
        The silence after which it stops.
    name : str
        For people.
    """

    version: int
    lowest_version: int
    highest_version: int
    boot_id: int
    period_ns: int = 0
    batch_ticks: int = 0
    buffer_samples: int = 0
    command_mode: CommandMode = "acceleration"
    encoder_resolution: float = 0.0
    travel: float = 0.0
    max_speed: float = 0.0
    max_acceleration: float = 0.0
    max_effort: float = 0.0
    watchdog_ns: int = 0
    name: str = ""


@dataclass(frozen=True)
class ClockReply:
    """What the device's clock read [ns] when the query came and when the answer left."""

    number: int
    received_ns: int
    sent_ns: int


@dataclass(frozen=True)
class RequestReply:
    """How a request stands."""

    number: int
    phase: ReplyPhase
    text: str


@dataclass(frozen=True)
class ArmReply:
    """Whether a sequence was accepted."""

    number: int
    is_accepted: bool
    text: str


@dataclass(frozen=True)
class Telemetry:
    """What the axis did and measured in the last ticks."""

    ticks: TickBatch


@dataclass(frozen=True)
class Status:
    """Where the device stands; sent with every batch and at every change.

    Parameters
    ----------
    boot_id : int
        As in ``Identity``.
    tick : int
        The tick that comes next.
    state : str
        identified, homed, enabled or fault.
    position_count, velocity_count : int
        Encoder [encoder_resolution], [encoder_resolution / period].
    setpoint_number : int
        Newest set-point that came, 0 if none has.
    setpoints_refused : int
        Counter, modulo 2^16.
    sequence_number : int
        The sequence that the rest is about.
    sequence_state : str
        none, armed, running, done, aborted or underrun.
    received : int
        Samples of it that have come without a gap.
    free : int
        Samples that the buffer has room for.
    reason : str
        Why the axis was disabled or stands in fault.
    sequence_reason : str
        Why the sequence ended early.
    """

    boot_id: int
    tick: int
    state: AxisState
    position_count: int
    velocity_count: int
    setpoint_number: int
    setpoints_refused: int
    sequence_number: int
    sequence_state: DeviceSequenceState
    received: int
    free: int
    reason: str
    sequence_reason: str


Message = (
    Hello
    | Heartbeat
    | ClockQuery
    | Request
    | Setpoint
    | Arm
    | Samples
    | Goodbye
    | Identity
    | ClockReply
    | RequestReply
    | ArmReply
    | Telemetry
    | Status
)

# Layouts --------------------------------------------------------------------------------------------------

_HELLO = struct.Struct("<4sBB")
_IDENTITY_HEAD = struct.Struct("<4sBBBI")
_IDENTITY = struct.Struct("<IBHB5dI")
_NUMBER = struct.Struct("<H")
_REQUEST = struct.Struct("<HB")
_SETPOINT = struct.Struct("<Hd")
_ARM = struct.Struct("<HQI")
_SAMPLES = struct.Struct("<HI")
_CLOCK_REPLY = struct.Struct("<HQQ")
_REPLY = struct.Struct("<HB")
_TELEMETRY = struct.Struct("<QB")
_TICK_BYTES = 8 + 4 + 4 + 4
_STATUS = struct.Struct("<IQBiiHHHBIH")

HELLO, HEARTBEAT, CLOCK_QUERY, REQUEST, SETPOINT, ARM, SAMPLES, GOODBYE = range(0x01, 0x09)
IDENTITY, CLOCK_REPLY, REQUEST_REPLY, ARM_REPLY, TELEMETRY, STATUS = range(0x81, 0x87)


def encode(message: Message) -> bytes:
    """Return a message as one frame, ready for the line."""
    return encode_frame(encode_payload(message))


def encode_payload(message: Message) -> bytes:
    """Return a message's type byte and body.

    Raises
    ------
    HubProtocolError
        A value does not fit its field.
    """
    try:
        return _encode(message)
    except (struct.error, ValueError) as err:
        raise HubProtocolError(
            f"{type(message).__name__} cannot be sent: {err}; see docs/protocol.md"
        ) from err


def _encode(message: Message) -> bytes:
    match message:
        case Hello():
            body = _HELLO.pack(MAGIC, message.lowest_version, message.highest_version)
            return _typed(HELLO, body)
        case Heartbeat():
            return _typed(HEARTBEAT)
        case ClockQuery():
            return _typed(CLOCK_QUERY, _NUMBER.pack(message.number))
        case Request():
            return _typed(REQUEST, _REQUEST.pack(message.number, REQUEST_KINDS.index(message.kind)))
        case Setpoint():
            return _typed(SETPOINT, _SETPOINT.pack(message.number, message.value))
        case Arm():
            return _typed(ARM, _ARM.pack(message.number, message.start_ns, message.n_samples))
        case Samples():
            _check_count("samples", len(message.values), MAX_SAMPLES)
            values = np.asarray(message.values, dtype="<f8").tobytes()
            return _typed(SAMPLES, _SAMPLES.pack(message.number, message.first) + values)
        case Goodbye():
            return _typed(GOODBYE)
        case Identity():
            return _typed(IDENTITY, _identity_body(message))
        case ClockReply():
            return _typed(
                CLOCK_REPLY, _CLOCK_REPLY.pack(message.number, message.received_ns, message.sent_ns)
            )
        case RequestReply():
            head = _REPLY.pack(message.number, REPLY_PHASES.index(message.phase))
            return _typed(REQUEST_REPLY, head + _text(message.text))
        case ArmReply():
            return _typed(ARM_REPLY, _REPLY.pack(message.number, message.is_accepted) + _text(message.text))
        case Telemetry():
            return _typed(TELEMETRY, _telemetry_body(message.ticks))
        case Status():
            return _typed(STATUS, _status_body(message))


def _typed(kind: int, body: bytes = b"") -> bytes:
    return bytes((kind,)) + body


def _text(text: str) -> bytes:
    data = text.encode()[:MAX_TEXT].decode(errors="ignore").encode()
    return bytes((len(data),)) + data


def _check_count(what: str, count: int, most: int) -> None:
    if not 1 <= count <= most:
        raise ValueError(f"{count} {what}, expected 1 to {most}")


def _identity_body(message: Identity) -> bytes:
    head = _IDENTITY_HEAD.pack(
        MAGIC, message.version, message.lowest_version, message.highest_version, message.boot_id
    )
    if message.version != VERSION:
        return head
    return (
        head
        + _IDENTITY.pack(
            message.period_ns,
            message.batch_ticks,
            message.buffer_samples,
            COMMAND_MODES.index(message.command_mode),
            message.encoder_resolution,
            message.travel,
            message.max_speed,
            message.max_acceleration,
            message.max_effort,
            message.watchdog_ns,
        )
        + _text(message.name)
    )


def _telemetry_body(ticks: TickBatch) -> bytes:
    _check_count("ticks", len(ticks), MAX_BATCH_TICKS)
    limits = np.iinfo(np.int32)
    return b"".join(
        (
            _TELEMETRY.pack(ticks.first_tick, len(ticks)),
            ticks.applied.astype("<f8").tobytes(),
            np.clip(ticks.position_counts, limits.min, limits.max).astype("<i4").tobytes(),
            np.clip(ticks.velocity_counts, limits.min, limits.max).astype("<i4").tobytes(),
            ticks.efforts.astype("<f4").tobytes(),
        )
    )


def _status_body(message: Status) -> bytes:
    return (
        _STATUS.pack(
            message.boot_id,
            message.tick,
            AXIS_STATES.index(message.state),
            message.position_count,
            message.velocity_count,
            message.setpoint_number,
            message.setpoints_refused,
            message.sequence_number,
            DEVICE_SEQUENCE_STATES.index(message.sequence_state),
            message.received,
            message.free,
        )
        + _text(message.reason)
        + _text(message.sequence_reason)
    )


def decode(payload: bytes) -> Message:
    """Return the message in a payload.

    Raises
    ------
    HubProtocolError
        The type is unknown, or the body is not what the type says.
    """
    if not payload:
        raise HubProtocolError("empty payload: expected a type byte and a body")
    decoder = _DECODERS.get(payload[0])
    if decoder is None:
        raise HubProtocolError(
            f"message type 0x{payload[0]:02x}: expected one of "
            + ", ".join(f"0x{kind:02x}" for kind in _DECODERS)
            + f"; the other side speaks another version than {VERSION}"
        )
    try:
        return decoder(payload[1:])
    except (struct.error, ValueError, IndexError, UnicodeDecodeError) as err:
        raise HubProtocolError(
            f"message type 0x{payload[0]:02x} with {len(payload) - 1} bytes: {err}; see docs/protocol.md"
        ) from err


def _take_text(data: bytes) -> tuple[str, bytes]:
    length = data[0]
    if length > min(len(data) - 1, MAX_TEXT):
        raise ValueError(f"text of {length} bytes where {len(data) - 1} follow")
    return data[1 : 1 + length].decode(), data[1 + length :]


def _last_text(data: bytes) -> str:
    text, rest = _take_text(data)
    if rest:
        raise ValueError(f"{len(rest)} bytes too many")
    return text


def _flag(value: int) -> bool:
    if value > 1:
        raise ValueError(f"flag {value}, expected 0 or 1")
    return bool(value)


def _decode_hello(body: bytes) -> Hello:
    magic, lowest, highest = _HELLO.unpack(body[: _HELLO.size])
    if magic != MAGIC:
        raise ValueError(f"magic {magic!r}, expected {MAGIC!r}")
    return Hello(lowest, highest)


def _decode_empty(make: Callable[[], Message]) -> Callable[[bytes], Message]:
    def decode_empty(body: bytes) -> Message:
        if body:
            raise ValueError("expected no body")
        return make()

    return decode_empty


def _decode_clock_query(body: bytes) -> ClockQuery:
    return ClockQuery(*_NUMBER.unpack(body))


def _decode_request(body: bytes) -> Request:
    number, kind = _REQUEST.unpack(body)
    return Request(number, REQUEST_KINDS[kind])


def _decode_setpoint(body: bytes) -> Setpoint:
    return Setpoint(*_SETPOINT.unpack(body))


def _decode_arm(body: bytes) -> Arm:
    return Arm(*_ARM.unpack(body))


def _decode_samples(body: bytes) -> Samples:
    number, first = _SAMPLES.unpack(body[: _SAMPLES.size])
    values = np.frombuffer(body[_SAMPLES.size :], dtype="<f8").astype(np.float64)
    _check_count("samples", len(values), MAX_SAMPLES)
    return Samples(number, first, values)


def _decode_identity(body: bytes) -> Identity:
    size = _IDENTITY_HEAD.size
    magic, version, lowest, highest, boot_id = _IDENTITY_HEAD.unpack(body[:size])
    if magic != MAGIC:
        raise ValueError(f"magic {magic!r}, expected {MAGIC!r}")
    if version != VERSION:
        return Identity(version, lowest, highest, boot_id)
    fields = _IDENTITY.unpack(body[size : size + _IDENTITY.size])
    period_ns, batch_ticks, buffer_samples, mode, resolution, *limits, watchdog = fields
    travel, speed, acceleration, effort = limits
    name = _last_text(body[size + _IDENTITY.size :])
    return Identity(
        version,
        lowest,
        highest,
        boot_id,
        period_ns,
        batch_ticks,
        buffer_samples,
        _mode(mode),
        resolution,
        travel,
        speed,
        acceleration,
        effort,
        watchdog,
        name,
    )


def _mode(index: int) -> CommandMode:
    modes: tuple[CommandMode, ...] = ("acceleration", "velocity", "position", "effort")
    return modes[index]


def _decode_clock_reply(body: bytes) -> ClockReply:
    return ClockReply(*_CLOCK_REPLY.unpack(body))


def _decode_request_reply(body: bytes) -> RequestReply:
    number, phase = _REPLY.unpack(body[: _REPLY.size])
    return RequestReply(number, REPLY_PHASES[phase], _last_text(body[_REPLY.size :]))


def _decode_arm_reply(body: bytes) -> ArmReply:
    number, is_accepted = _REPLY.unpack(body[: _REPLY.size])
    return ArmReply(number, _flag(is_accepted), _last_text(body[_REPLY.size :]))


def _decode_telemetry(body: bytes) -> Telemetry:
    first_tick, count = _TELEMETRY.unpack(body[: _TELEMETRY.size])
    _check_count("ticks", count, MAX_BATCH_TICKS)
    data = body[_TELEMETRY.size :]
    if len(data) != count * _TICK_BYTES:
        raise ValueError(f"{len(data)} bytes for {count} ticks, expected {count * _TICK_BYTES}")
    return Telemetry(
        TickBatch(
            first_tick,
            np.frombuffer(data, "<f8", count).astype(np.float64),
            np.frombuffer(data, "<i4", count, 8 * count).astype(np.int64),
            np.frombuffer(data, "<i4", count, 12 * count).astype(np.int64),
            np.frombuffer(data, "<f4", count, 16 * count).astype(np.float32),
        )
    )


def _decode_status(body: bytes) -> Status:
    fields = _STATUS.unpack(body[: _STATUS.size])
    boot_id, tick, state, position, velocity, setpoint, refused, number, sequence, received, free = fields
    reason, rest = _take_text(body[_STATUS.size :])
    return Status(
        boot_id,
        tick,
        AXIS_STATES[state],
        position,
        velocity,
        setpoint,
        refused,
        number,
        DEVICE_SEQUENCE_STATES[sequence],
        received,
        free,
        reason,
        _last_text(rest),
    )


_DECODERS: dict[int, Callable[[bytes], Message]] = {
    HELLO: _decode_hello,
    HEARTBEAT: _decode_empty(Heartbeat),
    CLOCK_QUERY: _decode_clock_query,
    REQUEST: _decode_request,
    SETPOINT: _decode_setpoint,
    ARM: _decode_arm,
    SAMPLES: _decode_samples,
    GOODBYE: _decode_empty(Goodbye),
    IDENTITY: _decode_identity,
    CLOCK_REPLY: _decode_clock_reply,
    REQUEST_REPLY: _decode_request_reply,
    ARM_REPLY: _decode_arm_reply,
    TELEMETRY: _decode_telemetry,
    STATUS: _decode_status,
}
