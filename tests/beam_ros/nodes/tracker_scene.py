"""Trackers as processes, a camera in the test's hands, and what comes back."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.messages import Displacement, Health, MarkerCloud
from beam_ros.rig.rig import Rig
from tests.graph import Graph
from tests.real_processes import Executables

PERIOD_NS = 10_000_000
RELIABLE = QualityOfService(30)


class Seen:
    """What one tracker has published."""

    def __init__(self, graph: Graph, namespace: str) -> None:
        self.displacements: list[Displacement] = []
        self.clouds: list[MarkerCloud] = []
        self.health: list[Health] = []
        graph.listen(
            "beam/displacement",
            lambda m: self.displacements.append(messages.read_displacement(m)),
            namespace=namespace,
        )
        graph.listen(
            "beam/markers", lambda m: self.clouds.append(messages.read_marker_cloud(m)), namespace=namespace
        )
        own = f"{namespace.strip('/')}/tracker: vision_tracker".lstrip("/")
        graph.listen(
            "/diagnostics",
            lambda m: self.health.extend(h for h in messages.read_diagnostics(m) if h.name == own),
        )

    def clear(self) -> None:
        """Forget what came so far."""
        self.displacements.clear()
        self.clouds.clear()
        self.health.clear()


class TrackerScene:
    """Trackers in namespaces and the test's camera."""

    def __init__(self, graph: Graph, executables: Executables, folder: Path) -> None:
        from beam_ros.vision.rendering.frames import SceneRenderer

        self.graph = graph
        self.folder = folder
        self.processes: dict[str, Any] = {}
        self.seen: dict[str, Seen] = {}
        self._executables = executables
        self._cameras: dict[str, Any] = {}
        self._stamp_ns = 0
        self.rig = Rig.from_file()
        self.heights = np.array(self.rig.markers.heights)
        self._renderer = SceneRenderer(self.rig.camera_parameters(), self.heights)
        self._rng = np.random.default_rng(0)

    def start(self, namespace: str, *, program: Sequence[str] = (), **parameters: object) -> None:
        """Start a tracker, or a program in its place; names of parameters with a double underscore for the dot."""
        words = [f"{name.replace('__', '.')}:={value}" for name, value in parameters.items()]
        self.processes[namespace] = self._executables.start(
            "vision_tracker",
            "--ros-args",
            "-r",
            f"__ns:=/{namespace}",
            *[word for assignment in words for word in ("-p", assignment)],
            timeout_s=120.0,
            program=program,
        )
        self.seen[namespace] = Seen(self.graph, f"/{namespace}")

    def camera(
        self, namespace: str, qos: QualityOfService = RELIABLE, topic: str = "camera/image_raw"
    ) -> Any:
        """Make the camera of a namespace, matched with its tracker."""
        if namespace not in self._cameras:
            publisher = self.graph.publisher(topic, qos, f"/{namespace}")
            self._cameras[namespace] = publisher
            self.graph.wait(
                lambda: publisher.get_subscription_count() > 0, "the tracker's subscription", 20.0
            )
        return self._cameras[namespace]

    def end_camera(self, namespace: str) -> None:
        """Take the camera of a namespace off the graph."""
        self.graph.node.destroy_publisher(self._cameras.pop(namespace))

    def stamp(self) -> int:
        """Stamp of the next frame: now, a period after the last one at least [ns]."""
        self._stamp_ns = max(self._stamp_ns + PERIOD_NS, time.time_ns())
        time.sleep(max(0.0, (self._stamp_ns - time.time_ns()) * 1e-9))
        return self._stamp_ns

    def pixels(self, x: float | Sequence[float]) -> Any:
        """Render a frame with all markers at x, or each at its own [m]."""
        return self._renderer.render(np.broadcast_to(np.asarray(x, dtype=float), (3,)), self._rng)

    def image(self, pixels: Any, **changes: object) -> Any:
        """Build a message, with fields set otherwise."""
        message = messages.image(self.graph.types, self.stamp(), pixels)
        for name, value in changes.items():
            setattr(message, name, value)
        return message

    def answer(self, namespace: str, message: Any) -> Displacement:
        """Publish a frame and wait for its displacement."""
        seen = self.seen[namespace].displacements
        count = len(seen)
        self.camera(namespace).publish(message)
        self.graph.wait(lambda: len(seen) > count, "an answer to the frame")
        return seen[-1]

    def until_quiet(self, namespace: str) -> None:
        """Wait until nothing has come for half a second: frames of a camera that is gone are still answered."""
        seen, count = self.seen[namespace].displacements, -1
        while count != len(seen):
            count, end = len(seen), time.monotonic() + 0.5
            self.graph.wait(lambda end=end: time.monotonic() > end, "half a second", 20.0)

    def complaint(self, namespace: str, words: str, level: str = "ERROR") -> Health:
        """Wait for diagnostics of a level that say something."""
        health = self.seen[namespace].health
        self.graph.wait(
            lambda: any(words in h.message and h.level == level for h in health),
            f"{level} {words!r} in {[(h.level, h.message) for h in health[-3:]]}",
        )
        return next(h for h in reversed(health) if words in h.message)
