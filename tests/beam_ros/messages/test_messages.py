"""Builders and readers: both families of message classes carry the same content, to the bit."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.errors import RosMissingError
from beam_ros.hub.contract import ClockSync, SampleBatch, SequenceChunk
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes, MessageContentError, RosTypes

STAMP = 1_700_000_000_123_456_789


def _families():
    yield pytest.param(BagTypes, id="bag")
    yield pytest.param(RosTypes, id="ros")


@pytest.fixture(params=_families())
def types(request):
    if request.param is RosTypes:
        pytest.importorskip("rclpy")
    return request.param()


def _batch(**columns):
    return SampleBatch(STAMP, 1_000_000, 3, **columns)


def test_displacement_keeps_names_stamp_and_unseen_markers(types):
    read = messages.read_displacement(messages.displacement(types, STAMP, ("z010", "z225"), [0.1, np.nan]))
    assert read.stamp_ns == STAMP
    assert read.names == ("z010", "z225")
    np.testing.assert_array_equal(read.positions, [0.1, np.nan])


def test_displacement_refuses_unequal_lengths(types):
    with pytest.raises(MessageContentError, match="2 markers"):
        messages.displacement(types, STAMP, ("z010", "z225"), [0.1])


@pytest.mark.parametrize(("names", "positions"), [(["a", "a"], [1, 2]), (["a"], [1, 2]), ([], [])])
def test_displacement_reader_refuses_what_is_no_table(names, positions):
    stamp = SimpleNamespace(sec=1, nanosec=0)
    message = SimpleNamespace(header=SimpleNamespace(stamp=stamp), name=names, position=positions)
    with pytest.raises(MessageContentError, match="expected one position"):
        messages.read_displacement(message)


def test_hub_state_leaves_unknown_quantities_out(types):
    message = messages.hub_state(types, messages.HubSample(STAMP, 0.01, -0.2))
    assert list(message.name) == ["hub"]
    assert len(message.effort) == 0
    read = messages.read_hub_state(message)
    assert (read.stamp_ns, read.position, read.velocity) == (STAMP, 0.01, -0.2)
    assert math.isnan(read.effort)


def test_batch_round_trip(types):
    batch = _batch(positions=np.array([1.0, 2.0]), efforts=np.array([-3.0, 4.0]))
    read = messages.read_trajectory_batch(messages.trajectory_batch(types, batch))
    assert (read.stamp_ns, read.period_ns, read.epoch) == (STAMP, 1_000_000, 3)
    np.testing.assert_array_equal(read.positions, batch.positions)
    np.testing.assert_array_equal(read.efforts, batch.efforts)
    assert read.velocities is None
    assert read.accelerations is None


def test_batch_of_another_suite_tells_its_period_by_its_times(types):
    message = messages.trajectory_batch(types, _batch(positions=np.arange(3.0)))
    message.header.frame_id = "rig"
    read = messages.read_trajectory_batch(message)
    assert (read.period_ns, read.epoch) == (1_000_000, 0)


def test_batch_with_uneven_times_is_refused(types):
    message = messages.trajectory_batch(types, _batch(positions=np.arange(3.0)))
    message.points[2].time_from_start.nanosec += 1
    with pytest.raises(MessageContentError, match="times from its start"):
        messages.read_trajectory_batch(message)


def test_batch_without_values_is_refused(types):
    message = messages.trajectory_batch(types, _batch(positions=np.arange(2.0)))
    for point in message.points:
        point.positions = types.floats(())
    with pytest.raises(MessageContentError, match="empty"):
        messages.read_trajectory_batch(message)


def test_batch_with_ragged_points_is_refused(types):
    message = messages.trajectory_batch(types, _batch(positions=np.arange(2.0)))
    message.points[1].positions = types.floats(())
    with pytest.raises(MessageContentError, match="expected one in every point"):
        messages.read_trajectory_batch(message)


@pytest.mark.parametrize("mode", sorted(messages.MODE_FIELDS))
def test_setpoint_round_trip_in_every_mode(types, mode):
    point = messages.StampedSetpoint(STAMP, mode, 0.25)
    assert messages.read_setpoint(messages.setpoint(types, point)) == point


def test_setpoint_with_two_points_is_refused(types):
    message = messages.trajectory_batch(types, _batch(positions=np.arange(2.0)))
    with pytest.raises(MessageContentError, match="exactly one"):
        messages.read_setpoint(message)


def test_sequence_chunks_round_trip(types):
    values = np.linspace(-1, 1, 1001)
    chunks = messages.split_sequence("chirp-1", STAMP, 2_000_000, values)
    read = [
        messages.read_sequence_chunk(messages.sequence_chunk(types, chunk, "acceleration"), 1_000_000)
        for chunk in chunks
    ]
    assert {mode for mode, _ in read} == {"acceleration"}
    for (_, got), sent in zip(read, chunks, strict=True):
        assert (got.sequence_id, got.index, got.count) == (sent.sequence_id, sent.index, sent.count)
        assert (got.start_ns, got.period_ns, got.first_tick) == (STAMP, 2_000_000, sent.first_tick)
        np.testing.assert_array_equal(got.values, sent.values)


@pytest.mark.parametrize("n", [2, 499, 500, 501, 1000, 1001, 5003])
def test_split_sequence_covers_all_samples_without_single_points(n):
    values = np.arange(n, dtype=float)
    chunks = messages.split_sequence("s", STAMP, 1_000_000, values)
    np.testing.assert_array_equal(np.concatenate([c.values for c in chunks]), values)
    assert [c.first_tick for c in chunks] == [int(c.values[0]) for c in chunks]
    assert all(2 <= len(c.values) <= 500 for c in chunks)
    assert [(c.index, c.count) for c in chunks] == [(k + 1, len(chunks)) for k in range(len(chunks))]


@pytest.mark.parametrize("name", ["", "chirp", "chirp 1", "a chirp 1/2", "chirp 1/x"])
def test_sequence_chunk_with_a_wrong_name_is_refused(types, name):
    chunk = SequenceChunk("chirp", 1, 1, STAMP, 1_000_000, 0, np.arange(2.0))
    message = messages.sequence_chunk(types, chunk, "position")
    message.header.frame_id = name
    with pytest.raises(MessageContentError, match="<id> <k>/<n>"):
        messages.read_sequence_chunk(message, 1_000_000)


def test_sequence_chunk_off_its_grid_is_refused(types):
    chunk = SequenceChunk("chirp", 1, 1, STAMP, 1_000_000, 4, np.arange(2.0))
    message = messages.sequence_chunk(types, chunk, "position")
    for point in message.points:
        point.time_from_start.nanosec += 1
    with pytest.raises(MessageContentError, match="multiples of one period"):
        messages.read_sequence_chunk(message, 1_000_000)


def test_single_point_chunk_takes_the_devices_period(types):
    chunk = SequenceChunk("chirp", 2, 2, STAMP, 1_000_000, 7, np.array([0.5]))
    _, read = messages.read_sequence_chunk(messages.sequence_chunk(types, chunk, "effort"), 1_000_000)
    assert read.first_tick == 7


def test_clock_sync_round_trip(types):
    sync = ClockSync(host_ns=STAMP, device_ns=5_123_456_789, epoch=2, rtt_ns=812_345)
    assert messages.read_clock_sync(messages.clock_sync(types, sync)) == sync


def test_clock_sync_without_epoch_is_refused(types):
    message = messages.clock_sync(types, ClockSync(STAMP, 0, 1, 1))
    message.source = "gps"
    with pytest.raises(MessageContentError, match="epoch"):
        messages.read_clock_sync(message)


def test_json_turns_what_json_does_not_know_into_null(types):
    message = messages.json_text(types, {"a": math.nan, "b": [1.5, math.inf], "c": {"d": "e"}})
    assert json.loads(message.data, parse_constant=lambda word: pytest.fail(word))
    assert messages.read_json(message) == {"a": None, "b": [1.5, None], "c": {"d": "e"}}


@pytest.mark.parametrize("text", ["", "{", "[1]", "NaN", "[" * 100_000])
def test_text_that_is_no_json_object_is_refused(text):
    with pytest.raises(MessageContentError, match="JSON"):
        messages.read_json(SimpleNamespace(data=text))


def _cloud():
    rows = np.zeros(3, dtype=messages.MARKER_DTYPE)
    rows["x"], rows["z"], rows["u"] = [0.1, 0.2, np.nan], [0.01, 0.225, 0.285], [320.25, 1 / 3, np.nan]
    rows["x_m"], rows["sigma_m"], rows["id"], rows["valid"] = 1e-6, 2e-6, [0, 1, 2], [1, 1, 0]
    return messages.MarkerCloud(STAMP, rows)


def test_marker_cloud_keeps_pixels_in_double_precision(types):
    message = messages.marker_cloud(types, _cloud())
    assert (message.point_step, message.row_step, message.width, message.height) == (56, 168, 3, 1)
    assert message.is_dense is False
    read = messages.read_marker_cloud(message)
    assert read.stamp_ns == STAMP
    assert read.rows.tobytes() == _cloud().rows.tobytes()


def test_marker_cloud_is_read_by_the_names_of_its_fields():
    types = BagTypes()
    message = messages.marker_cloud(types, _cloud())
    order = np.random.default_rng(1).permutation(len(message.fields))
    message.fields = [message.fields[k] for k in order]
    assert messages.read_marker_cloud(message).rows.tobytes() == _cloud().rows.tobytes()


def test_marker_cloud_that_is_too_short_or_lacks_a_field_is_refused():
    types = BagTypes()
    message = messages.marker_cloud(types, _cloud())
    message.data = message.data[:-1]
    with pytest.raises(MessageContentError, match="bytes for 3 points"):
        messages.read_marker_cloud(message)
    message = messages.marker_cloud(types, _cloud())
    message.fields = message.fields[1:]
    with pytest.raises(MessageContentError, match="fields"):
        messages.read_marker_cloud(message)
    message = messages.marker_cloud(types, _cloud())
    message.point_step = 40
    with pytest.raises(MessageContentError, match="do not fit"):
        messages.read_marker_cloud(message)


def test_image_is_mono8_with_rows_next_to_each_other(types):
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    message = messages.image(types, STAMP, pixels)
    assert (message.height, message.width, message.step, message.encoding) == (3, 4, 4, "mono8")
    assert bytes(message.data) == pixels.tobytes()
    assert message.header.frame_id == "camera_optical_frame"


def test_image_of_a_slice_is_made_contiguous(types):
    pixels = np.arange(24, dtype=np.uint8).reshape(3, 8)[:, ::2]
    assert bytes(messages.image(types, STAMP, pixels).data) == pixels.tobytes()


def test_camera_info_says_uncalibrated(types):
    message = messages.camera_info(types, STAMP, 640, 480)
    assert (message.width, message.height) == (640, 480)
    assert message.k[0] == 0.0


def test_diagnostics_round_trip(types):
    statuses = (
        messages.Health("hub", "WARN", "late", "usb-1", {"lost": "3"}),
        messages.Health("tracker", "OK", "running"),
    )
    assert messages.read_diagnostics(messages.diagnostics(types, STAMP, statuses)) == statuses


def _one_of_each(types):
    full = {name: np.linspace(0, 1, 20) for name in messages.BATCH_FIELDS}
    yield "trajectory_msgs/msg/JointTrajectory", messages.trajectory_batch(types, _batch(**full))
    yield graph.STRING, messages.json_text(types, {"id": "chirp", "points": 3})
    yield "sensor_msgs/msg/TimeReference", messages.clock_sync(types, ClockSync(STAMP, 17, 1, 900_000))
    yield "sensor_msgs/msg/PointCloud2", messages.marker_cloud(types, _cloud())
    yield "sensor_msgs/msg/Image", messages.image(types, STAMP, np.ones((4, 6), dtype=np.uint8))
    yield "sensor_msgs/msg/CameraInfo", messages.camera_info(types, STAMP, 640, 480)
    health = messages.Health("hub", "ERROR", "gone", "x", {"a": 1})
    yield "diagnostic_msgs/msg/DiagnosticArray", messages.diagnostics(types, STAMP, [health])


@pytest.mark.ros
def test_rclpy_serialises_to_the_same_bytes_as_the_bags_classes_but_for_padding():
    # CDR leaves padding undefined, and rclpy's is what stood in memory: compare after one normalisation.
    # Messages with empty arrays are left to the recorder's tests: serialize_message spoils those.
    serialization = pytest.importorskip("rclpy.serialization")
    bag_types = BagTypes()
    pairs = zip(_one_of_each(bag_types), _one_of_each(RosTypes()), strict=True)
    for (type_name, bag), (_, ros) in pairs:
        ours = bag_types.serialize(bag, type_name)
        theirs = serialization.serialize_message(ros)
        assert len(theirs) - len(ours) in range(4), type_name
        assert bag_types.serialize(bag_types.deserialize(theirs, type_name), type_name) == ours, type_name


def test_a_missing_ros_is_said_with_its_remedy():
    with pytest.raises(RosMissingError, match="source it, or install"):
        RosTypes().message_class("no_such_msgs/msg/Thing")


def test_the_module_imports_neither_rclpy_nor_rosbags():
    code = "import sys, beam_ros.messages; print([m for m in ('rclpy', 'rosbags') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.stdout.strip() == "[]", result.stderr
