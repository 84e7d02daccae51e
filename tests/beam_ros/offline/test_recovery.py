"""Recovery: whatever was wholly written comes back, in order and to the bit; the source is left as it is."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from beam_ros import messages
from beam_ros.bags.errors import BagError, BagExistsError, BagNotFoundError, BagTruncatedError, NotABagError
from beam_ros.bags.mcap_pieces import chunk_content, find_pieces, records_of
from beam_ros.bags.reading import Bag
from beam_ros.bags.recording_mark import is_marked
from beam_ros.bags.writing import BagWriter
from beam_ros.offline.recovery import recover
from tests.beam_ros.bags.small_bags import (
    BATCH,
    START,
    TYPES,
    batch,
    write_experiment,
)
from tests.whole_bags import messages_of_whole_bag


def _killed(tmp_path, *, batches=60, cut=None):
    """Leave a folder as a killed writer leaves it: marked, without an end."""
    writer = BagWriter(tmp_path / "run")
    for k in range(batches):
        writer.write_batch("hub/measured", START + k * 20_000_000, batch(k))
    writer.flush()
    killed = tmp_path / "killed"
    shutil.copytree(tmp_path / "run", killed)
    writer.discard()
    file = killed / "run_0.mcap"
    if cut is not None:
        file.write_bytes(file.read_bytes()[:cut])
    return killed


def test_a_killed_recording_comes_back_whole(tmp_path):
    killed = _killed(tmp_path)
    before = (killed / "run_0.mcap").read_bytes()
    report = recover(killed)
    assert report.target == tmp_path / "killed_recovered"
    assert report.message_count == 60
    assert not report.was_whole
    assert report.lost_bytes == 0
    with Bag(report.target) as bag:
        samples = bag.hub_samples()
    np.testing.assert_array_equal(samples.positions, np.arange(60 * BATCH) * 1e-6)
    assert (killed / "run_0.mcap").read_bytes() == before
    assert is_marked(killed)
    assert len(messages_of_whole_bag(report.target)) == 60


@pytest.mark.slow
def test_every_cut_gives_a_prefix_or_a_refusal(tmp_path):
    size = (_killed(tmp_path) / "run_0.mcap").stat().st_size
    counts = []
    for number, cut in enumerate(np.linspace(1, size, 40, dtype=int)):
        folder = tmp_path / str(number)
        killed = _killed(folder, cut=cut)
        try:
            report = recover(killed, folder / "saved")
        except BagError:
            assert not (folder / "saved").exists()
            counts.append(0)
            continue
        with Bag(report.target) as bag:
            positions = bag.hub_samples().positions
        np.testing.assert_array_equal(positions, np.arange(len(positions)) * 1e-6)
        counts.append(report.message_count)
    assert counts == sorted(counts)
    # A torn chunk gives the messages before the tear, so cuts half a chunk apart differ.
    assert len(set(counts)) > 20
    assert counts[-1] == 60


def test_a_chunk_with_a_flipped_bit_is_left_out_and_named(tmp_path):
    path = write_experiment(tmp_path / "run", batches=100)
    file = path / "run_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 4
    file.write_bytes(bytes(data))
    report = recover(path)
    (remark,) = report.remarks
    assert "has a wrong checksum" in remark
    assert sum(report.lost.values()) == 100 * 4 + 14 - report.message_count
    assert 0 < report.message_count < 100 * 4 + 14
    with Bag(report.target) as bag:
        assert len(bag.hub_samples().gaps) == 1


def test_times_and_qualities_of_service_survive(tmp_path):
    killed = _killed(tmp_path)
    report = recover(killed)
    with Reader(report.target) as reader:
        (connection,) = reader.connections
        assert connection.ext.offered_qos_profiles[0].depth == 1000
        assert next(reader.messages())[1] == START
    with (report.target / "killed_recovered_0.mcap").open("rb") as stream:
        _, _, message = next(make_reader(stream).iter_messages())
    assert message.publish_time == START


def test_a_whole_bag_is_said_to_be_whole(tmp_path):
    report = recover(write_experiment(tmp_path / "run"), tmp_path / "copy")
    assert report.was_whole
    assert report.message_count == 209


@pytest.mark.parametrize("compression", list(CompressionType))
def test_compressed_recordings_of_others_are_read(tmp_path, compression):
    file = tmp_path / "other.mcap"
    with file.open("wb") as stream:
        writer = McapWriter(stream, compression=compression, chunk_size=2000)
        writer.start("ros2")
        definition, _ = TYPES.store.generate_msgdef("std_msgs/msg/String", ros_version=2)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", definition.encode())
        channel = writer.register_channel("/text", "cdr", schema)
        custom = writer.register_channel("/custom", "cdr", writer.register_schema("a/msg/B", "ros2msg", b""))
        data = TYPES.serialize(messages.json_text(TYPES, {"k": 1}), "std_msgs/msg/String")
        for k in range(300):
            writer.add_message(channel, START + k, data, START + k)
        writer.add_message(custom, START, b"0000", START)
        writer.flush()
    report = recover(file)
    assert report.target == tmp_path / "other_recovered"
    assert report.message_count == 300
    assert any("a/msg/B" in remark for remark in report.remarks)


def test_sqlite_without_metadata_is_rewritten(tmp_path):
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=TYPES.store)
        data = TYPES.serialize(messages.json_text(TYPES, {"k": 1}), "std_msgs/msg/String")
        writer.write(connection, START, data)
    (tmp_path / "run" / "metadata.yaml").unlink()
    assert recover(tmp_path / "run").message_count == 1


def test_refusals(tmp_path):
    with pytest.raises(BagNotFoundError):
        recover(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(NotABagError):
        recover(tmp_path / "empty")
    (tmp_path / "fake.mcap").write_bytes(b"no recording")
    with pytest.raises(NotABagError, match="does not begin"):
        recover(tmp_path / "fake.mcap")
    assert not (tmp_path / "fake_recovered").exists()
    killed = _killed(tmp_path)
    recover(killed)
    with pytest.raises(BagExistsError):
        recover(killed)
    writer = BagWriter(tmp_path / "live")
    with pytest.raises(BagTruncatedError, match="still being recorded"):
        recover(tmp_path / "live")
    writer.close()


def _write_bytes(folder, data, metadata=None):
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(data)
    if metadata is not None:
        shutil.copy(metadata, folder)
    return folder


def _chunk_counts(data):
    """How many messages each chunk of a whole file holds, in the order of the file."""
    return [
        (chunk, sum(opcode == Opcode.MESSAGE for opcode, _ in records_of(chunk_content(data, chunk))))
        for chunk in find_pieces(data).chunks
    ]


def _damaged_copies(data, chunks, random):
    """Yield bits flipped anywhere and in what holds the chunks together, cuts, and blocks of zeros."""
    places = [int(random.integers(len(data))) for _ in range(15)]
    for _ in range(10):
        chunk, _ = chunks[random.integers(len(chunks))]
        places += [
            chunk.start + int(random.integers(60)),
            min(chunk.end + int(random.integers(150)), len(data) - 1),
        ]
    places += [0, 5, 12, 40, len(data) - 20, len(data) - 2000]
    for place in places:
        copy = bytearray(data)
        copy[place] ^= 1 << int(random.integers(8))
        yield f"bit in byte {place}", bytes(copy)
    for cut in random.integers(1, len(data), 10):
        yield f"cut at {cut}", data[:cut]
    for place in random.integers(0, len(data), 5):
        yield f"zeros from {place}", data[:place] + bytes(4096) + data[place + 4096 :]
    # Eight blocks at once, the names of all topics and the summary among them.
    copy = bytearray(data)
    for place in [300, len(data) - 4096, *map(int, random.integers(0, len(data) - 4096, 6))]:
        copy[place : place + 4096] = bytes(4096)
    yield "zeros everywhere", bytes(copy)


@pytest.mark.slow
def test_damage_costs_what_it_hit_and_is_counted(tmp_path):
    run = write_experiment(tmp_path / "run", batches=400)
    data = (run / "run_0.mcap").read_bytes()
    chunks = _chunk_counts(data)
    assert len(chunks) > 15
    total = sum(count for _, count in chunks)
    copies = _damaged_copies(data, chunks, np.random.default_rng(1))
    for number, (name, damaged) in enumerate(copies):
        folder = _write_bytes(tmp_path / str(number), damaged, run / "metadata.yaml")
        whole = sum(n for c, n in chunks if damaged[c.start : c.end] == data[c.start : c.end])
        try:
            report = recover(folder)
        except BagTruncatedError:
            assert whole == 0, name
            continue
        assert report.message_count >= 0.98 * whole, (name, report)
        assert report.is_complete == (report.message_count == total), (name, report)
        assert sum(report.lost.values()) == total - report.message_count, (name, report)


def test_a_killed_recording_whose_first_chunk_is_damaged_keeps_its_names(tmp_path):
    writer = BagWriter(tmp_path / "run")
    for k in range(100):
        writer.write_batch("hub/measured", START + k * 20_000_000, batch(k))
        writer.write_batch("hub/applied", START + k * 20_000_000, batch(k))
    writer.flush()
    data = bytearray(writer.file.read_bytes())
    writer.discard()
    data[200] ^= 1
    report = recover(_write_bytes(tmp_path / "killed", bytes(data)))
    with Bag(report.target) as bag:
        assert bag.count("hub/measured") > 70
        assert bag.count("hub/applied") > 70
    assert set(report.lost) == {"/hub/applied", "/hub/measured"}
    assert sum(report.lost.values()) == 200 - report.message_count


def test_info_and_recover_say_the_same(tmp_path):
    run = write_experiment(tmp_path / "run", batches=100)
    data = bytearray((run / "run_0.mcap").read_bytes())
    with Bag(run) as bag:
        assert not list(bag.damage())
    index = find_pieces(bytes(data)).chunks[1].end
    data[index + 1] ^= 1  # the length of an index, which no reader of messages looks at
    (run / "run_0.mcap").write_bytes(bytes(data))
    with Bag(run) as bag:
        assert bag.count("hub/measured") == 100
        said = list(bag.damage())
    report = recover(run)
    assert said == report.remarks
    assert f"from byte {index}" in said[0]
    assert report.is_complete
    assert not report.was_whole
