"""The node ``firmware_emulator``: a motion controller of the kind ``axis.kind``, with the beam that it moves.

Hub data leaves it over a pseudo-terminal, or as a JointTrajectoryController's joint states; else it is on the graph
only as the camera that films its beam.
"""

from __future__ import annotations

import os
import time
from typing import Any

from beam_ros.shell.axis_emulators import emulated_axis
from beam_ros.shell.fault_requests import FaultRequests
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import RigNode, run_node
from beam_ros.shell.simulated_camera import SimulatedCamera

_FILM_S = 0.005


class FirmwareEmulator(RigNode):
    """The controller, its beam and the camera."""

    def __init__(self, **options: Any) -> None:
        super().__init__("firmware_emulator", **options)
        self._controller = emulated_axis(self)
        self._requests = FaultRequests(self, self._controller)
        self._camera = SimulatedCamera(
            self,
            self.rig.beam_model(),
            self._controller.snapshots,
            self._controller.reached_ns,
            with_images=True,
        )
        self.get_logger().info(f"motion controller on {self._controller.port}")
        self.create_timer(_FILM_S, self._film)

    def _film(self) -> None:
        for note in self._controller.take_notes():
            self.get_logger().warning(note)
        self._camera.publish_until(self._controller.reached_ns)
        self._camera.note_lag((time.time_ns() - self._controller.reached_ns) * 1e-9)

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report where the controller is and how the camera keeps up."""
        level, sentence, counters = self._camera.health()
        if self._controller.trouble:
            return "ERROR", self._controller.trouble, counters
        place = f"controller on {self._controller.port}"
        return level, f"{sentence}; {place}" if sentence else place, counters

    def close(self) -> None:
        """Switch the controller off."""
        self._controller.close()


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    widen_shared_memory(os.environ)
    return run_node(FirmwareEmulator, argv)
