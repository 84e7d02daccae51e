"""A camera of a laboratory's own: a beam that hangs 1 mm to the side, a frame every 20 ms, stamped by its start."""

import time

import numpy as np

from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from beam_ros.vision.rendering.frames import SceneRenderer

PERIOD_NS = 20_000_000


class ToyCamera(CameraSource):
    def __init__(self, rig):
        self.name = "toy"
        heights = rig.markers.heights
        renderer = SceneRenderer(rig.camera_parameters(), heights)
        self._image = renderer.render(np.full(len(heights), 0.001), np.random.default_rng(1))

    def open(self):
        self.remarks = ("the toy is not a real camera",)
        self._stamp_ns = time.time_ns() // PERIOD_NS * PERIOD_NS

    def read(self):
        self._stamp_ns += PERIOD_NS
        time.sleep(max(0, self._stamp_ns - time.time_ns()) * 1e-9)
        return CapturedFrame(self._stamp_ns, self._image, "start")

    def close(self): ...
