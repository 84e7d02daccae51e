"""Messages of a bag, many at a time, as places in a few large buffers.

The indexes of an MCAP file say in which chunks the messages of a topic lie, and where in each of them. Chunks that
hold nothing of what is wanted are never read; neighbours are read in one piece, and of a large chunk of which little
is wanted only that is read. The same ranges serve a file on a disk and an object in a store. What has no such index,
and SQLite, is read by ``rosbags`` and packed in blocks of the same kind.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Schema, Statistics
from rosbags.rosbag2 import Reader

from beam_ros.arrays import ByteArray, IndexArray, StampArray
from beam_ros.bags.errors import BagTruncatedError
from beam_ros.bags.mcap_pieces import HEAD, MAGIC, chunk_at, chunk_content, records_of

READ_AT_ONCE = 8 * 2**20
"""Bytes of chunks that are in memory at a time; a larger chunk is alone."""

_MIN_PARTED = 2**20
"""Chunks below this size [bytes] are read whole and their checksum is compared."""

_NEAR = 64 * 1024
"""Pieces closer than this [bytes] are read as one."""

_MESSAGE_HEAD = 31
"""Opcode, length, channel, number, and two times before the bytes of a message."""

_CHUNK_HEAD_SIZE = 40
"""Times, size, checksum, no compression's name, and length before the records of a chunk."""

_INDEX_HEAD = struct.Struct("<BQHI")

FOREVER_NS = 2**63 - 1


class TypedTopic(NamedTuple):
    """A topic and its type: what a bag may hold several of under one name."""

    name: str
    type_name: str


class Span(NamedTuple):
    """Receive times from ``start_ns`` on and before ``end_ns`` [ns, UNIX]."""

    start_ns: int = 0
    end_ns: int = FOREVER_NS


@dataclass(frozen=True)
class Block:
    """Messages of one topic in one buffer, in the order of the file.

    Attributes
    ----------
    topic : TypedTopic
    data : ndarray of uint8 -- the buffer
    starts, sizes : ndarray of int, shape (n,) -- where each message's CDR bytes begin, and how many they are
    receive_ns : ndarray of int64, shape (n,) -- when each came [ns, UNIX]
    """

    topic: TypedTopic
    data: ByteArray
    starts: IndexArray
    sizes: IndexArray
    receive_ns: StampArray

    def message(self, k: int) -> bytes:
        """Return the CDR bytes of message k."""
        start = self.starts[k]
        return self.data[start : start + self.sizes[k]].tobytes()

    def within(self, span: Span) -> Block:
        """Return those of the messages that came within a span."""
        chosen = (self.receive_ns >= span.start_ns) & (self.receive_ns < span.end_ns)
        if chosen.all():
            return self
        return Block(self.topic, self.data, self.starts[chosen], self.sizes[chosen], self.receive_ns[chosen])


@dataclass(frozen=True)
class Haul:
    """What was read at once: a block for each topic, and before when nothing more can come [ns, UNIX]."""

    blocks: tuple[Block, ...]
    complete_until_ns: int


class ChunkedFile:
    """An MCAP file with an index of its chunks.

    Parameters
    ----------
    stream : binary file -- can be read from any place; it is closed with the object

    Raises
    ------
    BagTruncatedError
        The file's summary contradicts itself.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.topics: dict[int, TypedTopic] = {}
        self.chunks: list[ChunkIndex] = []
        self._message_count: int | None = None
        self._notes: dict[str, MetadataIndex] = {}
        size = stream.seek(0, 2)
        tail = self.read(size - HEAD.size - 20 - len(MAGIC), HEAD.size + 20 + len(MAGIC))
        footer = Footer.read(ReadDataStream(BytesIO(tail[HEAD.size :])))
        if not footer.summary_start:
            return
        summary = self.read(footer.summary_start, size - len(tail) - footer.summary_start)
        schemas: dict[int, str] = {}
        for opcode, record in records_of(summary):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(record)))
                schemas[schema.id] = schema.name
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(record)))
                self.topics[channel.id] = TypedTopic(channel.topic, schemas.get(channel.schema_id, ""))
            elif opcode == Opcode.CHUNK_INDEX:
                self.chunks.append(ChunkIndex.read(ReadDataStream(BytesIO(record))))
            elif opcode == Opcode.METADATA_INDEX:
                note = MetadataIndex.read(ReadDataStream(BytesIO(record)))
                self._notes.setdefault(note.name, note)
            elif opcode == Opcode.STATISTICS:
                self._message_count = Statistics.read(ReadDataStream(BytesIO(record))).message_count

    @property
    def is_indexed(self) -> bool:
        """Whether the indexes lead to every message."""
        if not self.chunks:
            return self._message_count == 0
        return all(chunk.message_index_offsets or not chunk.message_end_time for chunk in self.chunks)

    def note(self, name: str) -> dict[str, str]:
        """Return the first metadata record of a name; empty where there is none."""
        if name not in self._notes:
            return {}
        record = self.read(self._notes[name].offset, self._notes[name].length)
        note: dict[str, str] = Metadata.read(ReadDataStream(BytesIO(record[HEAD.size :]))).metadata
        return note

    def read(self, start: int, size: int) -> bytes:
        """Return ``size`` bytes from ``start`` on.

        Raises
        ------
        BagTruncatedError
            There are not so many.
        """
        self._stream.seek(max(0, start))
        data = self._stream.read(size)
        if start < 0 or len(data) != size:
            raise BagTruncatedError(f"no {size} bytes from byte {start} on")
        return data

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def haul(self, chunks: Sequence[ChunkIndex], channels: Collection[int]) -> tuple[Block, ...]:
        """Return the messages that some chunks have of some channels.

        Raises
        ------
        BagTruncatedError
            A checksum is wrong, or an index does not lead to messages.
        """
        contents: list[bytes] = []
        found: dict[int, list[StampArray]] = {}
        length = 0
        for content, entries in self._contents(chunks, channels):
            for channel, times_and_places in entries.items():
                times_and_places[:, 1] += length
                found.setdefault(channel, []).append(times_and_places)
            contents.append(content)
            length += len(content)
        buffer = np.frombuffer(b"".join(contents), dtype=np.uint8)
        return tuple(self._block(channel, np.concatenate(own), buffer) for channel, own in found.items())

    def _contents(
        self, chunks: Sequence[ChunkIndex], channels: Collection[int]
    ) -> Iterator[tuple[bytes, dict[int, StampArray]]]:
        """Yield records of each chunk, and time and place in them of every message of the channels."""
        whole = []
        for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset):
            parted = self._parted(chunk, channels)
            if parted is None:
                whole.append(chunk)
            else:
                yield parted
        first = 0
        while first < len(whole):
            last = first + 1
            while last < len(whole) and whole[last].chunk_start_offset - _end(whole[last - 1]) <= _NEAR:
                last += 1
            begin = whole[first].chunk_start_offset
            data = self.read(begin, _end(whole[last - 1]) - begin)
            for chunk in whole[first:last]:
                at = chunk.chunk_start_offset - begin
                piece = chunk_at(data, at)
                if piece is None or piece.is_torn:
                    raise BagTruncatedError(f"no chunk at byte {chunk.chunk_start_offset}")
                entries = {
                    channel: _entries(data, chunk.message_index_offsets[channel] - begin, channel)
                    for channel in channels
                    if channel in chunk.message_index_offsets
                }
                yield chunk_content(data, piece, begin), entries
            first = last

    def _parted(
        self, chunk: ChunkIndex, channels: Collection[int]
    ) -> tuple[bytes, dict[int, StampArray]] | None:
        """Return only what is wanted of a large chunk, unchecked; None where it is to be read whole."""
        if chunk.compression or chunk.uncompressed_size < _MIN_PARTED:
            return None
        begin = chunk.chunk_start_offset + chunk.chunk_length
        data = self.read(begin, chunk.message_index_length)
        every = {
            channel: _entries(data, offset - begin, channel)
            for channel, offset in chunk.message_index_offsets.items()
        }
        entries = {channel: own for channel, own in every.items() if channel in channels}
        edges = np.unique(np.concatenate([own[:, 1] for own in every.values()]))
        edges = np.append(edges, chunk.uncompressed_size)
        wanted = np.unique(np.concatenate([own[:, 1] for own in entries.values()]))
        ends = edges[np.searchsorted(edges, wanted) + 1]
        if edges[-2] >= edges[-1] or 4 * int(np.sum(ends - wanted)) > chunk.uncompressed_size:
            return None
        content = chunk.chunk_start_offset + HEAD.size + _CHUNK_HEAD_SIZE
        # A new piece begins where the way to the next message is too far to read it along.
        begins = np.flatnonzero(np.append(True, wanted[1:] - ends[:-1] > _NEAR))
        firsts = wanted[begins]
        sizes = ends[np.append(begins[1:], len(wanted)) - 1] - firsts
        pieces = [
            self.read(content + int(first), int(size)) for first, size in zip(firsts, sizes, strict=True)
        ]
        shifts = np.cumsum(sizes) - sizes - firsts
        for own in entries.values():
            own[:, 1] += shifts[np.searchsorted(firsts, own[:, 1], side="right") - 1]
        return b"".join(pieces), entries

    def _block(self, channel: int, entries: StampArray, buffer: ByteArray) -> Block:
        times, places = entries[:, 0], entries[:, 1]
        if len(places) and places.min() >= 0 and places.max() + _MESSAGE_HEAD <= len(buffer):
            lengths = _numbers(buffer, places + 1, "<i8")
            is_message = (
                (buffer[places] == Opcode.MESSAGE)
                & (_numbers(buffer, places + HEAD.size, "<u2") == channel)
                & (_numbers(buffer, places + HEAD.size + 6, "<i8") == times)
                & (lengths >= _MESSAGE_HEAD - HEAD.size)
                & (lengths <= len(buffer) - HEAD.size - places)
            )
        else:
            is_message = np.array([not len(places)])
        if not is_message.all():
            raise BagTruncatedError(f"the index of {self.topics[channel].name} does not lead to its messages")
        if not len(places):
            lengths = places
        sizes = lengths - (_MESSAGE_HEAD - HEAD.size)
        return Block(self.topics[channel], buffer, places + _MESSAGE_HEAD, sizes, times)


def _end(chunk: ChunkIndex) -> int:
    return int(chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)


def _entries(data: bytes, at: int, channel: int) -> StampArray:
    """Return time [ns] and place in the chunk of a channel's messages, shape (n, 2), from the index at ``at``."""
    if at < 0 or at + _INDEX_HEAD.size > len(data):
        raise BagTruncatedError("an index of messages lies outside of its chunk's")
    opcode, length, own, size = _INDEX_HEAD.unpack_from(data, at)
    at += _INDEX_HEAD.size
    if (
        (opcode, length, own) != (Opcode.MESSAGE_INDEX, size + 6, channel)
        or size % 16
        or at + size > len(data)
    ):
        raise BagTruncatedError(f"the index of channel {channel} is damaged")
    entries: StampArray = np.frombuffer(data, "<i8", size // 8, at).reshape(-1, 2).copy()
    return entries


def _numbers(buffer: ByteArray, places: StampArray, kind: str) -> StampArray:
    """Return the numbers that lie at any places of a buffer."""
    size = np.dtype(kind).itemsize
    every = np.ndarray((len(buffer) - size + 1,), kind, buffer, 0, (1,))
    numbers: StampArray = every[places]
    return numbers


class IndexedBag:
    """The files of a bag, all with an index, read by it.

    Parameters
    ----------
    files : sequence of ChunkedFile
    """

    def __init__(self, files: Sequence[ChunkedFile]) -> None:
        self._files = files

    def hauls(self, wanted: Mapping[TypedTopic, Span]) -> Iterator[Haul]:
        """Yield what the bag holds of some topics, each within its span of receive times, in the order of time.

        Raises
        ------
        BagTruncatedError
            The file is damaged.
        """
        chosen: list[tuple[int, int, ChunkIndex]] = []
        channels = [
            {number: wanted[topic] for number, topic in file.topics.items() if topic in wanted}
            for file in self._files
        ]
        for k, file in enumerate(self._files):
            chosen += [
                (chunk.message_start_time, k, chunk)
                for chunk in file.chunks
                if any(
                    chunk.message_start_time < span.end_ns and chunk.message_end_time >= span.start_ns
                    for channel, span in channels[k].items()
                    if channel in chunk.message_index_offsets
                )
            ]
        chosen.sort(key=lambda item: item[:2])
        first = 0
        while first < len(chosen):
            last, size = first, 0
            while last < len(chosen) and chosen[last][1] == chosen[first][1] and size < READ_AT_ONCE:
                size += chosen[last][2].uncompressed_size
                last += 1
            k = chosen[first][1]
            blocks = self._files[k].haul([chunk for _, _, chunk in chosen[first:last]], channels[k])
            until = chosen[last][0] if last < len(chosen) else FOREVER_NS
            yield Haul(tuple(block.within(wanted[block.topic]) for block in blocks), until)
            first = last

    def note(self, name: str) -> dict[str, str]:
        """Return a metadata record of the first file that has one of this name; empty where none has."""
        return next((note for file in self._files if (note := file.note(name))), {})

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()


class ScannedBag:
    """A bag that ``rosbags`` reads message by message.

    Parameters
    ----------
    reader : Reader -- open
    """

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def hauls(self, wanted: Mapping[TypedTopic, Span]) -> Iterator[Haul]:
        """Yield what the bag holds of some topics, each within its span of receive times, in the order of time."""
        connections = [c for c in self._reader.connections if TypedTopic(c.topic, c.msgtype) in wanted]
        if not connections:
            return
        start = min(span.start_ns for span in wanted.values())
        end = max(span.end_ns for span in wanted.values())
        messages = self._reader.messages(connections, start, end)
        while True:
            own: dict[TypedTopic, list[tuple[int, int, int]]] = {}
            contents: list[bytes] = []
            length = newest = 0
            for connection, receive_ns, data in messages:
                topic = TypedTopic(connection.topic, connection.msgtype)
                own.setdefault(topic, []).append((receive_ns, length, len(data)))
                contents.append(data)
                length += len(data)
                newest = max(newest, receive_ns)
                if length >= READ_AT_ONCE:
                    break
            if not contents:
                return
            buffer = np.frombuffer(b"".join(contents), dtype=np.uint8)
            tables = {topic: np.array(rows, dtype=np.int64) for topic, rows in own.items()}
            blocks = (
                Block(topic, buffer, rows[:, 1], rows[:, 2], rows[:, 0]) for topic, rows in tables.items()
            )
            yield Haul(tuple(block.within(wanted[block.topic]) for block in blocks), newest + 1)

    def note(self, name: str) -> dict[str, str]:
        """Return nothing: only files with an index are looked at for notes."""
        del name
        return {}

    def close(self) -> None:
        """Nothing of its own is open."""
