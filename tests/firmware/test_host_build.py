"""The firmware as a Linux program, in real time: on a pseudo-terminal, and with a plant on its second port."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from beam_ros.hub.conformance.suite import ALWAYS, CHECKS, run_checks
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder, encode_frame
from beam_ros.hub.parameters import AxisParameters, LinkParameters
from tests.beam_ros.hub.hub_scenes import PortRig, chunks_of, rest_to_rest
from tests.firmware.builds import built

pytestmark = pytest.mark.slow

QUICK = ("handshake", "limits", "clock_rate", "telemetry", "homing", "silence_while_running", "sequence")
"""Checks that need real time to mean something; all of them run in virtual time, and in `make verify`."""


@contextmanager
def running(*options: str) -> Iterator[dict[str, str]]:
    """Start the program; return where its ends are."""
    words = [str(built("beam-firmware-sanitized")), *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            ends = {}
            for _ in range(1 + options.count("--plant")):
                name, url = process.stdout.readline().split()
                ends[name] = url
            yield ends
            assert process.poll() is None, "the firmware ended"
        finally:
            process.terminate()


class PortLine:
    """A real port as the checks need it."""

    def __init__(self, url: str) -> None:
        self.port = serial.serial_for_url(url, 921_600, timeout=0)

    def send(self, data: bytes) -> None:
        self.port.write(data)

    def receive(self, timeout_s: float) -> bytes:
        self.port.timeout = timeout_s
        data = self.port.read(1)
        self.port.timeout = 0
        return data + self.port.read(65_536)

    def now_ns(self) -> int:
        return time.monotonic_ns()


def test_the_host_build_keeps_the_protocol_on_a_pseudo_terminal(executables):
    with running("--position", "0.01") as ends:
        verb = executables.run(
            "beam", "axis", "conformance", ends["host"], "--yes", "--json", "--only", *QUICK, timeout_s=60
        )
    found = {row["name"]: row for row in json.loads(verb.output())["checks"]}
    assert {name: row["reason"] for name, row in found.items() if row["outcome"] != "passed"} == {}
    assert set(found) == set(QUICK)
    assert verb.process.returncode == 0


@pytest.mark.verify
@pytest.mark.parametrize("mode", ["acceleration", "position"])
def test_the_host_build_keeps_the_whole_protocol_over_a_socket(mode):
    with running("--listen", "0", "--mode", mode) as ends:
        line = PortLine(ends["host"])
        found = list(run_checks(line, moves=True))
        line.port.close()
    assert {result.name: result.reason for result in found if result.outcome == "failed"} == {}
    assert len(found) == len(CHECKS) + len(ALWAYS)


def test_the_driver_runs_a_sequence_on_the_firmware():
    parameters = AxisParameters()
    values = rest_to_rest(1500)
    with running("--position", "0.004") as ends:
        rig = PortRig(parameters, LinkParameters(ends["host"]))
        try:
            rig.connect()
            rig.enable()
            for chunk in chunks_of(values, rig.now.unix_ns + 600_000_000):
                rig.hub.load(chunk, rig.now)
            rig.until(lambda r: any(s.state == "done" for s in r.sequences))
            rig.run(0.1)
        finally:
            rig.hub.close()
    assert [s.state for r in rig.reports for s in r.sequences][-2:] == ["running", "done"]
    assert rig.reports[-1].status.counters["watchdog_proved"] == 1
    applied = np.concatenate([batch.accelerations for r in rig.reports for batch in r.applied])
    (first,) = np.flatnonzero(applied == values[0])[:1]
    assert np.array_equal(applied[first : first + len(values)], values)


class StillPlant:
    """A motor that never moves, behind the plant port; written from the table in docs/firmware.md."""

    READING = struct.Struct("<BQIIfB")
    DRIVE = struct.Struct("<BQBddddi")

    def __init__(self, url: str) -> None:
        self._port = serial.serial_for_url(url, timeout=0)
        self._decoder = FrameDecoder()
        self.drives: list[tuple[object, ...]] = []
        self.boots = 0

    def serve(self, seconds: float) -> None:
        """Answer for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for payload in self._decoder.feed(self._port.read(65_536)):
                self._port.write(self._answer(payload))
            time.sleep(1e-4)

    def _answer(self, payload: bytes) -> bytes:
        if payload[0] == 0x81:
            self.boots += 1
            axis = AxisParameters(command_mode="velocity", encoder_resolution=1e-6)
            head = struct.pack("<BIBBd", 1, axis.period_ns, axis.batch_ticks, 1, axis.encoder_resolution)
            limits = struct.pack("<9dI", *vars(protocol.DeviceLimits.of(axis)).values())
            setup = head + limits + struct.pack("<d", 0.001)
            return encode_frame(setup) + encode_frame(self.READING.pack(2, 0, 7, 0, 0.0, 1))
        drive = self.DRIVE.unpack(payload)
        self.drives.append(drive)
        return encode_frame(self.READING.pack(2, drive[1] + 1, 7, 0, 0.0, 1))

    def close(self) -> None:
        self._port.close()


def test_a_plant_says_what_axis_it_is_and_keeps_step_with_the_ticks():
    with running("--listen", "0", "--plant", "0") as ends:
        plant = StillPlant(ends["plant"])
        plant.serve(0.5)
        line = PortLine(ends["host"])
        line.send(protocol.encode(protocol.Hello()))
        plant.serve(0.3)
        payloads = FrameDecoder().feed(line.receive(0.5))
        line.port.close()
        plant.close()
    identity = next(m for m in map(protocol.decode, payloads) if isinstance(m, protocol.Identity))
    assert (identity.command_mode, identity.encoder_resolution) == ("velocity", 1e-6)
    ticks = [drive[1] for drive in plant.drives]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
    assert len(ticks) > 300
    assert plant.boots >= 1
    assert {drive[2] for drive in plant.drives} == {0}  # nothing is powered


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that nobody has buried does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_program_ends_with_the_one_that_started_it():
    script = "import subprocess as s, sys; print(s.Popen(sys.argv[1:], stdout=s.DEVNULL).pid, flush=True)"
    words = [sys.executable, "-c", script, str(built("beam-firmware")), "--listen", "0"]
    pid = int(subprocess.run(words, capture_output=True, text=True, timeout=10, check=True).stdout)
    end = time.monotonic() + 5.0
    while is_alive(pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert not is_alive(pid)


@pytest.mark.parametrize("n_bytes", [3e6, pytest.param(1e8, marks=pytest.mark.verify)])
def test_any_bytes_leave_the_core_sound_and_the_hub_within_its_limits(n_bytes):
    done = subprocess.run(
        [str(built("fuzz")), str(n_bytes), "11"], capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[0]) >= n_bytes
