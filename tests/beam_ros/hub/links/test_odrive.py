"""The ODrive link against the emulated ODrive on a real pseudo-terminal, in real time."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from beam_ros.hub.emulated.controller import EmulatedController
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
from tests.beam_ros.hub.hub_scenes import LiveRig, chunks_of, rest_to_rest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
PATIENT = AxisParameters(watchdog_s=1.0)
METRES_PER_TURN = -0.02
DEVICE = SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=900_000_000_000, initial_position=0.003)


class OdriveRig(LiveRig):
    """The link, and an ODrive on a pseudo-terminal."""

    def __init__(
        self,
        folder: Path,
        parameters: AxisParameters = PATIENT,
        *,
        firmware: Mapping[str, object] | None = None,
        faults: Mapping[str, int] | None = None,
        **settings: object,
    ) -> None:
        def boot(device: SimulatedDevice, _boot_id: int) -> EmulatedOdrive:
            self.odrive = EmulatedOdrive(
                ServoAxis(parameters, RigidPlant(0.8, 1e-3), device),
                metres_per_turn=METRES_PER_TURN,
                **(firmware or {}),
            )
            for register, bits in (faults or {}).items():
                self.odrive.fail(register, bits)
            return self.odrive

        self.emulator = EmulatedController(
            parameters, RigidPlant(0.8, 1e-3), DEVICE, link=folder / "odrive", boot=boot
        )
        odrive = OdriveParameters(metres_per_turn=METRES_PER_TURN, **settings)
        super().__init__(OdriveHub(parameters, LinkParameters(self.emulator.port), odrive))

    def property(self, path: str) -> float:
        return self.odrive._properties[f"axis0.{path}"]

    def close(self) -> None:
        self.hub.close()
        self.emulator.close()


@pytest.fixture
def start(tmp_path):
    rigs = []

    def start_rig(*arguments: object, **settings: object) -> OdriveRig:
        rigs.append(OdriveRig(tmp_path, *arguments, **settings))
        return rigs[-1]

    yield start_rig
    for rig in rigs:
        rig.close()


def connected(rig: OdriveRig) -> OdriveRig:
    rig.until(lambda r: r.status.state == "identified")
    return rig


def clear(rig: OdriveRig) -> None:
    """Clear a fault; its cause is gone a quarter of a second after it was seen, of the time that this process had."""
    assert any(rig.run(0.3) and rig.ask("clear_fault").success for _ in range(50))


def test_limits_and_watchdog_are_on_the_drive_before_anything_moves(start) -> None:
    rig = connected(start())
    assert rig.property("controller.config.vel_limit") == pytest.approx(0.5 / 0.02)
    assert rig.property("config.watchdog_timeout") == 1.0
    assert rig.property("config.enable_watchdog") == 1
    assert rig.property("current_state") == 1
    # The watchdog was provoked, and its fault cleared.
    assert rig.property("error") == 0


def test_a_watchdog_that_is_set_and_does_not_run_is_never_connected(start) -> None:
    rig = start(AxisParameters(watchdog_s=0.2), firmware={"has_watchdog": False})
    reports = rig.until(lambda r: r.status.fault.name == "watchdog_unproved")
    assert reports[-1].status.state == "disconnected"
    assert "did not act on" in reports[-1].status.reason
    assert not rig.ask("enable").success


def test_a_host_that_is_frozen_while_it_proves_the_watchdog_looks_once_more(start, monkeypatch) -> None:
    watchdog_s, freezes = 0.5, []
    read = Odrive.read

    def read_and_freeze(odrive: Odrive, path: str) -> float:
        value = read(odrive, path)
        if path == "error" and not value and not freezes:
            freezes.append(path)
            time.sleep(1.5 * watchdog_s + 2.0 * ANSWER_S)
        return value

    monkeypatch.setattr(Odrive, "read", read_and_freeze)
    rig = connected(start(AxisParameters(watchdog_s=watchdog_s)))
    assert freezes
    assert "watchdog_unproved" not in {r.status.fault.name for r in rig.reports}


def test_a_watchdogs_fault_is_cleared_for_good_however_far_apart_the_commands_are(start, monkeypatch) -> None:
    """A watchdog that is cleared before it is fed acts again at once."""
    tell = Odrive.tell

    def tell_slowly(odrive: Odrive, command: str) -> None:
        tell(odrive, command)
        if command.startswith("w axis0.error"):
            time.sleep(0.02)

    monkeypatch.setattr(Odrive, "tell", tell_slowly)
    rig = connected(start())
    assert "watchdog_unproved" not in {r.status.fault.name for r in rig.reports}
    rig.enable()


def test_an_answer_that_came_while_the_host_was_frozen_is_read() -> None:
    class Line:
        """Answers at once; the host is frozen behind its question."""

        answers = (encode_line("12.5"),)

        def write(self, _data: bytes) -> None:
            self.waiting = list(self.answers)
            time.sleep(1.2 * ANSWER_S)

        def read(self, timeout_s: float) -> tuple[bytes, int]:
            assert timeout_s >= 0.0
            return self.waiting.pop(0) if self.waiting else b"", time.monotonic_ns()

    line = Line()
    odrive = Odrive(QueryLine(line), OdriveParameters())
    assert odrive.read("error") == 12.5
    # Half an answer, whose other half came only after the last look.
    line.answers = (line.answers[0][:3], line.answers[0][3:])
    with pytest.raises(HubProtocolError, match=r"no answer to 'r axis0.error' within 0\.1 s"):
        odrive.read("error")


def test_the_axis_runs_a_sequence_and_reports_what_was_written_and_when(start) -> None:
    rig = connected(start())
    rig.enable()
    assert rig.property("current_state") == 8
    # So slow that a drive whose host is busy for a while is not carried far.
    values = rest_to_rest(1000, amplitude=0.1)
    start_ns = rig.now.unix_ns + 400_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    reports = rig.until(lambda r: any(s.state == "done" for s in r.sequences)) + rig.run(0.1)
    plan = MotionPlan.sequence(values, PATIENT, 0.0)
    for name, tolerance in (("applied", 1e-12), ("measured", 2e-4)):
        batches = [b for r in reports for b in getattr(r, name)]
        assert all(b.period_ns == 0 and len(b) == 1 for b in batches)
        times = np.array([b.stamp_ns for b in batches])
        path = np.array([b.positions[0] for b in batches])
        # What was written is the plan at the very stamp; the drive follows with a lag of some milliseconds.
        assert np.max(np.abs(path)) > 4e-4
        assert np.max(np.abs(path - plan.sample((times - start_ns) * 1e-9)[0])) < tolerance
    assert rig.ask("disable").success
    rig.run(0.1)
    assert rig.property("current_state") == 1


def test_what_is_measured_is_where_the_motor_was_at_the_stamp(start) -> None:
    rig = connected(start(AxisParameters(watchdog_s=1.0, command_mode="velocity")))
    rig.enable()
    for _ in range(20):
        rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now)
        rig.run(0.05)
    batches = [b for r in rig.reports[-40:] for b in r.measured][:-5]
    times = np.array([b.stamp_ns for b in batches])
    # The emulator knows where it was; home is 3 mm from its zero. At 20 mm/s, 0.2 ms of a question's way are 4 um.
    truth = rig.emulator.snapshots(times).positions - 0.003
    error = np.array([b.positions[0] for b in batches]) - truth
    assert np.median(np.abs(error)) < 6e-6
    assert truth[-1] > 0.01


def test_a_set_point_that_is_not_refreshed_ends_in_a_ramp(start) -> None:
    rig = connected(start(AxisParameters(watchdog_s=0.3, command_mode="velocity")))
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
def test_a_fault_of_the_drive_is_named_and_stays_until_it_is_cleared(start, firmware, faults, words) -> None:
    rig = connected(start(firmware=firmware))
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
    clear(rig)
    assert "home it first" in rig.ask("enable").message
    assert rig.ask("home").success
    rig.run(0.2)
    assert rig.ask("enable").success


def test_a_connection_clears_no_fault_of_the_drive(start) -> None:
    """Neither the first one of a new host nor one after a pulled cable: only hub/clear_fault does."""
    rig = start(faults={"axis0.encoder.error": 0x4})
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert (status.fault.name, rig.property("encoder.error")) == ("drive_alarm", 0x4)
    assert "axis0.encoder.error NO_RESPONSE" in status.reason
    rig.emulator.unplug()
    rig.until(lambda r: r.status.state == "disconnected")
    rig.odrive.fail("axis0.controller.error", 0x80)
    rig.emulator.plug()
    rig.until(lambda r: r.status.state == "fault")
    assert (rig.property("encoder.error"), rig.property("controller.error")) == (0x4, 0x80)
    # What came beside it nobody was told yet: it becomes the fault.
    clear(rig)
    status = rig.until(lambda r: "SPINOUT_DETECTED" in r.status.reason)[-1].status
    assert status.fault.name == "drive_alarm"
    assert rig.property("controller.error") == 0x80
    clear(rig)
    rig.until(lambda r: r.status.state == "identified" and not rig.property("controller.error"))
    assert not rig.property("encoder.error")


def test_a_fault_that_nobody_could_read_survives_the_proof_of_the_watchdog(start) -> None:
    rig = connected(start(faults={"axis0.motor.error": 0x8}))
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
def test_a_firmware_that_the_link_does_not_know_is_refused(start, version, words) -> None:
    rig = start(firmware={"version": version})
    status = rig.until(lambda r: r.status.fault.name == "wrong_version")[-1].status
    assert status.state == "disconnected"
    assert re.search(words, status.reason)
    assert rig.property("config.enable_watchdog") == 0


def test_an_answer_that_is_no_number_is_no_silence(start) -> None:
    rig = start(axis=1)
    status = rig.until(lambda r: r.status.fault.name not in ("none", "no_answer"))[-1].status
    assert (status.state, status.fault.name) == ("disconnected", "status_unreadable")
    assert "the ODrive answered 'invalid property' to 'r axis1." in status.reason


def test_an_ordinary_answer_that_stops_to_be_one_is_no_silence(start, monkeypatch) -> None:
    rig = connected(start())
    answer = EmulatedOdrive._do_motor
    monkeypatch.setattr(
        EmulatedOdrive, "_do_motor", lambda o, verb, v: "nan nan" if verb == "f" else answer(o, verb, v)
    )
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "status_unreadable"
    assert "the ODrive answered 'nan nan' to 'f 0'" in status.reason


def test_a_limit_is_read_back_as_the_drive_prints_it(start) -> None:
    """Six decimals, so that a small one comes back rounded: 0.0123456789 turns/s as 0.012346."""
    speed = 0.0123456789 * abs(METRES_PER_TURN)
    rig = connected(
        start(AxisParameters(watchdog_s=0.3, max_speed=speed, homing_speed=speed, move_speed=speed))
    )
    assert rig.property("controller.config.vel_limit") == pytest.approx(0.0123456789)


def test_a_pulled_cable_loses_the_axis_and_the_drive_stops_by_itself(start) -> None:
    rig = connected(start(AxisParameters(watchdog_s=1.0, command_mode="velocity")))
    rig.enable()
    for _ in range(5):
        rig.hub.setpoint(rig.now.unix_ns, 0.03, rig.now)
        rig.run(0.05)
    rig.emulator.unplug()
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name in ("controller_silent", "port_lost")
    rig.run(1.5)
    assert rig.odrive.axis.velocity == 0.0
    rig.emulator.plug()
    rig.until(lambda r: r.status.state == "identified")
    assert rig.property("error") == 0


def test_a_killed_host_leaves_the_hub_at_rest(tmp_path) -> None:
    rig = OdriveRig(tmp_path, AxisParameters(watchdog_s=0.3))
    rig.hub.close()
    program = """
        import sys, time
        from beam_ros.hub.contract import HostTime
        from beam_ros.hub.link_parameters import OdriveParameters
        from beam_ros.hub.links.odrive import OdriveHub
        from beam_ros.hub.parameters import AxisParameters, LinkParameters
        parameters = AxisParameters(watchdog_s=0.3, command_mode="velocity")
        hub = OdriveHub(parameters, LinkParameters(sys.argv[1]), OdriveParameters(metres_per_turn=-0.02))
        now = lambda: HostTime(time.monotonic_ns(), time.time_ns())
        for kind in ("identified", "homed", "enabled"):
            while hub.poll(now()).status.state != kind:
                time.sleep(0.01)
            if kind != "enabled":
                hub.request("home" if kind == "identified" else "enable")
        while True:
            hub.setpoint(now().unix_ns, 0.03, now())
            hub.poll(now())
            time.sleep(0.02)
    """
    host = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program), rig.emulator.port], cwd=ROOT)
    try:
        end = time.monotonic() + 50.0
        while rig.odrive.axis.velocity < 0.02:
            assert time.monotonic() < end, "the host did not move the hub"
            time.sleep(0.01)
        os.kill(host.pid, signal.SIGKILL)
        host.wait()
        # The watchdog, and 0.03 m/s that friction stops at 2 m/s^2.
        time.sleep(0.3 + 0.015 + 0.3)
        assert rig.odrive.axis.velocity == 0.0
        assert int(rig.property("error")) & 0x800
    finally:
        host.kill()
        host.wait()
        rig.emulator.close()


def test_home_is_the_encoders_own_zero_where_that_is_chosen(start) -> None:
    rig = connected(start(homes_here=False))
    assert rig.run(0.05)[-1].status.position == pytest.approx(0.003, abs=1e-6)
    assert rig.ask("home").success
    assert rig.run(0.3)[-1].status.position == pytest.approx(0.0, abs=1e-5)
    assert rig.odrive.axis.true_position == pytest.approx(0.0, abs=1e-5)


def test_noise_on_the_line_never_passes_for_a_position(start) -> None:
    rig = connected(start())
    rng = np.random.default_rng(3)
    for _ in range(40):
        rig.emulator.inject(bytes(rng.integers(32, 127, 6, dtype=np.uint8)) + b"1.5 0.2\r\n" * 2)
        rig.run(0.02)
    positions = np.array([b.positions[0] for r in rig.reports for b in r.measured])
    rig.until(lambda r: r.status.state == "identified")
    assert np.ptp(positions) < 1e-9
    assert rig.reports[-1].status.counters["lost_answers"] > 0
