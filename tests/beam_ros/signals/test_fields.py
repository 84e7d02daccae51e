"""Numbers from any message type, out of bags that others wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from beam_ros.bags.errors import BagError, MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.errors import UsageError
from beam_ros.signals.fields import find_topic, read_field
from tests.beam_ros.bags.small_bags import write_experiment
from tests.beam_ros.signals import foreign_bags as foreign

MS = 1_000_000


def ramp(n: int = 40) -> list[foreign.Row]:
    """A joint and an accelerometer whose values are their index."""
    rows: list[foreign.Row] = []
    for k in range(n):
        stamp = foreign.START + k * 10 * MS
        rows.append(("/a/joint_states", stamp + MS, foreign.joint_state(stamp, lift=-1.0, axis=float(k))))
        rows.append(("/a/imu", stamp + MS, foreign.imu(stamp, 2.0 * k)))
        rows.append(("/a/pressure", stamp + MS, foreign.float64(3.0 * k)))
    return rows


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_every_storage_gives_the_same_samples(tmp_path: Path, storage: StoragePlugin) -> None:
    path = foreign.write(tmp_path / "bag", ramp(), storage)
    with Bag(path) as bag:
        axis = read_field(bag, "/a/joint_states", "position[axis]")
        imu = read_field(bag, "imu", "linear_acceleration.x")
        number = read_field(bag, "/a/joint_states", "position[1]")
    assert axis.stamps_ns.tolist() == [foreign.START + k * 10 * MS for k in range(40)]
    assert axis.values.tolist() == number.values.tolist() == list(range(40))
    assert imu.topic == "/a/imu"
    assert imu.values.tolist() == list(range(0, 80, 2))
    assert axis.has_own_stamps
    assert axis.notes(0) == []


def test_a_bag_compressed_by_message_gives_the_same_samples(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=foreign.STORE)
        for k in range(10):
            data = foreign.STORE.serialize_cdr(
                foreign.imu(foreign.START + k, float(k)), "sensor_msgs/msg/Imu"
            )
            writer.write(connection, foreign.START + k, data)
    with Bag(path) as bag:
        assert read_field(bag, "/imu", "linear_acceleration.x").values.tolist() == list(range(10))


def test_a_type_without_header_has_receive_times_and_says_so(tmp_path: Path) -> None:
    with Bag(foreign.write(tmp_path / "bag", ramp())) as bag:
        found = read_field(bag, "/a/pressure", "data")
    assert not found.has_own_stamps
    assert found.stamps_ns[0] == foreign.START + MS
    assert found.values[3] == 9.0
    assert "no stamps" in found.notes(0)[0]


def test_the_definition_in_the_bag_reads_a_type_that_nobody_else_knows(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    name = "acme_msgs/msg/Strain"
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32[2] gauges\nstring unit\n", name))
    for storage in StoragePlugin:
        path = tmp_path / storage.name
        with Writer(path, version=9, storage_plugin=storage) as writer:
            connection = writer.add_connection("/strain", name, typestore=store)
            for k in range(5):
                gauges = np.array([k, 10 * k], dtype=np.float32)
                message = store.types[name](foreign.header(foreign.START + k), gauges, "um/m")
                writer.write(connection, foreign.START + k, store.serialize_cdr(message, name))
        with Bag(path) as bag:
            assert read_field(bag, "/strain", "gauges[1]").values.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0]
            with pytest.raises(UsageError, match=r"gauges\[\]"):
                read_field(bag, "/strain", "gages[1]")


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("positon[axis]", r"did you mean position\[\]"),
        ("position[axi]", "did you mean axis"),
        ("position", r"list of 2: say which, position\[0\]"),
        ("header.frame_id", "no number"),
        ("position[axis", "is no path"),
        ("name[0]", "no number"),
    ],
)
def test_a_wrong_field_is_refused_with_those_that_are_there(tmp_path: Path, field: str, words: str) -> None:
    with Bag(foreign.write(tmp_path / "bag", ramp(3))) as bag, pytest.raises(UsageError, match=words):
        read_field(bag, "/a/joint_states", field)


def test_a_missing_topic_is_refused_with_the_likeliest_one(tmp_path: Path) -> None:
    with Bag(foreign.write(tmp_path / "bag", ramp(3))) as bag:
        with pytest.raises(MissingTopicsError, match="did you mean /a/joint_states"):
            find_topic(bag, "/a/joint_state")
        assert find_topic(bag, "imu") == ("/a/imu", "sensor_msgs/msg/Imu")


def test_samples_without_stamps_are_counted_and_none_with_stamps_is_an_error(tmp_path: Path) -> None:
    def rows(stamps: list[int]) -> list[tuple[str, int, Any]]:
        return [("/imu", foreign.START + k, foreign.imu(stamp, 1.0)) for k, stamp in enumerate(stamps)]

    some = foreign.write(tmp_path / "some", rows([0, foreign.START, foreign.START + MS]))
    with Bag(some) as bag:
        found = read_field(bag, "/imu", "linear_acceleration.x")
    assert len(found.values) == 2
    assert "1 messages have stamp 0" in found.notes(0)[0]
    none = foreign.write(tmp_path / "none", rows([0, 0]))
    with Bag(none) as bag, pytest.raises(BagError, match="2 with stamp 0"):
        read_field(bag, "/imu", "linear_acceleration.x")


def test_batches_of_the_hub_are_fields_too(tmp_path: Path) -> None:
    with Bag(write_experiment(tmp_path / "bag", batches=5, namespace="rig7")) as bag:
        found = read_field(bag, "hub/measured", "positions")
        assert found.values == pytest.approx(1e-6 * np.arange(100))
        with pytest.raises(UsageError, match="carries no efforts"):
            read_field(bag, "hub/measured", "efforts")
        second = read_field(bag, "beam/displacement", "position[z225]")
    assert second.values == pytest.approx(2e-4 * np.arange(10))
