"""The Dynamixel link against the emulated servo, in virtual time."""

from __future__ import annotations

import random

import numpy as np
import pytest

from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.link_parameters import DynamixelParameters
from beam_ros.hub.links.dynamixel import DynamixelHub
from beam_ros.hub.links.motion_plan import MotionPlan
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

METRES_PER_TURN = -0.1
COUNT = 0.1 / 4096
PATIENT = AxisParameters(watchdog_s=1.0, max_speed=0.12)
QUICK = AxisParameters(watchdog_s=0.25, max_speed=0.12)
VELOCITY = AxisParameters(watchdog_s=0.25, max_speed=0.12, command_mode="velocity")
DEVICE = SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=900_000_000_000, initial_position=-0.003)
LATENCY_TIMER_NS = 16_000_000


class ServoRig(PacedRig):
    """The link and its servo."""

    def __init__(
        self,
        parameters: AxisParameters = PATIENT,
        *,
        servo: dict[str, object] | None = None,
        prove_watchdog: bool = True,
        patience_s: float = 0.0,
        **settings: object,
    ) -> None:
        self.servo = EmulatedDynamixel(
            ServoAxis(parameters, RigidPlant(0.8, 1e-3), DEVICE),
            metres_per_turn=METRES_PER_TURN,
            **(servo or {}),
        )
        steady = VirtualTime()
        self.bus = VirtualPort(steady, self.servo, DEVICE)
        link = LinkParameters("bus", prove_watchdog=prove_watchdog, patience_s=patience_s)
        moves = DynamixelParameters(metres_per_turn=METRES_PER_TURN, **settings)
        super().__init__(DynamixelHub(parameters, link, moves, port=self.bus, steady=steady), steady)

    def kept(self) -> list[int]:
        """Addresses of what is kept without power that were written."""
        written = [data for data in self.bus.written if data[7] == 3]
        return [address for data in written if (address := int.from_bytes(data[8:10], "little")) < 64]


def test_mode_profile_and_watchdog_are_on_the_servo_before_anything_moves() -> None:
    rig = ServoRig(servo={"values": {108: 5, 112: 50, 68: 0}}).connected()
    servo = rig.servo
    assert (servo.value(11), servo.value(108, 4), servo.value(112, 4)) == (4, 0, 0)
    # 1 s are 50 units of 20 ms; the motor is off, and its watchdog was seen to act and was cleared.
    assert (servo.value(98), servo.value(64)) == (50, 0)
    assert rig.steady.ns - STEADY_START > 1_000_000_000
    (connected,) = rig.events("connected")
    assert "XC430-W150 with firmware 46, Dynamixel 1, counts of 2.44e-05 m, 12.0 V, 31 degrees C" in connected


def test_the_watchdogs_time_is_never_longer_than_the_rigs() -> None:
    assert ServoRig(QUICK).connected().servo.value(98) == 12


def test_what_wears_out_is_written_only_where_it_differs() -> None:
    rig = ServoRig().connected()
    assert rig.kept() == [11]
    rig = ServoRig(servo={"values": {11: 4}}).connected()
    assert rig.kept() == []


def test_a_watchdog_that_is_set_and_does_not_act_is_never_connected() -> None:
    rig = ServoRig(QUICK, servo={"has_watchdog": False})
    status = rig.until(lambda r: r.status.fault.name == "watchdog_unproved")[-1].status
    assert status.state == "disconnected"
    assert "was set to 0.24 s and did not act on 0.3" in status.reason
    assert not rig.ask("enable").success
    assert rig.servo.value(64) == 0
    without = ServoRig(QUICK, servo={"has_watchdog": False}, prove_watchdog=False).connected()
    without.enable()
    assert "believed, not proved" in without.hub.capabilities.shortcomings[-1]
    assert not any("believed" in sentence for sentence in rig.hub.capabilities.shortcomings)


def test_a_watchdog_that_acts_too_early_is_never_connected(monkeypatch) -> None:
    overdue = EmulatedDynamixel._is_overdue
    monkeypatch.setattr(EmulatedDynamixel, "_is_overdue", lambda s, ns: overdue(s, ns + 150_000_000))
    rig = ServoRig(QUICK)
    status = rig.until(lambda r: r.status.fault.name == "watchdog_unproved")[-1].status
    assert "look for another program" in status.reason


@pytest.mark.parametrize("share", [0.4, 1.5])
def test_a_host_that_is_frozen_while_it_proves_the_watchdog_believes_it(share: float, monkeypatch) -> None:
    wait = VirtualTime.wait
    freezes = []

    def wait_and_freeze(steady: VirtualTime, seconds: float) -> None:
        wait(steady, seconds)
        if seconds == pytest.approx(share * 0.24) and not freezes:
            freezes.append(seconds)
            wait(steady, 3.0)

    monkeypatch.setattr(VirtualTime, "wait", wait_and_freeze)
    rig = ServoRig(QUICK).connected()
    assert freezes
    assert "watchdog_unproved" not in {r.status.fault.name for r in rig.reports}


def test_a_hub_that_moves_is_not_held_to_prove_anything() -> None:
    rig = ServoRig(QUICK)
    rig.servo.axis.advance(DEVICE.clock_start_ns + 100_000_000, lambda _: (1.0, 0.1))
    rig.steady.ns += 100_000_000
    status = rig.run(0.02)[-1].status
    assert status.fault.name == "watchdog_unproved"
    assert "the hub moves with" in status.reason
    assert rig.servo.value(64) == 0
    rig.connected()


def test_the_axis_runs_a_sequence_and_reports_what_was_written_and_when() -> None:
    rig = ServoRig().connected()
    rig.enable()
    assert rig.servo.value(64) == 1
    values = rest_to_rest(1000)
    start_ns = rig.now.unix_ns + 400_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda r: any(s.state == "done" for s in r.sequences))
    plan = MotionPlan.sequence(values, PATIENT, 0.0)
    # What was written is the plan at the very stamp. The servo follows with its position loop's lag of 17 ms, at
    # the 50 mm/s that the sequence reaches.
    for name, tolerance in (("applied", 1e-12), ("measured", 17e-3 * 0.05)):
        batches = [b for r in rig.reports for b in getattr(r, name) if b.stamp_ns > start_ns - 10_000_000]
        assert all(b.period_ns == 0 and len(b) == 1 for b in batches)
        times = np.array([b.stamp_ns for b in batches])
        path = np.array([b.positions[0] for b in batches])
        assert len(times) > 200
        assert np.max(np.abs(path)) > 0.002
        assert np.max(np.abs(path - plan.sample((times - start_ns) * 1e-9)[0])) < tolerance
    assert rig.ask("disable").success
    rig.run(0.1)
    assert rig.servo.value(64) == 0


def test_what_is_measured_is_where_the_motor_was_at_the_stamp() -> None:
    rig = ServoRig(VELOCITY).connected()
    rig.enable()
    rig.drive(0.02, 1.0)
    batches = [b for r in rig.reports[-50:] for b in r.measured][:-5]
    steady = [b.stamp_ns - UNIX_START + STEADY_START for b in batches]
    truth = rig.servo.axis.snapshots([rig.bus.device_ns(ns) for ns in steady]).positions + 0.003
    error = np.array([b.positions[0] for b in batches]) - truth
    # Half a count, and 20 mm/s over half of the return delay of 0.5 ms and the bus.
    assert np.max(np.abs(error)) < COUNT / 2 + 0.02 * 0.35e-3
    assert truth[-1] > 0.015


def test_a_set_point_that_is_not_refreshed_ends_in_a_ramp() -> None:
    rig = ServoRig(VELOCITY).connected()
    rig.enable()
    assert rig.hub.setpoint(rig.now.unix_ns, 0.05, rig.now).success
    status = rig.until(lambda r: r.status.state == "homed")[-1].status
    assert status.fault.name == "setpoint_old"
    assert status.position == pytest.approx(0.25 * 0.05, rel=0.1)


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        (0x20, "Overload Error (12.0 V, 31 degrees C)"),
        (0x04 | 0x01, "Input Voltage Error, Overheating Error"),
        (0x08, "Motor Encoder Error"),
        (0x10, "Electrical Shock Error"),
    ],
)
def test_a_hardware_error_is_named_and_stays_until_it_is_cleared_by_a_restart(
    errors: int, words: str
) -> None:
    rig = ServoRig().connected()
    rig.enable()
    rig.servo.fail(errors)
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "drive_alarm"
    assert words in status.reason
    assert "clear the fault first" in rig.ask("enable").message
    rig.run(0.5)
    assert (rig.servo.value(70), rig.servo.value(64)) == (errors, 0), "only a person clears it"
    rig.clear()
    rig.run(3.0)
    # The restart took watchdog and mode back: both are set again, and the watchdog is proved again.
    assert (rig.servo.value(70), rig.servo.value(98), rig.servo.value(11)) == (0, 50, 4)
    assert "home it first" in rig.ask("enable").message
    rig.enable()
    assert {r.status.fault.name for r in rig.reports} == {"none", "drive_alarm"}


def test_a_missing_port_is_no_fault_while_it_is_waited_for() -> None:
    rig = ServoRig(patience_s=2.0)
    rig.bus.is_plugged = False
    assert {r.status.fault.name for r in rig.run(1.9)} == {"none"}
    rig.run(0.5)
    assert {r.status.fault.name for r in rig.run(1.0)} == {"port_unavailable"}
    rig.bus.is_plugged = True
    rig.until(lambda r: r.status.state == "identified")
    assert rig.reports[-1].status.fault.name == "none"


def test_a_connection_clears_no_hardware_error() -> None:
    rig = ServoRig()
    rig.servo.fail(0x20)
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert (status.fault.name, rig.servo.value(70)) == ("drive_alarm", 0x20)
    rig.bus.is_plugged = False
    rig.until(lambda r: r.status.state == "disconnected")
    rig.servo.fail(0x04)
    rig.bus.is_plugged = True
    rig.until(lambda r: r.status.state == "fault")
    assert rig.servo.value(70) == 0x24
    # What came beside it nobody was told yet: it becomes the fault.
    rig.clear()
    rig.until(lambda r: "Overheating Error, Overload Error" in r.status.reason)
    assert rig.servo.value(70) == 0x24
    rig.clear()
    rig.until(lambda r: r.status.state == "identified" and not rig.servo.value(70))


@pytest.mark.parametrize(
    ("values", "name", "words"),
    [
        ({0: 350}, "wrong_version", "of model 350: expected one of the X series"),
        ({6: 37}, "wrong_version", "firmware 37: expected 38 or later"),
        ({44: 300}, "wrong_axis", "hub.max_speed is 0.12: expected at most 0.1145, by the Velocity Limit"),
        ({7: 2}, "no_answer", "no answer to 'ping'"),
    ],
    ids=["model", "firmware", "speed", "number"],
)
def test_a_servo_that_cannot_be_the_axis_is_refused(values: dict[int, int], name: str, words: str) -> None:
    rig = ServoRig(servo={"values": values})
    status = rig.until(lambda r: r.status.reason != "the controller has not answered yet")[-1].status
    assert (status.state, status.fault.name) == ("disconnected", name)
    assert words in status.reason
    assert (rig.kept(), rig.servo.value(64), rig.servo.value(98)) == ([], 0, 0)


def test_a_travel_beyond_the_servos_turns_is_refused() -> None:
    rig = ServoRig(AxisParameters(watchdog_s=0.25, max_speed=0.12, travel=26.0))
    status = rig.run(0.1)[-1].status
    assert "hub.travel is 26: expected at most 25.6" in status.reason


def test_a_frozen_host_is_stopped_by_the_servo_and_nothing_is_enabled_again() -> None:
    rig = ServoRig(VELOCITY).connected()
    rig.enable()
    rig.drive(0.03, 0.3)
    before = rig.servo.axis.true_position
    rig.steady.ns += 2_000_000_000
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "host_silent"
    assert "Bus Watchdog -1" in status.reason
    # 0.24 s of 30 mm/s, and no more: its own goal was ahead by a few counts.
    assert abs(rig.servo.axis.true_position - before) < 0.03 * 0.24 + 0.001
    rig.run(1.0)
    assert (rig.servo.value(64), rig.servo.value(98)) == (0, 0xFF), "nobody has cleared it"
    rig.clear()
    rig.run(0.5)
    assert (rig.servo.value(64), rig.servo.value(98)) == (0, 0xFF)
    assert rig.ask("enable").success
    assert (rig.servo.value(64), rig.servo.value(98)) == (1, 12)


def test_a_servo_that_lost_its_power_for_a_moment_is_no_axis_any_more() -> None:
    rig = ServoRig().connected()
    rig.enable()
    rig.servo.table[64] = rig.servo.table[98] = 0
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "drive_alarm"
    assert "leads the motor no more (Torque Enable 0, Bus Watchdog 0): no error" in status.reason


def test_a_pulled_cable_loses_the_axis_and_the_servo_stops_by_itself() -> None:
    rig = ServoRig(VELOCITY).connected()
    rig.enable()
    rig.drive(0.03, 0.3)
    rig.bus.is_plugged = False
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "port_lost"
    rig.run(0.5)
    rig.servo.exchange(b"", rig.bus.device_ns(rig.steady.ns))
    assert abs(rig.servo.axis.velocity) < 1e-5
    assert rig.servo.value(98) == 0xFF
    rig.bus.is_plugged = True
    rig.connected()
    assert (rig.servo.value(64), rig.servo.value(98)) == (0, 12)


def test_a_servo_that_falls_silent_is_lost() -> None:
    rig = ServoRig(QUICK).connected()
    rig.servo.table[7] = 9
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "controller_silent"
    assert "the servo fell silent: no answer to 'read" in status.reason


def test_a_servo_that_refuses_is_not_silent(monkeypatch) -> None:
    rig = ServoRig(QUICK).connected()
    monkeypatch.setattr(EmulatedDynamixel, "_do_alone", lambda s, _instruction, _data: s._answer(2, b"", 0))
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "status_unreadable"
    assert "with Instruction Error: expected" in status.reason


def test_a_servo_that_does_not_stop_is_asked_nothing_so_that_its_watchdog_acts(monkeypatch) -> None:
    rig = ServoRig(VELOCITY).connected()
    rig.enable()
    rig.drive(0.03, 0.3)
    servo, obedient = rig.servo, rig.servo._command
    begun_ns, begun = servo.axis.device_ns, servo.axis.true_position

    def run_away(device_ns: int) -> tuple[float, float] | None:
        if servo._is_overdue(device_ns) or servo.value(98) == 0xFF:
            return obedient(device_ns)
        return begun + 0.03 * (device_ns - begun_ns) * 1e-9, 0.03

    monkeypatch.setattr(servo, "_command", run_away)
    monkeypatch.setattr(servo, "_write", lambda _address, _data: 0)
    rig.hub.request("stop")
    rig.until(lambda _: bool(rig.events("the host falls silent")))
    n_asked = len(rig.bus.written)
    rig.run(0.35)
    # The order to let go of the motor came before; nothing feeds the watchdog.
    assert rig.bus.written[n_asked:] == []
    servo.exchange(b"", rig.bus.device_ns(rig.steady.ns))
    assert servo.value(98) == 0xFF
    assert abs(servo.axis.velocity) < 1e-4
    status = rig.run(0.5)[-1].status
    assert (status.state, status.fault.name) == ("fault", "stop_ignored")


def test_home_is_the_encoders_own_zero_where_that_is_chosen() -> None:
    rig = ServoRig(homes_here=False).connected()
    assert rig.run(0.05)[-1].status.position == pytest.approx(-0.003, abs=COUNT)
    assert rig.ask("home").success
    assert rig.run(0.3)[-1].status.position == pytest.approx(0.0, abs=2 * COUNT)
    assert rig.servo.axis.true_position == pytest.approx(0.0, abs=2 * COUNT)


def test_noise_on_the_bus_never_passes_for_a_place() -> None:
    rig = ServoRig(QUICK).connected()
    rng = random.Random(3)
    for _ in range(60):
        rig.bus.inject(bytes(rng.choice([0xFF, 0xFD, 0, 1, 8, 0x55, rng.randrange(256)]) for _ in range(9)))
        rig.run(0.02)
    positions = np.array([b.positions[0] for r in rig.reports for b in r.measured])
    assert len(positions) > 50
    assert np.ptp(positions) < 1e-9


def test_an_adapter_with_a_latency_timer_is_led_slower_and_said_so() -> None:
    """16 ms are what many USB adapters come with: 60 answers a second."""
    rig = ServoRig(PATIENT)
    rig.bus.latency_ns = LATENCY_TIMER_NS
    rig.connected()
    rig.enable()
    values = rest_to_rest(2000, 0.1)
    start_ns = rig.now.unix_ns + 400_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda r: any(s.state == "done" for s in r.sequences))
    rig.run(3.0)
    (said,) = rig.events("times a second")
    assert "expected axis.rate = 200; set the latency timer of the USB adapter to 1 ms" in said
    assert 40 <= rig.reports[-1].status.counters["writes_per_second"] <= 63
    assert rig.reports[-1].status.state == "enabled"


def test_an_adapter_without_one_keeps_the_rate() -> None:
    rig = ServoRig(QUICK).connected()
    rig.run(5.0)
    assert rig.reports[-1].status.counters["writes_per_second"] == pytest.approx(200, abs=2)
    assert not rig.events("times a second")
