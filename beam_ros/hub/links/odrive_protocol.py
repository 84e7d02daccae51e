"""ODrive's ASCII protocol, the host's side: lines with their checksums, and the numbers of its faults as names.

Written from the documentation of firmware 0.5 (https://docs.odriverobotics.com/v/0.5.6/ascii-protocol.html). A line
is ``command *checksum``, where the checksum is the exclusive or of all bytes before the asterisk; a device that is
asked with one answers with one, so that noise on the line cannot pass for a position. An answer with the right
checksum but without the numbers that were asked for was meant: the device speaks, and cannot do this.
"""

from __future__ import annotations

import math
from functools import reduce
from operator import xor

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.links.query_line import UnreadableAnswerError

MIN_VERSION = (0, 5, 4)
"""Firmware before it does not set states over ASCII, and prints ``0d`` for a fault register that is 0."""
PRINTED_STEP = 1e-6
"""A property that is no integer is printed with six decimals."""

IDLE, CLOSED_LOOP = 1, 8
"""States of an axis: motor off, and led by its commands."""
POSITION_CONTROL, PASSTHROUGH = 3, 1
"""Control mode and input mode in which ``p`` is followed as it comes."""
WATCHDOG_EXPIRED = 0x800

AXIS_REGISTER, MOTOR_REGISTER = "axis{}.error", "axis{}.motor.error"
_FAULTS = """
error
    0x1 CONTROL_ITERATION_MISSED 0x2 DC_BUS_UNDER_VOLTAGE 0x4 DC_BUS_OVER_VOLTAGE
    0x8 DC_BUS_OVER_REGEN_CURRENT 0x10 DC_BUS_OVER_CURRENT 0x20 BRAKE_DEADTIME_VIOLATION
    0x40 BRAKE_DUTY_CYCLE_NAN 0x80 INVALID_BRAKE_RESISTANCE
axis{}.error
    0x1 INVALID_STATE 0x40 MOTOR_FAILED 0x80 SENSORLESS_ESTIMATOR_FAILED 0x100 ENCODER_FAILED
    0x200 CONTROLLER_FAILED 0x800 WATCHDOG_TIMER_EXPIRED 0x1000 MIN_ENDSTOP_PRESSED
    0x2000 MAX_ENDSTOP_PRESSED 0x4000 ESTOP_REQUESTED 0x20000 HOMING_WITHOUT_ENDSTOP 0x40000 OVER_TEMP
    0x80000 UNKNOWN_POSITION
axis{}.motor.error
    0x1 PHASE_RESISTANCE_OUT_OF_RANGE 0x2 PHASE_INDUCTANCE_OUT_OF_RANGE 0x8 DRV_FAULT
    0x10 CONTROL_DEADLINE_MISSED 0x80 MODULATION_MAGNITUDE 0x400 CURRENT_SENSE_SATURATION
    0x1000 CURRENT_LIMIT_VIOLATION 0x10000 MODULATION_IS_NAN 0x20000 MOTOR_THERMISTOR_OVER_TEMP
    0x40000 FET_THERMISTOR_OVER_TEMP 0x200000 CONTROLLER_FAILED 0x800000 BRAKE_RESISTOR_DISARMED
    0x1000000 SYSTEM_LEVEL 0x4000000 UNKNOWN_PHASE_ESTIMATE 0x800000000 UNBALANCED_PHASES
axis{}.controller.error
    0x1 OVERSPEED 0x2 INVALID_INPUT_MODE 0x4 UNSTABLE_GAIN 0x20 INVALID_ESTIMATE 0x80 SPINOUT_DETECTED
axis{}.encoder.error
    0x1 UNSTABLE_GAIN 0x2 CPR_POLEPAIRS_MISMATCH 0x4 NO_RESPONSE 0x10 ILLEGAL_HALL_STATE
    0x20 INDEX_NOT_FOUND_YET 0x40 ABS_SPI_TIMEOUT 0x80 ABS_SPI_COM_FAIL 0x100 ABS_SPI_NOT_READY
axis{}.sensorless_estimator.error
    0x1 UNSTABLE_GAIN 0x2 UNKNOWN_CURRENT_MEASUREMENT
"""


def _registers(text: str) -> dict[str, dict[int, str]]:
    """Return the table: a register, and below it its bits with their names."""
    registers: dict[str, dict[int, str]] = {}
    for line in text.strip().split("\n"):
        words = line.split()
        if len(words) == 1:
            names = registers.setdefault(words[0], {})
        else:
            names |= {int(bit, 16): name for bit, name in zip(words[::2], words[1::2], strict=True)}
    return registers


FAULT_REGISTERS = _registers(_FAULTS)
"""Properties that hold faults as bits, and the bits' names. A fault in any of them keeps the motor off."""
SHORT_REGISTERS = tuple(register for register in FAULT_REGISTERS if register != MOTOR_REGISTER)
"""Those of 32 bits. The motor's has 64, which the C library of the released firmware cannot print: it answers ``lu``
(https://github.com/odriverobotics/ODrive/issues/571)."""


def fault_names(register: str, axis: int, value: int) -> tuple[str, ...]:
    """Return the names of the bits that are set in an axis's register of faults, as odrivetool writes them."""
    names = FAULT_REGISTERS[register]
    bits = [1 << k for k in range(value.bit_length()) if value >> k & 1]
    return tuple(f"{register.format(axis)} {names.get(bit, f'bit 0x{bit:x}')}" for bit in bits)


def version_objection(version: tuple[int, int, int]) -> str:
    """Return why a firmware is not spoken to; empty where it is.

    The line 0.6 runs on other boards (S1, Pro, Micro), with other properties, states and faults.
    """
    if version[:2] == MIN_VERSION[:2] and version >= MIN_VERSION:
        return ""
    least = ".".join(map(str, MIN_VERSION))
    remedy = "`odrivetool dfu` brings it"
    if version > MIN_VERSION:
        remedy = (
            "put an S1, Pro or Micro behind ros2_control by ODrive's own package (odrive_ros2_control), with "
            "axis.kind trajectory_controller"
        )
    seen = ".".join(map(str, version))
    return f"the ODrive has firmware {seen}: expected {least} to 0.5.x of a version 3 board; {remedy}"


def encode_line(command: str) -> bytes:
    """Return a command as the line that carries it."""
    text = f"{command} ".encode("ascii")
    return b"%s*%d\n" % (text, reduce(xor, text))


def take_line(heard: bytes) -> tuple[bytes, bytes] | None:
    """Return the first whole line and what came after it; None while there is none."""
    line, end, rest = heard.partition(b"\n")
    return (line, rest) if end else None


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


def numbers(text: str, count: int, question: str) -> tuple[float, ...]:
    """Return the numbers of an answer.

    Raises
    ------
    UnreadableAnswerError
        There are more or fewer, or words: a property that this firmware does not have, or cannot print.
    """
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise UnreadableAnswerError(
            f"the ODrive answered {text[:60]!r} to {question!r}: expected {wanted}; check odrive.axis and the "
            "ODrive's firmware"
        )
    return values
