"""DYNAMIXEL Protocol 2.0, the host's side, and what is used of the control table of the X series.

Written from ROBOTIS's e-Manual (https://emanual.robotis.com/docs/en/dxl/protocol2/). A packet is ``FF FF FD 00``,
number of the servo, length, instruction, parameters, and a CRC-16 (polynomial 0x8005) over all before it. Where
instruction and parameters hold ``FF FF FD``, a byte ``FD`` is stuffed in after it, which the length counts. A status
packet has the instruction ``55``, and an error byte whose bit 7 says that the hardware has an error.
"""

from __future__ import annotations

from dataclasses import dataclass

from beam_ros.hub.errors import HubProtocolError

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, REBOOT, SYNC_WRITE, STATUS = 0x01, 0x02, 0x03, 0x08, 0x83, 0x55
EVERYBODY = 0xFE
"""The number that every servo listens to."""
ALERT = 0x80
_FRAME = 7
"""Bytes before the instruction: header, number and length."""
_MAX_LENGTH = 128
"""No answer that is asked for is as long [bytes after the length]."""

ERRORS = (
    *("Result Fail", "Instruction Error", "CRC Error", "Data Range Error"),
    *("Data Length Error", "Data Limit Error", "Access Error"),
)
"""By their numbers, from 1 on."""
HARDWARE_ERRORS = {
    0x01: "Input Voltage Error",
    0x04: "Overheating Error",
    0x08: "Motor Encoder Error",
    0x10: "Electrical Shock Error",
    0x20: "Overload Error",
}

_MODELS = """
    1000 XH430-W350 1001 XD430-T350 1010 XH430-W210 1011 XD430-T210 1020 XM430-W350 1030 XM430-W210
    1040 XH430-V350 1050 XH430-V210 1060 XL430-W250 1070 XC430-W150 1080 XC430-W240 1090 2XL430-W250
    1100 XH540-W270 1101 XD540-T270 1110 XH540-W150 1111 XD540-T150 1120 XM540-W270 1130 XM540-W150
    1140 XH540-V270 1150 XH540-V150 1160 2XC430-W250 1170 XW540-T260 1180 XW540-T140 1190 XL330-M077
    1200 XL330-M288 1210 XC330-T181 1220 XC330-T288 1230 XC330-M181 1240 XC330-M288 1270 XW430-T333
"""
MODELS = dict(zip(map(int, _MODELS.split()[::2]), _MODELS.split()[1::2], strict=True))
"""Names of the X series by their Model Number."""
MIN_FIRMWARE = 38
"""Firmware before it has no Bus Watchdog."""


@dataclass(frozen=True)
class Register:
    """One item of the control table.

    Parameters
    ----------
    name : str
        As the e-Manual has it.
    address, size : int
        Where it stands, and its bytes.
    """

    name: str
    address: int
    size: int = 1


OPERATING_MODE = Register("Operating Mode", 11)
VELOCITY_LIMIT = Register("Velocity Limit", 44, 4)
TORQUE_ENABLE = Register("Torque Enable", 64)
STATUS_RETURN_LEVEL = Register("Status Return Level", 68)
BUS_WATCHDOG = Register("Bus Watchdog", 98)
PROFILE_ACCELERATION = Register("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Register("Profile Velocity", 112, 4)
GOAL_POSITION = Register("Goal Position", 116, 4)
VELOCITY_AND_POSITION = Register("Present Velocity and Position", 128, 8)
CONDITION = Register("Torque Enable, Hardware Error Status and Bus Watchdog", 64, 35)
"""Of which they are the bytes 0, 6 and 34."""
VOLTAGE_AND_TEMPERATURE = Register("Present Input Voltage and Temperature", 144, 3)

EXTENDED_POSITION = 4
"""Operating mode: position over many turns."""
COUNTS = 4096
"""Of the encoder, in one turn."""
MOST_TURNS = 256
"""Goal positions reach so far from the encoder's zero."""
SPEED_UNIT = 0.229 / 60.0
"""Of velocities [turns/s]."""
WATCHDOG_UNIT_S = 0.02
MOST_WATCHDOG, EXPIRED = 127, 0xFF
"""Greatest time of the watchdog [units], and what the register reads when it has acted: -1."""
ANSWER_ALL = 2
"""Status return level at which every instruction is answered."""


@dataclass(frozen=True)
class ServoStatus:
    """A status packet.

    Parameters
    ----------
    servo_id : int
        Who sent it.
    error : int
        Its error byte, bit 7 the alert.
    parameters : bytes
        What was asked for.
    """

    servo_id: int
    error: int
    parameters: bytes

    @property
    def refusal(self) -> str:
        """Why the servo did not do it; empty where it did."""
        number = self.error & ~ALERT
        names = ("", *ERRORS)
        return names[number] if number < len(names) else f"error {number}"


def crc(data: bytes) -> int:
    """Return the CRC-16 with polynomial 0x8005, from 0, highest bit first."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x8005 if value & 0x8000 else 0)) & 0xFFFF
    return value


def encode(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return an instruction packet."""
    body = (bytes([instruction]) + parameters).replace(HEADER[:3], HEADER[:3] + b"\xfd")
    packet = HEADER + bytes([servo_id]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc(packet).to_bytes(2, "little")


def encode_read(servo_id: int, register: Register) -> bytes:
    """Return the question for a register."""
    return encode(servo_id, READ, _words(register.address, register.size))


def encode_write(servo_id: int, register: Register, value: int) -> bytes:
    """Return the order to set a register, which is answered."""
    return encode(servo_id, WRITE, _words(register.address) + _value(register, value))


def encode_sync_write(servo_id: int, register: Register, value: int) -> bytes:
    """Return the order to set a register of one servo, which nobody answers."""
    head = _words(register.address, register.size) + bytes([servo_id])
    return encode(EVERYBODY, SYNC_WRITE, head + _value(register, value))


def take_status(heard: bytes) -> tuple[bytes, bytes] | None:
    """Return the first sound packet, or a damaged one where there is no other, and what came after it.

    None while there is neither. What stands before a header is no packet, and neither is what has an impossible
    length: noise that looks like a header must not hide the packet behind it.
    """
    damaged = None
    start = heard.find(HEADER)
    while start >= 0:
        packet = heard[start:]
        length = int.from_bytes(packet[5:_FRAME], "little")
        end = _FRAME + length
        if 4 <= length <= _MAX_LENGTH and len(packet) >= end:
            if is_sound(packet[:end]):
                return packet[:end], packet[end:]
            damaged = damaged or (packet[:end], packet[end:])
        start = heard.find(HEADER, start + 1)
    return damaged


def is_sound(packet: bytes) -> bool:
    """Return whether a whole packet has the right CRC."""
    return crc(packet[:-2]) == int.from_bytes(packet[-2:], "little")


def decode(packet: bytes) -> ServoStatus:
    """Return a whole packet as the status that it is.

    Raises
    ------
    HubProtocolError
        It is damaged, or another packet.
    """
    body = packet[_FRAME:-2].replace(HEADER[:3] + b"\xfd", HEADER[:3])
    if not is_sound(packet) or body[0] != STATUS or len(body) < 2:
        raise HubProtocolError(
            f"packet {packet[:20].hex(' ')}: expected a status packet with its CRC; look for noise and another host "
            "on the bus, and for an adapter that echoes what it sends"
        )
    return ServoStatus(packet[4], body[1], body[2:])


def hardware_errors(value: int) -> tuple[str, ...]:
    """Return the names of the bits of Hardware Error Status."""
    bits = [1 << k for k in range(8) if value >> k & 1]
    return tuple(HARDWARE_ERRORS.get(bit, f"bit 0x{bit:x}") for bit in bits)


def model_objection(model: int, firmware: int) -> str:
    """Return why a servo is not spoken to; empty where it is."""
    if model not in MODELS:
        return (
            f"the servo is of model {model}: expected one of the X series, as 1060 of an XL430-W250; put another one "
            "behind ros2_control (dynamixel_hardware_interface), with axis.kind trajectory_controller"
        )
    if firmware < MIN_FIRMWARE:
        return (
            f"the {MODELS[model]} has firmware {firmware}: expected {MIN_FIRMWARE} or later, which has a Bus "
            "Watchdog; DYNAMIXEL Wizard 2.0 brings it"
        )
    return ""


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def _value(register: Register, value: int) -> bytes:
    return (value % (1 << 8 * register.size)).to_bytes(register.size, "little")
