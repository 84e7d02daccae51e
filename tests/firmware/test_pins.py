"""The STM32F405's program with pins, in QEMU: what it writes to registers that QEMU only notes down."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.firmware.builds import built

pytestmark = pytest.mark.slow

FLASH = 0x08000000
MODE, PULL, SET_RESET = 0x00, 0x0C, 0x18
ENABLE_LOW = 1 << 17
"""What resets PB1 by the register SET_RESET of its port."""
UNDEFINED = bytes.fromhex("00de")
"""An instruction that there is not, in the order of memory."""
START_WATCHDOG = 0xCCCC


@dataclass(frozen=True)
class Access:
    device: str
    offset: int
    value: int | None
    """What was written; None where it was read."""


def accesses(program: Path, folder: Path, enough: str) -> list[Access]:
    """Run a program until its log of unknown registers has some words, and a little longer; return the log."""
    log = folder / "log"
    words = ["qemu-system-arm", "-machine", "netduinoplus2", "-kernel", str(program), "-nodefaults"]
    words += ["-display", "none", "-monitor", "none", "-serial", "null", "-d", "unimp", "-D", str(log)]
    with subprocess.Popen(words) as process:
        try:
            deadline = time.monotonic() + 30
            while time.monotonic() < deadline and not (log.exists() and re.search(enough, log.read_text())):
                time.sleep(0.05)
            time.sleep(0.2)
        finally:
            process.terminate()
    line = r"(\w+): unimplemented device (?:read|write) +\(size 4, offset (\w+)(?:, value (\w+))?\)"
    found = re.findall(line, log.read_text())
    return [Access(name, int(offset, 16), int(value, 16) if value else None) for name, offset, value in found]


def symbols(program: Path) -> dict[str, int]:
    if shutil.which("arm-none-eabi-nm") is None:
        pytest.skip("no arm-none-eabi-nm on this machine")
    listed = subprocess.run(
        ["arm-none-eabi-nm", str(program)], capture_output=True, text=True, timeout=20, check=True
    ).stdout
    return {name: int(address, 16) for address, name in re.findall(r"^(\w+) \w (\w+)$", listed, re.M)}


def flash_offset(image: bytes) -> int:
    """Where the flash begins in an ELF file: its first segment."""
    (table,) = struct.unpack_from("<I", image, 28)
    _, offset, address = struct.unpack_from("<3I", image, table)
    assert address == FLASH
    return int(offset)


def written(log: list[Access], device: str, offset: int) -> list[int]:
    return [a.value for a in log if (a.device, a.offset) == (device, offset) and a.value is not None]


@pytest.fixture
def program() -> Path:
    return built("stm32f405-pins.elf")


def test_the_drive_is_off_before_anything_else_and_the_watchdog_runs_before_the_clocks(program, tmp_path):
    log = accesses(program, tmp_path, "GPIOB.*offset 0x010")
    on_port_b = [access for access in log if access.device == "GPIOB"]
    assert on_port_b[0] == Access("GPIOB", SET_RESET, ENABLE_LOW)
    assert {access.device for access in log[: log.index(on_port_b[0])]} == {"RCC"}
    assert on_port_b[2] == Access("GPIOB", MODE, 1 << 2)
    first_look_at_clocks = log.index(Access("RCC", 0x00, None))
    assert [a.value for a in log].index(START_WATCHDOG) < first_look_at_clocks
    # A supply that falls below 2.9 V ends in a fault.
    assert written(log, "PWR", 0x00) == [0xF0]
    # Home switch and encoder, end switches and alarm: pulled up, so that a cut wire reads as a hit.
    assert written(log, "GPIOA", PULL) == [1 << 0, 1 << 2, 1 << 4]
    assert written(log, "GPIOB", PULL) == [1 << 8, 1 << 10, 1 << 12]


def test_a_processor_that_loses_its_way_takes_the_drives_current_away(program, tmp_path):
    image = bytearray(program.read_bytes())
    tick = (symbols(program)["on_system_tick"] & ~1) - FLASH + flash_offset(image)
    image[tick : tick + 2] = UNDEFINED
    broken = tmp_path / "broken.elf"
    broken.write_bytes(image)
    log = accesses(broken, tmp_path, "TIM1")
    begun = next(k for k, access in enumerate(log) if access.device == "GPIOB")
    first = log[: log[begun:].index(Access("GPIOB", MODE, 1 << 2)) + begun + 1]
    # The last that it does is what it did first; before it there was no tick that would have read the switches.
    assert any(log[k : k + len(first)] == first for k in range(len(first), len(log)))
    assert written(log, "GPIOB", SET_RESET) == [ENABLE_LOW, ENABLE_LOW]


def test_every_vector_that_is_not_the_programs_own_is_the_fault(program):
    image, at = program.read_bytes(), symbols(program)
    vectors = struct.unpack_from("<98I", image, flash_offset(image))
    own = {1: "reset", 15: "on_system_tick", 16 + 37: "on_usart1", 16 + 38: "on_usart2"}
    for number, handler in enumerate(vectors[1:], start=1):
        assert handler & ~1 == at[own.get(number, "fault")], number
