"""The listening link against the emulated board, in virtual time; and on a real pseudo-terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.emulated.injected_faults import disturb, read_schedule
from beam_ros.hub.emulated.line_board import COUNT, LineBoard
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_board import REFUSAL, SILENCE_NS, CsvHub
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import (
    STEADY_START,
    UNIX_START,
    LiveRig,
    PacedRig,
    VirtualPort,
    VirtualTime,
    chunks_of,
    rest_to_rest,
)

COLUMNS = CsvColumns(position=2, clock=1, position_scale=COUNT)
# The counter of microseconds wraps within the first second.
DEVICE = SimulatedDevice(clock_drift_ppm=200.0, clock_start_ns=((1 << 32) - 1_000_000) * 1000)


class BoardRig(PacedRig):
    """The link, and its board."""

    def __init__(self, columns: CsvColumns = COLUMNS) -> None:
        parameters, steady = AxisParameters(), VirtualTime()
        self.board = LineBoard(parameters, RigidPlant(0.8, 1e-3), DEVICE)
        self.port = VirtualPort(steady, self.board, DEVICE)
        link = LinkParameters("port")
        super().__init__(CsvHub(parameters, link, columns, port=self.port, steady=steady), steady)


def _measured(reports) -> tuple[np.ndarray, np.ndarray]:
    batches = [batch for report in reports for batch in report.measured]
    return np.array([b.stamp_ns for b in batches]), np.array([b.positions[0] for b in batches])


@pytest.mark.parametrize("columns", [COLUMNS, CsvColumns(position=2, position_scale=COUNT)])
def test_every_line_is_a_measurement_with_a_stamp_of_its_own(columns) -> None:
    rig = BoardRig(columns).connected()
    rig.until(lambda r: bool(r.measured))
    stamps, positions = _measured(rig.run(3.0))
    assert len(stamps) > 100
    assert np.all(np.diff(stamps) > 0)
    truth = rig.board.axis.snapshots(
        [rig.port.device_ns(ns - UNIX_START + STEADY_START) for ns in stamps]
    ).positions
    assert np.max(np.abs(truth)) > 0.001
    # A line travels for some tenths of a millisecond, at 15 mm/s and less; one count is a micrometre.
    assert np.max(np.abs(positions - truth)) < 0.4e-3 * 0.015 + COUNT
    assert any("jitter" in said for said in rig.hub.capabilities.shortcomings) == (not columns.clock)


def test_every_command_is_refused_with_the_reason() -> None:
    rig = BoardRig().connected()
    for kind in ("enable", "disable", "home", "stop", "clear_fault"):
        outcome = rig.ask(kind)
        assert not outcome.success
        assert REFUSAL in outcome.message
    assert REFUSAL in rig.hub.setpoint(rig.now.unix_ns, 0.0, rig.now).message
    for chunk in chunks_of(rest_to_rest(1200), rig.now.unix_ns + 1_000_000_000):
        rig.hub.load(chunk, rig.now)
    (report,) = [s for r in rig.run(0.1) for s in r.sequences]
    assert (report.state, report.reason) == ("refused", REFUSAL)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("{fault: lying_encoder, offset: 0.1}", "position_jumped"),
        ("{fault: step, seconds: 5}", "clock_jumped"),
        ("{fault: step, seconds: -0.8}", "clock_backwards"),
    ],
)
def test_what_a_board_cannot_mean_is_a_fault_until_it_is_cleared(text: str, name: str) -> None:
    rig = BoardRig().connected()
    rig.until(lambda r: bool(r.measured))
    # The counter has wrapped, and goes back behind no zero.
    rig.run(2.0)
    (injected,) = read_schedule(text, "test", 0.0)
    if injected.kind == "step":
        rig.board.disturb(injected, begins=True)
    else:
        disturb(rig.board.axis, injected, begins=True)
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == name
    rig.clear()
    rig.until(lambda r: r.status.state == "identified")


def test_a_board_that_falls_silent_and_one_that_is_pulled_are_lost_and_come_back() -> None:
    rig = BoardRig().connected()
    rig.port.is_plugged = False
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name in ("controller_silent", "port_lost")
    rig.port.is_plugged = True
    rig.until(lambda r: r.status.state == "identified")


def test_a_process_that_was_frozen_does_not_take_its_board_for_silent() -> None:
    """Its executor wakes before the thread that reads, and judges a time in which nobody could hear."""
    rig = BoardRig().connected()
    rig.steady.wait(1.2e-9 * SILENCE_NS)
    reports = [rig.hub.poll(rig.now), *rig.run(0.5)]
    assert all(r.status.state == "identified" for r in reports)
    assert reports[-1].status.counters["connections"] == 1


def test_lines_that_cannot_be_read_are_no_silence() -> None:
    rig = BoardRig(CsvColumns(position=5))
    status = rig.until(lambda r: r.status.fault.name == "status_unreadable")[-1].status
    assert status.state == "disconnected"
    assert "expected 5 numbers in each" in status.reason
    assert rig.run(0.5)[-1].status.counters["bad_lines"] > 20


def test_a_board_that_goes_on_with_words_is_not_silent(monkeypatch) -> None:
    rig = BoardRig().connected()
    monkeypatch.setattr(LineBoard, "exchange", lambda *_: b"overheated\r\n")
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert status.fault.name == "status_unreadable"
    assert "such as b'overheated" in status.reason
    monkeypatch.undo()
    rig.until(lambda r: r.status.state == "identified")


@pytest.mark.slow
def test_a_board_on_a_port_is_measured(tmp_path: Path) -> None:
    parameters = AxisParameters()
    emulator = EmulatedController(
        parameters,
        RigidPlant(0.8, 1e-3),
        DEVICE,
        link=tmp_path / "board",
        boot=lambda device, _boot_id: LineBoard(parameters, RigidPlant(0.8, 1e-3), device),
    )
    rig = LiveRig(CsvHub(parameters, LinkParameters(emulator.port), COLUMNS))
    try:
        rig.until(lambda r: r.status.state == "identified" and bool(r.measured))
    finally:
        rig.hub.close()
        emulator.close()
