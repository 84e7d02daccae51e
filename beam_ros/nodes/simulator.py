"""The node ``hub`` without hardware: the Galerkin model of the beam, integrated in real time and filmed."""

from __future__ import annotations

import os

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from beam_ros import messages
from beam_ros.hub.contract import Hub, HubReport
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import beam_on_axis
from beam_ros.hub.simulated.simulated_hub import SimulatedHub
from beam_ros.rig.rig import Rig
from beam_ros.shell.hub_topics import HubNode
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import run_node
from beam_ros.shell.simulated_camera import SimulatedCamera


class Simulator(HubNode):
    """The simulated rig: hub, beam and camera."""

    def __init__(self) -> None:
        self._camera: SimulatedCamera | None = None
        super().__init__("simulator", self._build)
        factor = self.rig.simulation.real_time_factor
        self._simulated_time = self.offer("/clock") if factor != 1.0 else None

    def _build(self, rig: Rig) -> Hub:
        self._model = rig.beam_model()
        parameters = rig.axis_parameters()
        plant = beam_on_axis(self._model, parameters, rig.nonlinear_terms())
        factor = rig.simulation.real_time_factor
        self._simulated = SimulatedHub(
            VirtualAxis(parameters, plant),
            real_time_factor=factor,
            guard=rig.beam_guard(),
            checks_in_background=True,
        )
        return self._simulated

    def publish_report(self, report: HubReport) -> None:
        """Publish the hub's report, and what the camera saw meanwhile."""
        super().publish_report(report)
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

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report the hub's health and the camera's lost frames."""
        level, sentence, counters = super().health()
        if self._camera is not None:
            counters["frames"] = self._camera.published
            counters["dropped frames"] = self._camera.dropped_frames
        return level, sentence, counters


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    widen_shared_memory(os.environ)
    return run_node(Simulator, argv)
