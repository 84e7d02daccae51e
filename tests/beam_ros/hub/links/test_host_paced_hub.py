"""Hubs that the host leads, against emulated drives on real pseudo-terminals: what only real time shows."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from beam_ros.hub.emulated.controller import EmulatedController, Firmware
from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.link_parameters import DriveParameters, DynamixelParameters, OdriveParameters
from beam_ros.hub.links.dynamixel import DynamixelHub
from beam_ros.hub.links.odrive import OdriveHub
from beam_ros.hub.links.polled_hub import PolledHub
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import LiveRig

pytestmark = [pytest.mark.slow, pytest.mark.parametrize("drive", ["dynamixel", "odrive"])]

ROOT = Path(__file__).parents[4]
METRES_PER_TURN = -0.1
DRIVES: dict[str, tuple[type[PolledHub], type[DriveParameters], Callable[..., Firmware]]] = {
    "dynamixel": (DynamixelHub, DynamixelParameters, EmulatedDynamixel),
    "odrive": (OdriveHub, OdriveParameters, EmulatedOdrive),
}


class PortRig(LiveRig):
    """A link, and its drive on a pseudo-terminal."""

    def __init__(self, folder: Path, drive: str, watchdog_s: float) -> None:
        hub, settings, firmware = DRIVES[drive]
        parameters = AxisParameters(watchdog_s=watchdog_s, max_speed=0.12)

        def boot(device: SimulatedDevice, _boot_id: int) -> Firmware:
            self.firmware = firmware(
                ServoAxis(parameters, RigidPlant(0.8, 1e-3), device), metres_per_turn=METRES_PER_TURN
            )
            return self.firmware

        self.drive = drive
        self.emulator = EmulatedController(
            parameters, RigidPlant(0.8, 1e-3), SimulatedDevice(), link=folder / "drive", boot=boot
        )
        link = LinkParameters(self.emulator.port)
        super().__init__(hub(parameters, link, settings(metres_per_turn=METRES_PER_TURN)))

    @property
    def is_on(self) -> bool:
        if self.drive == "odrive":
            return self.firmware._properties["axis0.current_state"] == 8
        return bool(self.firmware.value(64))

    @property
    def is_expired(self) -> bool:
        if self.drive == "odrive":
            return bool(int(self.firmware._properties["axis0.error"]) & 0x800)
        return self.firmware.value(98) == 0xFF

    def close(self) -> None:
        self.hub.close()
        self.emulator.close()


def _wait(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def test_a_hub_on_a_port_is_led_and_closed_with_the_motor_off(drive: str, tmp_path: Path) -> None:
    rig = PortRig(tmp_path, drive, watchdog_s=1.0)
    try:
        rig.until(lambda r: r.status.state == "identified")
        rig.enable()
        rig.run(0.5)
        assert rig.is_on
        rig.hub.close()
        _wait(lambda: not rig.is_on, "the motor is on")
    finally:
        rig.close()


def test_a_killed_host_leaves_the_hub_at_rest(drive: str, tmp_path: Path) -> None:
    rig = PortRig(tmp_path, drive, watchdog_s=0.5)
    rig.hub.close()
    program = """
        import sys, time
        from beam_ros.hub.contract import HostTime
        from beam_ros.hub.parameters import AxisParameters, LinkParameters
        from tests.beam_ros.hub.links.test_host_paced_hub import DRIVES, METRES_PER_TURN
        Hub, Settings, _ = DRIVES[sys.argv[2]]
        parameters = AxisParameters(watchdog_s=0.5, max_speed=0.12, command_mode="velocity")
        hub = Hub(parameters, LinkParameters(sys.argv[1]), Settings(metres_per_turn=METRES_PER_TURN))
        now = lambda: HostTime(time.monotonic_ns(), time.time_ns())
        ways = {"identified": "home", "homed": "enable", "fault": "clear_fault"}
        again_s = 0.0
        while True:
            state = hub.poll(now()).status.state
            if state == "enabled":
                hub.setpoint(now().unix_ns, 0.03, now())
            elif state in ways and time.monotonic() > again_s:
                hub.request(ways[state])
                again_s = time.monotonic() + 0.5
            time.sleep(0.02)
    """
    command = [sys.executable, "-c", textwrap.dedent(program), rig.emulator.port, drive]
    host = subprocess.Popen(command, cwd=ROOT)
    try:
        _wait(lambda: rig.firmware.axis.velocity > 0.02, "the host did not move the hub")
        os.kill(host.pid, signal.SIGKILL)
        host.wait()
        _wait(lambda: rig.is_expired, "the watchdog did not act")
        _wait(lambda: abs(rig.firmware.axis.velocity) < 1e-4, "the hub moves")
    finally:
        host.kill()
        host.wait()
        rig.close()
