"""What answers on a port: every kind of controller on a real pseudo-terminal, by the verb `beam axis probe`."""

from __future__ import annotations

import json
import os
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beam_ros.cli.main import main
from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.line_board import LineBoard
from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.line import protocol
from beam_ros.hub.links.probe import ANSWER_S, probe_line
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.rig.rig import Rig

pytestmark = pytest.mark.slow

PARAMETERS = AxisParameters(command_mode="velocity")
PLANT = RigidPlant(0.8, 1e-3)
BOOTS = {
    "beam": None,
    "odrive": lambda device, _boot_id: EmulatedOdrive(ServoAxis(PARAMETERS, PLANT, device)),
    "dynamixel": lambda device, _boot_id: EmulatedDynamixel(
        ServoAxis(PARAMETERS, PLANT, device), values={7: 11}
    ),
    "csv": lambda device, _boot_id: LineBoard(PARAMETERS, PLANT, device),
}


def _probe(capsys, *arguments: object) -> tuple[int, str]:
    status = main(["axis", "probe", *map(str, arguments)])
    return status, capsys.readouterr().out


@pytest.mark.parametrize("kind", BOOTS)
def test_what_answers_is_named_and_its_rig_file_is_one(kind: str, tmp_path: Path, capsys) -> None:
    emulator = EmulatedController(PARAMETERS, PLANT, SimulatedDevice(), boot=BOOTS[kind])
    try:
        file = tmp_path / "rig.yaml"
        status, output = _probe(capsys, emulator.port, "--json", "--write", file)
        assert status == 0
        content = json.loads(output)
        assert (content["kind"], content["baud"]) == (kind, 921_600)
        rig = Rig.from_file(file)
        assert rig.axis.kind == kind
        assert rig.serial.port == emulator.port
        if kind == "beam":
            assert rig.hub.command_mode == "velocity"
            assert rig.hub.encoder_resolution == 1e-7
        if kind == "dynamixel":
            assert rig.dynamixel.id == 11
            assert "XC430-W150" in content["sentence"]
        if kind == "csv":
            assert (rig.csv.clock_column, rig.csv.position_column) == (1, 2)
            assert rig.csv.clock_tick == pytest.approx(1e-6)
            # Without a file the same lines are printed, for people.
            status, output = _probe(capsys, emulator.port)
            assert status == 0
            assert 'kind: "csv"' in output
            assert "  921600 baud: " in output
    finally:
        emulator.close()


class _Speaker:
    """Something at the other end of a pseudo-terminal."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(slave)
        self._slave = slave
        self._answer = answer
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.wait(0.01):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b""
            answer = self._answer(data)
            if answer:
                os.write(self._master, answer)

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


def _old_firmware(data: bytes) -> bytes:
    """Version 1: it answers a greeting that it does not speak with the head of its Identity alone."""
    hello = protocol.encode(protocol.Hello())
    return protocol.encode(protocol.Identity(0, 1, 1, 42)) if hello in data else b""


def _other_odrive() -> Callable[[bytes], bytes]:
    odrive = EmulatedOdrive(ServoAxis(PARAMETERS, PLANT, SimulatedDevice()), version=(0, 6, 9))
    return lambda data: odrive.exchange(data, 0) if data else b""


RNG = np.random.default_rng(4)


@pytest.mark.parametrize(
    ("answer", "kind", "words"),
    [
        (_old_firmware, "beam_other_version", "versions 1 to 1: expected version 2; update the firmware"),
        (_other_odrive(), "odrive_other_version", "firmware 0.6.9: expected 0.5.4 to 0.5.x"),
        (lambda _: RNG.integers(0, 256, 7, dtype=np.uint8).tobytes(), "noise", "neither numbers nor frames"),
        (lambda _: b"", "silence", "nobody answers"),
        (lambda _: b"ready\r\n", "noise", "neither numbers nor frames"),
    ],
    ids=["old", "odrive", "noise", "silence", "chatter"],
)
def test_what_is_no_axis_is_said_so(answer, kind: str, words: str, capsys, tmp_path: Path) -> None:
    speaker, rates = _Speaker(answer), [115200, 9600, 57600]
    try:
        file = tmp_path / "rig.yaml"
        status, output = _probe(capsys, speaker.port, "--baud", *rates, "--json", "--write", file)
        content = json.loads(output)
        assert (status, content["kind"]) == (1, kind)
        assert words in content["sentence"]
        assert not file.exists()
        # What speaks another version speaks at the rate at which it answered, be the computer busy: no further one
        # is tried.
        tried = [each["baud"] for each in content["tried"]]
        assert tried == rates[: len(tried)]
        assert (len(tried) < len(rates)) == kind.endswith("other_version")
    finally:
        speaker.close()


def test_an_answer_that_came_while_the_host_was_frozen_is_read() -> None:
    class Line:
        """Answers a greeting at once; the host is frozen when it listens."""

        answer = b""

        def write(self, data: bytes) -> None:
            self.answer = _old_firmware(data)
            self.is_frozen = True

        def read(self, timeout_s: float) -> tuple[bytes, int]:
            assert timeout_s >= 0.0
            answer = b""
            if self.answer and self.is_frozen:
                time.sleep(1.2 * ANSWER_S)
                self.is_frozen = False
            else:
                answer, self.answer = self.answer, b""
                time.sleep(0.01)
            return answer, time.monotonic_ns()

    assert probe_line(Line(), 115_200).kind == "beam_other_version"


def test_a_file_that_exists_and_a_port_that_does_not_are_refused(tmp_path: Path, capsys) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("mine")
    assert main(["axis", "probe", "/dev/null", "--write", str(file)]) == 2
    assert file.read_text() == "mine"
    assert main(["axis", "probe", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
