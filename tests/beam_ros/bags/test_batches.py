"""The fast codec agrees with rosbags and rclpy on every layout, and refuses what is no batch."""

from __future__ import annotations

import timeit

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from beam_ros import messages
from beam_ros.bags import batches
from beam_ros.bags.batches import (
    decode_batch,
    decode_chunk,
    decode_trajectory,
    encode_batch,
    encode_chunk,
    encode_trajectory,
    faulty_chunk,
)
from beam_ros.bags.errors import MessageDecodeError
from beam_ros.hub.contract import SampleBatch, SequenceChunk
from beam_ros.interfaces.graph import JOINT_TRAJECTORY
from beam_ros.messages import BATCH_FIELDS, BagTypes, RosTypes
from beam_ros.messages.stamps import header

STAMP = 1_700_000_000_999_999_999
TYPES = BagTypes()


def _assert_equal(one: SampleBatch, other: SampleBatch) -> None:
    assert (one.stamp_ns, one.period_ns, one.epoch) == (other.stamp_ns, other.period_ns, other.epoch)
    for name in BATCH_FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@st.composite
def _batches(draw):
    count = draw(st.integers(1, 60))
    chosen = draw(st.lists(st.sampled_from(sorted(BATCH_FIELDS)), min_size=1, unique=True))
    # Any float at all: NaN and infinities travel too.
    columns = {name: draw(hnp.arrays(np.float64, count)) for name in chosen}
    epoch = draw(st.integers(0, 10**9))  # its digits move the points to every place modulo 8
    period = draw(st.integers(1, 3_000_000_000))
    return SampleBatch(draw(st.integers(1, 2**31 * 10**9 - 1)), period, epoch, **columns)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(_batches())
def test_bytes_equal_those_of_rosbags_for_every_layout(batch):
    assert encode_batch(batch) == TYPES.serialize(messages.trajectory_batch(TYPES, batch), JOINT_TRAJECTORY)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(_batches())
def test_decode_inverts_encode_without_the_fallback(batch):
    data = encode_batch(batch)
    assert batches._decode(data) is not None
    _assert_equal(decode_batch(data), batch)


@pytest.mark.ros
def test_rclpy_and_the_codec_read_each_other():
    serialization = pytest.importorskip("rclpy.serialization")
    ros = RosTypes()
    full = {name: np.random.default_rng(2).normal(size=20) for name in BATCH_FIELDS}
    batch = SampleBatch(STAMP, 1_000_000, 1, **full)
    theirs = serialization.serialize_message(messages.trajectory_batch(ros, batch))
    _assert_equal(decode_batch(theirs), batch)
    assert batches._decode(theirs) is not None
    back = serialization.deserialize_message(encode_batch(batch), ros.message_class(JOINT_TRAJECTORY))
    _assert_equal(messages.read_trajectory_batch(back), batch)


def test_big_endian_bytes_go_through_the_fallback():
    batch = SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(5.0))
    message = messages.trajectory_batch(TYPES, batch)
    data = bytes(TYPES.store.serialize_cdr(message, JOINT_TRAJECTORY, little_endian=False))
    assert data[1] == 0
    assert batches._decode(data) is None
    _assert_equal(decode_batch(data), batch)


def test_trailing_bytes_of_a_serialiser_do_no_harm():
    batch = SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(5.0))
    _assert_equal(decode_batch(encode_batch(batch) + b"\0\0\0"), batch)


def test_ragged_points_are_refused_by_name():
    message = messages.trajectory_batch(TYPES, SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(5.0)))
    message.points[3].velocities = np.array([1.0])
    with pytest.raises(MessageDecodeError, match="velocities"):
        decode_batch(TYPES.serialize(message, JOINT_TRAJECTORY))


def test_every_truncation_is_refused_and_nothing_else_is_raised():
    data = encode_batch(SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(4.0), efforts=np.arange(4.0)))
    for length in range(len(data)):
        with pytest.raises(MessageDecodeError):
            decode_batch(data[:length])


def test_every_flipped_bit_gives_a_batch_or_a_refusal():
    data = encode_batch(SampleBatch(STAMP, 1_000_000, 1, velocities=np.arange(3.0)))
    outcomes = {"read": 0, "refused": 0}
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            decode_batch(bytes(damaged))
        except MessageDecodeError:
            outcomes["refused"] += 1
        else:
            outcomes["read"] += 1
    # Values and stamps have no redundancy; counts, times and names do.
    assert outcomes["read"] > 3 * 64
    assert outcomes["refused"] > 300


@pytest.mark.parametrize("mode", sorted(messages.MODE_FIELDS))
def test_chunks_round_trip_and_equal_rosbags(mode):
    for chunk in messages.split_sequence("chirp-20s", STAMP, 1_000_000, np.linspace(-1, 1, 1203)):
        data = encode_chunk(chunk, mode)
        message = messages.sequence_chunk(TYPES, chunk, mode)
        assert data == TYPES.serialize(message, JOINT_TRAJECTORY)
        read_mode, read = decode_chunk(data, 1_000_000)
        assert read_mode == mode
        np.testing.assert_array_equal(read.values, chunk.values)
        assert (read.sequence_id, read.index, read.count, read.start_ns, read.first_tick) == (
            chunk.sequence_id,
            chunk.index,
            chunk.count,
            chunk.start_ns,
            chunk.first_tick,
        )


def test_a_batch_is_no_chunk_and_says_so():
    data = encode_batch(SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(4.0)))
    with pytest.raises(MessageDecodeError, match="<id> <k>/<n>"):
        decode_chunk(data, 1_000_000)


def test_a_chunk_of_another_grid_is_refused():
    data = encode_chunk(SequenceChunk("c", 1, 1, STAMP, 1_000_000, 0, np.array([1.0])), "position")
    with pytest.raises(MessageDecodeError, match="multiples"):
        decode_chunk(data, 0)


def test_bytes_that_are_no_chunk_still_name_their_sequence_where_they_can():
    chunk = SequenceChunk("run-7", 2, 3, 1_700_000_000_000_000_007, 1_000_000, 500, np.arange(9.0))
    data = encode_chunk(chunk, "velocity")
    with pytest.raises(MessageDecodeError):
        decode_chunk(data[:-40], 1_000_000)
    faulty = faulty_chunk(data[:-40], "cut off")
    assert (faulty.sequence_id, faulty.start_ns, faulty.fault) == ("run-7", chunk.start_ns, "cut off")
    assert len(faulty.values) == 0
    for n_bytes in range(len(data)):
        assert faulty_chunk(data[:n_bytes], "cut off").sequence_id in ("run-7", "")
    for name in ("", "no number", "two words 1/2", "\n 1/2"):
        nameless = encode_chunk(SequenceChunk("x", 1, 1, 1, 1_000_000, 0, np.zeros(2)), "velocity")
        text = name.encode() + b"\0"
        nameless = nameless[:12] + len(text).to_bytes(4, "little") + text + nameless[20:]
        assert faulty_chunk(nameless, "bad name").sequence_id == ""


def test_the_codec_is_much_faster_than_the_general_one():
    batch = SampleBatch(STAMP, 1_000_000, 1, positions=np.arange(20.0), velocities=np.arange(20.0))
    data = encode_batch(batch)

    def best(call):
        return min(timeit.repeat(call, number=200, repeat=5)) / 200

    general = best(lambda: TYPES.deserialize(data, JOINT_TRAJECTORY))
    # Measured: 20 us against 98 us. Half of it leaves room for a busy machine.
    assert best(lambda: decode_batch(data)) < 0.5 * general


@pytest.mark.parametrize("names", [("positions",), ("positions", "velocities")])
def test_a_trajectory_of_somebody_elses_joint_is_what_rosbags_makes_of_it(names) -> None:
    times_ns = np.array([0, 250_000_000, 1_000_000_001], dtype=np.int64)
    columns = {name: np.array([0.5, -1.25, k]) for k, name in enumerate(names)}
    data = encode_trajectory("slider_joint", STAMP, times_ns, columns)
    message = TYPES.deserialize(data, JOINT_TRAJECTORY)
    assert list(message.joint_names) == ["slider_joint"]
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP
    assert TYPES.serialize(message, JOINT_TRAJECTORY) == data
    for name in names:
        assert [getattr(point, name)[0] for point in message.points] == columns[name].tolist()
    stamp, times, back = decode_trajectory(data, "slider_joint")
    assert (stamp, times.tolist(), sorted(back)) == (STAMP, times_ns.tolist(), sorted(names))
    with pytest.raises(MessageDecodeError, match="slider_joint"):
        decode_trajectory(data, "other")
    with pytest.raises(MessageDecodeError):
        decode_trajectory(data[:40], "slider_joint")


def test_an_empty_trajectory_is_read_as_one() -> None:
    empty = TYPES.make(JOINT_TRAJECTORY, header=header(TYPES, 0, ""), joint_names=["j"], points=[])
    stamp, times, columns = decode_trajectory(TYPES.serialize(empty, JOINT_TRAJECTORY), "j")
    assert (stamp, len(times), columns) == (0, 0, {})
