"""Batches and sequence chunks to CDR bytes and back, without a Python object for every sample.

A JointTrajectory of n points costs a general serialiser n objects. The suite's own messages have a regular
layout instead: header, one joint name, then points that all carry the same arrays of one value each. In CDR
every such point but the first has the same length (after the first, a point always begins at the same place
modulo 8), so the points are a strided array that NumPy reads and writes in one step:

    point = [count, (padding to 8), value] or [count = 0]  for positions, velocities, accelerations, effort;
            seconds, nanoseconds

Whatever has another layout (big-endian, several joints, uneven points) goes through ``rosbags``. The bytes made
here equal those that rclpy and rosbags make.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray, IndexArray, Int32Array, StampArray
from beam_ros.bags.errors import MessageDecodeError
from beam_ros.hub.contract import SampleBatch, SequenceChunk
from beam_ros.interfaces import graph
from beam_ros.messages import (
    BATCH_FIELDS,
    MODE_FIELDS,
    SECOND_NS,
    BagTypes,
    MessageContentError,
    batch_from_columns,
    chunk_frame,
    chunk_from_columns,
    format_batch_frame,
    parse_batch_frame,
    read_sequence_chunk,
    read_trajectory_batch,
)
from beam_ros.messages.stamps import stamp_ns
from beam_ros.messages.trajectories import point_columns

_ENCAPSULATION = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, which is what every ROS 2 middleware on x86 and ARM writes."""

_JOINT = graph.HUB_JOINT.encode()
_WIRE_NAMES = tuple(MODE_FIELDS.values())
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_VALUE = struct.Struct("<d")

_Columns = dict[str, FloatArray]


def _point_dtype(present: tuple[bool, ...], phase: int) -> np.dtype[Any]:
    """Layout of a point that begins at ``phase`` modulo 8 and carries the arrays that are ``present``."""
    names, formats, offsets = [], [], []
    offset = phase
    for name, is_present in zip(_WIRE_NAMES, present, strict=True):
        names.append(f"{name}_count")
        formats.append("<u4")
        offsets.append(offset - phase)
        offset += 4
        if is_present:
            offset += -offset % 8
            names.append(name)
            formats.append("<f8")
            offsets.append(offset - phase)
            offset += 8
    for name, kind in (("sec", "<i4"), ("nanosec", "<u4")):
        names.append(name)
        formats.append(kind)
        offsets.append(offset - phase)
        offset += 4
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": offset - phase}
    return np.dtype(layout)  # type: ignore[call-overload, no-any-return]


@dataclass(frozen=True)
class _Layout:
    """Where things lie in the points of a trajectory whose first one begins at a given phase.

    Attributes
    ----------
    first, rest : dtype -- the first point, and each of those after it
    first_size, size : int -- their lengths [bytes]
    count_words : ndarray of int -- the arrays' lengths, as 4-byte words of a later point
    counts : ndarray of int -- what stands there
    values : tuple of (name, offset in the first point, offset in a later point)
    """

    first: np.dtype[Any]
    rest: np.dtype[Any]
    first_size: int
    size: int
    count_words: IndexArray
    counts: Int32Array
    values: tuple[tuple[str, int, int], ...]


@functools.lru_cache(maxsize=64)
def _layout(present: tuple[bool, ...], phase: int) -> _Layout:
    first = _point_dtype(present, phase)
    rest = _point_dtype(present, (phase + first.itemsize) % 8)
    first_fields, rest_fields = dict(first.fields or {}), dict(rest.fields or {})
    return _Layout(
        first=first,
        rest=rest,
        first_size=first.itemsize,
        size=rest.itemsize,
        count_words=np.array([rest_fields[f"{name}_count"][1] // 4 for name in _WIRE_NAMES]),
        counts=np.array(present, dtype=np.int32),
        values=tuple(
            (name, first_fields[name][1], rest_fields[name][1])
            for name, is_present in zip(_WIRE_NAMES, present, strict=True)
            if is_present
        ),
    )


# --- writing ---------------------------------------------------------------------------------------------


def encode_batch(batch: SampleBatch) -> bytes:
    """Return the CDR bytes of a batch's JointTrajectory, as ``Publisher.publish`` and a bag take them.

    Parameters
    ----------
    batch : SampleBatch -- with at least one sample

    Returns
    -------
    bytes
    """
    columns = {wire: getattr(batch, quantity) for quantity, wire in BATCH_FIELDS.items()}
    frame = format_batch_frame(batch.epoch, batch.period_ns)
    return _encode(batch.stamp_ns, frame, np.arange(len(batch)) * batch.period_ns, columns)


def encode_chunk(chunk: SequenceChunk, mode: str) -> bytes:
    """Return the CDR bytes of a sequence chunk's JointTrajectory.

    Parameters
    ----------
    chunk : SequenceChunk
    mode : str -- position, velocity, acceleration or effort

    Returns
    -------
    bytes
    """
    ticks = np.arange(chunk.first_tick, chunk.first_tick + len(chunk.values))
    columns = {MODE_FIELDS[mode]: chunk.values}
    return _encode(chunk.start_ns, chunk_frame(chunk), ticks * chunk.period_ns, columns)


def encode_trajectory(joint: str, stamp_ns: int, times_ns: StampArray, columns: _Columns) -> bytes:
    """Return the CDR bytes of the JointTrajectory of somebody else's joint.

    Parameters
    ----------
    joint : str -- its name
    stamp_ns : int -- when the trajectory begins [ns, UNIX]
    times_ns : ndarray of int64, shape (n_points,) -- time_from_start [ns]
    columns : dict of str to ndarray, shape (n_points,) each -- by the names of the message's fields

    Returns
    -------
    bytes
    """
    return _encode(stamp_ns, "", times_ns, columns, joint)


def _encode(
    stamp_ns: int,
    frame_id: str,
    times_ns: StampArray,
    columns: Mapping[str, FloatArray | None],
    joint: str = graph.HUB_JOINT,
) -> bytes:
    stamp = _STAMP.pack(*divmod(stamp_ns, SECOND_NS))
    joints = _COUNT.pack(1) + _text(joint)
    head = stamp + _text(frame_id) + joints + _COUNT.pack(len(times_ns))

    present = tuple(columns.get(name) is not None for name in _WIRE_NAMES)
    seconds, nanoseconds = np.divmod(times_ns, SECOND_NS)
    layout = _layout(present, len(head) % 8)
    pieces = []
    for dtype, part in ((layout.first, slice(0, 1)), (layout.rest, slice(1, None))):
        points = np.zeros(len(seconds[part]), dtype=dtype)
        for name in _WIRE_NAMES:
            values = columns.get(name)
            if values is not None:
                points[f"{name}_count"] = 1
                points[name] = values[part]
        points["sec"] = seconds[part]
        points["nanosec"] = nanoseconds[part]
        pieces.append(points.tobytes())
    return b"".join((_ENCAPSULATION, head, *pieces))


def _text(text: str) -> bytes:
    """Return a CDR string, filled up so that a 4-byte number may follow."""
    data = text.encode() + b"\0"
    return _COUNT.pack(len(data)) + data + bytes(-len(data) % 4)


# --- reading ---------------------------------------------------------------------------------------------


def decode_batch(data: bytes) -> SampleBatch:
    """Return the batch that the CDR bytes of a JointTrajectory hold.

    Parameters
    ----------
    data : bytes -- as they come from the wire or a bag

    Raises
    ------
    MessageDecodeError
        The bytes are no JointTrajectory, or it is no batch of the hub's.
    """
    fast = _decode(data)
    try:
        if fast is None:
            return read_trajectory_batch(_general_trajectory(data))
        stamp_ns, frame_id, times_ns, columns = fast
        return batch_from_columns(stamp_ns, *parse_batch_frame(frame_id), times_ns, columns)
    except MessageContentError as err:
        raise MessageDecodeError(str(err)) from err


def decode_chunk(data: bytes, device_period_ns: int) -> tuple[str, SequenceChunk]:
    """Return the command mode and the sequence chunk that the CDR bytes of a JointTrajectory hold.

    Parameters
    ----------
    data : bytes -- as they come from the wire or a bag
    device_period_ns : int -- taken for the period where a single point does not tell it

    Raises
    ------
    MessageDecodeError
        The bytes are no JointTrajectory, or it is no chunk of a sequence.
    """
    fast = _decode(data)
    try:
        if fast is None:
            return read_sequence_chunk(_general_trajectory(data), device_period_ns)
        start_ns, frame_id, times_ns, columns = fast
        return chunk_from_columns(start_ns, frame_id, times_ns, columns, device_period_ns=device_period_ns)
    except MessageContentError as err:
        raise MessageDecodeError(str(err)) from err


def decode_trajectory(data: bytes, joint: str) -> tuple[int, StampArray, _Columns]:
    """Return stamp [ns], times from it [ns] and columns of the CDR bytes of somebody else's JointTrajectory.

    Parameters
    ----------
    data : bytes -- as they come from the wire
    joint : str -- the one joint that it must be of

    Raises
    ------
    MessageDecodeError
        The bytes are no JointTrajectory, of other joints, or its points carry different arrays.
    """
    fast = _decode(data, joint.encode())
    if fast is not None:
        stamp, _, times_ns, columns = fast
        return stamp, times_ns, columns
    message = _general_trajectory(data)
    if len(message.points) == 0:
        return stamp_ns(message), np.zeros(0, dtype=np.int64), {}
    try:
        columns, times_ns = point_columns(message, joint)
    except MessageContentError as err:
        raise MessageDecodeError(str(err)) from err
    return stamp_ns(message), times_ns, columns


def faulty_chunk(data: bytes, fault: str) -> SequenceChunk:
    """Return what stands for a chunk that could not be decoded, so that its sequence is refused.

    Parameters
    ----------
    data : bytes -- as they came from the wire
    fault : str -- what is wrong with them

    Returns
    -------
    SequenceChunk -- without samples; its name and start are empty and 0 where even they cannot be read
    """
    try:
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        frame = _read_text(memoryview(data)[4:], 8)[0].decode()
    except (struct.error, UnicodeDecodeError):
        seconds, nanoseconds, frame = 0, 0, ""
    sequence_id, _, numbers = frame.rpartition(" ")
    if not sequence_id or "/" not in numbers or any(map(str.isspace, sequence_id)):
        sequence_id = ""
    return SequenceChunk(
        sequence_id[:80], 0, 0, seconds * SECOND_NS + nanoseconds, 0, 0, np.zeros(0), fault=fault
    )


def _general_trajectory(data: bytes) -> Any:
    try:
        return BagTypes().deserialize(data, graph.JOINT_TRAJECTORY)
    except Exception as err:  # rosbags raises whatever the damaged bytes lead it to
        raise MessageDecodeError(
            f"{len(data)} bytes that are no JointTrajectory ({type(err).__name__}: {err}); the recording is "
            "damaged there, or another type was recorded under this name"
        ) from err


def _decode(data: bytes, wanted: bytes = _JOINT) -> tuple[int, str, StampArray, _Columns] | None:
    """Read stamp, frame_id, times and arrays; None for any layout but the suite's own."""
    if data[:2] != _ENCAPSULATION[:2]:
        return None
    body = memoryview(data)[4:]
    try:
        seconds, nanoseconds = _STAMP.unpack_from(body, 0)
        frame, offset = _read_text(body, 8)
        (n_joints,) = _COUNT.unpack_from(body, offset)
        joint, offset = _read_text(body, offset + 4)
        (count,) = _COUNT.unpack_from(body, offset)
        offset += 4
        if n_joints != 1 or joint != wanted or not 1 <= count <= len(body):
            return None
        frame_id = frame.decode()
        present = _present_arrays(body, offset)
    except (struct.error, UnicodeDecodeError):
        return None
    if present is None:
        return None
    layout = _layout(present, offset % 8)
    second = offset + layout.first_size
    if second + (count - 1) * layout.size > len(body):
        return None
    # Every field lies on a multiple of 4, so the points after the first are rows of a table of words.
    words = np.ndarray((count - 1, layout.size // 4), "<i4", body, second)
    if (words[:, layout.count_words] != layout.counts).any():
        return None
    columns = {}
    for name, first_offset, rest_offset in layout.values:
        values = np.empty(count)
        (values[0],) = _VALUE.unpack_from(body, offset + first_offset)
        if count > 1:
            values[1:] = np.ndarray(count - 1, "<f8", body, second + rest_offset, layout.size)
        columns[name] = values
    first_seconds, first_nanoseconds = _STAMP.unpack_from(body, second - _STAMP.size)
    times_ns = np.empty(count, dtype=np.int64)
    times_ns[0] = first_seconds * SECOND_NS + first_nanoseconds
    np.multiply(words[:, -2], SECOND_NS, out=times_ns[1:], dtype=np.int64)
    times_ns[1:] += words[:, -1]
    return seconds * SECOND_NS + nanoseconds, frame_id, times_ns, columns


def _read_text(body: memoryview, offset: int) -> tuple[bytes, int]:
    """Return a CDR string without its closing zero, and where the next 4-byte number begins."""
    (length,) = _COUNT.unpack_from(body, offset)
    end = offset + 4 + length
    if length == 0 or end > len(body):
        raise struct.error("string runs over the end")
    return bytes(body[offset + 4 : end - 1]), end + -end % 4


def _present_arrays(body: memoryview, offset: int) -> tuple[bool, ...] | None:
    """Which arrays the first point carries; None where one has more than one value."""
    present = []
    for _ in _WIRE_NAMES:
        (count,) = _COUNT.unpack_from(body, offset)
        offset += 4
        if count > 1:
            return None
        present.append(count == 1)
        if count:
            offset += -offset % 8 + 8
    return tuple(present)
