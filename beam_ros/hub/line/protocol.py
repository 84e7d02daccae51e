"""The line protocol's messages: typed values to payloads and back. docs/protocol.md is its specification.

``Hello`` and the head of ``Identity`` never change, so that host and device of any two versions can tell each
other which versions they speak. Everything else belongs to ``VERSION``. All numbers are little-endian.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import ACTIVITIES, AXIS_STATES, REQUEST_KINDS, Activity, AxisState, RequestKind
from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.line.framing import encode_frame
from beam_ros.hub.parameters import COMMAND_MODES, MAX_BATCH_TICKS, AxisParameters, CommandMode
from beam_ros.hub.ticks import TickBatch

MAGIC = b"BEAM"
VERSION = 2
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


@dataclass(frozen=True)
class DeviceLimits:
    """What a device keeps by itself; in ``Identity`` the widest that it can, in a session what it obeys.

    Parameters
    ----------
    travel : float
        Whole travel [m], home in its middle.
    max_speed, max_acceleration, max_effort : float
        Greatest speed [m/s], acceleration [m/s^2], effort [N].
    stop_deceleration : float
        Of the stop ramp [m/s^2].
    move_speed, move_acceleration : float
        Of the move to a position set-point [m/s], [m/s^2].
    homing_speed, homing_acceleration : float
        Of the way home [m/s], [m/s^2].
    watchdog_ns : int
        The silence after which it stops [ns].
    """

    travel: float = 0.0
    max_speed: float = 0.0
    max_acceleration: float = 0.0
    max_effort: float = 0.0
    stop_deceleration: float = 0.0
    move_speed: float = 0.0
    move_acceleration: float = 0.0
    homing_speed: float = 0.0
    homing_acceleration: float = 0.0
    watchdog_ns: int = 0

    @classmethod
    def of(cls, parameters: AxisParameters) -> DeviceLimits:
        """Return the limits of the rig file."""
        names = (field.name for field in fields(cls) if field.name != "watchdog_ns")
        return cls(
            **{name: float(getattr(parameters, name)) for name in names},
            watchdog_ns=round(parameters.watchdog_s * 1e9),
        )

    def narrowed(self, widest: AxisParameters) -> AxisParameters:
        """Return an axis that obeys these limits, or its own where they are narrower.

        Raises
        ------
        HubParameterError
            No axis can have them.
        """
        own = vars(DeviceLimits.of(widest))
        least = {name: min(wanted, own[name]) for name, wanted in vars(self).items()}
        if not all(math.isfinite(wanted) for wanted in vars(self).values()):
            least = vars(DeviceLimits())
        watchdog_s = least.pop("watchdog_ns") * 1e-9
        return replace(widest, watchdog_s=watchdog_s, **least)


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
class SetLimits:
    """Hands the device what it must obey in this session; answered by ``LimitsReply``."""

    number: int
    limits: DeviceLimits


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
    encoder_resolution : float
        One count [m].
    widest : DeviceLimits
        The widest limits that the device can be given.
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
    widest: DeviceLimits = DeviceLimits()
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
class LimitsReply:
    """What the device obeys from now on; all zero where it has no limits yet."""

    number: int
    limits: DeviceLimits


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
    activity : str
        What the axis does in that state.
    position_count, velocity_count : int
        Encoder [encoder_resolution], [encoder_resolution / period].
    fault_number : int
        Why the axis was last stopped, by ``beam_ros.hub.faults``; 0: nothing is wrong.
    silences : int
        How often in this session the watchdog's time passed without a valid frame, modulo 2^16.
    silence_tick : int
        When it last did, 0 if never.
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
    activity: Activity
    position_count: int
    velocity_count: int
    fault_number: int
    silences: int
    silence_tick: int
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
    | SetLimits
    | Identity
    | ClockReply
    | RequestReply
    | ArmReply
    | Telemetry
    | Status
    | LimitsReply
)

# Layouts --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Field:
    """How a field is written, and how it is read from an offset on: its value, and where the next one begins."""

    pack: Callable[[Any], bytes]
    take: Callable[[bytes, int], tuple[Any, int]]


def _number(code: str) -> _Field:
    layout = struct.Struct(f"<{code}")
    return _Field(layout.pack, lambda data, at: (layout.unpack_from(data, at)[0], at + layout.size))


def _one_of(words: Sequence[object]) -> _Field:
    def take(data: bytes, at: int) -> tuple[object, int]:
        return words[data[at]], at + 1

    return _Field(lambda word: bytes((words.index(word),)), take)


def _pack_text(text: str) -> bytes:
    data = text.encode()[:MAX_TEXT].decode(errors="ignore").encode()
    return bytes((len(data),)) + data


def _take_text(data: bytes, at: int) -> tuple[str, int]:
    end = at + 1 + data[at]
    if end > len(data) or data[at] > MAX_TEXT:
        raise ValueError(f"text of {data[at]} bytes where {len(data) - at - 1} follow")
    return _printable(data[at + 1 : end].decode()), end


def _printable(text: str) -> str:
    """Replace what would steer a terminal or break a line of a log: a device's words are shown as they are."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


_LIMITS_STRUCT = struct.Struct("<9dI")


def _pack_limits(limits: DeviceLimits) -> bytes:
    return _LIMITS_STRUCT.pack(*vars(limits).values())


def _take_limits(data: bytes, at: int) -> tuple[DeviceLimits, int]:
    return DeviceLimits(*_LIMITS_STRUCT.unpack_from(data, at)), at + _LIMITS_STRUCT.size


def _check_count(what: str, count: int, most: int) -> None:
    if not 1 <= count <= most:
        raise ValueError(f"{count} {what}, expected 1 to {most}")


def _pack_samples(values: FloatArray) -> bytes:
    _check_count("samples", len(values), MAX_SAMPLES)
    return np.asarray(values, dtype="<f8").tobytes()


def _take_samples(data: bytes, at: int) -> tuple[FloatArray, int]:
    values = np.frombuffer(data[at:], dtype="<f8").astype(np.float64)
    _check_count("samples", len(values), MAX_SAMPLES)
    return values, len(data)


def _pack_ticks(ticks: TickBatch) -> bytes:
    _check_count("ticks", len(ticks), MAX_BATCH_TICKS)
    limits = np.iinfo(np.int32)
    return b"".join(
        (
            _TICKS.pack(ticks.first_tick, len(ticks)),
            ticks.applied.astype("<f8").tobytes(),
            np.clip(ticks.position_counts, limits.min, limits.max).astype("<i4").tobytes(),
            np.clip(ticks.velocity_counts, limits.min, limits.max).astype("<i4").tobytes(),
            ticks.efforts.astype("<f4").tobytes(),
        )
    )


def _take_ticks(data: bytes, at: int) -> tuple[TickBatch, int]:
    first_tick, n = _TICKS.unpack_from(data, at)
    _check_count("ticks", n, MAX_BATCH_TICKS)
    at += _TICKS.size
    ticks = TickBatch(
        first_tick,
        np.frombuffer(data, "<f8", n, at).astype(np.float64),
        np.frombuffer(data, "<i4", n, at + 8 * n).astype(np.int64),
        np.frombuffer(data, "<i4", n, at + 12 * n).astype(np.int64),
        np.frombuffer(data, "<f4", n, at + 16 * n).astype(np.float32),
    )
    return ticks, at + 20 * n


_TICKS = struct.Struct("<QB")
_U8, _U16, _U32, _U64, _I32, _F64 = map(_number, "BHIQid")
_TEXT = _Field(_pack_text, _take_text)
_LIMITS = _Field(_pack_limits, _take_limits)
_SAMPLES = _Field(_pack_samples, _take_samples)
_TICK_BATCH = _Field(_pack_ticks, _take_ticks)
_FLAG = _one_of((False, True))


def _named(field: _Field) -> _Field:
    """Return a field whose 0 stands for none, so that no message may have it."""

    def check(number: int) -> int:
        if number == 0:
            raise ValueError("number 0, which stands for none: expected 1 to 65535")
        return number

    def take(data: bytes, at: int) -> tuple[int, int]:
        number, end = field.take(data, at)
        return check(number), end

    return _Field(lambda number: field.pack(check(number)), take)


_NAME = _named(_U16)


@dataclass(frozen=True)
class _Layout:
    """The fields of a message in their order.

    Those of the handshake begin with ``MAGIC`` and ``n_frozen`` fields that no version changes; the first
    field names the version that the rest belongs to, and what follows of another one is ignored.
    """

    make: Callable[..., Message]
    fields: tuple[_Field, ...] = ()
    n_frozen: int = 0

    @property
    def magic(self) -> bytes:
        return MAGIC if self.n_frozen else b""

    def ends_after(self, values: Sequence[object]) -> bool:
        """Whether nothing of this version follows these first fields."""
        return 0 < self.n_frozen == len(values) and (len(self.fields) == len(values) or values[0] != VERSION)


HELLO, HEARTBEAT, CLOCK_QUERY, REQUEST, SETPOINT, ARM, SAMPLES, GOODBYE, SET_LIMITS = range(0x01, 0x0A)
IDENTITY, CLOCK_REPLY, REQUEST_REPLY, ARM_REPLY, TELEMETRY, STATUS, LIMITS_REPLY = range(0x81, 0x88)

_LAYOUTS: dict[int, _Layout] = {
    HELLO: _Layout(Hello, (_U8, _U8), n_frozen=2),
    HEARTBEAT: _Layout(Heartbeat),
    CLOCK_QUERY: _Layout(ClockQuery, (_U16,)),
    REQUEST: _Layout(Request, (_U16, _one_of(REQUEST_KINDS))),
    SETPOINT: _Layout(Setpoint, (_NAME, _F64)),
    ARM: _Layout(Arm, (_NAME, _U64, _U32)),
    SAMPLES: _Layout(Samples, (_U16, _U32, _SAMPLES)),
    GOODBYE: _Layout(Goodbye),
    SET_LIMITS: _Layout(SetLimits, (_U16, _LIMITS)),
    IDENTITY: _Layout(
        Identity,
        (_U8, _U8, _U8, _U32, _U32, _U8, _U16, _one_of(COMMAND_MODES), _F64, _LIMITS, _TEXT),
        n_frozen=4,
    ),
    CLOCK_REPLY: _Layout(ClockReply, (_U16, _U64, _U64)),
    REQUEST_REPLY: _Layout(RequestReply, (_U16, _one_of(REPLY_PHASES), _TEXT)),
    ARM_REPLY: _Layout(ArmReply, (_U16, _FLAG, _TEXT)),
    TELEMETRY: _Layout(Telemetry, (_TICK_BATCH,)),
    LIMITS_REPLY: _Layout(LimitsReply, (_U16, _LIMITS)),
    STATUS: _Layout(
        Status,
        (
            *(_U32, _U64, _one_of(AXIS_STATES), _one_of(ACTIVITIES), _I32, _I32),
            *(_U8, _U16, _U64, _U16, _U16),
            *(_U16, _one_of(DEVICE_SEQUENCE_STATES), _U32, _U16, _TEXT, _TEXT),
        ),
    ),
}
_KINDS = {layout.make: kind for kind, layout in _LAYOUTS.items()}


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
    kind = _KINDS[type(message)]
    layout = _LAYOUTS[kind]
    values = list(vars(message).values())
    if layout.ends_after(values[: layout.n_frozen]):
        values = values[: layout.n_frozen]
    try:
        body = b"".join(field.pack(value) for field, value in zip(layout.fields, values, strict=False))
    except (struct.error, ValueError) as err:
        raise HubProtocolError(
            f"{type(message).__name__} cannot be sent: {err}; see docs/protocol.md"
        ) from err
    return bytes((kind,)) + layout.magic + body


def decode(payload: bytes) -> Message:
    """Return the message in a payload.

    Raises
    ------
    HubProtocolError
        The type is unknown, or the body is not what the type says.
    """
    if not payload:
        raise HubProtocolError("empty payload: expected a type byte and a body")
    layout = _LAYOUTS.get(payload[0])
    if layout is None:
        raise HubProtocolError(
            f"message type 0x{payload[0]:02x}: expected one of "
            + ", ".join(f"0x{kind:02x}" for kind in _LAYOUTS)
            + f"; the other side speaks another version than {VERSION}"
        )
    try:
        return _decode(payload, layout)
    except (struct.error, ValueError, IndexError, UnicodeDecodeError) as err:
        raise HubProtocolError(
            f"message type 0x{payload[0]:02x} with {len(payload) - 1} bytes: {err}; see docs/protocol.md"
        ) from err


def _decode(payload: bytes, layout: _Layout) -> Message:
    at = 1 + len(layout.magic)
    if payload[1:at] != layout.magic:
        raise ValueError(f"magic {payload[1:at]!r}, expected {layout.magic!r}")
    values: list[object] = []
    for field in layout.fields:
        value, at = field.take(payload, at)
        values.append(value)
        if layout.ends_after(values):
            return layout.make(*values)
    if at != len(payload):
        raise ValueError(f"{len(payload) - at} bytes too many")
    return layout.make(*values)
