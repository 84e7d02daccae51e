"""The node ``hub`` without hardware: the Galerkin model of the beam, integrated in real time and filmed."""

from __future__ import annotations

import os
from typing import Any

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from beam_ros import messages
from beam_ros.hub.contract import Hub, HubReport
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.simulated_hub import SimulatedHub
from beam_ros.rig.rig import Rig
from beam_ros.shell.fault_requests import FaultRequests, SimulatedAxisFaults
from beam_ros.shell.hub_topics import HubNode, host_time
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import run_node
from beam_ros.shell.simulated_camera import SimulatedCamera


class Simulator(HubNode):
    """The simulated rig: hub, beam and camera."""

    def __init__(self, **options: Any) -> None:
        self._camera: SimulatedCamera | None = None
        super().__init__("simulator", self._build, **options)
        self._requests = FaultRequests(self, self._faults)
        factor = self.rig.simulation.real_time_factor
        self._simulated_time = self.offer("/clock") if factor != 1.0 else None

    def _build(self, rig: Rig) -> Hub:
        self._model = rig.beam_model()
        parameters = rig.axis_parameters()
        drift_ppm = rig.simulation.hub_clock_ppm
        plant = rig.simulated_plant(self._model, drift_ppm)
        axis = VirtualAxis(parameters, plant, rig.simulated_device(drift_ppm))
        self._faults = SimulatedAxisFaults(axis)
        factor = rig.simulation.real_time_factor
        self._simulated = SimulatedHub(
            axis, real_time_factor=factor, guard=rig.beam_guard(), checks_in_background=True
        )
        return self._simulated

    def publish_report(self, report: HubReport) -> None:
        """Publish the hub's report, and what the camera saw meanwhile."""
        super().publish_report(report)
        for note in self._faults.happen():
            self.get_logger().warning(note)
        reached_ns = self._simulated.reached_ns
        if self._camera is None:
            with_images = self.rig.simulation.images
            self._camera = SimulatedCamera(
                self, self._model, self._simulated.snapshots, reached_ns, with_images=with_images
            )
        self._camera.publish_until(reached_ns)
        if self._simulated_time is not None:
            seconds, nanoseconds = divmod(reached_ns, messages.SECOND_NS)
            self._simulated_time.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))
        self._camera.note_lag(self._simulated.lag_s(host_time()))

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report the hub's health, and how the simulation keeps up."""
        level, sentence, counters = super().health()
        if self._camera is None:
            return level, sentence, counters
        camera_level, camera_sentence, camera_counters = self._camera.health()
        if camera_level != "OK":
            level = camera_level if level == "OK" else level
            sentence = f"{camera_sentence}; {sentence}"
        return level, sentence, {**counters, **camera_counters}


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    widen_shared_memory(os.environ)
    return run_node(Simulator, argv)
