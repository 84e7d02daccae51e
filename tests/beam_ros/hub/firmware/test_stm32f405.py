"""The firmware for the STM32F405, instruction by instruction in QEMU: the protocol, the emulator's path, its load."""

from __future__ import annotations

import json
import os
import signal
import time

import numpy as np
import pytest

from beam_ros.hub.conformance.suite import run_checks
from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.firmware.built_firmware import BuiltFirmware
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import RigidPlant
from benchmarks import firmware_load
from benchmarks.paced_firmware import PacedFirmware
from tests.beam_ros.hub.conformance.virtual_line import VirtualLine
from tests.beam_ros.hub.hub_scenes import rest_to_rest
from tests.firmware.builds import built
from tests.firmware.test_core import Host, emulated, play

pytestmark = pytest.mark.slow

QUICK = ("handshake", "limits", "noise", "homing", "silence_while_running", "sequence", "limit_edges")


@pytest.fixture
def paced():
    made = []

    def make(mode="acceleration", position=0.01):
        axis = AxisParameters(command_mode=mode)
        made.append(PacedFirmware(built("stm32f405-plant.elf"), axis, RigidPlant(0.8, 1e-3), position))
        return made[-1]

    yield make
    for firmware in made:
        firmware.close()


def test_the_processor_keeps_the_protocol(paced):
    found = list(run_checks(VirtualLine(paced()), moves=True, names=QUICK))
    assert {result.name: result.reason for result in found if result.outcome != "passed"} == {}
    assert len(found) == len(QUICK)


@pytest.mark.verify
@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_the_processor_keeps_the_whole_protocol(paced, mode):
    firmware = paced(mode)
    found = list(run_checks(VirtualLine(firmware), moves=True, bench=firmware.axis))
    # Paced, the clock stands still between ticks: what it is worth shows in real time.
    failed = {r.name: r.reason for r in found if r.outcome != "passed" and r.name != "clock_rate"}
    assert failed == {}


def test_the_processor_takes_the_emulators_way_bit_for_bit(paced):
    """Its doubles are done in software, by another compiler: still the same sums."""
    values = rest_to_rest(1500)
    ours = paced()
    ends = []
    for firmware in (ours, emulated("acceleration")):
        host = Host(firmware)
        host.enable()
        ends.append(play(host, values))
    assert np.array_equal(ends[0].applied, values)
    assert np.abs(ends[0].position_counts - ends[1].position_counts).max() <= 1
    # What the plant did is what the samples say: it was led from rest at home, and is there again.
    assert ours.axis.velocity == pytest.approx(0.0, abs=1e-12)
    assert ours.axis.true_position == pytest.approx(0.0, abs=2e-7)


def test_the_firmware_serves_a_port_in_real_time_and_restarts_with_another_boot_id(executables, tmp_path):
    axis, plant = AxisParameters(), RigidPlant(0.8, 1e-3)

    def boot(device, boot_id):
        file = built("stm32f405-plant.elf")
        return BuiltFirmware(file, axis, plant, device, n_starts=boot_id)

    controller = EmulatedController(axis, plant, link=tmp_path / "hub", boot=boot)
    try:
        names = ("handshake", "limits")
        words = ("beam", "axis", "conformance", controller.port, "--no-motion", "--json", "--only", *names)
        seen = []
        for _ in range(2):
            verb = executables.run(*words, timeout_s=60)
            assert json.loads(verb.output())["checks"][0]["outcome"] == "passed"
            seen.append(controller.reached_ns)
            controller.restart()
        assert seen[1] > seen[0]
        assert controller.trouble == ""
    finally:
        controller.close()


def test_a_processor_that_was_killed_is_told():
    axis = AxisParameters()
    firmware = BuiltFirmware(built("stm32f405-plant.elf"), axis, RigidPlant(0.8, 1e-3))
    try:
        deadline = time.monotonic() + 20.0
        while firmware.axis.device_ns == 0 and time.monotonic() < deadline:
            firmware.exchange(b"", time.monotonic_ns())
        assert firmware.trouble == ""
        os.kill(firmware.pid, signal.SIGKILL)
        while firmware.sources:
            time.sleep(0.01)
        assert firmware.exchange(b"x", time.monotonic_ns()) == b""
        assert firmware.sources == ()
        assert firmware.trouble.startswith("the firmware (process")
    finally:
        firmware.close()


def test_a_tick_takes_less_than_a_fifth_of_its_time_and_the_stack_stays_shallow(tmp_path):
    """An instruction is counted as two cycles: most take one here, but the processor waits for its flash at times."""
    load = firmware_load.measure(built("stm32f405-plant.elf"), tmp_path)
    assert 500 < load.in_tick < load.most
    assert 500 < load.mean < load.most
    assert 2 * load.in_tick < 33_600
    assert 2 * load.mean < 33_600
    assert 256 < load.stack_bytes < 8192
