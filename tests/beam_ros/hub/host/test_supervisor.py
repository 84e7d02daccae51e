"""What the host makes of a device that goes wrong: the axis stops, and nothing looks as if all were well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ros.hub.contract import HubReport
from beam_ros.hub.emulated.injected_faults import read_schedule
from beam_ros.hub.faults import FAULTS
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.journal import Journal
from beam_ros.hub.line import protocol
from beam_ros.hub.parameters import COMMAND_MODES, AxisParameters, SimulatedDevice
from beam_ros.hub.ticks import TickBatch
from tests.beam_ros.hub.hub_scenes import (
    DRIFTING,
    Change,
    DriverRig,
    LoopbackRig,
    Rig,
    chunks_of,
    frozen,
    only,
    rest_to_rest,
)

PARAMETERS = AxisParameters()
VELOCITY = dataclasses.replace(PARAMETERS, command_mode="velocity")


def honest(data: bytes) -> bytes:
    return data


def moving(parameters: AxisParameters = VELOCITY, speed: float = 0.02) -> LoopbackRig:
    rig = LoopbackRig(parameters)
    rig.connect()
    rig.enable()
    drive(rig, speed, 0.5)
    return rig


def drive(rig: Rig, value: float, seconds: float) -> list[HubReport]:
    reports = []
    for _ in range(round(seconds / 0.05)):
        rig.hub.setpoint(rig.now.unix_ns, value, rig.now)
        reports += rig.run(0.05)
    return reports


def seen(reports: list[HubReport]) -> list[str]:
    """Faults in the order in which they were seen, each once."""
    names = [r.status.fault.name for r in reports if r.status.fault.is_of_host and r.status.state == "fault"]
    return list(dict.fromkeys(names))


def shifted(by_m: float) -> Change:
    counts = round(by_m / PARAMETERS.encoder_resolution)

    def change(message: protocol.Telemetry) -> protocol.Telemetry:
        ticks = message.ticks
        return protocol.Telemetry(dataclasses.replace(ticks, position_counts=ticks.position_counts + counts))

    return change


ACCIDENTS = {
    "position_jumped": lambda: only(protocol.Telemetry, shifted(0.01)),
    "motion_unexplained": lambda: only(protocol.Telemetry, frozen()),
    "telemetry_stopped": lambda: only(protocol.Telemetry, lambda _: None),
    "status_stopped": lambda: only(protocol.Status, lambda _: None),
    "status_unreadable": lambda: only(protocol.Status, lambda m: protocol.encode_payload(m)[:-1]),
    "clock_jumped": lambda: only(
        protocol.ClockReply,
        lambda m: protocol.ClockReply(m.number, m.received_ns + 10**12, m.sent_ns + 10**12),
    ),
    "clock_backwards": lambda: only(
        protocol.ClockReply,
        lambda m: protocol.ClockReply(m.number, m.received_ns - 10**10, m.sent_ns - 10**10),
    ),
}


# An encoder that was stuck jumps when it is honest again.
LOSES_HOME = ("position_jumped", "motion_unexplained", "clock_jumped", "clock_backwards")


@pytest.mark.slow
@pytest.mark.parametrize("name", ACCIDENTS)
def test_every_accident_stops_the_axis_and_stays_a_fault_until_it_is_cleared(name):
    rig = moving()
    x_before = rig.firmware.axis.position
    rig.to_host = ACCIDENTS[name]()
    reports = drive(rig, 0.02, 1.5)
    assert seen(reports) == [name]
    status = reports[-1].status
    assert (status.state, status.fault.name) == ("fault", name)
    assert status.reason
    assert any(e.level == "error" and status.fault.remedy in e.text for r in reports for e in r.events)
    # At 20 mm/s: it has gone on for a second at most, and stands.
    axis = rig.firmware.axis
    assert (axis.state, axis.velocity) == ("homed", 0.0)
    assert abs(axis.position - x_before) < 0.025
    # Nothing is taken while it is there.
    assert not rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now).success
    for kind in ("enable", "home"):
        outcome = rig.ask(kind)
        assert not outcome.success
        assert "clear the fault first" in outcome.message
    rig.to_host = honest
    rig.run(1.5)
    assert rig.reports[-1].status.fault.name == name
    first, *rest = rig.run(0.3)[-1].status.way_back
    assert rig.ask(first).success
    assert rig.run(0.1)[-1].status.state == ("identified" if name in LOSES_HOME else "homed")
    if name in LOSES_HOME:
        assert rig.ask("enable").message == "cannot enable: the axis is identified; home it first"
    assert (first, *rest) == ("clear_fault", *["home"] * (name in LOSES_HOME), "enable")
    for step in rest:
        assert rig.ask(step).success
    reports = drive(rig, -0.02, 1.0)
    assert seen(reports) == []
    assert reports[-1].status.state == "enabled"


def test_a_running_sequence_is_aborted_with_the_reason():
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.enable()
    for chunk in chunks_of(rest_to_rest(3000), rig.now.unix_ns + 300_000_000):
        rig.hub.load(chunk, rig.now)
    rig.run(0.7)
    rig.to_host = only(protocol.Telemetry, frozen())
    reports = rig.run(2.0)
    (end,) = [s for r in reports for s in r.sequences]
    assert end.state == "aborted"
    assert "hub.max_following_error" in end.reason
    assert rig.firmware.axis.velocity == 0.0


def test_what_was_asked_before_the_fault_is_not_asked_again_after_the_stop():
    rig = LoopbackRig(VELOCITY)
    rig.connect()
    assert rig.ask("home").success
    rig.to_device = only(protocol.Request, lambda m: None if m.kind == "enable" else m)
    request_id = rig.hub.request("enable")
    rig.run(0.05)
    rig.to_host = ACCIDENTS["status_unreadable"]()
    reports = rig.run(0.2)
    rig.to_device = honest
    reports += rig.run(1.0)
    (outcome,) = [outcome for r in reports for number, outcome in r.completed if number == request_id]
    assert not outcome.success
    assert "the axis is stopped" in outcome.message
    assert rig.firmware.axis.state == "homed"


@pytest.mark.slow
def test_a_hub_that_is_pushed_out_of_its_travel_is_a_fault_while_it_is_disabled_too():
    rig = LoopbackRig(dataclasses.replace(PARAMETERS, command_mode="effort"))
    rig.connect()
    assert rig.ask("home").success
    step = iter(np.arange(0, 0.06, 2e-4))
    pushed = [0.0]

    def push(message: protocol.Telemetry) -> protocol.Telemetry:
        pushed[0] = next(step, pushed[0])
        return shifted(pushed[0])(message)

    rig.to_host = only(protocol.Telemetry, push)
    reports = rig.run(6.5)
    assert seen(reports) == ["beyond_travel"]
    where = float(reports[-1].status.reason.split()[4])
    # The limit of 50 mm, the lag of 2 mm, and a step of 0.2 mm.
    assert 52.0 <= where <= 52.3


def test_a_fault_cannot_be_cleared_while_its_cause_is_there():
    rig = moving()
    rig.to_host = ACCIDENTS["telemetry_stopped"]()
    drive(rig, 0.02, 1.5)
    outcome = rig.ask("clear_fault")
    assert not outcome.success
    assert outcome.message.startswith("cannot clear the fault: its cause is still there: no telemetry for")
    assert rig.run(0.1)[-1].status.state == "fault"


def test_a_device_that_does_not_stop_when_asked_is_left_to_its_watchdog():
    rig = LoopbackRig(dataclasses.replace(PARAMETERS, command_mode="position"))
    rig.connect()
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.045, rig.now)
    rig.run(0.2)
    rig.to_host = ACCIDENTS["position_jumped"]()
    # It hears the stop, which keeps its watchdog from acting, and does nothing.
    rig.to_device = only(protocol.Request, lambda m: protocol.Heartbeat() if m.kind == "stop" else m)
    reports = rig.run(0.7)
    assert any("falls silent" in e.text for r in reports for e in r.events)
    axis = rig.firmware.axis
    assert (axis.state, axis.velocity) == ("homed", 0.0)
    assert axis.fault.name == "host_silent"
    assert axis.position < 0.04
    # It rests: the host speaks again, and the fault can be cleared.
    rig.to_host = rig.to_device = honest
    rig.run(1.0)
    assert rig.ask("clear_fault").success


@pytest.mark.slow
def test_a_device_that_works_for_ever_is_a_fault():
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    pending: list[int] = []

    def keep(message: protocol.RequestReply) -> protocol.RequestReply:
        pending.append(message.number)
        return protocol.RequestReply(message.number, "pending", "")

    rig.to_host = only(protocol.RequestReply, keep)
    start = rig.steady_ns
    outcome = rig.ask("home", timeout_s=60.0)
    assert not outcome.success
    assert "expected an end within" in outcome.message
    # Six travels of 0.1 m at 20 mm/s, and some leisure.
    assert 30.0 < (rig.steady_ns - start) * 1e-9 < 40.0
    assert seen(rig.run(0.1)) == ["never_done"]
    assert pending
    rig.to_host = honest
    rig.run(1.0)
    assert rig.ask("clear_fault").success


def test_a_fault_outlasts_the_session():
    rig = moving()
    rig.to_host = ACCIDENTS["position_jumped"]()
    drive(rig, 0.02, 0.2)
    rig.to_host = lambda data: b""
    rig.until(lambda r: r.status.state == "disconnected")
    rig.to_host = honest
    reports = rig.until(lambda r: r.status.state != "disconnected")
    assert reports[-1].status.fault.name == "position_jumped"
    assert not rig.ask("enable").success


def test_a_process_that_was_put_aside_misses_nothing():
    supervisor = Supervisor(PARAMETERS, Journal([]))
    now_ns = 0
    for _ in range(20):
        supervisor.look(now_ns)
        for kind in ("telemetry", "status", "other"):
            supervisor.hear(kind)
        now_ns += 5_000_000
    now_ns += 10_000_000_000
    supervisor.look(now_ns)
    for _ in range(30):
        supervisor.hear("other")
        supervisor.hear("status")
        supervisor.look(now_ns)
        now_ns += 5_000_000
    assert supervisor.fault is FAULTS[0]
    for _ in range(60):
        supervisor.look(now_ns)
        supervisor.hear("status")
        now_ns += 5_000_000
    assert supervisor.fault.name == "telemetry_stopped"


def test_a_hub_that_was_pushed_while_it_was_disabled_is_enabled_without_a_fault():
    supervisor = Supervisor(dataclasses.replace(PARAMETERS, command_mode="position"), Journal([]))
    counts = np.full(20, 100_000)
    zeros = np.zeros(20, dtype=np.float32)

    def came(first_tick: int, applied: np.ndarray) -> None:
        supervisor.note_ticks(TickBatch(first_tick, applied, counts, zeros, zeros), 0, is_homing=False)

    supervisor.note_status("homed", "idle", 20)
    came(20, np.zeros(20))
    # It is enabled at tick 50, where it stands: 10 mm from where it was left.
    supervisor.note_status("enabled", "hold", 50)
    came(40, np.where(np.arange(40, 60) < 50, 0.0, 0.01))
    came(60, np.full(20, 0.01))
    assert supervisor.fault is FAULTS[0]
    came(80, np.full(20, 0.02))
    assert supervisor.fault.name == "motion_unexplained"


@pytest.mark.slow
@pytest.mark.parametrize("mode", COMMAND_MODES)
@pytest.mark.parametrize("start", [-0.04, 0.0, 0.03])
def test_no_alarm_is_raised_by_a_healthy_axis_on_a_noisy_line(mode, start):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    device = dataclasses.replace(DRIFTING, initial_position=start)
    rig = LoopbackRig(parameters, device)
    rig.connect()
    rng = np.random.default_rng(6)

    def noisy(data: bytes) -> bytes:
        if data and rng.random() < 0.03:
            changed = bytearray(data)
            changed[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            return bytes(changed)
        return data

    rig.to_host = rig.to_device = noisy
    limits = {"acceleration": 1.0, "velocity": 0.3, "position": 0.04, "effort": 2.0}
    for turn in range(3):
        rig.enable()
        for k in range(20):
            value = limits[mode] * (-1) ** (k // 3 + turn) * 0.5
            rig.hub.setpoint(rig.now.unix_ns, value, rig.now)
            rig.run(0.05)
        rig.ask("disable")
        rig.run(0.1)
        # Into a limit of the device, where it stops by itself.
        rig.ask("enable")
        for _ in range(12):
            rig.hub.setpoint(rig.now.unix_ns, limits[mode], rig.now)
            rig.run(0.05)
        rig.ask("stop")
        rig.ask("clear_fault")
        rig.run(0.3)
    assert seen(rig.reports) == []
    assert rig.reports[-1].status.counters["bad_frames"] > 8


@pytest.mark.slow
def test_a_device_with_clocks_of_32_bits_is_no_worse_than_another():
    narrow = SimulatedDevice(clock_start_ns=(1 << 32) * 1000 - 3_000_000_000)
    rig = LoopbackRig(VELOCITY, narrow)
    width = (1 << 32) * 1000

    def wrapped(message: protocol.ClockReply) -> protocol.ClockReply:
        return protocol.ClockReply(message.number, message.received_ns % width, message.sent_ns % width)

    rig.to_host = only(protocol.ClockReply, wrapped)
    rig.connect()
    rig.enable()
    reports = drive(rig, 0.005, 5.0)
    assert seen(rig.reports) == []
    stamps = np.array([b.stamp_ns for r in reports for b in r.measured])
    assert np.all(np.abs(np.diff(stamps) - 20_000_000) < 10_000)
    assert {b.epoch for r in rig.reports for b in r.measured} == {1}


@pytest.fixture
def live(tmp_path):
    rig = DriverRig(dataclasses.replace(PARAMETERS, command_mode="velocity", watchdog_s=1.0), tmp_path)
    rig.connect()
    rig.enable()
    yield rig
    rig.close()


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("{fault: step, seconds: 30}", "clock_jumped"),
        ("{fault: step, seconds: -30}", "clock_backwards"),
        ("{fault: wrap, bits: 36}", "clock_backwards"),
        ("{fault: drift, ppm: 10000}", "clock_jumped"),
    ],
)
def test_a_real_ports_clock_that_goes_wrong_stops_the_axis(live, fault, name):
    live.hub.setpoint(live.now.unix_ns, 0.01, live.now)
    live.run(0.2)
    live.emulator.bring_about(read_schedule(fault, "test", live.emulator.elapsed))
    reports = live.until(lambda r: r.status.state == "fault", 4.0)
    assert seen(reports) == [name]
    live.run(0.3)
    assert (live.emulator.axis.state, live.emulator.axis.velocity) == ("homed", 0.0)
    assert not live.ask("enable").success


@pytest.mark.slow
def test_a_real_ports_clock_of_32_bits_wraps_under_a_sequence(live):
    live.emulator.bring_about(read_schedule("{fault: wrap, bits: 32}", "test", live.emulator.elapsed))
    live.run(0.5)
    values = 0.02 * np.sin(np.pi * np.arange(5001) / 2500) * (np.arange(5001) < 5000)
    for chunk in chunks_of(values, live.now.unix_ns + 400_000_000):
        live.hub.load(chunk, live.now)
    reports = [*live.until(lambda r: "done" in [s.state for s in r.sequences], 12.0), *live.run(0.1)]
    assert seen(reports) == []
    applied = np.concatenate([b.velocities for r in reports for b in r.applied])
    first = np.flatnonzero(applied)[0] - 1
    assert np.array_equal(applied[first : first + 5001], values)
    stamps = np.array([b.stamp_ns for r in reports for b in r.measured])
    assert np.all(np.abs(np.diff(stamps) - 20_000_000) < 200_000)
