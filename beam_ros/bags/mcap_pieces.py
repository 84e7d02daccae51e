"""The whole pieces of an MCAP file, found in spite of damage.

An MCAP file is a row of records: chunks of messages with a checksum each, the index of every chunk behind it, and
a summary at the end. A record is believed where the lengths within it add up to its own. Where none begins, the next
chunk or the end of the data is looked for byte by byte, so that damage costs what it hit and nothing behind it.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from beam_ros.bags.errors import BagTruncatedError, NotABagError

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length, before every record."""

_CHUNK_HEAD = struct.Struct("<QQQI")
_COUNT = struct.Struct("<I")
_LENGTH = struct.Struct("<Q")
_INDEX_HEAD = struct.Struct("<HI")
_INDEX_ENTRY_SIZE = 16
_MESSAGE_HEAD_SIZE = 2 + 4 + 8 + 8
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_BEGINNING = re.compile(
    rb"\x06.{36}(?:\0{4}|\x03\0\0\0lz4|\x04\0\0\0zstd)|\x0f\x04\0{7}.{4}[\x02\x03\x04\x0b]", re.DOTALL
)
"""How a chunk begins, and the end of the data."""

_READERS = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: SummaryOffset.read,
    Opcode.DATA_END: DataEnd.read,
}
_PRIVATE_OPCODES = 0x80

Buffer = bytes | mmap.mmap

_LOOKED_AT_ONCE = 2**25
"""Bytes of a mapped file that stay in memory behind the place that is looked at."""


class ChunkDamagedError(BagTruncatedError):
    """A chunk whose content is not what was written."""


@dataclass(frozen=True)
class ChunkPiece:
    """Where a chunk lies in its file.

    Attributes
    ----------
    start, end : int -- of the record; ``end`` is the file's where the chunk is torn
    content : int -- where its messages begin
    compression : bytes
    uncompressed_size : int -- of the messages [bytes]
    checksum : int -- CRC-32 of the messages, uncompressed; 0 where the writer gave none
    is_torn : bool -- the file ends before the chunk does
    """

    start: int
    end: int
    content: int
    compression: bytes
    uncompressed_size: int
    checksum: int
    is_torn: bool


@dataclass
class McapPieces:
    """What a file holds.

    Attributes
    ----------
    chunks : list of ChunkPiece -- in the file's order
    messages : list of (int, int) -- content of messages outside of chunks: start and end
    schemas, channels : dict -- by their numbers, from records outside of chunks
    notes : list of Metadata
    statistics : Statistics or None -- the writer's own count of everything
    summary_is_checked : bool -- the summary's checksum is right
    has_wrong_checksum : bool -- the summary has a checksum, and another one; a writer need not give any
    indexed : dict of int to int -- messages by channel, counted by the indexes behind the chunks
    damaged : list of (int, int) -- start and end of what no record explains
    has_end : bool -- the writer came to its end
    """

    chunks: list[ChunkPiece] = field(default_factory=list)
    messages: list[tuple[int, int]] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    notes: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    summary_is_checked: bool = False
    has_wrong_checksum: bool = False
    indexed: dict[int, int] = field(default_factory=dict)
    damaged: list[tuple[int, int]] = field(default_factory=list)
    has_end: bool = False


def find_pieces(data: Buffer) -> McapPieces:
    """Find all whole records of a file outside of chunks, and all chunks.

    Parameters
    ----------
    data : bytes or mmap -- the file

    Returns
    -------
    McapPieces
    """
    pieces = McapPieces()
    is_chunked = any(chunk_at(data, match.start()) for match in _BEGINNING.finditer(data))
    position = len(MAGIC)
    if data[:position] != MAGIC:
        pieces.damaged.append((0, position))
    kept_from = 0
    while position < len(data):
        kept_from = _let_go(data, kept_from, position)
        if pieces.has_end and data[position:] == MAGIC:
            break
        end = _take_record(data, position, pieces, is_chunked=is_chunked)
        if end is None:
            end = _next_beginning(data, position + 1, is_chunked=is_chunked)
            pieces.damaged.append((position, end))
        position = end
    return pieces


def damage_of(data: Buffer, pieces: McapPieces) -> Iterator[str]:
    """Yield what is amiss with a file, in words."""
    for start, end in pieces.damaged:
        yield f"no record can be read from byte {start} to {end}"
    kept_from = 0
    for chunk in pieces.chunks:
        kept_from = _let_go(data, kept_from, chunk.start)
        try:
            chunk_content(data, chunk)
        except ChunkDamagedError as err:
            yield str(err)
        else:
            if chunk.is_torn:
                yield f"the last chunk, from byte {chunk.start}, is torn"
    if not pieces.has_end:
        yield "the file has no end: its writer was cut off"
    elif pieces.has_wrong_checksum and not pieces.damaged:
        yield "the summary has a wrong checksum"


def _let_go(data: Buffer, kept_from: int, position: int) -> int:
    """Give back the memory of what lies before a place, from time to time; return from where the rest is kept."""
    if not isinstance(data, mmap.mmap) or position - kept_from < _LOOKED_AT_ONCE:
        return kept_from
    end = position - position % mmap.PAGESIZE
    if hasattr(mmap, "MADV_DONTNEED"):  # the bytes are read again from the disk where they are wanted again
        data.madvise(mmap.MADV_DONTNEED, 0, end)
    return end


def open_file(path: Path) -> mmap.mmap:
    """Return a file's bytes as they lie on the disk, read where they are looked at.

    Raises
    ------
    NotABagError
        The file is empty.
    """
    with path.open("rb") as stream:
        try:
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError as err:
            raise NotABagError(f"{path} is empty: expected a ROS 2 recording") from err


def chunk_content(data: Buffer, chunk: ChunkPiece, begin: int = 0) -> bytes:
    """Return a chunk's records as they were written; ``begin``: where in its file ``data`` begins.

    Raises
    ------
    ChunkDamagedError
        They do not fit their checksum, or cannot be decompressed.
    """
    content = bytes(data[chunk.content : chunk.end])
    if chunk.is_torn:
        if chunk.compression:
            raise ChunkDamagedError(
                f"the last chunk, from byte {begin + chunk.start}, is torn in compressed data"
            )
        return content
    compression = chunk.compression.decode()
    record = Chunk(compression, content, 0, 0, chunk.checksum, chunk.uncompressed_size)
    try:
        stream, length = get_chunk_data_stream(record, validate_crc=True)
        return bytes(stream.read(length))
    except CRCValidationError as err:
        raise ChunkDamagedError(f"the chunk at byte {begin + chunk.start} has a wrong checksum") from err
    except Exception as err:  # damaged data lead the libraries anywhere
        raise ChunkDamagedError(
            f"the chunk at byte {begin + chunk.start} cannot be read ({type(err).__name__}: {err})"
        ) from err


def records_of(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the whole records of a chunk."""
    offset = 0
    while offset + HEAD.size <= len(content):
        opcode, length = HEAD.unpack_from(content, offset)
        end = offset + HEAD.size + length
        if end > len(content):
            return
        yield opcode, content[offset + HEAD.size : end]
        offset = end


def _take_record(data: Buffer, start: int, pieces: McapPieces, *, is_chunked: bool) -> int | None:
    """Take the record that begins at ``start``; return its end, or None where none can be believed."""
    if start + HEAD.size > len(data):
        return None
    opcode, length = HEAD.unpack_from(data, start)
    if opcode == Opcode.CHUNK:
        chunk = chunk_at(data, start)
        if chunk is None:
            return None
        pieces.chunks.append(chunk)
        return chunk.end
    body = start + HEAD.size
    end: int = body + length
    if end > len(data):
        return None
    if opcode == Opcode.MESSAGE:
        # A writer uses chunks or not; a bare message between chunks is an index with a wrong opcode.
        if is_chunked or length < _MESSAGE_HEAD_SIZE:
            return None
        pieces.messages.append((body, end))
        return end
    if opcode == Opcode.MESSAGE_INDEX:
        count = _indexed_messages(data, body, length)
        if count is None:
            return None
        channel = int.from_bytes(data[body : body + 2], "little")
        pieces.indexed[channel] = pieces.indexed.get(channel, 0) + count
        return end
    if opcode >= _PRIVATE_OPCODES:
        return end if _is_beginning(data, end) else None
    record = _read_record(opcode, bytes(data[body:end]))
    if record is None:
        return None
    if isinstance(record, Schema):
        pieces.schemas[record.id] = record
    elif isinstance(record, Channel):
        pieces.channels[record.id] = record
    elif isinstance(record, Metadata):
        pieces.notes.append(record)
    elif isinstance(record, Statistics):
        pieces.statistics = record
    elif isinstance(record, Footer):
        pieces.has_end = True
        summary = data[record.summary_start : body + 16] if record.summary_start else b""
        pieces.summary_is_checked = bool(summary) and zlib.crc32(summary) == record.summary_crc
        pieces.has_wrong_checksum = record.summary_crc != 0 and not pieces.summary_is_checked
    return end


def _read_record(opcode: int, body: bytes) -> object | None:
    """Return a record whose parts fill it to the byte, or None."""
    reader = _READERS.get(opcode)
    if reader is None:
        return None
    stream = ReadDataStream(BytesIO(body))
    try:
        record: object = reader(stream)
    except Exception:  # noqa: BLE001 - damaged records lead the library anywhere
        return None
    return record if stream.count == len(body) else None


def _indexed_messages(data: Buffer, body: int, length: int) -> int | None:
    if length < _INDEX_HEAD.size:
        return None
    _, size = _INDEX_HEAD.unpack_from(data, body)
    if size != length - _INDEX_HEAD.size or size % _INDEX_ENTRY_SIZE:
        return None
    return int(size // _INDEX_ENTRY_SIZE)


def chunk_at(data: Buffer, start: int) -> ChunkPiece | None:
    """Return the chunk that begins at ``start``, or None where its lengths do not fit each other."""
    head = start + HEAD.size
    name = head + _CHUNK_HEAD.size + _COUNT.size
    if name > len(data) or data[start] != Opcode.CHUNK:
        return None
    (length,) = _LENGTH.unpack_from(data, start + 1)
    _, _, uncompressed_size, checksum = _CHUNK_HEAD.unpack_from(data, head)
    (name_length,) = _COUNT.unpack_from(data, name - _COUNT.size)
    compression = bytes(data[name : name + min(name_length, 5)])
    content = name + name_length + _LENGTH.size
    if compression not in _COMPRESSIONS or content > len(data):
        return None
    (size,) = _LENGTH.unpack_from(data, content - _LENGTH.size)
    end: int = content + size
    if end != head + length:
        return None
    return ChunkPiece(
        start, min(end, len(data)), content, compression, uncompressed_size, checksum, end > len(data)
    )


def _is_beginning(data: Buffer, position: int) -> bool:
    return position == len(data) or _take_record(data, position, McapPieces(), is_chunked=True) is not None


def _next_beginning(data: Buffer, position: int, *, is_chunked: bool) -> int:
    """Return where the next chunk begins, or the end of the data, or that of the file."""
    if not is_chunked:
        return _next_message(data, position)
    for match in _BEGINNING.finditer(data, position):
        if data[match.start()] == Opcode.DATA_END or chunk_at(data, match.start()):
            return match.start()
    return len(data)


def _next_message(data: Buffer, position: int) -> int:
    """Return where two records without chunks follow each other; bare messages have no other sign."""
    for match in re.compile(rb"[\x02-\x0f].{4}\0{4}", re.DOTALL).finditer(data, position):
        end = _take_record(data, match.start(), McapPieces(), is_chunked=False)
        if end is not None and _take_record(data, end, McapPieces(), is_chunked=False) is not None:
            return match.start()
    return len(data)
