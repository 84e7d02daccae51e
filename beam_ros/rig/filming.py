"""The simulated camera: when a frame is due, where beam and markers are then, and what the frame shows.

Works on whatever can say where hub and beam were at exact instants, so that the simulator, the firmware
emulator and the offline simulation film the same plant in the same way.

What the rig file says of an imperfect camera happens here: its clock may run fast, so that its frames come and its
stamps count in a time of its own; stamps jitter; frames get lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beam_model import BeamModel
from beam_ros.arrays import FloatArray
from beam_ros.hub.errors import SnapshotError
from beam_ros.hub.simulated.beam_points import BeamPoints
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.rig.rig import Rig
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.timing import FrameTiming, exposure_weights

_STRIP_POINTS = 25
_MAX_BACKLOG_FRAMES = 50


@dataclass(frozen=True)
class Exposure:
    """What the camera was exposed to in one frame.

    Attributes
    ----------
    stamp_ns : int -- the frame's stamp, in the camera's meaning, with the errors of its clock [ns, UNIX]
    markers : ndarray, shape (n_instants, n_markers) -- displacement u during the exposure [m]
    strip : ndarray, shape (n_strip,) or (n_instants, n_strip) -- displacement of the strip, its mean over the
    exposure
        of its rows or at the exposure's instants [m]
    """

    stamp_ns: int
    markers: FloatArray
    strip: FloatArray


class Film:
    """Frames of one beam at the camera's rate.

    Parameters
    ----------
    rig : Rig
    model : BeamModel
    snapshots : callable -- from stamps [ns, UNIX] to ``Snapshots``
    start_ns : int -- when the first exposure begins [ns, UNIX]
    strip_points : int -- heights at which the strip is known at every instant of the exposure; 0: few, and its mean
    unevenness_s : float -- frames begin by up to so much sooner or later than their turn, and their stamps say so [s]

    Attributes
    ----------
    dropped_frames : int -- lost because the reader fell behind
    frames_left_out : int -- lost because the rig file wants a share of them lost
    """

    def __init__(
        self,
        rig: Rig,
        model: BeamModel,
        snapshots: Callable[[Sequence[int]], Snapshots],
        start_ns: int,
        *,
        strip_points: int = 0,
        unevenness_s: float = 0.0,
    ) -> None:
        self.camera: CameraParameters = rig.camera_parameters()
        self.strip_heights = np.linspace(0.0, rig.beam.length, strip_points or _STRIP_POINTS)
        self._smears_strip = strip_points > 0
        self._unevenness_ns = unevenness_s * 1e9
        self.timing = FrameTiming(self.camera)
        self.dropped_frames = self.frames_left_out = 0
        self._heights = rig.markers.heights
        self._markers = BeamPoints(model, self._heights)
        self._strip = BeamPoints(model, self.strip_heights.tolist())
        self._between_markers = _interpolation(self.strip_heights, np.array(self._heights))
        self._snapshots = snapshots
        self._period_ns = round(1e9 / self.camera.rate_hz)
        self._start_ns = start_ns
        self._next = 0
        simulation = rig.simulation
        self._clock_ppb = round(simulation.camera_clock_ppm * 1000)
        self._offset_ns = round(simulation.stamp_offset * 1e9)
        self._jitter_ns, self._drop_share = simulation.stamp_jitter * 1e9, simulation.frame_drops
        self._accidents = np.random.default_rng([simulation.seed, *b"camera"])

    def due(self, reached_ns: int) -> Iterator[Exposure]:
        """Yield the exposures that have ended by ``reached_ns`` [ns, UNIX] and were not yielded before.

        A camera whose reader falls behind by more than half a second loses frames, as a real one does.
        """
        stamp_ns = self.timing.stamp(self._start_ns)
        elapsed_ns = reached_ns - self.timing.end(stamp_ns)
        finished = (elapsed_ns + elapsed_ns * self._clock_ppb // 1_000_000_000) // self._period_ns
        if finished - self._next > _MAX_BACKLOG_FRAMES:
            self.dropped_frames += finished - self._next
            self._next = finished
        while self._next <= finished:
            camera_ns = self._next * self._period_ns
            self._next += 1
            jitter_ns = self._jitter_ns * self._accidents.standard_normal()
            if self._accidents.random() < self._drop_share:
                self.frames_left_out += 1
                continue
            if self._unevenness_ns:
                camera_ns += round(self._unevenness_ns * self._accidents.uniform(-1.0, 1.0))
            true_ns = camera_ns * 1_000_000_000 // (1_000_000_000 + self._clock_ppb)
            try:
                exposure = self._expose(
                    self.timing.stamp(self._start_ns + true_ns),
                    camera_ns - true_ns + self._offset_ns + round(jitter_ns),
                )
            except SnapshotError:
                # While the frames before were drawn the plant went on, and has forgotten that instant.
                self.dropped_frames += 1
                continue
            yield exposure

    def _expose(self, stamp_ns: int, error_ns: int) -> Exposure:
        """Expose the frame whose right stamp is known, and stamp it with an error."""
        instants = self.timing.exposure_instants(stamp_ns, self._heights)
        n_instants, n_markers = instants.shape
        weights = exposure_weights(n_instants)
        if self.camera.readout_s == 0.0:
            snapshots = self._snapshots(instants[:, 0].tolist())
            markers = self._markers.displacements(snapshots)
            line = self._strip.displacements(snapshots)
            return Exposure(stamp_ns + error_ns, markers, line if self._smears_strip else weights @ line)
        snapshots = self._snapshots(instants.ravel().tolist())
        columns = np.arange(n_markers)
        u = self._markers.displacements(snapshots).reshape(n_instants, n_markers, n_markers)
        # Rows between the markers' are exposed between the markers' times.
        strip = self._strip.displacements(snapshots).reshape(n_instants, n_markers, -1)
        line = np.einsum("km,imk->ik", self._between_markers, strip)
        return Exposure(
            stamp_ns + error_ns, u[:, columns, columns], line if self._smears_strip else weights @ line
        )

    def marker_stamps(self, exposure: Exposure) -> tuple[int, ...]:
        """Return the middle of each marker's exposure [ns, UNIX], shape (n_markers,)."""
        return tuple(
            self.timing.row_middle(exposure.stamp_ns, float(row)) for row in self.camera.rows(self._heights)
        )

    def mean_displacement(self, exposure: Exposure) -> FloatArray:
        """Return the mean of u over each marker's exposure, shape (n_markers,) [m]."""
        return np.asarray(exposure_weights(len(exposure.markers)) @ exposure.markers)


def _interpolation(heights: FloatArray, nodes: FloatArray) -> FloatArray:
    """Weights of values at nodes for piecewise straight lines through them, shape (n_heights, n_nodes)."""
    weights = np.zeros((len(heights), len(nodes)))
    if len(nodes) == 1:
        return weights + 1.0
    lower = np.clip(np.searchsorted(nodes, heights) - 1, 0, len(nodes) - 2)
    share = (heights - nodes[lower]) / (nodes[lower + 1] - nodes[lower])
    every = np.arange(len(heights))
    weights[every, lower], weights[every, lower + 1] = 1.0 - share, share
    return weights
