"""A bag as two independent libraries judge it: what `mcap doctor` checks, by `mcap`, and the same by `rosbags`."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

_END = 8 + 4  # the last magic, and the checksum of the summary before it


def messages_of_whole_bag(path: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, receive time and bytes of every message of a folder that both libraries find whole.

    Raises
    ------
    AssertionError
        Checksums, counts or indexes of a file are wrong, or the libraries do not read the same.
    McapError
        A file has no end, or a record that is none.
    """
    with Reader(path) as reader:
        by_rosbags = [(row.topic, receive_ns, bytes(data)) for row, receive_ns, data in reader.messages()]
        counted = {row.topic: row.msgcount for row in reader.connections}
        assert reader.message_count == len(by_rosbags)
    by_mcap = [message for file in sorted(path.glob("*.mcap")) for message in _messages_of_whole_file(file)]
    assert sorted(by_mcap) == sorted(by_rosbags)
    seen = Counter(topic for topic, *_ in by_mcap)
    assert counted == {topic: seen[topic] for topic in counted}
    return by_mcap


def _messages_of_whole_file(file: Path) -> list[tuple[str, int, bytes]]:
    with file.open("rb") as stream:
        # Front to back, as after a loss of the summary.
        records = list(StreamReader(stream, validate_crcs=True).records)
        stream.seek(0)
        chunks = [row for row in StreamReader(stream, emit_chunks=True).records if isinstance(row, Chunk)]
        stream.seek(0)
        indexed = make_reader(stream, validate_crcs=True)
        by_index = [(channel.topic, row.log_time, row.data) for _, channel, row in indexed.iter_messages()]
        summary = indexed.get_summary()
    assert isinstance(records[0], Header)
    assert records[0].profile == "ros2"
    assert summary is not None
    statistics = summary.statistics
    assert isinstance(statistics, Statistics)
    (end,) = (row for row in records if isinstance(row, DataEnd))
    (footer,) = (row for row in records if isinstance(row, Footer))
    assert all(row.uncompressed_crc for row in chunks)
    assert footer.summary_crc == zlib.crc32(file.read_bytes()[footer.summary_start : -_END])
    assert struct.pack("<I", footer.summary_crc) == file.read_bytes()[-_END:-8]

    before_summary = records[: records.index(end)]
    schemas = {row.id: row for row in before_summary if isinstance(row, Schema)}
    channels = {row.id: row for row in before_summary if isinstance(row, Channel)}
    assert summary.schemas == schemas
    assert summary.channels == channels
    assert all(row.schema_id in schemas and row.message_encoding == "cdr" for row in channels.values())
    messages = [row for row in records if isinstance(row, Message)]
    by_stream = [(channels[row.channel_id].topic, row.log_time, row.data) for row in messages]
    assert sorted(by_stream) == sorted(by_index)
    assert statistics.message_count == len(messages)
    counts = Counter(row.channel_id for row in messages)
    assert {number: n for number, n in statistics.channel_message_counts.items() if n} == counts
    assert statistics.chunk_count == len(summary.chunk_indexes) == len(chunks)
    assert (statistics.schema_count, statistics.channel_count) == (len(schemas), len(channels))
    times = [row.log_time for row in messages] or [0]
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    return by_index
