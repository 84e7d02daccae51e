"""The deflected beam as a line for people to look at: from the markers' displacements, as far as these tell.

    u(z) = alpha + sum_i phi_i(z) q_i

with the mode shapes of the rig's model. Every coordinate q_i has a prior of zero: the first mode may deflect the tip
as far as the rig allows, the others as far as the same energy takes them, which falls with their frequency. The hub's
position is what the markers say. The line ends where the fit no longer knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.arrays import FloatArray
from beam_ros.interfaces import graph
from beam_ros.messages import MessageTypes
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import Displacement
from beam_ros.vision.measurement.beam_shape import BeamShapeFitter

_POINTS = 41
_KNOWN_SHARE = 0.1
"""The line is drawn where its standard deviation is below this share of the largest tip deflection."""
_LINE_WIDTH_M = 0.002
_SEEN_RGB = (0.2, 0.9, 0.3)
_INCOMPLETE_RGB = (1.0, 0.7, 0.1)
_LINE_STRIP, _ADD, _DELETE = 4, 0, 2


@dataclass(frozen=True)
class BeamLine:
    """The beam in one frame.

    Attributes
    ----------
    heights_m : ndarray, shape (n_points,) -- above the clamp [m]; empty where the markers tell nothing
    x_m, sigma_m : ndarray, shape (n_points,) -- absolute displacement and its standard deviation [m]
    is_complete : bool -- every marker was seen
    """

    heights_m: FloatArray
    x_m: FloatArray
    sigma_m: FloatArray
    is_complete: bool


class BeamLineFitter:
    """Fits the line to the markers of one rig.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        model = rig.beam_model()
        length, allowed = rig.beam.length, rig.hub.max_tip_deflection
        frequencies = model.natural_frequencies
        tip = np.abs(model.shape([length])[0])
        self._fitter = BeamShapeFitter(
            model.shape(rig.markers.heights), allowed / tip * frequencies[0] / frequencies
        )
        self._heights = np.linspace(0.0, length, _POINTS)
        self._shapes = model.shape(self._heights)
        self._known_m = _KNOWN_SHARE * allowed

    def fit(self, displacement: Displacement) -> BeamLine:
        """Fit the line to one frame's displacements; NaN where a marker was not seen."""
        seen = np.isfinite(displacement.x_m)
        shape = self._fitter.fit(displacement.x_m, displacement.sigma_m)
        x, sigma = shape.displacement(self._shapes)
        unknown = np.flatnonzero(sigma > self._known_m)
        end = int(unknown[0]) if unknown.size else _POINTS
        return BeamLine(self._heights[:end], x[:end], sigma[:end], bool(seen.all()))


def line_marker(types: MessageTypes, stamp_ns: int, line: BeamLine) -> Any:
    """Build the visualization_msgs/Marker of ``beam/shape``: a line strip in ``rig``, or its removal."""
    colour = _SEEN_RGB if line.is_complete else _INCOMPLETE_RGB
    r, g, b = colour
    return types.make(
        "visualization_msgs/msg/Marker",
        header=messages.header(types, stamp_ns, graph.RIG_FRAME),
        ns="beam",
        id=0,
        type=_LINE_STRIP,
        action=_ADD if len(line.x_m) > 1 else _DELETE,
        pose=types.make(
            "geometry_msgs/msg/Pose",
            position=types.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=types.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        ),
        scale=types.make("geometry_msgs/msg/Vector3", x=_LINE_WIDTH_M, y=0.0, z=0.0),
        color=types.make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=1.0),
        lifetime=types.make("builtin_interfaces/msg/Duration", sec=1, nanosec=0),
        frame_locked=False,
        points=[
            types.make("geometry_msgs/msg/Point", x=float(x), y=0.0, z=float(z))
            for x, z in zip(line.x_m, line.heights_m, strict=True)
        ],
        colors=[],
        texture_resource="",
        texture=types.make(
            "sensor_msgs/msg/CompressedImage",
            header=messages.header(types, stamp_ns, ""),
            format="",
            data=types.octets(b""),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=types.make("visualization_msgs/msg/MeshFile", filename="", data=types.octets(b"")),
        mesh_use_embedded_materials=False,
    )
