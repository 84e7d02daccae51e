"""The emulated servo by the bytes of the e-Manual: what a real one is known to do."""

from __future__ import annotations

import struct

import pytest

from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant

PERIOD_NS = 1_000_000


class Bus:
    """A servo, and raw instructions for it."""

    def __init__(self, **settings: object) -> None:
        self.servo = EmulatedDynamixel(
            ServoAxis(AxisParameters(), RigidPlant(0.8, 1e-3), SimulatedDevice()),
            metres_per_turn=0.1,
            **settings,
        )
        self.now_ns = 0

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9) // PERIOD_NS):
            self.now_ns += PERIOD_NS
            self.servo.exchange(b"", self.now_ns)

    def send(self, instruction: int, parameters: bytes = b"", servo_id: int = 1) -> tuple[int, bytes] | None:
        """Return the error byte and the data of the answer, or None, half a millisecond later."""
        packet = (
            b"\xff\xff\xfd\x00" + bytes([servo_id]) + struct.pack("<HB", len(parameters) + 3, instruction)
        )
        packet += parameters
        self.servo.exchange(packet + struct.pack("<H", by_table(packet)), self.now_ns)
        assert self.servo.exchange(b"", self.now_ns + 499_999) == b""
        self.now_ns += 500_000
        answer = self.servo.exchange(b"", self.now_ns)
        return (answer[8], answer[9:-2]) if answer else None

    def read(self, address: int, kind: str) -> int:
        error, data = self.send(0x02, struct.pack("<HH", address, struct.calcsize(kind)))
        assert not error & 0x7F
        return struct.unpack(kind, data)[0]

    def write(self, address: int, kind: str, value: int) -> int:
        return self.send(0x03, struct.pack("<H" + kind[-1], address, value))[0]


def by_table(data: bytes) -> int:
    """The CRC as the e-Manual computes it, by a table of 256 numbers."""
    numbers = []
    for k in range(256):
        value = k << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        numbers.append(value & 0xFFFF)
    crc = 0
    for byte in data:
        crc = ((crc << 8) ^ numbers[(crc >> 8) ^ byte]) & 0xFFFF
    return crc


def test_it_answers_the_ping_of_the_documentation_after_its_return_delay() -> None:
    servo = Bus(values={0: 1030, 6: 38}).servo
    servo.exchange(bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E"), 0)
    assert servo.due_ns == 500_000
    assert servo.exchange(b"", 499_999) == b""
    assert servo.exchange(b"", 500_000).hex(" ").upper() == "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"


def test_what_is_kept_without_power_is_locked_while_the_motor_is_on() -> None:
    bus = Bus()
    assert bus.write(64, "<B", 1) == 0
    assert bus.write(11, "<B", 4) == 7
    assert bus.read(11, "<B") == 3
    assert bus.write(64, "<B", 0) == 0
    assert bus.write(11, "<B", 4) == 0
    assert bus.read(11, "<B") == 4
    assert bus.write(132, "<i", 5) == 7, "what is measured cannot be written"
    assert bus.write(116, "<B", 5) == 5
    assert bus.write(98, "<B", 128) == 4


@pytest.mark.parametrize(("level", "answered"), [(0, (1,)), (1, (1, 2)), (2, (1, 2, 3))])
def test_the_status_return_level_says_what_is_answered(level: int, answered: tuple[int, ...]) -> None:
    bus = Bus(values={68: level})
    parameters = {1: b"", 2: struct.pack("<HH", 6, 1), 3: struct.pack("<HB", 65, 1)}
    assert tuple(k for k, data in parameters.items() if bus.send(k, data)) == answered
    assert bus.send(1, servo_id=2) is None
    assert bus.send(0x83, struct.pack("<HHBB", 68, 1, 1, 2), 0xFE) is None
    assert bus.send(3, parameters[3]) == (0, b"")


def test_goals_and_places_are_whole_counts_over_many_turns() -> None:
    bus = Bus(values={11: 4})
    bus.write(64, "<B", 1)
    bus.write(116, "<i", 5000)
    bus.wait(0.5)
    assert bus.read(132, "<i") == 5000
    assert bus.servo.axis.true_position == pytest.approx(5000 / 4096 * 0.1, abs=1e-6)
    one_turn = Bus()
    assert one_turn.write(116, "<i", 5000) == 6, "the mode that it comes with has one turn"


def test_the_speed_comes_in_units_of_0_229_rpm_and_a_profile_limits_it() -> None:
    bus = Bus(values={11: 4, 112: 100})
    bus.write(64, "<B", 1)
    bus.write(116, "<i", 20_000)
    bus.wait(0.5)
    assert bus.read(128, "<i") == 100
    assert bus.servo.axis.velocity == pytest.approx(100 * 0.229 / 60 * 0.1, rel=1e-3)


def test_the_watchdog_stops_the_motor_and_refuses_goals_until_it_is_set_to_0() -> None:
    bus = Bus(values={11: 4, 112: 100})
    bus.write(98, "<B", 10)
    bus.wait(1.0)
    assert bus.read(98, "<b") == 10, "it watches with the motor on alone"
    bus.write(64, "<B", 1)
    bus.write(116, "<i", 20_000)
    for _ in range(3):
        bus.wait(0.15)
        assert bus.send(1, servo_id=9) is None
        assert bus.servo.axis.velocity > 0.03, "every instruction feeds it, whoever it is for"
    bus.wait(0.3)
    assert abs(bus.servo.axis.velocity) < 0.229 / 60 * 0.1, "less than its register can say"
    where = bus.read(132, "<i")
    assert where < 15_000
    assert bus.read(98, "<b") == -1
    assert bus.write(116, "<i", 0) == 4
    assert bus.write(98, "<B", 0) == 0
    assert bus.write(116, "<i", 0) == 0
    bus.wait(0.2)
    assert bus.read(132, "<i") < where - 250


def test_a_hardware_error_switches_the_motor_off_until_a_restart_which_forgets_the_turns() -> None:
    bus = Bus(values={11: 4})
    bus.write(64, "<B", 1)
    bus.write(116, "<i", 5000)
    bus.write(98, "<B", 100)
    bus.wait(0.5)
    bus.servo.fail(0x20)
    assert bus.write(64, "<B", 1) == 0x80
    assert bus.read(64, "<B") == 0
    assert bus.send(0x08) == (0x80, b"")
    assert bus.send(0x01) is None, "it hears nothing while it restarts"
    bus.wait(0.3)
    assert bus.send(0x01)[0] == 0
    assert [bus.read(address, "<B") for address in (11, 64, 70, 98)] == [4, 0, 0, 0]
    assert bus.read(132, "<i") == 5000 - 4096
    assert bus.write(64, "<B", 1) == 0
    assert bus.read(64, "<B") == 1


def test_an_error_that_shutdown_leaves_out_is_only_said() -> None:
    bus = Bus()
    bus.write(64, "<B", 1)
    bus.servo.fail(0x08)
    assert bus.send(0x01)[0] == 0x80
    assert bus.read(64, "<B") == 1


def test_nonsense_is_refused_or_not_heard() -> None:
    bus = Bus()
    assert bus.send(0x99)[0] == 2
    assert bus.send(0x02, struct.pack("<HH", 140, 100))[0] == 4
    assert (
        bus.servo.exchange(bytes.fromhex("FF FF FD 00 01 03 00 01 19 4F") + b"\xff\xff\xfd\x00\x01", 0) == b""
    )
    assert bus.servo.due_ns is None
