"""The markers in one frame, ``beam/markers``, and the line that they tell of the beam, ``beam/shape``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beam_ros.arrays import FloatArray, StructuredArray
from beam_ros.interfaces import graph
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import header, stamp_ns

MARKER_DTYPE = np.dtype(
    {
        "names": ["x", "y", "z", "u", "v", "x_m", "sigma_m", "id", "valid"],
        "formats": ["<f4", "<f4", "<f4", "<f8", "<f8", "<f8", "<f8", "<u4", "u1"],
        "offsets": [0, 4, 8, 16, 24, 32, 40, 48, 52],
        "itemsize": 56,
    }
)
"""A row of ``beam/markers``: x, y, z [m] in ``rig``, u, v [px], displacement and its deviation [m], id, valid."""

_LINE_WIDTH_M = 0.002
_SEEN_RGB = (0.2, 0.9, 0.3)
_INCOMPLETE_RGB = (1.0, 0.7, 0.1)
_LINE_STRIP, _ADD, _DELETE = 4, 0, 2

_POINT_FIELD_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_POINT_FIELD_TYPES = {code: kind for kind, code in _POINT_FIELD_CODES.items()}


@dataclass(frozen=True)
class MarkerCloud:
    """What ``beam/markers`` says: the frame's stamp [ns, UNIX] and a row of ``MARKER_DTYPE`` per marker."""

    stamp_ns: int
    rows: StructuredArray


def marker_cloud(types: MessageTypes, cloud: MarkerCloud) -> Any:
    """Build the PointCloud2 of ``beam/markers`` from rows of ``MARKER_DTYPE``."""
    fields = [
        types.make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=MARKER_DTYPE.fields[name][1],
            datatype=_POINT_FIELD_CODES[MARKER_DTYPE.fields[name][0].str[1:]],
            count=1,
        )
        for name in MARKER_DTYPE.names or ()
        if MARKER_DTYPE.fields is not None
    ]
    # Padding between the fields is zeroed, so that equal clouds are equal bytes.
    rows = np.zeros(len(cloud.rows), dtype=MARKER_DTYPE)
    for name in MARKER_DTYPE.names or ():
        rows[name] = cloud.rows[name]
    return types.make(
        "sensor_msgs/msg/PointCloud2",
        header=header(types, cloud.stamp_ns, graph.RIG_FRAME),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=MARKER_DTYPE.itemsize,
        row_step=MARKER_DTYPE.itemsize * len(rows),
        data=types.octets(rows.tobytes()),
        is_dense=bool(np.all(np.isfinite(rows["x"]))),
    )


def marker_cloud_from_columns(
    types: MessageTypes,
    stamp_ns: int,
    heights_m: ArrayLike,
    x_m: FloatArray,
    sigma_m: FloatArray,
    u_px: FloatArray,
    v_px: FloatArray,
) -> Any:
    """Build the PointCloud2 of ``beam/markers``.

    Parameters
    ----------
    types : MessageTypes
    stamp_ns : int -- of the frame [ns, UNIX]
    heights_m : array_like, shape (m,) -- above the clamp [m]
    x_m, sigma_m : ndarray, shape (m,) -- displacement and its standard deviation [m]
    u_px, v_px : ndarray, shape (m,) -- position in the image as it is; NaN where not seen [px]
    """
    rows = np.zeros(len(u_px), dtype=MARKER_DTYPE)
    rows["x"], rows["z"] = x_m, heights_m
    rows["x_m"], rows["sigma_m"] = x_m, sigma_m
    rows["u"], rows["v"] = u_px, v_px
    rows["id"] = np.arange(len(u_px))
    rows["valid"] = np.isfinite(u_px)
    return marker_cloud(types, MarkerCloud(stamp_ns, rows))


def read_marker_cloud(message: Any) -> MarkerCloud:
    """Read a message of ``beam/markers`` by the names of its fields, in whatever order and type they are.

    Raises
    ------
    MessageContentError
        A field is missing, or the data are shorter than they should be.
    """
    order = ">" if message.is_bigendian else "<"
    kinds = {f.name: (order + _POINT_FIELD_TYPES.get(f.datatype, "u1"), f.offset) for f in message.fields}
    names = list(MARKER_DTYPE.names or ())
    missing = [name for name in names if name not in kinds]
    count = int(message.width) * int(message.height)
    data = bytes(message.data)
    if missing or len(data) < count * message.point_step:
        raise MessageContentError(
            f"marker cloud with the fields {', '.join(kinds)} and {len(data)} bytes for {count} points: "
            f"expected {', '.join(names)} and {message.point_step} bytes for each"
        )
    try:
        wire = np.dtype(
            {
                "names": names,
                "formats": [kinds[name][0] for name in names],
                "offsets": [kinds[name][1] for name in names],
                "itemsize": int(message.point_step),
            }
        )
    except ValueError as err:
        raise MessageContentError(
            f"marker cloud whose fields do not fit into {message.point_step} bytes: {err}"
        ) from err
    table = np.frombuffer(data, dtype=wire, count=count)
    rows = np.zeros(count, dtype=MARKER_DTYPE)
    for name in names:
        rows[name] = table[name]
    return MarkerCloud(stamp_ns(message), rows)


def beam_shape(
    types: MessageTypes, stamp_ns: int, heights_m: FloatArray, x_m: FloatArray, *, is_complete: bool
) -> Any:
    """Build the visualization_msgs/Marker of ``beam/shape``: a line strip in ``rig``, or its removal.

    Parameters
    ----------
    types : MessageTypes
    stamp_ns : int -- of the frame [ns, UNIX]
    heights_m, x_m : ndarray, shape (n_points,) -- the line [m]; empty where it is not known
    is_complete : bool -- every marker was seen
    """
    r, g, b = _SEEN_RGB if is_complete else _INCOMPLETE_RGB
    return types.make(
        "visualization_msgs/msg/Marker",
        header=header(types, stamp_ns, graph.RIG_FRAME),
        ns="beam",
        id=0,
        type=_LINE_STRIP,
        action=_ADD if len(x_m) > 1 else _DELETE,
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
            for x, z in zip(x_m, heights_m, strict=True)
        ],
        colors=[],
        texture_resource="",
        texture=types.make(
            "sensor_msgs/msg/CompressedImage",
            header=header(types, stamp_ns, ""),
            format="",
            data=types.octets(b""),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=types.make("visualization_msgs/msg/MeshFile", filename="", data=types.octets(b"")),
        mesh_use_embedded_materials=False,
    )
