"""What can be read of a damaged recording, written anew as a whole bag.

Damage costs what it hit: a chunk whose checksum is wrong, the record of a torn end. What the first chunk says of the
topics is said again elsewhere, in the file's summary or in ``metadata.yaml``, and their counts tell what is
missing. The source is left as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from beam_ros.bags.errors import BagError, BagNotFoundError, BagTruncatedError, NotABagError
from beam_ros.bags.mcap_pieces import (
    ChunkDamagedError,
    chunk_content,
    damage_of,
    find_pieces,
    open_file,
    records_of,
)
from beam_ros.bags.metadata import METADATA_NAME, TopicRecord, parse_qos_profiles, read_topics
from beam_ros.bags.reading import STORAGE_SUFFIXES, Bag
from beam_ros.bags.recording_mark import is_being_written
from beam_ros.bags.writing import CHANNELS_NOTE, BagWriter
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes

_SAMPLES = 5
"""Messages of an unnamed channel that are tried as a topic's type."""


@dataclass
class RecoveryReport:
    """What was saved of a recording.

    Attributes
    ----------
    source, target : Path
    message_count : int -- messages in the new bag
    duration_ns : int -- of the new bag [ns]
    lost : dict of str to int -- messages by topic that were recorded and not saved, as far as counts tell
    lost_bytes : int -- bytes of messages that could not be read
    remarks : list of str -- what was amiss, and why something was left out
    """

    source: Path
    target: Path
    message_count: int = 0
    duration_ns: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    lost_bytes: int = 0
    remarks: list[str] = field(default_factory=list)

    @property
    def was_whole(self) -> bool:
        """Whether nothing was amiss."""
        return self.is_complete and not self.remarks

    @property
    def is_complete(self) -> bool:
        """Whether every message is saved that ever reached the file."""
        return not self.lost and not self.lost_bytes

    def remark(self, text: str) -> None:
        """Add a remark that is not there yet."""
        if text not in self.remarks:
            self.remarks.append(text)


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
    announced = read_topics(source / METADATA_NAME) if source.is_dir() else ()
    salvages = [_McapSalvage(file, announced, report) for file in files if file.suffix == ".mcap"]
    with BagWriter(target) as writer:
        for salvage in salvages:
            salvage.copy(writer)
        for file in files:
            if file.suffix != ".mcap":
                _copy(file, writer)
        report.message_count = writer.message_count
        if not writer.message_count:
            raise BagTruncatedError(
                f"{source}: nothing can be read ({'; '.join(report.remarks) or 'no messages'}); expected "
                "at least one closed chunk"
            )
        saved = {topic.name: topic.message_count for topic in writer.topics()}
    report.lost = _lost(salvages, {topic.name: topic.message_count for topic in announced}, saved)
    with Bag(target, namespace="") as bag:
        report.duration_ns = bag.duration_ns
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


def _lost(
    salvages: list[_McapSalvage], announced: Mapping[str, int], saved: Mapping[str, int]
) -> dict[str, int]:
    """Return by topic what was recorded and not saved, by the surest count that there is."""
    if all(salvage.is_counted for salvage in salvages) or not announced:
        recorded: Mapping[str, int] = sum((salvage.recorded() for salvage in salvages), Counter())
    else:
        recorded = announced
    missing = {topic: count - saved.get(topic, 0) for topic, count in sorted(recorded.items())}
    return {topic: count for topic, count in missing.items() if count > 0}


class _McapSalvage:
    """One MCAP file: what its channels are, and what of it can be handed to a writer."""

    def __init__(self, file: Path, announced: tuple[TopicRecord, ...], report: RecoveryReport) -> None:
        self._file = file
        self._report = report
        self._topics: dict[int, TopicRecord] = {}
        self._data = open_file(file)
        self._pieces = find_pieces(self._data)
        if not self._pieces.chunks and not self._pieces.messages and self._pieces.damaged[:1] == [(0, 8)]:
            raise NotABagError(f"{file} does not begin as an MCAP file: expected a ROS 2 recording")
        self._name_channels(announced)

    @property
    def is_counted(self) -> bool:
        """Whether the file's own count of its messages has the right checksum."""
        return self._pieces.summary_is_checked and self._pieces.statistics is not None

    def recorded(self) -> Counter[str]:
        """Return how many messages the file had by topic: its own count, or else that of the chunks' indexes."""
        statistics = self._pieces.statistics
        counts = statistics.channel_message_counts if self.is_counted and statistics else self._pieces.indexed
        recorded: Counter[str] = Counter()
        for channel, count in counts.items():
            recorded[self._label(channel)] += count
        return recorded

    def copy(self, writer: BagWriter) -> None:
        """Write all messages that can be read and named."""
        for damage in damage_of(self._data, self._pieces):
            self._report.remark(f"{self._file.name}: {damage}")
        refused = set()
        for channel, record in self._topics.items():
            try:
                writer.add_topic(record.name, record.type_name, record.qos)
            except BagError as err:
                refused.add(channel)
                self._report.remark(str(err))
        for message in self._messages():
            if message.channel_id not in self._topics or message.channel_id in refused:
                self._report.lost_bytes += len(message.data)
                self._report.remark(f"messages of {self._label(message.channel_id)} are left out")
                continue
            name = self._topics[message.channel_id].name
            writer.write(name, message.log_time, message.data, publish_ns=message.publish_time)

    def _label(self, channel: int) -> str:
        return (
            self._topics[channel].name if channel in self._topics else f"channel {channel}, which has no name"
        )

    # --- content

    def _contents(self, *, counts: bool) -> Iterator[bytes]:
        """Yield the content of every chunk that is whole."""
        for chunk in self._pieces.chunks:
            try:
                content = chunk_content(self._data, chunk)
            except ChunkDamagedError:
                if counts:
                    self._report.lost_bytes += chunk.end - chunk.content
                continue
            if counts and chunk.is_torn:
                used = sum(9 + len(record) for _, record in records_of(content))
                self._report.lost_bytes += len(content) - used
            yield content

    def _messages(self) -> Iterator[Message]:
        for start, end in self._pieces.messages:
            yield _message(bytes(self._data[start:end]))
        for content in self._contents(counts=True):
            for opcode, record in records_of(content):
                if opcode == Opcode.MESSAGE:
                    yield _message(record)

    # --- names of channels

    def _name_channels(self, announced: tuple[TopicRecord, ...]) -> None:
        """Find every channel's topic: in the summary, the chunks, the writer's notes, and the rest by elimination."""
        schemas, channels = dict(self._pieces.schemas), dict(self._pieces.channels)
        used: Counter[int] = Counter()
        samples: dict[int, list[bytes]] = {}
        if not self._pieces.summary_is_checked:
            for content in self._contents(counts=False):
                _read_names(content, schemas, channels, used, samples)
        for number, channel in channels.items():
            schema = schemas.get(channel.schema_id)
            known = next((topic for topic in announced if topic.name == channel.topic), None)
            type_name = schema.name if schema else known.type_name if known else _type_in_graph(channel.topic)
            qos = parse_qos_profiles(channel.metadata.get("offered_qos_profiles", "")) or ()
            self._topics[number] = TopicRecord(channel.topic, type_name, "", qos)
        for note in self._pieces.notes:
            if note.name == CHANNELS_NOTE:
                for text, said in note.metadata.items():
                    name, _, type_name = said.partition(" ")
                    self._topics.setdefault(int(text), TopicRecord(name, type_name, "", ()))
        unnamed = {number: samples[number] for number in sorted(used) if number not in self._topics}
        for number, record in _by_elimination(unnamed, self._topics, announced, self._pieces.indexed):
            self._topics[number] = record
            self._report.remark(
                f"{self._file.name}: channel {number} is taken for {record.name}, by what its messages are"
            )


def _message(record: bytes) -> Message:
    return Message.read(ReadDataStream(BytesIO(record)), len(record))


def _read_names(
    content: bytes,
    schemas: dict[int, Schema],
    channels: dict[int, Channel],
    used: Counter[int],
    samples: dict[int, list[bytes]],
) -> None:
    """Add what a chunk says of its channels, which its checksum confirms, and the first messages of each."""
    for opcode, record in records_of(content):
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(record)))
            channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            number = int.from_bytes(record[:2], "little")
            used[number] += 1
            if used[number] <= _SAMPLES:
                samples.setdefault(number, []).append(_message(record).data)


def _type_in_graph(topic: str) -> str:
    row = next((row for name, row in graph.TOPICS.items() if topic.endswith(f"/{name.lstrip('/')}")), None)
    return row.type_name if row else ""


def _by_elimination(
    unnamed: Mapping[int, list[bytes]],
    named: Mapping[int, TopicRecord],
    announced: tuple[TopicRecord, ...],
    indexed: Mapping[int, int],
) -> Iterator[tuple[int, TopicRecord]]:
    """Yield channels whose topic can only be one of those that are left.

    A topic is possible where the messages are of its type.  Of several, the one with as many messages as the channel
    is taken; or, where all topics are known in the order in which they were announced, that of the same number.
    """
    taken = {record.name for record in named.values()}
    left = [topic for topic in announced or _graph_topics() if topic.name not in taken]
    types = BagTypes()
    for number, samples in unnamed.items():
        possible = [topic for topic in left if _are_of_type(types, samples, topic.type_name)]
        equal = [topic for topic in possible if announced and topic.message_count == indexed.get(number)]
        in_order = [topic for topic in possible if announced[number - 1 : number] == (topic,)]
        for found in (possible, equal, in_order):
            if len(found) == 1:
                left.remove(found[0])
                yield number, found[0]
                break


def _graph_topics() -> tuple[TopicRecord, ...]:
    return tuple(
        TopicRecord(name if name.startswith("/") else f"/{name}", row.type_name, "", (row.qos,))
        for name, row in graph.TOPICS.items()
        if not row.is_derived
    )


def _are_of_type(types: BagTypes, samples: list[bytes], type_name: str) -> bool:
    try:
        for data in samples:
            types.deserialize(data, type_name)
    except Exception:  # noqa: BLE001 - bytes of another type lead the library anywhere
        return False
    return True
