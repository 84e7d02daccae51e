"""The driver against the emulated controller on a real pseudo-terminal, in real time."""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameters
from beam_ros.hub.contract import SequenceChunk
from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.connection import SILENCE_NS
from beam_ros.hub.line.driver import DriverHub
from beam_ros.hub.line.transport import SerialTransport
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import BeamPlant, RigidPlant
from beam_ros.rig.rig import Rig as RigFile
from tests.beam_ros.hub.hub_scenes import (
    DriverRig,
    PortRig,
    Rig,
    SimulatedRig,
    busy_link,
    chunks_of,
    rest_to_rest,
)
from tests.beam_ros.hub.line.relay import SerialServer

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
ACCELERATION = AxisParameters()
VELOCITY = AxisParameters(command_mode="velocity")
DEVICE = SimulatedDevice(
    clock_drift_ppm=35.0, clock_start_ns=900_000_000_000, initial_position=0.001, buffer_samples=4096
)
# For what is not about watchdogs: a busy computer that stands still for half a second changes nothing.
PATIENT = AxisParameters(watchdog_s=1.0)


@pytest.fixture
def start(tmp_path):
    rigs = []

    def start_rig(
        parameters: AxisParameters,
        plant: object = None,
        device: SimulatedDevice = DEVICE,
        guard: BeamGuard | None = None,
    ) -> DriverRig:
        rigs.append(DriverRig(parameters, tmp_path, plant, device, guard))
        rigs[-1].connect()
        return rigs[-1]

    yield start_rig
    for rig in rigs:
        rig.close()


def states(reports):
    return [s.state for r in reports for s in r.sequences]


def load(rig: Rig, values: np.ndarray, lead_ns: int = 300_000_000) -> None:
    for chunk in chunks_of(values, rig.now.unix_ns + lead_ns):
        rig.hub.load(chunk, rig.now)


def hold_velocity(rig: Rig, value: float, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        assert rig.hub.setpoint(rig.now.unix_ns, value, rig.now).success
        rig.run(0.05)


def script(rig: Rig) -> list[object]:
    """Do what a session does, right and wrong, and return all answers."""
    answers: list[object] = []

    def note(*things: object) -> None:
        answers.extend(things)

    note(rig.ask("enable"), rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now))
    note(rig.ask("home"), rig.ask("clear_fault"), rig.ask("enable"), rig.ask("home"), rig.ask("enable"))
    note(rig.hub.setpoint(0, 0.1, rig.now), rig.hub.setpoint(rig.now.unix_ns, 99.0, rig.now))
    note(rig.hub.setpoint(rig.now.unix_ns - 10**9, 0.1, rig.now).success)

    rig.hub.load(SequenceChunk("old", 1, 1, rig.now.unix_ns - 10**9, 1_000_000, 0, np.ones(9)), rig.now)
    rig.hub.load(SequenceChunk("nan", 1, 1, rig.now.unix_ns + 10**9, 1_000_000, 0, np.ones(9)), rig.now)
    note(states(rig.run(0.05)))

    load(rig, rest_to_rest(700))
    note(rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now))
    reports = rig.until(lambda r: "done" in states([r]))
    note([s for r in reports for s in r.sequences], reports[-1].status.state)

    load(rig, rest_to_rest(1500))
    rig.until(lambda r: "running" in states([r]))
    note(rig.ask("stop"), rig.reports[-1].status.state, rig.reports[-1].status.reason)
    note([s for r in rig.reports[-30:] for s in r.sequences][-1], rig.ask("stop"), rig.ask("enable"))

    # Held for the watchdog's second, 0.2 m/s^2 would be 100 mm.
    note(rig.hub.setpoint(rig.now.unix_ns, -0.2, rig.now).success)
    note(rig.hub.setpoint(rig.now.unix_ns, -0.05, rig.now))
    rig.until(lambda r: r.status.state != "enabled")
    rig.run(0.1)
    note(rig.reports[-1].status.state, rig.reports[-1].status.reason, rig.reports[-1].status.velocity)
    note(
        [e.text for r in rig.reports for e in r.events if e.text.startswith("axis") and "limit" not in e.text]
    )
    return answers


def script_of_a_fault(rig: Rig) -> list[object]:
    """Push the hub to the end of its travel, which nobody can predict without a beam, and return all answers."""
    answers: list[object] = []
    rig.enable()
    # Away at 1 m/s^2: the axis stops by itself 45 mm later.
    for _ in range(40):
        if rig.run(0.05)[-1].status.state == "fault":
            break
        rig.hub.setpoint(rig.now.unix_ns, 0.8, rig.now)
    answers += rig.reports[-1].status.state, rig.reports[-1].status.reason.split(":")[0]
    rig.run(0.2)
    answers += rig.ask("enable").success, rig.ask("clear_fault"), rig.reports[-1].status.state
    answers.append(rig.ask("enable"))
    return answers


def test_a_fault_and_its_end_are_the_same_for_driver_and_simulated_hub(start):
    parameters = AxisParameters(watchdog_s=1.0, command_mode="effort")
    simulated = script_of_a_fault(SimulatedRig(parameters, device=DEVICE))
    assert simulated[0] == "fault"
    assert script_of_a_fault(start(parameters)) == simulated


def test_the_driver_gives_the_same_answers_as_the_simulated_hub(start):
    simulated = script(SimulatedRig(PATIENT, device=DEVICE))
    real = script(start(PATIENT))
    # The simulated device was identified before anyone listened.
    real[-1].remove("axis identified")
    assert real == simulated


@pytest.mark.slow
def test_applied_and_measured_are_the_simulators_bit_for_bit(start):
    rig_parameters = BeamParameters.from_section(0.3, 0.025, 0.0005, 7850.0, 200e9, hub_mass=0.8)
    values = rest_to_rest(1800, 0.7)

    def record(rig: Rig) -> dict[str, np.ndarray]:
        rig.enable()
        load(rig, values)
        reports = rig.until(lambda r: "done" in states([r])) + rig.run(0.1)
        applied = np.concatenate([b.accelerations for r in reports for b in r.applied])
        begin = np.flatnonzero(applied == values[1])[0] - 1
        part = slice(begin, begin + 1820)
        return {
            "applied": applied[part],
            "x": np.concatenate([b.positions for r in reports for b in r.measured])[part],
            "v": np.concatenate([b.velocities for r in reports for b in r.measured])[part],
            "f": np.concatenate([b.efforts for r in reports for b in r.measured])[part],
        }

    device = dataclasses.replace(DEVICE, initial_position=0.0)
    simulated = record(SimulatedRig(PATIENT, BeamPlant(BeamModel(rig_parameters), 1e-3), device))
    real = record(start(PATIENT, BeamPlant(BeamModel(rig_parameters), 1e-3), device))
    assert np.array_equal(simulated["applied"][:1800], values)
    for name, array in simulated.items():
        assert np.array_equal(real[name], array), name


def test_stamps_are_as_true_as_the_hub_says(start):
    """On a line at rest that is 0.1 ms (``test_sample_stamping.py``); a busy computer knows less."""
    rig = start(ACCELERATION)
    reports = rig.run(1.5)
    batches = [b for r in reports for b in r.measured]
    stamps = np.array([b.stamp_ns for b in batches])
    assert len(stamps) >= 72
    assert np.all(np.diff(stamps) > 0)
    true_ns = []
    for stamp in stamps:
        device_ns = rig.emulator.device_ns(int(stamp))
        true_ns.append(device_ns - round(device_ns / 1e6) * 1_000_000)
    stated_ns = max(r.status.counters["stamp_sd_ns"] for r in reports)
    assert np.max(np.abs(true_ns)) < 4 * stated_ns
    counters = reports[-1].status.counters
    assert counters["lost_ticks"] == counters["bad_frames"] == counters["unknown_messages"] == 0


def test_a_cable_pulled_mid_sequence_stops_the_axis_and_the_driver_comes_back(start):
    rig = start(ACCELERATION)
    rig.enable()
    load(rig, rest_to_rest(3000))
    rig.until(lambda r: "running" in states([r]))
    rig.run(0.3)
    rig.emulator.unplug()
    reports = [*rig.until(lambda r: "aborted" in states([r])), *rig.run(0.6)]
    assert states(reports) == ["aborted"]
    assert reports[-1].status.state == "disconnected"
    (event,) = [e for r in reports for e in r.events]
    assert event.level == "error"
    assert "was lost" in event.text
    assert rig.emulator.axis.state == "homed"
    assert rig.emulator.axis.velocity == 0.0
    rig.emulator.plug()
    reports = rig.until(lambda r: r.status.state == "homed")
    rig.run(0.3)
    stamps = [b.stamp_ns for r in rig.reports for b in r.measured]
    assert np.all(np.diff(stamps) > 0)
    assert np.max(np.diff(stamps)) > 500_000_000
    assert rig.ask("enable").success


def test_ten_minutes_are_checked_while_the_axis_stays_enabled(start):
    """The check takes a second or more; meanwhile the host speaks, or the device's watchdog would stop the axis."""
    rig = start(PATIENT, guard=RigFile.from_file().beam_guard())
    rig.enable()
    values = np.zeros(600_000)
    values[:3000] = rest_to_rest(3000)
    start_ns = rig.now.unix_ns + 30_000_000_000
    for k, chunk in enumerate(chunks_of(values, start_ns)):
        rig.hub.load(chunk, rig.now)
        if k % 100 == 0:
            rig.run(0.01)
    for _ in range(3000):
        report = rig.run(0.01)[-1]
        if "loading" not in states([report]) and states([report]):
            break
    assert states([report]) == ["ready"], report.sequences
    assert report.status.state == "enabled", report.status.reason
    assert rig.ask("stop").success


def test_garbage_on_the_line_does_not_disturb_a_sequence(start):
    rig = start(PATIENT)
    rig.enable()
    load(rig, rest_to_rest(800))
    rng = random.Random(5)
    for _ in range(26):
        rig.emulator.inject(rng.randbytes(rng.randint(1, 300)))
        rig.run(0.05)
    assert states(rig.reports)[-1] == "done"
    assert rig.reports[-1].status.counters["bad_frames"] > 0
    assert rig.reports[-1].status.state == "enabled"


def test_a_frozen_host_finds_the_axis_stopped_by_its_own_watchdog(start):
    rig = start(VELOCITY)
    rig.enable()
    hold_velocity(rig, 0.05, 0.3)
    assert rig.emulator.axis.velocity == pytest.approx(0.05, abs=1e-3)
    # How soon, virtual time says in the checks of silence; here a limit only ends what hangs.
    frozen_at = time.monotonic()
    while rig.emulator.axis.velocity != 0.0 or rig.emulator.axis.state != "homed":
        assert time.monotonic() - frozen_at < 30.0
        time.sleep(0.005)
    rig.run(0.5)
    assert rig.reports[-1].status.state == "homed"
    assert "0.25 s" in rig.reports[-1].status.reason


def test_close_leaves_a_moving_axis_at_rest(start):
    n_threads = threading.active_count()
    rig = start(VELOCITY)
    rig.enable()
    hold_velocity(rig, 0.1, 0.2)
    rig.hub.close()
    assert rig.emulator.axis.velocity == 0.0
    assert rig.emulator.axis.state == "homed"
    # The emulator's own thread is left.
    assert threading.active_count() <= n_threads + 1


def test_a_power_cut_of_the_controller_is_a_new_epoch(start):
    rig = start(ACCELERATION)
    rig.enable()
    rig.run(0.2)
    rig.emulator.restart()
    reports = rig.until(lambda r: r.status.state == "identified")
    reports += rig.until(lambda r: bool(r.measured))
    assert any("restarted" in e.text for r in reports for e in r.events)
    batches = [b for r in rig.reports for b in r.measured]
    assert {b.epoch for b in batches} == {1, 2}
    assert np.all(np.diff([b.stamp_ns for b in batches]) > 0)


CHILD = """
import sys, time
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.contract import HostTime
from beam_ros.hub.parameters import AxisParameters, LinkParameters
from beam_ros.hub.line.driver import DriverHub

hub = DriverHub(AxisParameters(command_mode="velocity"), LinkParameters(sys.argv[1]))
wanted = ["home", "enable"]
state = "disconnected"
while True:
    now = HostTime(time.monotonic_ns(), time.time_ns())
    report = hub.poll(now)
    if report.status.state == "identified" and state != "identified":
        hub.request("home")
    elif report.status.state == "homed" and state != "homed":
        hub.request("enable")
    elif report.status.state == "enabled":
        hub.setpoint(now.unix_ns, 0.05, now)
    state = report.status.state
    time.sleep(0.02)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_process_leaves_the_axis_stopped(tmp_path, number):
    emulator = EmulatedController(VELOCITY, BeamPlant(_beam(), 1e-3), DEVICE, link=tmp_path / "hub")
    child = subprocess.Popen([sys.executable, "-c", CHILD, emulator.port], cwd=ROOT)
    try:
        end = time.monotonic() + 60.0
        while abs(emulator.axis.velocity - 0.05) > 1e-3:
            assert time.monotonic() < end
            assert child.poll() is None
            time.sleep(0.01)
        os.kill(child.pid, number)
        while emulator.axis.velocity != 0.0 or emulator.axis.state != "homed":
            assert time.monotonic() < end
            time.sleep(0.01)
        assert "0.25 s" in emulator.axis.reason
    finally:
        child.kill()
        child.wait()
        emulator.close()


def _beam() -> BeamModel:
    return BeamModel(BeamParameters.from_section(0.3, 0.025, 0.0005, 7850.0, 200e9, hub_mass=0.8))


@pytest.fixture
def driver():
    hubs = []

    def start_driver(port: str, **options: object) -> Rig:
        rig = PortRig(PATIENT, busy_link(port, **options))
        hubs.append(rig.hub)
        return rig

    yield start_driver
    for hub in hubs:
        hub.close()


@pytest.fixture
def emulator(tmp_path):
    controller = EmulatedController(PATIENT, RigidPlant(0.8, 1e-3), DEVICE, link=tmp_path / "hub")
    yield controller
    controller.close()


def connected(report) -> bool:
    return report.status.state != "disconnected"


def told(rig: Rig) -> list[str]:
    return [event.text for report in rig.reports for event in report.events]


@pytest.mark.parametrize(
    ("port", "words"), [("", "set serial.port"), ("sokcet://there:1", "socket://host:4000")]
)
def test_a_port_that_can_never_be_one_is_refused_at_once(port, words):
    with pytest.raises(HubConnectionError) as caught:
        DriverHub(ACCELERATION, LinkParameters(port))
    text = str(caught.value)
    assert words in text
    assert "expected" in text
    assert "\n" not in text


def test_a_port_that_is_missing_at_the_start_is_a_fault_and_is_used_when_it_comes(driver, tmp_path):
    rig = driver(str(tmp_path / "hub"))
    reports = rig.until(lambda r: r.status.fault.name == "port_unavailable")
    reports += rig.run(0.8)
    assert reports[-1].status.state == "disconnected"
    (text,) = told(rig)
    assert str(tmp_path / "hub") in text
    assert "expected an existing port" in text
    assert "correct serial.port" in text
    assert rig.ask("enable").message.endswith(text)
    emulator = EmulatedController(PATIENT, RigidPlant(0.8, 1e-3), DEVICE, link=tmp_path / "hub")
    try:
        reports = rig.until(connected)
        assert reports[-1].status.reason == ""
    finally:
        emulator.close()


def test_a_missing_port_is_no_fault_while_it_is_waited_for(driver, tmp_path):
    waiting = driver(str(tmp_path / "hub"), patience_s=600.0)
    assert {r.status.fault.name for r in waiting.run(0.6)} == {"none"}
    rig = driver(str(tmp_path / "hub"), patience_s=0.1)
    rig.until(lambda r: r.status.fault.name == "port_unavailable")
    assert len(told(rig)) == 1


def test_what_is_no_port_or_belongs_to_another_program_is_told_and_tried_again(start, driver, tmp_path):
    (tmp_path / "file").write_text("not a port")
    rig = driver(str(tmp_path / "file"))
    rig.until(lambda r: "cannot be opened" in r.status.reason)
    first = start(PATIENT)
    second = driver(first.emulator.port)
    second.until(lambda r: "no other program" in r.status.reason)
    assert second.reports[-1].status.fault.name == "port_unavailable"
    assert first.run(0.1)[-1].status.state == "identified"
    first.hub.close()
    second.until(connected)


def test_another_trouble_of_the_same_port_is_told_too(driver, tmp_path):
    """A port that is missing first, and then nobody answers on it."""
    rig = driver(str(tmp_path / "hub"))
    rig.until(lambda r: r.status.fault.name == "port_unavailable")
    master, slave = os.openpty()
    try:
        (tmp_path / "hub").symlink_to(os.ttyname(slave))
        rig.until(lambda r: "nobody answers" in r.status.reason)
    finally:
        os.close(master)
        os.close(slave)
    assert ["cannot be opened" in text for text in told(rig)] == [True, False]


@pytest.mark.filterwarnings("ignore:set.* is deprecated")  # pyserial's, in its RFC 2217
@pytest.mark.parametrize("kind", ["plain", "rfc2217", "spy"])
def test_any_url_of_pyserial_is_a_port(driver, emulator, tmp_path, kind):
    server = None
    url = f"spy://{emulator.port}?file={tmp_path / 'log'}"
    if kind != "spy":
        server = SerialServer(emulator.port, speaks_rfc2217=kind == "rfc2217")
        url = server.url
    try:
        rig = driver(url)
        rig.connect()
        rig.enable()
        before = rig.reports[-1].status.counters
        load(rig, rest_to_rest(600), lead_ns=600_000_000)
        rig.until(lambda r: "done" in states([r]))
        rig.run(0.2)
        after = rig.reports[-1].status.counters
        for counter in ("lost_ticks", "bad_frames", "connections"):
            assert after[counter] == before[counter], (counter, told(rig))
        if server is not None:
            server.close()
            rig.until(lambda r: r.status.state == "disconnected")
            assert rig.reports[-1].status.fault.name in ("port_lost", "controller_silent")
    finally:
        if server is not None:
            server.close()


def test_a_port_that_only_hears_itself_has_nobody_who_answers(driver):
    rig = driver("loop://")
    rig.until(lambda r: "nobody answers" in r.status.reason)
    assert rig.reports[-1].status.fault.name == "no_answer"


@pytest.mark.parametrize("delay_s", [0.06, 0.15, 0.4])
def test_a_greeting_that_is_answered_late_is_answered_all_the_same(driver, emulator, delay_s):
    """The host greets every 0.2 s: it has greeted up to four times before the first answer comes."""
    server = SerialServer(emulator.port, delay_s=delay_s)
    try:
        rig = driver(server.url)
        rig.until(connected)
        reports = rig.run(1.5)
        assert all(map(connected, reports)), told(rig)
        assert reports[-1].status.counters["connections"] == 1, told(rig)
    finally:
        server.close()


def test_a_flood_neither_starves_the_executor_nor_ends_the_driver(driver):
    server = SerialServer("", noise_seed=4)
    try:
        rig = driver(server.url)
        rig.until(lambda r: r.status.fault.name == "line_flooded")
        rig.run(1.0)
        assert "line_flooded" in {r.status.fault.name for r in rig.reports}
        (text,) = told(rig)
        assert "expected at most 340000" in text
        assert "hub-serial" in {thread.name for thread in threading.enumerate()}
    finally:
        server.close()


@pytest.mark.slow
def test_whatever_a_vanishing_port_raises_is_a_connection_error(emulator):
    """Plugged and unplugged at random times while it is opened, read and written without a pause."""
    rng = random.Random(8)
    is_over = threading.Event()

    def flap() -> None:
        while not is_over.is_set():
            time.sleep(rng.random() * 2e-3)
            emulator.unplug()
            emulator.plug()

    flapping = threading.Thread(target=flap, daemon=True)
    flapping.start()
    transport = SerialTransport(emulator.port, 921_600, 10**9)
    kinds = {"open": 0, "use": 0}
    end = time.monotonic() + 3.0
    try:
        while time.monotonic() < end:
            try:
                transport.open()
                kinds["open"] += 1
                for _ in range(rng.randint(1, 20)):
                    transport.write(b"hello")
                    transport.read(1e-4)
            except HubConnectionError:
                kinds["use"] += 1
            transport.close()
    finally:
        is_over.set()
        flapping.join()
        transport.dispose()
    assert min(kinds.values()) > 20, kinds


def _unplug_again_and_again(rig: DriverRig, cycles: int) -> None:
    def resources() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    before = resources()
    for cycle in range(cycles):
        rig.emulator.unplug()
        rig.until(lambda r: r.status.state == "disconnected")
        assert rig.reports[-1].status.fault.name == "port_lost"
        rig.emulator.plug()
        rig.until(connected)
        assert rig.reports[-1].status.counters["connections"] == cycle + 2
        rig.reports.clear()
    assert resources() == before


def test_a_port_that_is_unplugged_again_and_again_comes_back_every_time(start):
    _unplug_again_and_again(start(PATIENT), 4)


def test_a_host_that_is_frozen_behind_its_look_at_the_port_does_not_take_the_controller_for_silent(
    start, monkeypatch
):
    rig = start(PATIENT)
    before = rig.reports[-1].status.counters["connections"]
    read, frozen = rig.hub._transport.read, threading.Event()

    def read_and_freeze(timeout_s: float) -> tuple[bytes, int]:
        answer = read(timeout_s)
        if not frozen.is_set():
            frozen.set()
            time.sleep(1.2e-9 * SILENCE_NS)
        return answer

    monkeypatch.setattr(rig.hub._transport, "read", read_and_freeze)
    reports = rig.run(2.0)
    assert frozen.is_set()
    assert all(r.status.state != "disconnected" for r in reports), told(rig)
    assert reports[-1].status.counters["connections"] == before


@pytest.mark.verify
def test_fifty_replugs_leave_nothing_behind(start):
    _unplug_again_and_again(start(PATIENT), 50)


def _flap(rig: DriverRig, seconds: float) -> None:
    """Plug and unplug at random times, 2 ms to 2 s apart, and look whether the driver then is alive and back."""
    rng = random.Random(11)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rig.emulator.unplug()
        rig.run(10 ** rng.uniform(-2.7, 0.3))
        rig.emulator.plug()
        rig.run(10 ** rng.uniform(-2.7, 0.3))
        rig.reports[:-1] = []
    rig.until(lambda r: connected(r) and bool(r.measured))
    rig.enable()


def test_a_flapping_port_finds_the_driver_alive(start):
    _flap(start(PATIENT), 6.0)


@pytest.mark.verify
def test_ten_minutes_of_a_flapping_port_find_the_driver_alive(start):
    _flap(start(PATIENT), 600.0)


def test_a_poll_that_follows_on_news_finds_some(tmp_path):
    rig = DriverRig(AxisParameters(command_mode="velocity", watchdog_s=1.0), tmp_path)
    try:
        rig.connect()
        told = threading.Event()
        rig.hub.call_on_news(told.set)
        for _ in range(20):
            rig.hub.poll(rig.now)
            told.clear()
            # A batch comes every 20 ms; nobody polls in vain meanwhile.
            assert told.wait(60.0)
            report = rig.hub.poll(rig.now)
            assert report.measured or report.completed
    finally:
        rig.close()
