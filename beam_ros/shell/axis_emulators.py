"""The emulated controllers in one table: what ``firmware_emulator`` runs for each value of ``axis.kind``."""

from __future__ import annotations

import dataclasses
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from beam_ros.arrays import StampArray
from beam_ros.bags.batches import decode_trajectory
from beam_ros.bags.errors import MessageDecodeError
from beam_ros.errors import UsageError
from beam_ros.hub.emulated.controller import EmulatedController, Firmware, FirmwareMaker
from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.injected_faults import InjectedFault
from beam_ros.hub.emulated.line_board import COUNT, LineBoard
from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import ServoAxis, servo_parameters
from beam_ros.hub.emulated.trajectory_controller import EmulatedTrajectoryController, Waypoints
from beam_ros.hub.errors import HubParameterError
from beam_ros.hub.firmware.built_firmware import BuiltFirmware
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.hub.simulated.plant import Plant
from beam_ros.interfaces.graph import JOINT_STATE, JOINT_TRAJECTORY
from beam_ros.messages.stamps import ros_time
from beam_ros.rig.rig import Rig
from beam_ros.shell.fault_requests import FaultyAxis
from beam_ros.shell.node import RigNode
from beam_ros.shell.trajectory_topics import CONTROLLER_QOS, OwnThread

PYTHON = "python"
"""The word of ``emulator.firmware`` for the suite's own emulator of one."""
_HEADROOM = 2.0
"""By how much the device could do more than the rig file allows: limits that are not handed over would show."""

_TURN_S = 1e-4
"""How long one thread of the interpreter keeps another one waiting, with a built firmware [s]."""

_POWER_ON_NS = 123_456_000_000
"""What the device's clock reads at power-on: an epoch that nobody could mistake for the host's."""


class EmulatedAxis(FaultyAxis, Protocol):
    """A controller with the beam on its hub."""

    @property
    def port(self) -> str:
        """Where it is reached: a pseudo-terminal or topics."""

    @property
    def reached_ns(self) -> int:
        """The newest stamp [ns, UNIX] that ``snapshots`` can show."""

    def snapshots(self, stamps_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants up to ``reached_ns``."""

    def take_notes(self) -> list[str]:
        """Return what went wrong on request since the last call, for the log."""

    @property
    def trouble(self) -> str:
        """Why the controller goes on no more; empty while it does."""

    def close(self) -> None:
        """Switch it off."""


def _device(rig: Rig) -> SimulatedDevice:
    device = rig.simulated_device(rig.emulator.clock_drift_ppm, _POWER_ON_NS)
    return dataclasses.replace(device, buffer_samples=rig.emulator.buffer)


def _beam(node: RigNode) -> EmulatedAxis:
    rig = node.rig
    widest = rig.axis_parameters().widened(_HEADROOM)
    built = rig.emulator.firmware
    if built == PYTHON:
        return _on_port(rig, widest, rig.simulated_plant(rig.beam_model(), rig.emulator.clock_drift_ppm))
    # In every tick it waits for the plant's thread, which would else wait 5 ms for the thread that draws frames.
    sys.setswitchinterval(_TURN_S)
    # A built firmware has the clock of what it runs on.
    plant = rig.simulated_plant(rig.beam_model(), 0.0)

    def boot(device: SimulatedDevice, boot_id: int) -> BuiltFirmware:
        return BuiltFirmware(built, widest, plant, device, n_starts=boot_id)

    return _on_port(rig, widest, plant, boot, rig.simulated_device(0.0, 0))


def _servo_plant(rig: Rig, clock_drift_ppm: float) -> Plant:
    period_ns = servo_parameters(rig.axis_parameters()).period_ns
    return rig.simulated_plant(rig.beam_model(), clock_drift_ppm, period_ns)


def _on_port(
    rig: Rig,
    parameters: AxisParameters,
    plant: Plant,
    boot: FirmwareMaker | None = None,
    device: SimulatedDevice | None = None,
) -> EmulatedAxis:
    return EmulatedController(
        parameters,
        plant,
        device or _device(rig),
        link=rig.emulator.port_link or None,
        line_baud=rig.emulator.line_baud,
        fifo_bytes=rig.emulator.fifo,
        boot=boot,
    )


def _drive(make: type[EmulatedOdrive] | type[EmulatedDynamixel]) -> Callable[[RigNode], EmulatedAxis]:
    """Return what makes a drive that counts turns, on a port."""

    def emulated(node: RigNode) -> EmulatedAxis:
        rig = node.rig
        parameters, plant = rig.axis_parameters(), _servo_plant(rig, rig.emulator.clock_drift_ppm)
        per_turn = rig.axis.metres_per_unit

        def boot(device: SimulatedDevice, _boot_id: int) -> Firmware:
            return make(ServoAxis(parameters, plant, device), metres_per_turn=per_turn)

        return _on_port(rig, parameters, plant, boot)

    return emulated


def _csv(node: RigNode) -> EmulatedAxis:
    rig = node.rig
    parameters, plant = rig.axis_parameters(), _servo_plant(rig, rig.emulator.clock_drift_ppm)
    if rig.axis.metres_per_unit != COUNT:
        raise UsageError(
            f"axis.metres_per_unit is {rig.axis.metres_per_unit:g}: the emulated board prints {COUNT:g} m for one "
            f"count; set axis.metres_per_unit to {COUNT:g}"
        )
    return _on_port(rig, parameters, plant, lambda device, _boot_id: LineBoard(parameters, plant, device))


class _ControllerTopics:
    """An emulated JointTrajectoryController on the graph, with its joint_state_broadcaster."""

    def __init__(self, node: RigNode) -> None:
        rig = node.rig
        self._types = node.types
        self._own = OwnThread("emulated_controller_manager", node.context)
        own = self._own.node
        self._joint = rig.trajectory.joint
        # Its own thread leads it, the node's thread films it.
        self._lock = threading.Lock()
        self._cycle_ns = round(1e9 / rig.emulator.controller_rate)
        self._controller = EmulatedTrajectoryController(
            ServoAxis(
                rig.axis_parameters(), _servo_plant(rig, 0.0), SimulatedDevice(clock_start_ns=time.time_ns())
            ),
            metres_per_unit=rig.axis.metres_per_unit,
        )
        topic = f"{rig.trajectory.controller}/joint_trajectory"
        self.port = topic
        self._state_class = node.types.message_class(JOINT_STATE)
        self._states = own.create_publisher(self._state_class, rig.trajectory.joint_states, CONTROLLER_QOS)
        trajectory_class = node.types.message_class(JOINT_TRAJECTORY)
        own.create_subscription(trajectory_class, topic, self._on_trajectory, CONTROLLER_QOS, raw=True)
        self._next_ns = self._controller.reached_ns + self._cycle_ns
        own.create_timer(1.0 / rig.emulator.controller_rate, self._catch_up)
        self._own.start()

    @property
    def elapsed(self) -> float:
        return 0.0

    def bring_about(self, faults: Sequence[InjectedFault]) -> None:
        """Leave it: none passes the check."""

    def check_faults(self, faults: Sequence[InjectedFault]) -> None:
        if faults:
            raise HubParameterError(
                "faults on request: expected an axis.kind with a serial line (beam, odrive, dynamixel, csv), because "
                "this one has topics alone; leave faults.schedule empty"
            )

    def take_notes(self) -> list[str]:
        return []

    @property
    def trouble(self) -> str:
        return ""

    @property
    def reached_ns(self) -> int:
        return self._controller.reached_ns

    def snapshots(self, stamps_ns: Sequence[int] | StampArray) -> Snapshots:
        with self._lock:
            return self._controller.snapshots(stamps_ns)

    def close(self) -> None:
        self._own.close()

    def _catch_up(self) -> None:
        """Do the cycles that are due: a real controller keeps its times, however busy this computer is."""
        while self._next_ns <= time.time_ns():
            with self._lock:
                position, velocity = self._controller.update(self._next_ns)
            message = self._state_class()
            message.header.stamp = ros_time(self._types, self._next_ns)
            message.name, message.position, message.velocity = [self._joint], [position], [velocity]
            self._states.publish(message)
            self._next_ns += self._cycle_ns

    def _on_trajectory(self, data: bytes) -> None:
        try:
            stamp_ns, times_ns, columns = decode_trajectory(data, self._joint)
        except MessageDecodeError as err:
            self._own.node.get_logger().error(str(err))
            return
        way = Waypoints(
            stamp_ns,
            times_ns,
            columns.get("positions", np.zeros(0)),
            columns.get("velocities"),
            columns.get("accelerations"),
        )
        self._catch_up()
        rejected = len(self._controller.rejected)
        with self._lock:
            self._controller.receive(way, time.time_ns())
        for reason in self._controller.rejected[rejected:]:
            self._own.node.get_logger().error(reason)


AXIS_EMULATORS: dict[str, Callable[[RigNode], EmulatedAxis]] = {
    "beam": _beam,
    "trajectory_controller": _ControllerTopics,
    "odrive": _drive(EmulatedOdrive),
    "dynamixel": _drive(EmulatedDynamixel),
    "csv": _csv,
}
"""What stands in for the controller behind each kind of axis link."""


def emulated_axis(node: RigNode) -> EmulatedAxis:
    """Make the emulated controller that the node's rig asks for.

    Raises
    ------
    UsageError
        There is no emulator of this kind of axis.
    """
    kind = node.rig.axis.kind
    if kind not in AXIS_EMULATORS:
        raise UsageError(
            f"axis.kind is {kind!r}: there is no emulator of it, expected one of {', '.join(AXIS_EMULATORS)}; a "
            "package that adds a link brings its own emulator"
        )
    return AXIS_EMULATORS[kind](node)
