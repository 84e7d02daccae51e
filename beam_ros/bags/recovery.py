"""What can be read of a recording that was cut off, written anew as a whole bag.

An MCAP file is a row of records, and everything up to the last whole one is good: closed chunks with their
checksums, and of a chunk that was torn in the middle of writing, the messages that had been written. The
source is left as it is.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from beam_ros.bags.errors import BagError, BagNotFoundError, BagTruncatedError, NotABagError
from beam_ros.bags.metadata import parse_qos_profiles
from beam_ros.bags.reading import STORAGE_SUFFIXES, Bag
from beam_ros.bags.recording_mark import is_being_written
from beam_ros.bags.writing import BagWriter

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")
_TORN_CHUNK_HEAD = 8 + 8 + 8 + 4
"""Bytes before the name of the compression in a chunk: two times, size, checksum."""


@dataclass
class RecoveryReport:
    """What was saved of a recording.

    Attributes
    ----------
    source, target : Path
    message_count : int -- messages in the new bag
    duration_ns : int -- of the new bag [ns]
    lost_bytes : int -- bytes of the source that could not be read
    was_whole : bool -- nothing was amiss
    remarks : list of str -- what was left out, and why
    """

    source: Path
    target: Path
    message_count: int = 0
    duration_ns: int = 0
    lost_bytes: int = 0
    was_whole: bool = False
    remarks: list[str] = field(default_factory=list)


def recover(source: Path | str, target: Path | str | None = None) -> RecoveryReport:
    """Rewrite what can be read of a bag into a new, whole one.

    Parameters
    ----------
    source : Path or str -- a bag's folder, or its file
    target : Path or str, optional -- the new bag's folder; by default the source's name with ``_recovered``

    Returns
    -------
    RecoveryReport

    Raises
    ------
    BagNotFoundError, NotABagError
        There is no recording at the source.
    BagExistsError
        Something is at the target.
    BagTruncatedError
        The recording still runs, or nothing of it can be read.
    """
    source = Path(source)
    if not source.exists():
        raise BagNotFoundError(f"{source} does not exist: expected a bag's folder, or a .mcap or .db3 file")
    if source.is_dir() and is_being_written(source):
        raise BagTruncatedError(
            f"{source} is still being recorded: expected a recording that has ended; end the recorder first"
        )
    if target is None:
        name = source.resolve().name if source.is_dir() else source.stem
        target = source.resolve().with_name(f"{name}_recovered")
    target = Path(target)
    report = RecoveryReport(source, target)
    files = _storage_files(source)
    with BagWriter(target) as writer:
        for file in files:
            if file.suffix == ".mcap":
                _McapSalvage(file, writer, report).run()
            else:
                _copy(file, writer)
        report.message_count = writer.message_count
        if not writer.message_count:
            raise BagTruncatedError(
                f"{source}: nothing can be read ({'; '.join(report.remarks) or 'no messages'}); expected "
                "at least one closed chunk"
            )
    with Bag(target, namespace="") as bag:
        report.duration_ns = bag.duration_ns
    report.was_whole = not report.lost_bytes and not report.remarks
    return report


def _storage_files(source: Path) -> list[Path]:
    files = [source] if source.is_file() else sorted(source.iterdir())
    found = [file for file in files if file.suffix in STORAGE_SUFFIXES and file.is_file()]
    if not found:
        raise NotABagError(f"{source} holds no recording: expected a .mcap or .db3 file")
    return found


def _copy(file: Path, writer: BagWriter) -> None:
    """Copy a SQLite file, which either opens whole or not at all."""
    with Bag(file, namespace="") as bag:
        for topic in bag.topics:
            writer.add_topic(topic.name, topic.type_name)
        for message in bag.raw_messages():
            writer.write(message.topic, message.receive_ns, message.data)


class _McapSalvage:
    """Reads one MCAP file from its start as far as it goes and hands its messages to a writer."""

    def __init__(self, file: Path, writer: BagWriter, report: RecoveryReport) -> None:
        self._file = file
        self._writer = writer
        self._report = report
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, str | None] = {}

    def run(self) -> None:
        size = self._file.stat().st_size
        with self._file.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise NotABagError(f"{self._file} does not begin as an MCAP file: expected a ROS 2 recording")
            is_finished = False
            while not is_finished and stream.tell() < size:
                is_finished = self._take_record(stream, size)
        if not is_finished:
            self._report.remarks.append(f"{self._file.name} has no end: its writer was cut off")

    def _take_record(self, stream: BinaryIO, size: int) -> bool:
        """Take the next record; return whether the file's content ends there."""
        start = stream.tell()
        head = stream.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            self._report.lost_bytes += len(head)
            return False
        opcode, length = _RECORD_HEAD.unpack(head)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return True
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END:
            self._lose(size - start, f"no record begins at byte {start}; the rest of the file is lost")
            stream.seek(size)
            return False
        payload = stream.read(min(length, size - stream.tell()))
        if opcode == Opcode.CHUNK:
            self._take_chunk(payload, is_torn=len(payload) < length)
        elif len(payload) < length:
            self._report.lost_bytes += len(head) + len(payload)
        else:
            self._take_plain(opcode, payload)
        return False

    def _take_chunk(self, payload: bytes, *, is_torn: bool) -> None:
        try:
            if is_torn:
                records = payload[_torn_content(payload) :]
            else:
                chunk = Chunk.read(ReadDataStream(BytesIO(payload)))
                content, length = get_chunk_data_stream(chunk, validate_crc=True)
                records = content.read(length)
        except CRCValidationError:
            self._lose(len(payload), "a chunk has a wrong checksum")
            return
        except Exception as err:  # noqa: BLE001 - damaged records lead the libraries anywhere
            self._lose(len(payload), f"a chunk cannot be read ({type(err).__name__}: {err})")
            return
        used = 0
        for opcode, record in _whole_records(records):
            used += _RECORD_HEAD.size + len(record)
            self._take_plain(opcode, record)
        self._report.lost_bytes += len(records) - used

    def _take_plain(self, opcode: int, payload: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(payload)))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                self._announce(Channel.read(ReadDataStream(BytesIO(payload))))
            elif opcode == Opcode.MESSAGE:
                self._take_message(Message.read(ReadDataStream(BytesIO(payload)), len(payload)))
        except BagError:
            raise
        except Exception as err:  # noqa: BLE001 - damaged records lead the libraries anywhere
            self._lose(len(payload), f"a record cannot be read ({type(err).__name__}: {err})")

    def _announce(self, channel: Channel) -> None:
        if channel.id in self._topics:
            return
        schema = self._schemas.get(channel.schema_id)
        try:
            self._writer.add_topic(
                channel.topic,
                schema.name if schema else "",
                parse_qos_profiles(channel.metadata.get("offered_qos_profiles", "")),
            )
        except BagError as err:
            self._topics[channel.id] = None
            self._report.remarks.append(str(err))
        else:
            self._topics[channel.id] = channel.topic

    def _take_message(self, message: Message) -> None:
        topic = self._topics.get(message.channel_id)
        if topic is None:
            self._report.lost_bytes += len(message.data)
            return
        self._writer.write(topic, message.log_time, message.data, publish_ns=message.publish_time)

    def _lose(self, count: int, remark: str) -> None:
        self._report.lost_bytes += count
        if remark not in self._report.remarks:
            self._report.remarks.append(remark)


def _torn_content(payload: bytes) -> int:
    """Return where the records begin in a chunk whose end is missing; only an uncompressed one has any."""
    (length,) = struct.unpack_from("<I", payload, _TORN_CHUNK_HEAD)
    if length:
        raise ValueError("torn in the middle of compressed data")
    return _TORN_CHUNK_HEAD + 4 + 8


def _whole_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    offset = 0
    while offset + _RECORD_HEAD.size <= len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, offset)
        end = offset + _RECORD_HEAD.size + length
        if end > len(data):
            return
        yield opcode, data[offset + _RECORD_HEAD.size : end]
        offset = end
