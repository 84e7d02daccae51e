"""An emulated Dynamixel of the X series: Protocol 2.0, its control table, its watchdog, with the beam on its motor.

Written from ROBOTIS's e-Manual, not from the host's side of this suite: the two meet on the wire. Its habits: answers
come after a delay of its own; the status return level decides what is answered at all; what is kept without power
cannot be written with the motor on; the bus watchdog watches with the motor on alone, is fed by every instruction,
stops the motor where it is, and refuses goals until it is set to 0; a hardware error of a kind that is in Shutdown
switches the motor off until a restart, which forgets the turns.
"""

from __future__ import annotations

import math
import struct

from beam_ros.hub.emulated.servo import ServoAxis

_COUNTS = 4096
_RPM = 0.229 / 60.0
_TABLE_BYTES = 147
_KEPT_BYTES = 64
"""What stands below is kept without power, and locked while the motor is on."""
_BOOT_NS = 200_000_000
"""A servo that restarts hears nothing for so long [ns]."""
_WRITABLE = ((7, 64), (64, 70), (76, 120))
_GOALS = (100, 102, 104, 116)
_RANGES = {11: (0, 16), 44: (0, 1023), 64: (0, 1), 68: (0, 2), 98: (0, 127)}
_SIZES = {0: 2, 44: 4, 100: 2, 102: 2, 104: 4, 108: 4, 112: 4, 116: 4, 144: 2}
"""Bytes of an item, where it is not one."""
_INSTRUCTION, _RANGE, _LENGTH, _LIMIT, _ACCESS = 2, 4, 5, 6, 7


def _crc(data: bytes) -> int:
    """Return the checksum of Protocol 2.0, by division of polynomials over GF(2)."""
    remainder = int.from_bytes(data, "big") << 16
    for bit in range(8 * len(data) + 15, 15, -1):
        if remainder >> bit & 1:
            remainder ^= 0x18005 << (bit - 16)
    return remainder


class EmulatedDynamixel:
    """A servo alone on its bus.

    Parameters
    ----------
    axis : ServoAxis
        The motor, with the hub on it.
    metres_per_turn : float
        Travel of the hub for one turn [m].
    has_watchdog : bool, optional
        False: one whose watchdog does not act.
    values : mapping, optional
        Of the control table, by address, in place of those of a new XC430-W150.
    """

    def __init__(
        self,
        axis: ServoAxis,
        *,
        metres_per_turn: float = 1.0,
        has_watchdog: bool = True,
        values: dict[int, int] | None = None,
    ) -> None:
        self.axis = axis
        self._turn = metres_per_turn
        self._has_watchdog = has_watchdog
        new = {0: 1070, 6: 46, 7: 1, 9: 250, 11: 3, 44: 460, 63: 52, 68: 2, 144: 120, 146: 31}
        self.table = bytearray(_TABLE_BYTES)
        for address, value in {**new, **(values or {})}.items():
            size = _SIZES.get(address, 1)
            self.table[address : address + size] = value.to_bytes(size, "little")
        self._power_on = bytes(self.table)
        self._fed_ns = self._now_ns = self._deaf_until_ns = axis.device_ns
        self._input = b""
        self._waiting: list[tuple[int, bytes]] = []
        self._zero = self._goal = 0
        self._forget_turns()

    @property
    def due_ns(self) -> int | None:
        """Device time at which the next answer leaves [ns]."""
        return self._waiting[0][0] if self._waiting else None

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Advance to a device time [ns], do what the bytes say, and return the answers that are due."""
        self._now_ns = device_ns
        profile = self.value(112, 4) * _RPM * abs(self._turn)
        self.axis.speed_limit = profile or math.inf
        self.axis.advance(device_ns, self._command)
        if self._is_overdue(device_ns):
            self.table[98] = 0xFF
            self._goal = self._counts()
        if device_ns >= self._deaf_until_ns:
            self._input = (self._input + data)[-512:]
            self._take_packets()
        out = b"".join(packet for due_ns, packet in self._waiting if due_ns <= device_ns)
        self._waiting = [each for each in self._waiting if each[0] > device_ns]
        return out

    def fail(self, errors: int) -> None:
        """Let hardware errors come about, by the bits of Hardware Error Status."""
        self.table[70] |= errors
        if errors & self.table[63]:
            self.table[64] = 0

    def value(self, address: int, size: int = 1) -> int:
        """Return an item of the control table."""
        return int.from_bytes(self.table[address : address + size], "little")

    # The motor -----------------------------------------------------------------------------------------

    def _command(self, device_ns: int) -> tuple[float, float] | None:
        if not self.table[64]:
            return None
        if self._is_overdue(device_ns):
            return self.axis.true_position, 0.0
        return (self._goal + self._zero) / _COUNTS * self._turn, 0.0

    def _is_overdue(self, device_ns: int) -> bool:
        patience = self.table[98]
        is_watching = self._has_watchdog and self.table[64] and 0 < patience < 0xFF
        return bool(is_watching) and device_ns - self._fed_ns > patience * 20_000_000

    def _counts(self) -> int:
        """Return the encoder's count, from where it was at power-on."""
        turns = self.axis.position_at(self._now_ns) / self._turn
        return round(turns * _COUNTS) - self._zero

    def _forget_turns(self) -> None:
        """Count from the present turn: the encoder knows the place in it alone."""
        self._zero += self._counts() // _COUNTS * _COUNTS

    # The bus -------------------------------------------------------------------------------------------

    def _take_packets(self) -> None:
        while (start := self._input.find(b"\xff\xff\xfd\x00")) >= 0:
            packet = self._input[start:]
            end = 7 + int.from_bytes(packet[5:7], "little") if len(packet) >= 7 else len(packet) + 1
            if len(packet) < end:
                break
            self._input = packet[end:]
            if end >= 10 and _crc(packet[: end - 2]) == int.from_bytes(packet[end - 2 : end], "little"):
                body = packet[7 : end - 2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                self._do(packet[4], body[0], body[1:])

    def _do(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        """Do one instruction, whose every kind feeds the watchdog."""
        self._fed_ns = self._now_ns
        if servo_id not in (self.table[7], 0xFE):
            return
        if instruction == 0x83 and len(parameters) >= 4:
            address, size = struct.unpack("<HH", parameters[:4])
            for k in range(4, len(parameters), 1 + size):
                if parameters[k] == self.table[7]:
                    self._write(address, parameters[k + 1 : k + 1 + size])
        elif instruction == 0x01:
            self._answer(0, bytes(self.table[0:2]) + bytes(self.table[6:7]), 0)
        elif servo_id == self.table[7]:
            self._do_alone(instruction, parameters)

    def _do_alone(self, instruction: int, parameters: bytes) -> None:
        if instruction == 0x02 and len(parameters) == 4:
            address, size = struct.unpack("<HH", parameters)
            self._measure()
            data = bytes(self.table[address : address + size])
            self._answer(0 if len(data) == size else _RANGE, data, 1)
        elif instruction == 0x03 and len(parameters) > 2:
            self._answer(self._write(int.from_bytes(parameters[:2], "little"), parameters[2:]), b"", 2)
        elif instruction == 0x08:
            self._answer(0, b"", 2)
            kept = self.table[:_KEPT_BYTES]
            self.table[:] = kept + self._power_on[_KEPT_BYTES:]
            self._forget_turns()
            self._deaf_until_ns = self._now_ns + _BOOT_NS
        else:
            self._answer(_INSTRUCTION, b"", 2)

    def _write(self, address: int, data: bytes) -> int:
        """Write into the control table; return the error's number."""
        value = int.from_bytes(data, "little", signed=True)
        error = self._refusal(address, len(data), value)
        if error or (address == 64 and value and self.table[70] & self.table[63]):
            # What is shut down takes the order, and stays off.
            return error
        if address == 116:
            self._goal = value
        elif address == 64 and value and not self.table[64]:
            # A motor that is switched on holds where it stands.
            self._goal = self._counts()
        self.table[address : address + len(data)] = data
        return 0

    def _refusal(self, address: int, size: int, value: int) -> int:
        is_kept = address < _KEPT_BYTES
        if not any(first <= address < last for first, last in _WRITABLE) or (is_kept and self.table[64]):
            return _ACCESS
        if size != _SIZES.get(address, 1):
            return _LENGTH
        low, high = _RANGES.get(address, (-(1 << 31), 1 << 31))
        if not low <= value <= high or (address in _GOALS and self.table[98] == 0xFF):
            return _RANGE
        is_one_turn = address == 116 and self.table[11] == 3
        return _LIMIT if is_one_turn and not 0 <= value < _COUNTS else 0

    def _measure(self) -> None:
        speed = round(self.axis.velocity / self._turn / _RPM)
        struct.pack_into("<ii", self.table, 128, speed, self._counts())

    def _answer(self, error: int, data: bytes, least_level: int) -> None:
        """Let a status packet leave after the return delay, where the level has it answered."""
        if self.table[68] < least_level:
            return
        alert = 0x80 if self.table[70] else 0
        body = (bytes([0x55, error | alert]) + data).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = b"\xff\xff\xfd\x00" + bytes([self.table[7]]) + (len(body) + 2).to_bytes(2, "little") + body
        due_ns = self._now_ns + 2000 * self.table[9]
        self._waiting.append((due_ns, packet + _crc(packet).to_bytes(2, "little")))
