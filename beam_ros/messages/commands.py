"""Commands for the hub: ``hub/setpoint``, and ``hub/sequence`` in chunks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.hub.contract import MAX_CHUNK_POINTS, SequenceChunk
from beam_ros.interfaces import graph
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.message_types import MessageTypes
from beam_ros.messages.stamps import stamp_ns
from beam_ros.messages.trajectories import MODE_FIELDS, point_columns, single_column, trajectory


@dataclass(frozen=True)
class StampedSetpoint:
    """One set-point of ``hub/setpoint``: stamp [ns, UNIX], command mode and value in the mode's unit."""

    stamp_ns: int
    mode: str
    value: float


def setpoint(types: MessageTypes, point: StampedSetpoint) -> Any:
    """Build the JointTrajectory of ``hub/setpoint``."""
    column = {MODE_FIELDS[point.mode]: np.array([point.value])}
    return trajectory(types, point.stamp_ns, graph.RIG_FRAME, [0], column)


def read_setpoint(message: Any) -> StampedSetpoint:
    """Read a message of ``hub/setpoint``.

    Raises
    ------
    MessageContentError
        It does not hold exactly one point with one value for the hub's joint.
    """
    columns, times = point_columns(message)
    mode, values = single_column(columns, "set-point")
    if len(times) != 1:
        raise MessageContentError(f"set-point with {len(times)} points: expected exactly one")
    return StampedSetpoint(stamp_ns(message), mode, float(values[0]))


def split_sequence(
    sequence_id: str, start_ns: int, period_ns: int, values: ArrayLike, max_points: int = MAX_CHUNK_POINTS
) -> tuple[SequenceChunk, ...]:
    """Cut a sequence into chunks of nearly equal length.

    Parameters
    ----------
    sequence_id : str -- its name, without white space
    start_ns : int -- when its first sample is to be applied [ns, UNIX]
    period_ns : int -- distance of the samples [ns of device time]
    values : array_like, shape (n_points,) -- samples in the command mode's unit
    max_points : int -- most points in a chunk, at least 2

    Returns
    -------
    tuple of SequenceChunk -- none of them with one point only, whose period could not be told
    """
    samples = np.asarray(values, dtype=np.float64)
    count = max(1, math.ceil(len(samples) / max_points))
    pieces = np.array_split(samples, count)
    first_ticks = np.cumsum([0] + [len(piece) for piece in pieces[:-1]])
    return tuple(
        SequenceChunk(sequence_id, k + 1, count, start_ns, period_ns, int(first), piece)
        for k, (first, piece) in enumerate(zip(first_ticks, pieces, strict=True))
    )


def sequence_chunk(types: MessageTypes, chunk: SequenceChunk, mode: str) -> Any:
    """Build the JointTrajectory of ``hub/sequence`` from a chunk in a command mode.

    ``bags.batches.encode_chunk`` makes the same message's bytes much faster.
    """
    offsets = [(chunk.first_tick + k) * chunk.period_ns for k in range(len(chunk.values))]
    return trajectory(types, chunk.start_ns, chunk_frame(chunk), offsets, {MODE_FIELDS[mode]: chunk.values})


def chunk_frame(chunk: SequenceChunk) -> str:
    """Return the frame_id of a chunk, ``<id> <k>/<n>``."""
    return f"{chunk.sequence_id} {chunk.index}/{chunk.count}"


def read_sequence_chunk(message: Any, device_period_ns: int) -> tuple[str, SequenceChunk]:
    """Read a message of ``hub/sequence``.

    Parameters
    ----------
    message : JointTrajectory
    device_period_ns : int -- taken for the period where a single point does not tell it

    Returns
    -------
    mode : str -- position, velocity, acceleration or effort
    chunk : SequenceChunk

    Raises
    ------
    MessageContentError
        The name is not ``<id> <k>/<n>``, the points do not carry one value each, or their times are no
        consecutive multiples of a period.
    """
    columns, times = point_columns(message)
    return chunk_from_columns(
        stamp_ns(message), message.header.frame_id, times, columns, device_period_ns=device_period_ns
    )


def chunk_from_columns(
    start_ns: int,
    frame_id: str,
    times_ns: StampArray,
    columns: Mapping[str, FloatArray],
    *,
    device_period_ns: int,
) -> tuple[str, SequenceChunk]:
    """Check name and times of a chunk's points and make the chunk; see ``read_sequence_chunk``."""
    mode, values = single_column(columns, "sequence chunk")
    match = re.fullmatch(r"(\S+) (\d{1,6})/(\d{1,6})", frame_id)
    if match is None:
        raise MessageContentError(
            f"sequence chunk named {frame_id[:80]!r}: expected '<id> <k>/<n>' in header.frame_id, an id "
            "without white space"
        )
    period_ns = int(times_ns[1] - times_ns[0]) if len(times_ns) > 1 else device_period_ns
    first_tick, rest = divmod(int(times_ns[0]), period_ns) if period_ns > 0 else (0, 1)
    steps = np.arange(first_tick, first_tick + len(times_ns)) * max(period_ns, 0)
    if rest or not np.array_equal(times_ns, steps):
        raise MessageContentError(
            f"chunk {frame_id[:80]!r} with times from the start {times_ns[:3].tolist()}.. ns: expected "
            "consecutive multiples of one period"
        )
    index, count = int(match[2]), int(match[3])
    return mode, SequenceChunk(match[1], index, count, start_ns, period_ns, first_tick, values)
