"""Points of a JointTrajectory for the joint ``hub``, which commands and batches are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.interfaces import graph
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import DURATION, header, ros_time, time_ns

MODE_FIELDS = {
    "position": "positions",
    "velocity": "velocities",
    "acceleration": "accelerations",
    "effort": "effort",
}
"""The array of a JointTrajectoryPoint that carries a command mode's values."""

_POINT = "trajectory_msgs/msg/JointTrajectoryPoint"


def trajectory(
    types: MessageTypes,
    stamp_ns: int,
    frame_id: str,
    offsets_ns: Iterable[int],
    columns: Mapping[str, FloatArray],
) -> Any:
    """Build a JointTrajectory of the hub from the times of its points and their columns.

    Parameters
    ----------
    types : MessageTypes
    stamp_ns : int -- header stamp [ns, UNIX]
    frame_id : str -- what the topic says in it
    offsets_ns : iterable of int -- time_from_start of every point [ns]
    columns : mapping of str to ndarray, shape (n_points,) -- by the name of a point's array
    """

    def values(name: str, k: int) -> Any:
        column = columns.get(name)
        return types.floats(()) if column is None else types.floats((column[k],))

    points = [
        types.make(
            _POINT,
            **{name: values(name, k) for name in MODE_FIELDS.values()},
            time_from_start=ros_time(types, offset, DURATION),
        )
        for k, offset in enumerate(offsets_ns)
    ]
    stamped = header(types, stamp_ns, frame_id)
    joints = [graph.HUB_JOINT]
    return types.make(graph.JOINT_TRAJECTORY, header=stamped, joint_names=joints, points=points)


def point_columns(message: Any, joint: str = graph.HUB_JOINT) -> tuple[dict[str, FloatArray], StampArray]:
    """Return the columns that a JointTrajectory of the hub carries, by name, and its times from the start [ns].

    Raises
    ------
    MessageContentError
        Another joint, no points, or points that carry different arrays.
    """
    if list(message.joint_names) != [joint] or not len(message.points):
        raise MessageContentError(
            f"trajectory with {len(message.points)} points for the joints {list(message.joint_names)}: "
            f"expected at least one point for the joint `{joint}`"
        )
    columns = {}
    for name in MODE_FIELDS.values():
        values = [getattr(point, name) for point in message.points]
        lengths = {len(value) for value in values}
        if lengths not in ({0}, {1}):
            raise MessageContentError(
                f"trajectory whose points have {sorted(lengths)} {name}: expected one in every point, or none"
            )
        if lengths == {1}:
            columns[name] = np.array([value[0] for value in values], dtype=np.float64)
    times = np.array([time_ns(point.time_from_start) for point in message.points], dtype=np.int64)
    return columns, times


def single_column(columns: Mapping[str, FloatArray], what: str) -> tuple[str, FloatArray]:
    """Return command mode and values of a trajectory, named ``what``, that carries one array.

    Raises
    ------
    MessageContentError
        It carries another number of arrays.
    """
    if len(columns) != 1:
        raise MessageContentError(
            f"{what} with the arrays {', '.join(columns) or 'none'}: expected exactly one of "
            f"{', '.join(MODE_FIELDS.values())}, the command mode's"
        )
    ((name, values),) = columns.items()
    mode = next(mode for mode, field_name in MODE_FIELDS.items() if field_name == name)
    return mode, values
