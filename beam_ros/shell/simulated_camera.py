"""A simulated camera on the graph, for the node that holds the plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from beam_model import BeamModel
from beam_ros import messages
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.rig.filming import Exposure, Film
from beam_ros.shell.node import RigNode
from beam_ros.vision.rendering.frames import SceneRenderer


class SimulatedCamera:
    """Publishes what a simulated camera sees: frames, or displacements where no images are wanted.

    Parameters
    ----------
    node : RigNode -- the node that offers the topics
    model : BeamModel
    snapshots : callable -- from stamps [ns, UNIX] to ``Snapshots``
    start_ns : int -- when the first exposure begins [ns, UNIX]
    with_images : bool -- frames; else ``beam/displacement`` directly
    """

    def __init__(
        self,
        node: RigNode,
        model: BeamModel,
        snapshots: Callable[[Sequence[int]], Snapshots],
        start_ns: int,
        *,
        with_images: bool,
    ) -> None:
        rig = node.rig
        self._types = node.types
        self._film = Film(rig, model, snapshots, start_ns)
        seed = rig.simulation.seed
        self._rng = np.random.default_rng(seed)
        self._names = rig.markers.names
        self._noise = rig.simulation.displacement_noise
        self.published = 0
        if with_images:
            self._renderer = SceneRenderer(
                self._film.camera,
                rig.markers.heights,
                strip_heights=self._film.strip_heights,
                seed=seed,
            )
            self._images = node.offer("camera/image_raw")
            self._infos = node.offer("camera/camera_info")
            self._show = self._show_frame
        else:
            self._displacements = node.offer("beam/displacement")
            self._show = self._show_displacement

    @property
    def dropped_frames(self) -> int:
        """Frames that were lost because this process fell behind."""
        return self._film.dropped_frames

    def publish_until(self, reached_ns: int) -> None:
        """Publish every exposure that has ended by ``reached_ns`` [ns, UNIX]."""
        for exposure in self._film.due(reached_ns):
            self._show(exposure)
            self.published += 1

    def _show_frame(self, exposure: Exposure) -> None:
        camera = self._film.camera
        frame = self._renderer.render(exposure.markers, self._rng, exposure.strip)
        self._images.publish(messages.image(self._types, exposure.stamp_ns, frame))
        self._infos.publish(messages.camera_info(self._types, exposure.stamp_ns, camera.width, camera.height))

    def _show_displacement(self, exposure: Exposure) -> None:
        u = self._film.mean_displacement(exposure)
        u = u + self._noise * self._rng.standard_normal(len(u))
        stamps = self._film.marker_stamps(exposure)
        for _, message in messages.displacement_messages(self._types, self._names, stamps, u):
            self._displacements.publish(message)
