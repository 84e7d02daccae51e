"""ODrive's ASCII protocol, the host's side: lines with their checksums, and the numbers of its faults as names.

Written from the documentation of firmware 0.5 (https://docs.odriverobotics.com/v/0.5.6/ascii-protocol.html). A line
is ``command *checksum``, where the checksum is the exclusive or of all bytes before the asterisk; a device that is
asked with one answers with one, so that noise on the line cannot pass for a position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import reduce
from operator import xor

from beam_ros.hub.errors import HubProtocolError

MAX_LINE = 256
"""A longer line is noise [bytes]."""

IDLE, CLOSED_LOOP = 1, 8
"""States of an axis: motor off, and led by its commands."""
POSITION_CONTROL, PASSTHROUGH = 3, 1
"""Control mode and input mode in which ``p`` is followed as it comes."""
WATCHDOG_EXPIRED = 0x800

AXIS_FAULTS = {
    0x1: "INVALID_STATE",
    0x40: "MOTOR_FAILED",
    0x80: "SENSORLESS_ESTIMATOR_FAILED",
    0x100: "ENCODER_FAILED",
    0x200: "CONTROLLER_FAILED",
    WATCHDOG_EXPIRED: "WATCHDOG_TIMER_EXPIRED",
    0x1000: "MIN_ENDSTOP_PRESSED",
    0x2000: "MAX_ENDSTOP_PRESSED",
    0x4000: "ESTOP_REQUESTED",
    0x20000: "HOMING_WITHOUT_ENDSTOP",
    0x40000: "OVER_TEMP",
    0x80000: "UNKNOWN_POSITION",
}
MOTOR_FAULTS = {
    0x1: "PHASE_RESISTANCE_OUT_OF_RANGE",
    0x2: "PHASE_INDUCTANCE_OUT_OF_RANGE",
    0x8: "DRV_FAULT",
    0x10: "CONTROL_DEADLINE_MISSED",
    0x80: "MODULATION_MAGNITUDE",
    0x400: "CURRENT_SENSE_SATURATION",
    0x1000: "CURRENT_LIMIT_VIOLATION",
    0x10000: "MODULATION_IS_NAN",
    0x20000: "MOTOR_THERMISTOR_OVER_TEMP",
    0x40000: "FET_THERMISTOR_OVER_TEMP",
    0x200000: "CONTROLLER_FAILED",
    0x800000: "BRAKE_RESISTOR_DISARMED",
    0x1000000: "SYSTEM_LEVEL",
    0x4000000: "UNKNOWN_PHASE_ESTIMATE",
    0x800000000: "UNBALANCED_PHASES",
}
CONTROLLER_FAULTS = {
    0x1: "OVERSPEED",
    0x2: "INVALID_INPUT_MODE",
    0x4: "UNSTABLE_GAIN",
    0x20: "INVALID_ESTIMATE",
    0x80: "SPINOUT_DETECTED",
}
ENCODER_FAULTS = {
    0x1: "UNSTABLE_GAIN",
    0x2: "CPR_POLEPAIRS_MISMATCH",
    0x4: "NO_RESPONSE",
    0x10: "ILLEGAL_HALL_STATE",
    0x20: "INDEX_NOT_FOUND_YET",
    0x40: "ABS_SPI_TIMEOUT",
    0x80: "ABS_SPI_COM_FAIL",
    0x100: "ABS_SPI_NOT_READY",
}

FAULT_REGISTERS: Mapping[str, Mapping[int, str]] = {
    "error": AXIS_FAULTS,
    "motor.error": MOTOR_FAULTS,
    "controller.error": CONTROLLER_FAULTS,
    "encoder.error": ENCODER_FAULTS,
}
"""Properties of an axis that hold faults as bits, and the bits' names."""


def fault_names(register: str, value: int) -> list[str]:
    """Return the names of the bits that are set in a register of faults."""
    names = FAULT_REGISTERS[register]
    bits = [1 << k for k in range(value.bit_length()) if value >> k & 1]
    return [f"{register} {names.get(bit, f'bit 0x{bit:x}')}" for bit in bits]


def encode_line(command: str) -> bytes:
    """Return a command as the line that carries it."""
    text = f"{command} ".encode("ascii")
    return b"%s*%d\n" % (text, reduce(xor, text))


def decode_line(line: bytes) -> str:
    """Return the text of an answer, its checksum taken off.

    Raises
    ------
    HubProtocolError
        There is no checksum, or a wrong one: not the line that was sent.
    """
    text, star, checksum = line.strip().rpartition(b"*")
    if not star or not checksum.isdigit() or int(checksum) != reduce(xor, text, 0) or not text.isascii():
        raise HubProtocolError(
            f"line {line[:60]!r}: expected an answer with its checksum, as 24.087744*32; look for noise on the "
            "line, and for serial.baud"
        )
    return text.decode("ascii").strip()


def numbers(text: str, count: int) -> tuple[float, ...]:
    """Return the numbers of an answer.

    Raises
    ------
    HubProtocolError
        There are more or fewer, or words: a property that this firmware does not have.
    """
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise HubProtocolError(
            f"the ODrive answered {text[:60]!r}: expected {count} numbers; firmware 0.5 is needed, "
            "`odrivetool dfu` brings it"
        )
    return values
