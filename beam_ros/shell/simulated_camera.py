"""A simulated camera on the graph, for the node that holds the plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np

from beam_model import BeamModel
from beam_ros import messages
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.rig.filming import Exposure, Film
from beam_ros.shell.node import RigNode
from beam_ros.vision.camera.images import as_jpeg
from beam_ros.vision.rendering.frames import SceneRenderer

TURN_S = 0.04
"""Frames of so long a time are drawn before the node turns to what else waits [s]: a node that is behind catches up
in many turns, and one that is polled every 10 ms still does."""
BEHIND_S = 0.02
"""A turn that took longer than two polls of the hub [s]: the film gives way, for what it lacks is only frames."""
MAX_LAG_S = 0.1
"""So far a simulation may be behind real time before it says so [s]: ten polls of the hub."""


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
        self._preset = rig.simulation.preset
        self._published = 0
        self._frames_per_turn = math.ceil(TURN_S * self._film.camera.rate_hz)
        self._lag_s = self._worst_lag_s = 0.0
        if with_images:
            self._renderer = SceneRenderer(
                self._film.camera,
                rig.markers.heights,
                strip_heights=self._film.strip_heights,
                seed=seed,
                full_well=rig.simulation.full_well,
            )
            self._images = node.offer("camera/image_raw")
            self._compressed = node.offer("camera/image_raw/compressed")
            self._infos = node.offer("camera/camera_info")
            self._show = self._show_frame
        else:
            self._displacements = node.offer("beam/displacement")
            self._show = self._show_displacement

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report what is simulated, and how that keeps up with real time since the start and the last report."""
        film, lag_s = self._film, self._worst_lag_s
        self._worst_lag_s = 0.0
        troubles = []
        if film.dropped_frames:
            # Recorded with the bag, so that whoever reads it later knows.
            troubles.append(f"{film.dropped_frames} frames were lost because this computer fell behind")
        if lag_s > MAX_LAG_S:
            troubles.append(f"{lag_s:.2f} s behind real time")
        counters: dict[str, object] = {
            "hardware": self._preset,
            "frames": self._published,
            "dropped frames": film.dropped_frames,
            "frames left out": film.frames_left_out,
            "lag": round(lag_s, 3),
        }
        if troubles:
            return "WARN", f"the simulation falls behind: {', '.join(troubles)}", counters
        return "OK", "", counters

    def publish_until(self, reached_ns: int) -> None:
        """Publish exposures that have ended by ``reached_ns`` [ns, UNIX]; commands wait for a few, not for all."""
        is_behind = self._lag_s > BEHIND_S
        n_frames = max(1, self._frames_per_turn // 4) if is_behind else self._frames_per_turn
        for exposure in islice(self._film.due(reached_ns), n_frames):
            self._show(exposure)
            self._published += 1

    def note_lag(self, lag_s: float) -> None:
        """Note how far the plant now is behind real time [s]."""
        self._lag_s = lag_s
        self._worst_lag_s = max(self._worst_lag_s, lag_s)

    def _show_frame(self, exposure: Exposure) -> None:
        camera = self._film.camera
        frame = self._renderer.render(exposure.markers, self._rng, exposure.strip)
        self._images.publish(messages.image(self._types, exposure.stamp_ns, frame))
        if self._compressed.get_subscription_count():
            self._compressed.publish(
                messages.compressed_image(self._types, exposure.stamp_ns, as_jpeg(frame))
            )
        self._infos.publish(messages.camera_info(self._types, exposure.stamp_ns, camera.width, camera.height))

    def _show_displacement(self, exposure: Exposure) -> None:
        u = self._film.mean_displacement(exposure)
        u = u + self._noise * self._rng.standard_normal(len(u))
        stamps = self._film.marker_stamps(exposure)
        for _, message in messages.displacement_messages(self._types, self._names, stamps, u):
            self._displacements.publish(message)
