"""What runs a firmware refuses what is none, with one line that says what to do."""

from __future__ import annotations

import sys

import pytest

from beam_ros.hub.errors import HubConnectionError, HubParameterError
from beam_ros.hub.firmware.machine import FirmwareMachine
from tests.firmware.builds import built

pytestmark = pytest.mark.slow


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(HubParameterError, match=r"No such file.*make firmware"):
        FirmwareMachine(tmp_path / "x.elf")


def test_a_file_that_is_no_program_is_refused(tmp_path):
    (tmp_path / "x.elf").write_bytes(b"\x7fEL, or not")
    with pytest.raises(HubParameterError, match="is no ELF file"):
        FirmwareMachine(tmp_path / "x.elf")


def test_a_microcontrollers_firmware_without_qemu_is_refused_with_the_package(tmp_path, monkeypatch):
    (tmp_path / "x.elf").write_bytes(b"\x7fELF" + bytes(14) + b"\x28\x00")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(HubConnectionError, match="install the package qemu-system-arm"):
        FirmwareMachine(tmp_path / "x.elf")


def test_another_program_is_no_firmware():
    with pytest.raises(HubConnectionError, match=r"says no ports.*expected the program beam-firmware"):
        FirmwareMachine(sys.executable)


def test_only_an_emulated_processor_can_be_paced():
    with pytest.raises(HubParameterError, match="runs in real time on this computer"):
        FirmwareMachine(sys.executable, is_paced=True)


def test_the_host_build_runs_until_it_is_switched_off():
    machine = FirmwareMachine(built("beam-firmware"))
    assert machine.is_running
    machine.close()
    assert not machine.is_running
