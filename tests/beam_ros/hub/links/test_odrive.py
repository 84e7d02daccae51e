"""The ODrive link against the emulated ODrive, in virtual time."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pytest

from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.link_parameters import OdriveParameters
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.odrive import Odrive, OdriveHub
from beam_ros.hub.links.odrive_protocol import encode_line
from beam_ros.hub.links.query_line import ANSWER_S, QueryLine
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import (
    STEADY_START,
    UNIX_START,
    PacedRig,
    VirtualPort,
    VirtualTime,
    chunks_of,
    rest_to_rest,
)

PATIENT = AxisParameters(watchdog_s=1.0)
METRES_PER_TURN = -0.02
DEVICE = SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=900_000_000_000, initial_position=0.003)


class OdriveRig(PacedRig):
    """The link, and its drive."""

    def __init__(
        self,
        parameters: AxisParameters = PATIENT,
        *,
        firmware: Mapping[str, object] | None = None,
        faults: Mapping[str, int] | None = None,
        **settings: object,
    ) -> None:
        self.odrive = EmulatedOdrive(
            ServoAxis(parameters, RigidPlant(0.8, 1e-3), DEVICE),
            metres_per_turn=METRES_PER_TURN,
            **(firmware or {}),
        )
        for register, bits in (faults or {}).items():
            self.odrive.fail(register, bits)
        steady = VirtualTime()
        self.port = VirtualPort(steady, self.odrive, DEVICE)
        moves = OdriveParameters(metres_per_turn=METRES_PER_TURN, **settings)
        super().__init__(
            OdriveHub(parameters, LinkParameters("port"), moves, port=self.port, steady=steady), steady
        )

    def property(self, path: str) -> float:
        return self.odrive._properties[f"axis0.{path}"]


def test_limits_and_watchdog_are_on_the_drive_before_anything_moves() -> None:
    rig = OdriveRig().connected()
    assert rig.property("controller.config.vel_limit") == pytest.approx(0.5 / 0.02)
    assert rig.property("config.watchdog_timeout") == 1.0
    assert rig.property("config.enable_watchdog") == 1
    assert rig.property("current_state") == 1
    # The watchdog was provoked, and its fault cleared.
    assert rig.property("error") == 0


def test_a_watchdog_that_is_set_and_does_not_run_is_never_connected() -> None:
    rig = OdriveRig(AxisParameters(watchdog_s=0.2), firmware={"has_watchdog": False})
    reports = rig.until(lambda r: r.status.fault.name == "watchdog_unproved")
    assert reports[-1].status.state == "disconnected"
    assert "did not act on" in reports[-1].status.reason
    assert not rig.ask("enable").success


def test_a_host_that_is_frozen_while_it_proves_the_watchdog_looks_once_more(monkeypatch) -> None:
    watchdog_s, freezes = 0.5, []
    read = Odrive.read

    def read_and_freeze(odrive: Odrive, path: str) -> float:
        value = read(odrive, path)
        if path == "error" and not value and not freezes:
            freezes.append(path)
            rig.steady.wait(1.5 * watchdog_s + 2.0 * ANSWER_S)
        return value

    monkeypatch.setattr(Odrive, "read", read_and_freeze)
    rig = OdriveRig(AxisParameters(watchdog_s=watchdog_s))
    rig.connected()
    assert freezes
    assert "watchdog_unproved" not in {r.status.fault.name for r in rig.reports}


def test_a_watchdogs_fault_is_cleared_for_good_however_far_apart_the_commands_are(monkeypatch) -> None:
    """A watchdog that is cleared before it is fed acts again at once."""
    tell = Odrive.tell

    def tell_slowly(odrive: Odrive, command: str) -> None:
        tell(odrive, command)
        if command.startswith("w axis0.error"):
            rig.steady.wait(0.02)

    monkeypatch.setattr(Odrive, "tell", tell_slowly)
    rig = OdriveRig()
    rig.connected()
    assert "watchdog_unproved" not in {r.status.fault.name for r in rig.reports}
    rig.enable()


def test_an_answer_that_came_while_the_host_was_frozen_is_read() -> None:
    class Line:
        """Answers at once; the host is frozen behind its question."""

        answers = (encode_line("12.5"),)

        def write(self, _data: bytes) -> None:
            self.waiting = list(self.answers)
            steady.wait(1.2 * ANSWER_S)

        def read(self, timeout_s: float) -> tuple[bytes, int]:
            assert timeout_s >= 0.0
            return self.waiting.pop(0) if self.waiting else b"", steady.ns

    steady, line = VirtualTime(), Line()
    odrive = Odrive(QueryLine(line, steady), OdriveParameters())
    assert odrive.read("error") == 12.5
    # Half an answer, whose other half came only after the last look.
    line.answers = (line.answers[0][:3], line.answers[0][3:])
    with pytest.raises(HubProtocolError, match=r"no answer to 'r axis0.error' within 0\.1 s"):
        odrive.read("error")


def test_the_axis_runs_a_sequence_and_reports_what_was_written_and_when() -> None:
    rig = OdriveRig().connected()
    rig.enable()
    assert rig.property("current_state") == 8
    values = rest_to_rest(1000)
    start_ns = rig.now.unix_ns + 400_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    reports = rig.until(lambda r: any(s.state == "done" for s in r.sequences)) + rig.run(0.1)
    plan = MotionPlan.sequence(values, PATIENT, 0.0)
    # What was written is the plan at the very stamp; the drive follows with a lag of 5 ms at 50 mm/s and less.
    for name, tolerance in (("applied", 1e-12), ("measured", 5e-3 * 0.05)):
        batches = [b for r in reports for b in getattr(r, name)]
        assert all(b.period_ns == 0 and len(b) == 1 for b in batches)
        times = np.array([b.stamp_ns for b in batches])
        path = np.array([b.positions[0] for b in batches])
        assert np.max(np.abs(path)) > 0.002
        assert np.max(np.abs(path - plan.sample((times - start_ns) * 1e-9)[0])) < tolerance
    assert rig.ask("disable").success
    rig.run(0.1)
    assert rig.property("current_state") == 1


def test_what_is_measured_is_where_the_motor_was_at_the_stamp() -> None:
    rig = OdriveRig(AxisParameters(watchdog_s=1.0, command_mode="velocity")).connected()
    rig.enable()
    rig.drive(0.02, 1.0)
    batches = [b for r in rig.reports[-40:] for b in r.measured][:-5]
    steady = [b.stamp_ns - UNIX_START + STEADY_START for b in batches]
    # The emulator knows where it was; home is 3 mm from its zero. At 20 mm/s, 0.2 ms of a question's way are 4 um.
    truth = rig.odrive.axis.snapshots([rig.port.device_ns(ns) for ns in steady]).positions - 0.003
    error = np.array([b.positions[0] for b in batches]) - truth
    assert np.median(np.abs(error)) < 6e-6
    assert truth[-1] > 0.01


def test_a_set_point_that_is_not_refreshed_ends_in_a_ramp() -> None:
    rig = OdriveRig(AxisParameters(watchdog_s=0.3, command_mode="velocity")).connected()
    rig.enable()
    assert rig.hub.setpoint(rig.now.unix_ns, 0.05, rig.now).success
    reports = rig.until(lambda r: r.status.state == "homed")
    assert reports[-1].status.fault.name == "setpoint_old"
    assert reports[-1].status.position == pytest.approx(0.3 * 0.05, rel=0.2)


PRINTS = {"prints_64_bits": True}


@pytest.mark.parametrize(
    ("firmware", "faults", "words"),
    [
        (
            PRINTS,
            {"axis0.motor.error": 0x1000 | 0x800000},
            "axis0.motor.error CURRENT_LIMIT_VIOLATION, axis0.motor.error BRAKE_RESISTOR_DISARMED",
        ),
        # A fault of the motor need not show in any register that can be read: the state says that it is off.
        (
            {},
            {"axis0.motor.error": 0x8},
            "no fault that can be read; axis0.motor.error cannot be read ('lu')",
        ),
        (
            {},
            {"axis0.motor.error": 0x1000000, "axis0.error": 0x40, "error": 0x2},
            "error DC_BUS_UNDER_VOLTAGE, axis0.error MOTOR_FAILED; axis0.motor.error cannot be read",
        ),
        ({}, {"axis0.encoder.error": 0x4}, "axis0.encoder.error NO_RESPONSE"),
    ],
    ids=["printed", "hidden", "summary", "encoder"],
)
def test_a_fault_of_the_drive_is_named_and_stays_until_it_is_cleared(firmware, faults, words) -> None:
    rig = OdriveRig(firmware=firmware).connected()
    rig.enable()
    for register, bits in faults.items():
        rig.odrive.fail(register, bits)
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "drive_alarm"
    assert words in status.reason
    refused = rig.ask("enable")
    assert not refused.success
    assert "clear the fault first" in refused.message
    # Nothing is cleared before a person has seen it and said so.
    for register, bits in faults.items():
        assert rig.odrive._properties[register] == bits
    rig.clear()
    assert "home it first" in rig.ask("enable").message
    assert rig.ask("home").success
    rig.run(0.2)
    assert rig.ask("enable").success


def test_a_connection_clears_no_fault_of_the_drive() -> None:
    """Neither the first one of a new host nor one after a pulled cable: only hub/clear_fault does."""
    rig = OdriveRig(faults={"axis0.encoder.error": 0x4})
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert (status.fault.name, rig.property("encoder.error")) == ("drive_alarm", 0x4)
    assert "axis0.encoder.error NO_RESPONSE" in status.reason
    rig.port.is_plugged = False
    rig.until(lambda r: r.status.state == "disconnected")
    rig.odrive.fail("axis0.controller.error", 0x80)
    rig.port.is_plugged = True
    rig.until(lambda r: r.status.state == "fault")
    assert (rig.property("encoder.error"), rig.property("controller.error")) == (0x4, 0x80)
    # What came beside it nobody was told yet: it becomes the fault.
    rig.clear()
    status = rig.until(lambda r: "SPINOUT_DETECTED" in r.status.reason)[-1].status
    assert status.fault.name == "drive_alarm"
    assert rig.property("controller.error") == 0x80
    rig.clear()
    rig.until(lambda r: r.status.state == "identified" and not rig.property("controller.error"))
    assert not rig.property("encoder.error")


def test_a_fault_that_nobody_could_read_survives_the_proof_of_the_watchdog() -> None:
    rig = OdriveRig(faults={"axis0.motor.error": 0x8}).connected()
    assert (rig.property("error"), rig.property("motor.error")) == (0, 0x8)
    refused = rig.ask("home")
    assert not refused.success
    assert "axis0.motor.error cannot be read ('lu')" in refused.message
    assert rig.property("motor.error") == 0x8


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (
            (0, 5, 3),
            "firmware 0.5.3: expected 0.5.4 to 0.5.x of a version 3 board; `odrivetool dfu` brings it",
        ),
        ((0, 6, 9), "firmware 0.6.9: expected 0.5.4 to 0.5.x of a version 3 board; .* ros2_control"),
        ((0, 4, 12), "firmware 0.4.12: expected"),
    ],
)
def test_a_firmware_that_the_link_does_not_know_is_refused(version, words) -> None:
    rig = OdriveRig(firmware={"version": version})
    status = rig.until(lambda r: r.status.fault.name == "wrong_version")[-1].status
    assert status.state == "disconnected"
    assert re.search(words, status.reason)
    assert rig.property("config.enable_watchdog") == 0


def test_an_answer_that_is_no_number_is_no_silence() -> None:
    rig = OdriveRig(axis=1)
    status = rig.until(lambda r: r.status.fault.name not in ("none", "no_answer"))[-1].status
    assert (status.state, status.fault.name) == ("disconnected", "status_unreadable")
    assert "the ODrive answered 'invalid property' to 'r axis1." in status.reason


def test_an_ordinary_answer_that_stops_to_be_one_is_no_silence(monkeypatch) -> None:
    rig = OdriveRig().connected()
    answer = EmulatedOdrive._do_motor
    monkeypatch.setattr(
        EmulatedOdrive, "_do_motor", lambda o, verb, v: "nan nan" if verb == "f" else answer(o, verb, v)
    )
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "status_unreadable"
    assert "the ODrive answered 'nan nan' to 'f 0'" in status.reason


def test_a_limit_is_read_back_as_the_drive_prints_it() -> None:
    """Six decimals, so that a small one comes back rounded: 0.0123456789 turns/s as 0.012346."""
    speed = 0.0123456789 * abs(METRES_PER_TURN)
    rig = OdriveRig(
        AxisParameters(watchdog_s=0.3, max_speed=speed, homing_speed=speed, move_speed=speed)
    ).connected()
    assert rig.property("controller.config.vel_limit") == pytest.approx(0.0123456789)


def test_a_pulled_cable_loses_the_axis_and_the_drive_stops_by_itself() -> None:
    rig = OdriveRig(AxisParameters(watchdog_s=1.0, command_mode="velocity")).connected()
    rig.enable()
    rig.drive(0.03, 0.25)
    rig.port.is_plugged = False
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name in ("controller_silent", "port_lost")
    rig.run(1.5)
    rig.odrive.exchange(b"", rig.port.device_ns(rig.steady.ns))
    assert rig.odrive.axis.velocity == 0.0
    rig.port.is_plugged = True
    rig.until(lambda r: r.status.state == "identified")
    assert rig.property("error") == 0


def test_home_is_the_encoders_own_zero_where_that_is_chosen() -> None:
    rig = OdriveRig(homes_here=False).connected()
    assert rig.run(0.05)[-1].status.position == pytest.approx(0.003, abs=1e-6)
    assert rig.ask("home").success
    assert rig.run(0.3)[-1].status.position == pytest.approx(0.0, abs=1e-5)
    assert rig.odrive.axis.true_position == pytest.approx(0.0, abs=1e-5)


def test_noise_on_the_line_never_passes_for_a_position() -> None:
    rig = OdriveRig().connected()
    rng = np.random.default_rng(3)
    for _ in range(40):
        rig.port.inject(bytes(rng.integers(32, 127, 6, dtype=np.uint8)) + b"1.5 0.2\r\n" * 2)
        rig.run(0.02)
    positions = np.array([b.positions[0] for r in rig.reports for b in r.measured])
    rig.until(lambda r: r.status.state == "identified")
    assert np.ptp(positions) < 1e-9
    assert rig.reports[-1].status.counters["lost_answers"] > 0
