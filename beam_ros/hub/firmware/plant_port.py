"""The plant port: what a firmware and the plant behind it say to each other, tick by tick.

The messages of docs/firmware.md, in the frames of the line protocol. The board says what its drive does, the
plant says what the board's sensors read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import astuple, dataclass

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.line.framing import encode_frame
from beam_ros.hub.line.protocol import DeviceLimits
from beam_ros.hub.parameters import COMMAND_MODES, AxisParameters


@dataclass(frozen=True)
class Reading:
    """What the board's sensors read at the beginning of a tick.

    Parameters
    ----------
    tick : int
        Number of the tick; 0 for the one that the board begins with.
    counter : int
        The encoder's counter, modulo 2^32 [encoder_resolution].
    home_counter : int
        The counter where the home switch last changed, modulo 2^32.
    effort : float
        Force on the hub in the tick that has ended [N].
    is_counter_valid, has_home_counter, is_below_home, is_at_low_end, is_at_high_end, has_drive_alarm : bool
        Whether the encoder works, whether ``home_counter`` means anything, home and end switches, alarm.
    has_lost_steps : bool
        Whether the drive did not make all steps of a tick in its time.
    """

    tick: int
    counter: int
    home_counter: int = 0
    effort: float = 0.0
    is_counter_valid: bool = True
    has_home_counter: bool = False
    is_below_home: bool = False
    is_at_low_end: bool = False
    is_at_high_end: bool = False
    has_drive_alarm: bool = False
    has_lost_steps: bool = False


@dataclass(frozen=True)
class Boot:
    """The firmware has started, and waits for its settings."""

    boot_id: int


@dataclass(frozen=True)
class Drive:
    """What the drive does during a tick.

    Parameters
    ----------
    tick : int
        Number of the tick.
    is_powered, is_free : bool
        Whether the drive is on; whether the hub is free under ``effort``, else it follows the reference.
    position, velocity, acceleration : float
        The reference at the tick's beginning [m], after any jump [m/s], and held over the tick [m/s^2].
    effort : float
        Force held over the tick where the hub is free [N].
    steps : int
        Step pulses in this tick, signed.
    """

    tick: int
    is_powered: bool
    is_free: bool
    position: float
    velocity: float
    acceleration: float
    effort: float
    steps: int


SETUP, READING, BOOT, DRIVE = 0x01, 0x02, 0x81, 0x82

_SETUP = struct.Struct("<BIBBd9dId")
_READING = struct.Struct("<BQIIfB")
_BOOT = struct.Struct("<BI")
_DRIVE = struct.Struct("<BQBddddi")
_COUNTER = 0xFFFFFFFF


def encode_setup(parameters: AxisParameters, max_following_error: float = 0.0) -> bytes:
    """Return the frame that tells a board which axis it has: its tick, mode and encoder, and its widest limits.

    Parameters
    ----------
    parameters : AxisParameters
        The axis, with the widest limits.
    max_following_error : float
        Between reference and encoder [m]; 0: not looked at.
    """
    return encode_frame(
        _SETUP.pack(
            SETUP,
            parameters.period_ns,
            parameters.batch_ticks,
            COMMAND_MODES.index(parameters.command_mode),
            parameters.encoder_resolution,
            *astuple(DeviceLimits.of(parameters)),
            max_following_error,
        )
    )


def encode_reading(reading: Reading) -> bytes:
    """Return the frame of a reading."""
    flags = (
        reading.is_counter_valid,
        reading.has_home_counter,
        reading.is_below_home,
        reading.is_at_low_end,
        reading.is_at_high_end,
        reading.has_drive_alarm,
        reading.has_lost_steps,
    )
    return encode_frame(
        _READING.pack(
            READING,
            reading.tick,
            reading.counter & _COUNTER,
            reading.home_counter & _COUNTER,
            reading.effort,
            sum(flag << bit for bit, flag in enumerate(flags)),
        )
    )


def _take_boot(payload: bytes) -> Boot:
    return Boot(_BOOT.unpack(payload)[1])


def _take_drive(payload: bytes) -> Drive:
    _, tick, flags, position, velocity, acceleration, effort, steps = _DRIVE.unpack(payload)
    return Drive(tick, bool(flags & 1), bool(flags & 2), position, velocity, acceleration, effort, steps)


_TAKERS: dict[int, Callable[[bytes], Boot | Drive]] = {BOOT: _take_boot, DRIVE: _take_drive}


def decode(payload: bytes) -> Boot | Drive:
    """Return what a board said.

    Raises
    ------
    HubProtocolError
        The payload is none of the messages, or not as long as its type.
    """
    take = _TAKERS.get(payload[0])
    if take is None:
        raise HubProtocolError(
            f"plant port: message {payload[0]:#04x}, expected {BOOT:#04x} or {DRIVE:#04x}; "
            "build firmware and suite from the same source"
        )
    try:
        return take(payload)
    except struct.error as err:
        raise HubProtocolError(
            f"plant port: message {payload[0]:#04x} with {len(payload)} bytes: {err}; "
            "build firmware and suite from the same source"
        ) from err
