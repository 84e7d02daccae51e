"""The listening link against the emulated board on a real pseudo-terminal."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.emulated.injected_faults import read_schedule
from beam_ros.hub.emulated.line_board import COUNT, LineBoard
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_board import REFUSAL, SILENCE_NS, CsvHub
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import LiveRig, chunks_of, rest_to_rest

pytestmark = pytest.mark.slow

COLUMNS = CsvColumns(position=2, clock=1, position_scale=COUNT)
# The counter of microseconds wraps within the first second.
DEVICE = SimulatedDevice(clock_drift_ppm=200.0, clock_start_ns=((1 << 32) - 1_000_000) * 1000)


class BoardRig(LiveRig):
    """The link, and a board on a pseudo-terminal."""

    def __init__(self, folder: Path, columns: CsvColumns = COLUMNS) -> None:
        parameters = AxisParameters()
        self.emulator = EmulatedController(
            parameters,
            RigidPlant(0.8, 1e-3),
            DEVICE,
            link=folder / "board",
            boot=lambda device, _boot_id: LineBoard(parameters, RigidPlant(0.8, 1e-3), device),
        )
        super().__init__(CsvHub(parameters, LinkParameters(self.emulator.port), columns))

    def close(self) -> None:
        self.hub.close()
        self.emulator.close()


@pytest.fixture
def start(tmp_path):
    rigs = []

    def start_rig(*arguments: object) -> BoardRig:
        rigs.append(BoardRig(tmp_path, *arguments))
        rigs[-1].until(lambda r: r.status.state == "identified")
        return rigs[-1]

    yield start_rig
    for rig in rigs:
        rig.close()


def _measured(reports) -> tuple[np.ndarray, np.ndarray]:
    batches = [batch for report in reports for batch in report.measured]
    return np.array([b.stamp_ns for b in batches]), np.array([b.positions[0] for b in batches])


# How late a line comes, and so how well a stamp is known, is this computer's to say: `test_csv_measurements` holds
# both in virtual time. Here lines are measurements, one after the other.
@pytest.mark.parametrize("columns", [COLUMNS, CsvColumns(position=2, position_scale=COUNT)])
def test_every_line_is_a_measurement_with_a_stamp_of_its_own(start, columns) -> None:
    rig = start(columns)
    rig.until(lambda r: bool(r.measured))
    stamps, positions = _measured(rig.run(3.0))
    assert len(stamps) > 100
    assert np.all(np.diff(stamps) > 0)
    truth = rig.emulator.snapshots(stamps[:-50]).positions
    assert np.max(np.abs(truth)) > 0.001
    assert np.max(np.abs(positions)) < 2.0 * np.max(np.abs(truth))
    assert np.corrcoef(positions[:-50], truth)[0, 1] > 0.9
    assert any("jitter" in said for said in rig.hub.capabilities.shortcomings) == (not columns.clock)


def test_every_command_is_refused_with_the_reason(start) -> None:
    rig = start()
    for kind in ("enable", "disable", "home", "stop", "clear_fault"):
        outcome = rig.ask(kind)
        assert not outcome.success
        assert REFUSAL in outcome.message
    assert REFUSAL in rig.hub.setpoint(rig.now.unix_ns, 0.0, rig.now).message
    for chunk in chunks_of(rest_to_rest(1200), rig.now.unix_ns + 1_000_000_000):
        rig.hub.load(chunk, rig.now)
    (report,) = [s for r in rig.run(0.1) for s in r.sequences]
    assert (report.state, report.reason) == ("refused", REFUSAL)


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("{fault: lying_encoder, offset: 0.1}", "position_jumped"),
        ("{fault: step, seconds: 5}", "clock_jumped"),
        ("{fault: step, seconds: -0.8}", "clock_backwards"),
    ],
)
def test_what_a_board_cannot_mean_is_a_fault_until_it_is_cleared(start, text, name) -> None:
    rig = start()
    rig.until(lambda r: bool(r.measured))
    # The counter has wrapped, and goes back behind no zero.
    rig.run(2.0)
    rig.emulator.bring_about(read_schedule(text, "test", rig.emulator.elapsed))
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == name
    # The cause is gone a quarter of a second after it was seen, of the time in which this process could look.
    assert any(rig.run(0.4) and rig.ask("clear_fault").success for _ in range(50))
    rig.until(lambda r: r.status.state == "identified")


def test_a_board_that_falls_silent_and_one_that_is_pulled_are_lost_and_come_back(start) -> None:
    rig = start()
    rig.emulator.unplug()
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name in ("controller_silent", "port_lost")
    rig.emulator.plug()
    rig.until(lambda r: r.status.state == "identified")


def test_a_process_that_was_frozen_does_not_take_its_board_for_silent(start, monkeypatch) -> None:
    """Its executor wakes before the thread that reads, and judges a time in which nobody could hear."""
    rig = start()
    transport, frozen_s = rig.hub._transport, 1.2e-9 * SILENCE_NS
    read, begun = transport.read, threading.Event()

    def freeze_and_read(timeout_s: float) -> tuple[bytes, int]:
        if not begun.is_set():
            begun.set()
            time.sleep(frozen_s + 0.1)
        return read(timeout_s)

    monkeypatch.setattr(transport, "read", freeze_and_read)
    assert begun.wait(60.0)
    time.sleep(frozen_s)
    reports = rig.run(0.5)
    assert all(r.status.state == "identified" for r in reports)
    assert reports[-1].status.counters["connections"] == 1


def test_lines_that_cannot_be_read_are_no_silence(tmp_path) -> None:
    rig = BoardRig(tmp_path, CsvColumns(position=5))
    try:
        status = rig.until(lambda r: r.status.fault.name == "status_unreadable")[-1].status
        assert status.state == "disconnected"
        assert "expected 5 numbers in each" in status.reason
        assert rig.run(0.5)[-1].status.counters["bad_lines"] > 20
    finally:
        rig.close()


def test_a_board_that_goes_on_with_words_is_not_silent(start, monkeypatch) -> None:
    rig = start()
    monkeypatch.setattr(LineBoard, "exchange", lambda *_: b"overheated\r\n")
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "status_unreadable"
    assert "such as b'overheated" in status.reason
    monkeypatch.undo()
    rig.until(lambda r: r.status.state == "identified")
