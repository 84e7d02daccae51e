"""The markers in one frame: ``beam/markers``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ros.arrays import StructuredArray
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
