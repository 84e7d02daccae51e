"""Blocks: what is wanted of a bag is read by its indexes, and nothing else."""

from __future__ import annotations

import io

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Reader

from beam_ros import messages
from beam_ros.bags.blocks import ChunkedFile, IndexedBag, ScannedBag, Span, TypedTopic
from beam_ros.bags.errors import BagTruncatedError, MissingTopicsError
from beam_ros.bags.reading import Bag
from tests.beam_ros.bags.small_bags import START, TYPES, write_experiment

STRING = "std_msgs/msg/String"
SECOND = 1_000_000_000


class CountedFile(io.BytesIO):
    """A file that counts what is read of it."""

    n_read = 0

    def read(self, size=-1):
        data = super().read(size)
        self.n_read += len(data)
        return data


def write_mcap(stream, rows, *, compression=CompressionType.NONE, chunk_size=4096, **options):
    """Write (topic, time, bytes) in this order, whatever the times."""
    writer = Writer(stream, compression=compression, chunk_size=chunk_size, **options)
    writer.start(profile="ros2", library="test")
    definition, _ = TYPES.store.generate_msgdef(STRING, ros_version=2)
    schema = writer.register_schema(STRING, "ros2msg", definition.encode())
    channels = {}
    for topic, at_ns, data in rows:
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channels[topic], at_ns, data, at_ns)
    writer.finish()


def text(number, size=10):
    """A String that says a number, of about so many bytes."""
    return TYPES.serialize(messages.json_text(TYPES, {"n": number, "fill": "x" * size}), STRING)


def said(source, topics, span=None):
    """Topic, time and bytes of what a bag's hauls hold."""
    wanted = {TypedTopic(topic, STRING): span or Span() for topic in topics}
    return [
        (block.topic.name, int(block.receive_ns[k]), block.message(k))
        for haul in source.hauls(wanted)
        for block in haul.blocks
        for k in range(len(block.starts))
    ]


def some_rows(count=400, seed=1):
    rng = np.random.default_rng(seed)
    topics = rng.choice(["/a", "/b", "/c"], size=count)
    times = START + np.sort(rng.integers(10 * SECOND, size=count))
    return [(str(topics[k]), int(times[k]), text(k, int(rng.integers(60)))) for k in range(count)]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_what_was_written_is_read_topic_by_topic(compression):
    rows = some_rows()
    file = io.BytesIO()
    write_mcap(file, rows, compression=compression)
    bag = IndexedBag([ChunkedFile(file)])
    assert sorted(said(bag, ["/a", "/c"])) == sorted(row for row in rows if row[0] != "/b")


def test_a_span_takes_its_beginning_and_leaves_its_end():
    rows = [("/a", START + k, text(k)) for k in range(100)]
    file = io.BytesIO()
    write_mcap(file, rows, chunk_size=500)
    got = said(IndexedBag([ChunkedFile(file)]), ["/a"], Span(START + 20, START + 50))
    assert got == rows[20:50]


def test_chunks_without_what_is_wanted_are_not_read():
    rows = [("/a" if 10 <= k < 12 else "/b", START + k * SECOND, text(k, 50_000)) for k in range(40)]
    file = CountedFile()
    write_mcap(file, rows, chunk_size=60_000)
    chunked = ChunkedFile(file)
    file.n_read = 0
    assert len(said(IndexedBag([chunked]), ["/a"])) == 2
    assert file.n_read < 250_000  # of 2 MB
    file.n_read = 0
    assert len(said(IndexedBag([chunked]), ["/b"], Span(START + 30 * SECOND, START + 33 * SECOND))) == 3
    assert file.n_read < 300_000


def test_of_large_chunks_only_the_wanted_part_is_read():
    rows = []
    for k in range(60):
        rows.append(("/image", START + 3 * k, text(k, 300_000)))
        rows += [("/u", START + 3 * k + j, text(10 * k + j)) for j in (1, 2)]
    file = CountedFile()
    write_mcap(file, rows, chunk_size=5_000_000)
    chunked = ChunkedFile(file)
    file.n_read = 0
    got = said(IndexedBag([chunked]), ["/u"])
    assert got == [row for row in rows if row[0] == "/u"]
    assert file.n_read < 50_000  # of 18 MB


def test_messages_of_overlapping_chunks_come_in_the_order_of_their_times(tmp_path):
    rows = some_rows()
    rng = np.random.default_rng(3)
    late = [row for k, row in enumerate(rows) if k % 7 == 0]
    mixed = [row for k, row in enumerate(rows) if k % 7] + [late[k] for k in rng.permutation(len(late))]
    with (tmp_path / "run.mcap").open("wb") as file:
        write_mcap(file, mixed, chunk_size=2000)
    with Bag(tmp_path / "run.mcap") as bag, Reader(tmp_path / "run.mcap") as reader:
        ours = [(m.topic, m.receive_ns, m.data) for m in bag.raw_messages()]
        theirs = [(c.topic, at_ns, data) for c, at_ns, data in reader.messages()]
    assert [row[1] for row in ours] == [row[1] for row in theirs]
    assert sorted(ours) == sorted(theirs) == sorted(rows)


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"index_types": IndexType.NONE}])
def test_files_without_an_index_are_read_all_the_same(tmp_path, options):
    rows = some_rows(60)
    with (tmp_path / "run.mcap").open("wb") as file:
        write_mcap(file, rows, **options)
    with (tmp_path / "run.mcap").open("rb") as file:
        assert not ChunkedFile(file).is_indexed
    with Bag(tmp_path / "run.mcap") as bag:
        assert [(m.topic, m.receive_ns, m.data) for m in bag.raw_messages("/a")] == [
            row for row in rows if row[0] == "/a"
        ]
    with Reader(tmp_path / "run.mcap") as reader:
        assert sorted(said(ScannedBag(reader), ["/b"])) == sorted(row for row in rows if row[0] == "/b")


def test_a_flipped_bit_in_a_chunk_or_an_index_is_noticed():
    rows = some_rows(200)
    file = io.BytesIO()
    write_mcap(file, rows)
    whole = file.getvalue()
    chunked = ChunkedFile(io.BytesIO(whole))
    first, last = chunked.chunks[0], chunked.chunks[-1]
    end = last.chunk_start_offset + last.chunk_length + last.message_index_length
    rng = np.random.default_rng(4)
    for place in rng.integers(first.chunk_start_offset, end, size=150).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        source = IndexedBag([ChunkedFile(io.BytesIO(bytes(damaged)))])
        try:
            got = said(source, ["/a", "/b", "/c"])
        except BagTruncatedError:
            continue
        # Times and lengths that a chunk says of itself are said again by its index.
        assert sorted(got) == sorted(rows), place


def test_a_bag_in_parts_is_read_as_one(tmp_path):
    path = write_experiment(tmp_path / "run")
    with Bag(path) as bag:
        whole = bag.hub_samples()
        part = Bag(path, start_s=0.2, end_s=0.6)
        samples = part.hub_samples()
        assert part.excitation_info() == {"kind": "chirp", "seed": 1}  # latched: said before, and still true
        part.close()
    first = int(np.flatnonzero(whole.positions == samples.positions[0])[0])
    np.testing.assert_array_equal(samples.positions, whole.positions[first : first + len(samples.positions)])
    assert len(samples.positions) == pytest.approx(400, abs=20)


def test_a_time_behind_the_end_is_refused(tmp_path):
    path = write_experiment(tmp_path / "run", batches=5)
    with pytest.raises(MissingTopicsError, match="nothing after 2 s"):
        Bag(path, start_s=2.0)
