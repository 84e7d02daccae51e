"""Layouts: columns of many messages hold what rosbags decodes of each of them."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.bags.blocks import Block, TypedTopic
from beam_ros.bags.errors import MessageDecodeError
from beam_ros.bags.layouts import Alike, Layout, Shapes
from tests.beam_ros.bags.small_bags import TYPES

STORE = TYPES.store
RANGES = ("field_of_view", "min_range", "max_range", "range", "variance")


def _time(rng):
    return TYPES.make(
        "builtin_interfaces/msg/Time", sec=int(rng.integers(2**31)), nanosec=int(rng.integers(10**9))
    )


def _header(rng, frame):
    return TYPES.make("std_msgs/msg/Header", stamp=_time(rng), frame_id=frame)


def _vector(rng, kind="Vector3", **more):
    names = ("x", "y", "z", *more)
    return TYPES.make(f"geometry_msgs/msg/{kind}", **{name: float(rng.normal()) for name in names})


def _joints(rng, names=("a", "bcd")):
    return TYPES.make(
        "sensor_msgs/msg/JointState",
        header=_header(rng, "rig"),
        name=list(names),
        position=rng.normal(size=len(names)),
        velocity=rng.normal(size=0),
        effort=rng.normal(size=len(names)),
    )


def _imu(rng):
    return TYPES.make(
        "sensor_msgs/msg/Imu",
        header=_header(rng, "imu_link"),
        orientation=_vector(rng, "Quaternion", w=0),
        orientation_covariance=rng.normal(size=9),
        angular_velocity=_vector(rng),
        angular_velocity_covariance=rng.normal(size=9),
        linear_acceleration=_vector(rng),
        linear_acceleration_covariance=rng.normal(size=9),
    )


def _range(rng):
    return TYPES.make(
        "sensor_msgs/msg/Range",
        header=_header(rng, "laser"),
        radiation_type=int(rng.integers(2)),
        **{
            name: np.float32(rng.normal())
            for name in ("field_of_view", "min_range", "max_range", "range", "variance")
        },
    )


def _trajectory(rng, n=3):
    points = [
        TYPES.make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=rng.normal(size=1),
            velocities=rng.normal(size=0),
            accelerations=rng.normal(size=2),
            effort=rng.normal(size=0),
            time_from_start=TYPES.make(
                "builtin_interfaces/msg/Duration", sec=-3, nanosec=int(rng.integers(10**9))
            ),
        )
        for _ in range(n)
    ]
    header = _header(rng, "epoch=1")
    return TYPES.make(
        "trajectory_msgs/msg/JointTrajectory", header=header, joint_names=["hub"], points=points
    )


CASES = {
    "sensor_msgs/msg/JointState": _joints,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/Range": _range,
    "trajectory_msgs/msg/JointTrajectory": _trajectory,
}


def _values(message, path):
    """All values of a field, as a person would collect them."""
    head, _, rest = path.partition(".")
    value = getattr(message, head)
    if not rest:
        return np.atleast_1d(value).tolist()
    parts = value if isinstance(value, list) else [value]
    return [number for part in parts for number in _values(part, rest)]


def _block(messages, type_name):
    data = [TYPES.serialize(message, type_name) for message in messages]
    sizes = np.array([len(item) for item in data])
    starts = 3 + np.cumsum(sizes) - sizes  # the buffer begins anywhere
    buffer = np.frombuffer(b"abc" + b"".join(data), dtype=np.uint8)
    return Block(TypedTopic("/x", type_name), buffer, starts, sizes, np.arange(len(data)))


@pytest.mark.parametrize("type_name", CASES)
def test_every_number_of_every_message_is_where_rosbags_finds_it(type_name):
    rng = np.random.default_rng(5)
    messages = [CASES[type_name](rng) for _ in range(9)]
    (alike, alone) = Shapes(STORE, type_name).sort(_block(messages, type_name))
    assert not len(alone)
    np.testing.assert_array_equal(alike.numbers, np.arange(9))
    assert alike.layout.paths
    for path in alike.layout.paths:
        np.testing.assert_array_equal(
            alike.layout.numbers(path, alike.rows), [_values(message, path) for message in messages]
        )


def test_messages_of_several_shapes_in_one_block_are_told_apart():
    rng = np.random.default_rng(6)
    names = [("a", "bcd"), ("b", "acd"), ("long name", "y")]
    of = rng.integers(3, size=60)
    messages = [_joints(rng, names[k]) for k in of]
    found = list(
        Shapes(STORE, "sensor_msgs/msg/JointState").sort(_block(messages, "sensor_msgs/msg/JointState"))
    )
    shapes = [part for part in found if isinstance(part, Alike)]
    assert sorted(tuple(part.numbers) for part in shapes) == sorted(
        tuple(np.flatnonzero(of == k)) for k in range(3)
    )
    assert not len(found[-1])
    for part in shapes:
        np.testing.assert_array_equal(
            part.layout.numbers("position", part.rows), [messages[k].position for k in part.numbers]
        )


def _form(data):
    """What a shape stands for: texts and lengths, as rosbags reads them; None where it reads nothing."""
    try:
        message = TYPES.deserialize(data, "sensor_msgs/msg/JointState")
    except Exception:  # noqa: BLE001 - damaged bytes lead rosbags anywhere
        return None
    lengths = [len(values) for values in (message.position, message.velocity, message.effort)]
    return message.header.frame_id, message.name, lengths


def test_a_flipped_bit_leaves_the_shape_where_it_changes_a_text_or_a_length_and_only_there():
    data = TYPES.serialize(_joints(np.random.default_rng(7)), "sensor_msgs/msg/JointState")
    layout = Layout(STORE, "sensor_msgs/msg/JointState", data)
    topic = TypedTopic("/x", "")
    for k in range(4, len(data)):
        flipped = bytearray(data)
        flipped[k] ^= 1
        buffer = np.frombuffer(bytes(flipped), np.uint8)
        block = Block(topic, buffer, np.array([0]), np.array([len(data)]), np.zeros(1, dtype=np.int64))
        (fits,) = layout.fits(layout.rows(block, np.array([0])))
        # The zero behind a text is part of it here; rosbags does not look at it.
        is_end = data[k] == 0 and data[k - 1 : k].isalpha()
        assert fits == (_form(bytes(flipped)) == _form(data) and not is_end), k


@pytest.mark.parametrize("length", [0, 4, 11, 40, 60])
def test_a_cut_message_has_no_layout(length):
    data = TYPES.serialize(_joints(np.random.default_rng(8)), "sensor_msgs/msg/JointState")
    with pytest.raises(MessageDecodeError):
        Layout(STORE, "sensor_msgs/msg/JointState", data[:length])


def test_another_byte_order_has_no_layout():
    data = TYPES.serialize(_joints(np.random.default_rng(8)), "sensor_msgs/msg/JointState")
    with pytest.raises(MessageDecodeError, match="little-endian"):
        Layout(STORE, "sensor_msgs/msg/JointState", b"\0\0" + data[2:])
