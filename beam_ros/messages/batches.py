"""What was applied and measured: ``hub/applied`` and ``hub/measured``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.contract import SampleBatch
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import stamp_ns
from beam_ros.messages.texts import key_values
from beam_ros.messages.trajectories import MODE_FIELDS, point_columns, trajectory

BATCH_FIELDS = {
    "positions": "positions",
    "velocities": "velocities",
    "accelerations": "accelerations",
    "efforts": "effort",
}
"""The array of a JointTrajectoryPoint that carries each quantity of a ``SampleBatch``."""


def format_batch_frame(epoch: int, period_ns: int) -> str:
    """Return the frame_id of a batch, which says what no other field does: clock epoch and period."""
    return f"epoch={epoch} period_ns={period_ns}"


def parse_batch_frame(frame_id: str) -> tuple[int, int]:
    """Return epoch and period [ns] from a batch's frame_id; 0 stands for what it does not say."""
    values = key_values(frame_id)
    return values.get("epoch", 0), values.get("period_ns", 0)


def trajectory_batch(types: MessageTypes, batch: SampleBatch) -> Any:
    """Build the JointTrajectory of ``hub/applied`` and ``hub/measured`` from a batch.

    ``bags.batches.encode_batch`` makes the same message's bytes much faster.
    """
    columns = {
        name: getattr(batch, quantity)
        for quantity, name in BATCH_FIELDS.items()
        if getattr(batch, quantity) is not None
    }
    offsets = [k * batch.period_ns for k in range(len(batch))]
    frame = format_batch_frame(batch.epoch, batch.period_ns)
    return trajectory(types, batch.stamp_ns, frame, offsets, columns)


def read_trajectory_batch(message: Any) -> SampleBatch:
    """Read a message of ``hub/applied`` or ``hub/measured``.

    Raises
    ------
    MessageContentError
        The points have different arrays, more than one joint, or uneven times.
    """
    columns, times = point_columns(message)
    epoch, period_ns = parse_batch_frame(message.header.frame_id)
    return batch_from_columns(stamp_ns(message), epoch, period_ns, times, columns)


def batch_from_columns(
    stamp: int, epoch: int, period_ns: int, times_ns: StampArray, columns: Mapping[str, FloatArray]
) -> SampleBatch:
    """Check the times of a batch's points and make the batch.

    Parameters
    ----------
    stamp : int -- header stamp [ns, UNIX]
    epoch : int -- clock epoch
    period_ns : int -- period that the frame_id names; 0: from the times
    times_ns : ndarray, shape (n_points,) -- time_from_start [ns]
    columns : mapping -- arrays by the names of the message's fields, shape (n_points,) each

    Raises
    ------
    MessageContentError
        The times are not ``k * period_ns``.
    """
    count = len(times_ns)
    if period_ns <= 0 and count > 1:
        period_ns = int(times_ns[1] - times_ns[0])
    if count == 0 or (times_ns != np.arange(count) * period_ns).any() or (count > 1 > period_ns):
        raise MessageContentError(
            f"batch with times from its start {times_ns[:3].tolist()}.. ns: expected at least one point and "
            f"0, T, 2 T, .. with T = {period_ns} ns"
        )
    if not columns:
        raise MessageContentError(
            f"batch whose points are empty: expected one of {', '.join(MODE_FIELDS.values())} in every point"
        )
    quantities = {name: columns.get(wire_name) for name, wire_name in BATCH_FIELDS.items()}
    return SampleBatch(stamp, period_ns, epoch, **quantities)
