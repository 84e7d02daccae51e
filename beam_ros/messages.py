"""The suite's messages, built and read in one place for the wire and for bags.

A node speaks rclpy's message classes, a bag is written and read with those of `rosbags`; both have the same
fields. The builders here take a `MessageTypes`, which hides the three differences (where a class comes from,
how an array of numbers and a byte are held), and the readers take whatever has the fields. Neither rclpy nor
rosbags is imported before it is asked for.

Stamps are integer nanoseconds (UNIX, host); everything else is SI. Positions, velocities, accelerations and
forces are positive along +x of the frame `rig`.
"""

from __future__ import annotations

import array
import functools
import importlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beam_ros import interfaces
from beam_ros.errors import RigError, RosMissingError
from beam_ros.hub.contract import ClockSync, FloatArray, SampleBatch, SequenceChunk, SequenceReport
from beam_ros.hub.sequences import MAX_CHUNK_POINTS

SECOND_NS = 1_000_000_000

MODE_FIELDS = {
    "position": "positions",
    "velocity": "velocities",
    "acceleration": "accelerations",
    "effort": "effort",
}
"""The array of a JointTrajectoryPoint that carries a command mode's values."""

BATCH_FIELDS = {
    "positions": "positions",
    "velocities": "velocities",
    "accelerations": "accelerations",
    "efforts": "effort",
}
"""The array of a JointTrajectoryPoint that carries each quantity of a `SampleBatch`."""

MARKER_DTYPE = np.dtype(
    {
        "names": ["x", "y", "z", "u", "v", "x_m", "sigma_m", "id", "valid"],
        "formats": ["<f4", "<f4", "<f4", "<f8", "<f8", "<f8", "<f8", "<u4", "u1"],
        "offsets": [0, 4, 8, 16, 24, 32, 40, 48, 52],
        "itemsize": 56,
    }
)
"""A row of `beam/markers`: x, y, z [m] in `rig`, u, v [px], displacement and its deviation [m], id, valid."""

_POINT_FIELD_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_POINT_FIELD_TYPES = {code: kind for kind, code in _POINT_FIELD_CODES.items()}

_TIME = "builtin_interfaces/msg/Time"
_DURATION = "builtin_interfaces/msg/Duration"
_HEADER = "std_msgs/msg/Header"
_POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
_KEY_VALUES = re.compile(r"(\w+)=(-?\d+)")


class MessageContentError(RigError, ValueError):
    """A message has the right type, but not the content that its topic promises."""


class MessageTypes(Protocol):
    """Where message classes come from and how they hold numbers."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from all of its fields."""

    def floats(self, values: ArrayLike) -> Any:
        """Hold numbers as a `float64[]` field wants them."""

    def octets(self, values: bytes) -> Any:
        """Hold bytes as a `uint8[]` field wants them."""

    def octet(self, value: int) -> Any:
        """Hold one byte as a `byte` field wants it."""


class RosTypes:
    """The message classes of rclpy, imported when first asked for."""

    def __init__(self) -> None:
        self._classes: dict[str, Any] = {}

    def message_class(self, type_name: str) -> Any:
        """Return rclpy's class of a message type, "package/msg/Name".

        Raises
        ------
        RosMissingError
            ROS 2, or this message package, is not installed.
        """
        if type_name not in self._classes:
            package, kind, name = type_name.split("/")
            try:
                self._classes[type_name] = getattr(importlib.import_module(f"{package}.{kind}"), name)
            except (ImportError, AttributeError) as err:
                raise RosMissingError(
                    f"ROS 2 type {type_name} cannot be loaded ({err}); expected ROS 2 Jazzy with its common "
                    "interfaces; source it, or install this package with its `ros` extra"
                ) from err
        return self._classes[type_name]

    def service_class(self, type_name: str) -> Any:
        """Return rclpy's class of a service type, "package/srv/Name"."""
        return self.message_class(type_name)

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from its fields."""
        return self.message_class(type_name)(**fields)

    def floats(self, values: ArrayLike) -> array.array[float]:
        """Hold numbers in the array that rclpy takes over without checking each."""
        return array.array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())

    def octets(self, values: bytes) -> array.array[int]:
        """Hold bytes in the array that rclpy takes over without checking each."""
        return array.array("B", values)

    def octet(self, value: int) -> bytes:
        """Hold one byte as rclpy does: as bytes of length 1."""
        return bytes([value])


class BagTypes:
    """The message classes of rosbags for ROS 2 Jazzy, with their CDR serialisation."""

    def __init__(self) -> None:
        self.store = _jazzy_typestore()

    def make(self, type_name: str, **fields: Any) -> Any:
        """Build a message of type "package/msg/Name" from all of its fields."""
        return self.store.types[type_name](**fields)

    def floats(self, values: ArrayLike) -> FloatArray:
        """Hold numbers as an array of float64."""
        return np.ascontiguousarray(values, dtype=np.float64)

    def octets(self, values: bytes) -> NDArray[np.uint8]:
        """Hold bytes as an array of uint8."""
        return np.frombuffer(values, dtype=np.uint8)

    def octet(self, value: int) -> int:
        """Hold one byte as a number."""
        return value

    def serialize(self, message: Any, type_name: str) -> bytes:
        """Return a message's CDR bytes, as they travel on the wire."""
        return bytes(self.store.serialize_cdr(message, type_name))

    def deserialize(self, data: bytes, type_name: str) -> Any:
        """Return the message that CDR bytes hold."""
        return self.store.deserialize_cdr(data, type_name)


@functools.lru_cache(maxsize=1)
def _jazzy_typestore() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


# --- stamps ---------------------------------------------------------------------------------------------


def _time(types: MessageTypes, time_ns: int, type_name: str = _TIME) -> Any:
    seconds, nanoseconds = divmod(int(time_ns), SECOND_NS)
    return types.make(type_name, sec=seconds, nanosec=nanoseconds)


def header(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """Build a std_msgs/Header."""
    return types.make(_HEADER, stamp=_time(types, stamp_ns), frame_id=frame_id)


def time_ns(time: Any) -> int:
    """Return a Time or a Duration in nanoseconds."""
    return int(time.sec) * SECOND_NS + int(time.nanosec)


def stamp_ns(message: Any) -> int:
    """Return the header stamp of a message [ns, UNIX]."""
    return time_ns(message.header.stamp)


# --- displacements and the hub's state -------------------------------------------------------------------


@dataclass(frozen=True)
class Displacement:
    """What `beam/displacement` says at one instant.

    Attributes
    ----------
    stamp_ns : int -- instant [ns, UNIX]
    names : tuple of str -- markers, `z010` ..
    positions : ndarray, shape (n_markers,) -- absolute displacement u [m], NaN where not seen
    """

    stamp_ns: int
    names: tuple[str, ...]
    positions: FloatArray


def displacement(types: MessageTypes, stamp_ns: int, names: Sequence[str], positions: ArrayLike) -> Any:
    """Build the JointState of `beam/displacement`: u [m] of each marker, NaN where it was not seen."""
    values = np.asarray(positions, dtype=np.float64)
    if values.shape != (len(names),):
        raise MessageContentError(
            f"displacement of shape {values.shape} for {len(names)} markers: expected one number for each"
        )
    return _joint_state(types, stamp_ns, names, values, (), ())


def read_displacement(message: Any) -> Displacement:
    """Read a message of `beam/displacement`.

    Raises
    ------
    MessageContentError
        There is not one position for each name, or a name comes twice.
    """
    names = tuple(message.name)
    positions = np.array(message.position, dtype=np.float64)
    if len(positions) != len(names) or len(set(names)) != len(names) or not names:
        raise MessageContentError(
            f"displacement with {len(positions)} positions for the names {list(names)}: expected one "
            "position for each of at least one name, and no name twice"
        )
    return Displacement(stamp_ns(message), names, positions)


@dataclass(frozen=True)
class HubSample:
    """What `hub/state` says: stamp [ns, UNIX], position [m], velocity [m/s], effort [N]; NaN: not known."""

    stamp_ns: int
    position: float
    velocity: float = math.nan
    effort: float = math.nan


def hub_state(types: MessageTypes, sample: HubSample) -> Any:
    """Build the JointState of `hub/state`; a velocity or effort of NaN is left out."""
    optional = [() if math.isnan(value) else (value,) for value in (sample.velocity, sample.effort)]
    return _joint_state(types, sample.stamp_ns, (interfaces.HUB_JOINT,), (sample.position,), *optional)


def read_hub_state(message: Any) -> HubSample:
    """Read a message of `hub/state`.

    Raises
    ------
    MessageContentError
        It does not hold exactly one joint with a position.
    """
    if len(message.name) != 1 or len(message.position) != 1:
        raise MessageContentError(
            f"hub state with joints {list(message.name)} and {len(message.position)} positions: expected one "
            f"joint `{interfaces.HUB_JOINT}` with a position"
        )
    velocity, effort = (float(v[0]) if len(v) else math.nan for v in (message.velocity, message.effort))
    return HubSample(stamp_ns(message), float(message.position[0]), velocity, effort)


def _joint_state(
    types: MessageTypes,
    stamp_ns: int,
    names: Sequence[str],
    positions: ArrayLike,
    velocities: ArrayLike,
    efforts: ArrayLike,
) -> Any:
    return types.make(
        interfaces.JOINT_STATE,
        header=header(types, stamp_ns, interfaces.RIG_FRAME),
        name=list(names),
        position=types.floats(positions),
        velocity=types.floats(velocities),
        effort=types.floats(efforts),
    )


# --- trajectories: batches, sequences and set-points -----------------------------------------------------


def format_batch_frame(epoch: int, period_ns: int) -> str:
    """Return the frame_id of a batch, which says what no other field does: clock epoch and period."""
    return f"epoch={epoch} period_ns={period_ns}"


def parse_batch_frame(frame_id: str) -> tuple[int, int]:
    """Return epoch and period [ns] from a batch's frame_id; 0 stands for what it does not say."""
    values = dict(_KEY_VALUES.findall(frame_id))
    return int(values.get("epoch", 0)), int(values.get("period_ns", 0))


def trajectory_batch(types: MessageTypes, batch: SampleBatch) -> Any:
    """Build the JointTrajectory of `hub/applied` and `hub/measured` from a batch.

    `beam_ros.bags.batches.encode_batch` makes the same message's bytes much faster.
    """
    columns = {
        name: getattr(batch, quantity)
        for quantity, name in BATCH_FIELDS.items()
        if getattr(batch, quantity) is not None
    }
    offsets = [k * batch.period_ns for k in range(len(batch))]
    frame = format_batch_frame(batch.epoch, batch.period_ns)
    return _trajectory(types, batch.stamp_ns, frame, offsets, columns)


def read_trajectory_batch(message: Any) -> SampleBatch:
    """Read a message of `hub/applied` or `hub/measured`.

    Raises
    ------
    MessageContentError
        The points have different arrays, more than one joint, or uneven times.
    """
    columns, times = _point_columns(message)
    epoch, period_ns = parse_batch_frame(message.header.frame_id)
    return batch_from_columns(stamp_ns(message), epoch, period_ns, times, columns)


def batch_from_columns(
    stamp: int, epoch: int, period_ns: int, times_ns: NDArray[np.int64], columns: Mapping[str, FloatArray]
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


@dataclass(frozen=True)
class Setpoint:
    """One set-point of `hub/setpoint`: stamp [ns, UNIX], command mode and value in the mode's unit."""

    stamp_ns: int
    mode: str
    value: float


def setpoint(types: MessageTypes, point: Setpoint) -> Any:
    """Build the JointTrajectory of `hub/setpoint`."""
    column = {MODE_FIELDS[point.mode]: np.array([point.value])}
    return _trajectory(types, point.stamp_ns, interfaces.RIG_FRAME, [0], column)


def read_setpoint(message: Any) -> Setpoint:
    """Read a message of `hub/setpoint`.

    Raises
    ------
    MessageContentError
        It does not hold exactly one point with one value for the hub's joint.
    """
    columns, times = _point_columns(message)
    mode, values = _single_column(columns, "set-point")
    if len(times) != 1:
        raise MessageContentError(f"set-point with {len(times)} points: expected exactly one")
    return Setpoint(stamp_ns(message), mode, float(values[0]))


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
    """Build the JointTrajectory of `hub/sequence` from a chunk in a command mode.

    `beam_ros.bags.batches.encode_chunk` makes the same message's bytes much faster.
    """
    offsets = [(chunk.first_tick + k) * chunk.period_ns for k in range(len(chunk.values))]
    return _trajectory(types, chunk.start_ns, chunk_frame(chunk), offsets, {MODE_FIELDS[mode]: chunk.values})


def chunk_frame(chunk: SequenceChunk) -> str:
    """Return the frame_id of a chunk, ``<id> <k>/<n>``."""
    return f"{chunk.sequence_id} {chunk.index}/{chunk.count}"


def read_sequence_chunk(message: Any, device_period_ns: int) -> tuple[str, SequenceChunk]:
    """Read a message of `hub/sequence`.

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
    columns, times = _point_columns(message)
    return chunk_from_columns(
        stamp_ns(message), message.header.frame_id, times, columns, device_period_ns=device_period_ns
    )


def chunk_from_columns(
    start_ns: int,
    frame_id: str,
    times_ns: NDArray[np.int64],
    columns: Mapping[str, FloatArray],
    *,
    device_period_ns: int,
) -> tuple[str, SequenceChunk]:
    """Check name and times of a chunk's points and make the chunk; see `read_sequence_chunk`."""
    mode, values = _single_column(columns, "sequence chunk")
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


def _single_column(columns: Mapping[str, FloatArray], what: str) -> tuple[str, FloatArray]:
    if len(columns) != 1:
        raise MessageContentError(
            f"{what} with the arrays {', '.join(columns) or 'none'}: expected exactly one of "
            f"{', '.join(MODE_FIELDS.values())}, the command mode's"
        )
    ((name, values),) = columns.items()
    mode = next(mode for mode, field_name in MODE_FIELDS.items() if field_name == name)
    return mode, values


def _trajectory(
    types: MessageTypes,
    stamp_ns: int,
    frame_id: str,
    offsets_ns: Iterable[int],
    columns: Mapping[str, FloatArray],
) -> Any:
    def values(name: str, k: int) -> Any:
        column = columns.get(name)
        return types.floats(()) if column is None else types.floats((column[k],))

    points = [
        types.make(
            _POINT,
            **{name: values(name, k) for name in MODE_FIELDS.values()},
            time_from_start=_time(types, offset, _DURATION),
        )
        for k, offset in enumerate(offsets_ns)
    ]
    stamped = header(types, stamp_ns, frame_id)
    joints = [interfaces.HUB_JOINT]
    return types.make(interfaces.JOINT_TRAJECTORY, header=stamped, joint_names=joints, points=points)


def _point_columns(message: Any) -> tuple[dict[str, FloatArray], NDArray[np.int64]]:
    if list(message.joint_names) != [interfaces.HUB_JOINT] or not len(message.points):
        raise MessageContentError(
            f"trajectory with {len(message.points)} points for the joints {list(message.joint_names)}: "
            f"expected at least one point for the joint `{interfaces.HUB_JOINT}`"
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


# --- clocks and texts ------------------------------------------------------------------------------------


def clock_sync(types: MessageTypes, sync: ClockSync) -> Any:
    """Build the TimeReference of `hub/clock_sync`."""
    return types.make(
        "sensor_msgs/msg/TimeReference",
        header=header(types, sync.host_ns, ""),
        time_ref=_time(types, sync.device_ns),
        source=f"epoch={sync.epoch} rtt_ns={sync.rtt_ns}",
    )


def read_clock_sync(message: Any) -> ClockSync:
    """Read a message of `hub/clock_sync`.

    Raises
    ------
    MessageContentError
        Its source does not name epoch and round trip.
    """
    values = dict(_KEY_VALUES.findall(message.source))
    if not {"epoch", "rtt_ns"} <= set(values):
        raise MessageContentError(
            f"clock sync with source {message.source[:80]!r}: expected 'epoch=<n> rtt_ns=<n>'"
        )
    device_ns = time_ns(message.time_ref)
    return ClockSync(stamp_ns(message), device_ns, int(values["epoch"]), int(values["rtt_ns"]))


def json_text(types: MessageTypes, content: Mapping[str, Any]) -> Any:
    """Build a String that carries JSON; NaN and infinities, which JSON does not know, become null."""
    return types.make(interfaces.STRING, data=json.dumps(_without_nan(content)))


def sequence_state(types: MessageTypes, report: SequenceReport) -> Any:
    """Build the String of `hub/sequence_state`."""
    content = {
        "id": report.sequence_id,
        "state": report.state,
        "points": report.points,
        "reason": report.reason,
    }
    return json_text(types, content)


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def read_json(message: Any) -> dict[str, Any]:
    """Read a String that carries a JSON object.

    Raises
    ------
    MessageContentError
        The text is no JSON object.
    """
    try:
        content = json.loads(message.data)
    except (ValueError, RecursionError) as err:
        raise MessageContentError(f"text {message.data[:80]!r} is no JSON ({err})") from err
    if not isinstance(content, dict):
        raise MessageContentError(f"text {message.data[:80]!r}: expected a JSON object {{..}}")
    return content


# --- camera and markers ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class MarkerCloud:
    """What `beam/markers` says: the frame's stamp [ns, UNIX] and a row of `MARKER_DTYPE` per marker."""

    stamp_ns: int
    rows: NDArray[np.void]


def marker_cloud(types: MessageTypes, cloud: MarkerCloud) -> Any:
    """Build the PointCloud2 of `beam/markers` from rows of `MARKER_DTYPE`."""
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
        header=header(types, cloud.stamp_ns, interfaces.RIG_FRAME),
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
    """Read a message of `beam/markers` by the names of its fields, in whatever order and type they are.

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


def image(types: MessageTypes, stamp_ns: int, pixels: NDArray[np.uint8]) -> Any:
    """Build an Image from pixels: mono8 of shape (height, width), bgr8 of shape (height, width, 3)."""
    height, width = pixels.shape[:2]
    return types.make(
        "sensor_msgs/msg/Image",
        header=header(types, stamp_ns, interfaces.CAMERA_FRAME),
        height=height,
        width=width,
        encoding="mono8" if pixels.ndim == 2 else "bgr8",
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=types.octets(pixels.tobytes()),
    )


def camera_info(types: MessageTypes, stamp_ns: int, width: int, height: int) -> Any:
    """Build the CameraInfo of an uncalibrated camera: size and, by convention, a K of zeros."""
    return types.make(
        "sensor_msgs/msg/CameraInfo",
        header=header(types, stamp_ns, interfaces.CAMERA_FRAME),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=types.floats(np.zeros(5)),
        k=np.zeros(9),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=types.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )


# --- diagnostics -----------------------------------------------------------------------------------------

LEVELS = ("OK", "WARN", "ERROR", "STALE")


@dataclass(frozen=True)
class Health:
    """One status of `/diagnostics`: who, level (OK, WARN, ERROR, STALE), a sentence, and values."""

    name: str
    level: str
    message: str
    hardware_id: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


def diagnostics(types: MessageTypes, stamp_ns: int, statuses: Iterable[Health]) -> Any:
    """Build the DiagnosticArray of `/diagnostics`."""
    return types.make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header(types, stamp_ns, ""),
        status=[
            types.make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=types.octet(LEVELS.index(status.level)),
                name=status.name,
                message=status.message,
                hardware_id=status.hardware_id,
                values=[
                    types.make("diagnostic_msgs/msg/KeyValue", key=str(key), value=str(value))
                    for key, value in status.values.items()
                ],
            )
            for status in statuses
        ],
    )


def read_diagnostics(message: Any) -> tuple[Health, ...]:
    """Read a message of `/diagnostics`; a level outside OK..STALE counts as STALE."""
    return tuple(
        Health(
            status.name,
            LEVELS[min(_octet_value(status.level), len(LEVELS) - 1)],
            status.message,
            status.hardware_id,
            {item.key: item.value for item in status.values},
        )
        for status in message.status
    )


def _octet_value(level: Any) -> int:
    return level[0] if isinstance(level, bytes) else int(level)
