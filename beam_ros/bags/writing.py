"""Bags written as ROS 2 Jazzy's recorder writes them, but so that a killed writer loses a second at most.

A bag is a folder with MCAP files ``<folder>_0.mcap``, ``<folder>_1.mcap`` .. and ``metadata.yaml``. Messages are
gathered in chunks; a chunk reaches the file when the messages' receive times have advanced by half a second or when
``flush`` is called, and from then on it survives whatever happens to the process. Where a limit is given, the next
file begins behind the chunk that reaches it, with the newest message of every latched topic said again. Until
``close``, the folder carries the mark ``RECORDING`` and has no ``metadata.yaml``, so that nobody takes it for a
finished bag.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from beam_ros.bags.batches import encode_batch
from beam_ros.bags.errors import BagError, BagExistsError
from beam_ros.bags.metadata import (
    EMPTY_START_NS,
    METADATA_NAME,
    PROVENANCE_NOTE,
    FileRecord,
    TopicRecord,
    bag_information,
    qos_profiles,
    to_yaml,
)
from beam_ros.bags.recording_mark import RecordingMark
from beam_ros.hub.contract import SampleBatch
from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.messages import BagTypes

CHUNK_NS = 500_000_000
"""Receive time after which a chunk is closed [ns]."""

CHANNELS_NOTE = "beam_ros/channels"
"""Metadata record that says again, outside of the first chunk, which topic each channel is: "name type" by number."""


@dataclass(frozen=True)
class FileLimits:
    """After how much another file of the bag begins; 0: never.

    Attributes
    ----------
    size : int -- of a file [bytes]
    duration_ns : int -- between the first and the newest receive time in a file [ns]
    """

    size: int = 0
    duration_ns: int = 0


class _OpenFile:
    """A file of the bag in the making: the writer of its records, and what is in it so far."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stream = path.open("xb")
        self.writer = Writer(self.stream, compression=CompressionType.NONE)
        self.writer.start(profile="ros2", library="beam_ros")
        self.channels: dict[str, int] = {}
        self.schemas: dict[str, int] = {}
        self.counts: dict[str, int] = {}
        self.unsaid_channels: dict[str, str] = {}
        self.first_ns, self.last_ns = EMPTY_START_NS, 0

    def record(self, counted_topics: Iterable[TopicRecord]) -> FileRecord:
        """Return what the metadata say of the file."""
        count = sum(self.counts.get(topic.name, 0) for topic in counted_topics)
        return FileRecord(
            self.path.name, self.first_ns, max(0, self.last_ns - self.first_ns) if count else 0, count
        )

    def finish(self) -> None:
        """Write the index and close the file, which is then on the disk."""
        self.writer.finish()
        self.stream.flush()
        os.fsync(self.stream.fileno())
        self.stream.close()


class BagWriter:
    """Writes one bag; a context manager that removes the bag again when its block fails.

    Parameters
    ----------
    path : Path or str
        The bag's folder; must not exist.
    namespace : str
        Put before the relative names of topics: "" makes "/hub/applied", "rig1" makes "/rig1/hub/applied".
    custom_data : mapping of str to str, optional
        Notes for the metadata.
    provenance : mapping of str to str, optional
        How the bag comes about; stands in every file and in the metadata.
    limits : FileLimits, optional
        By default everything goes into one file.

    Attributes
    ----------
    path : Path
    message_count : int -- messages written so far

    Raises
    ------
    BagExistsError
        Something is at the path.
    BagError
        The folder cannot be written.

    Notes
    -----
    Not for several threads at once.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        namespace: str = "",
        custom_data: Mapping[str, str] | None = None,
        provenance: Mapping[str, str] | None = None,
        limits: FileLimits = FileLimits(),
    ) -> None:
        self.path = Path(path)
        self.message_count = 0
        self._namespace = namespace.strip("/")
        self._provenance = dict(provenance or {})
        self._custom_data = dict(custom_data or {}) | self._provenance
        self._limits = limits
        self._types = BagTypes()
        self._topics: dict[str, TopicRecord] = {}
        self._names: dict[str, str] = {}
        self._latched: dict[str, tuple[int, bytes]] = {}
        self._counts: dict[str, int] = {}
        self._finished: list[FileRecord] = []
        self._chunk_start_ns: int | None = None
        self._is_open = False
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as err:
            raise BagExistsError(
                f"{self.path} exists already: expected a new path; give another one or move it away"
            ) from err
        except OSError as err:
            raise self._failure("create", err) from err
        try:
            self._mark = RecordingMark(self.path, self._file_name())
            self._file = self._open_file()
        except OSError as err:
            raise self._failure("create", err) from err
        self._is_open = True
        self.flush()

    def _file_name(self) -> str:
        return f"{self.path.resolve().name}_{len(self._finished)}.mcap"

    def _open_file(self) -> _OpenFile:
        file = _OpenFile(self.path / self._file_name())
        if self._provenance:
            file.writer.add_metadata(PROVENANCE_NOTE, self._provenance)
        return file

    @property
    def file(self) -> Path:
        """Path of the MCAP file that is written."""
        return self._file.path

    def full_name(self, topic: str) -> str:
        """Return a topic's name in the bag: relative names are moved into the bag's namespace."""
        if topic.startswith("/"):
            return topic
        return f"/{self._namespace}/{topic}" if self._namespace else f"/{topic}"

    def add_topic(
        self, topic: str, type_name: str | None = None, qos: tuple[QualityOfService, ...] | None = None
    ) -> None:
        """Announce a topic, with or without messages to come; a second time it does nothing.

        Parameters
        ----------
        topic : str -- a name of the rig's table, or any other with its type
        type_name : str, optional -- "package/msg/Name"; by default the table's
        qos : tuple of QualityOfService, optional -- what its publishers offer; by default the table's

        Raises
        ------
        BagError
            The type is not known to ROS 2 Jazzy's common interfaces.
        """
        name = self.full_name(topic)
        if name in self._topics:
            return
        row = graph.TOPICS.get(topic)
        type_name = type_name or (row.type_name if row else "")
        qos = qos or ((row.qos,) if row else (QualityOfService(10),))
        store = self._types.store
        if type_name not in store.types:
            raise BagError(
                f"{name} is of type {type_name or 'unknown'!r}: expected a message type of ROS 2 Jazzy's "
                "common interfaces; leave this topic out"
            )
        self._topics[name] = TopicRecord(name, type_name, store.hash_rihs01(type_name), qos)
        self._names[topic] = self._names[name] = name
        self._counts[name] = 0
        self._register(name)

    def _register(self, name: str) -> None:
        """Announce a topic in the file that is written."""
        topic, file = self._topics[name], self._file
        if topic.type_name not in file.schemas:
            definition, _ = self._types.store.generate_msgdef(topic.type_name, ros_version=2)
            file.schemas[topic.type_name] = file.writer.register_schema(
                topic.type_name, "ros2msg", definition.encode()
            )
        # `ros2 bag reindex` has nothing but these to make the metadata from.
        metadata = {
            "offered_qos_profiles": to_yaml(qos_profiles(topic.qos)).strip(),
            "topic_type_hash": topic.type_hash,
        }
        channel = file.writer.register_channel(name, "cdr", file.schemas[topic.type_name], metadata)
        file.channels[name] = channel
        file.unsaid_channels[str(channel)] = f"{name} {topic.type_name}"

    def write(self, topic: str, receive_ns: int, data: bytes, *, publish_ns: int | None = None) -> None:
        """Write one message's CDR bytes.

        Parameters
        ----------
        topic : str -- a topic of the table or one that was announced
        receive_ns : int -- when it came [ns, UNIX]
        data : bytes -- its serialised form
        publish_ns : int, optional -- when it was sent [ns, UNIX]; by default ``receive_ns``

        Raises
        ------
        BagError
            The bag is closed, the topic unknown, or the disk refuses.
        """
        if not self._is_open:
            raise BagError(f"{self.path} is closed: expected an open bag; make a new writer")
        if topic not in self._names:
            self.add_topic(topic)
            self._names[topic] = self.full_name(topic)
        name = self._names[topic]
        receive_ns = max(0, receive_ns)
        publish_ns = receive_ns if publish_ns is None or publish_ns < 0 else publish_ns
        try:
            if self._chunk_start_ns is not None and abs(receive_ns - self._chunk_start_ns) >= CHUNK_NS:
                self.flush()
                if self._is_full(receive_ns):
                    self._begin_file(receive_ns)
            self._add(name, receive_ns, publish_ns, data)
        except OSError as err:
            raise self._failure("write", err) from err
        if any(qos.is_latched for qos in self._topics[name].qos):
            self._latched[name] = publish_ns, data

    def _add(self, name: str, receive_ns: int, publish_ns: int, data: bytes) -> None:
        file = self._file
        file.writer.add_message(file.channels[name], receive_ns, data, publish_ns)
        if self._chunk_start_ns is None:
            self._chunk_start_ns = receive_ns
        file.first_ns, file.last_ns = min(file.first_ns, receive_ns), max(file.last_ns, receive_ns)
        file.counts[name] = file.counts.get(name, 0) + 1
        self._counts[name] += 1
        self.message_count += 1

    def _is_full(self, receive_ns: int) -> bool:
        limits, file = self._limits, self._file
        return bool(
            (limits.size and file.stream.tell() >= limits.size)
            or (limits.duration_ns and receive_ns - file.first_ns >= limits.duration_ns)
        )

    def _begin_file(self, receive_ns: int) -> None:
        """Finish the file that is written, and begin the next with what is latched."""
        self._finish_file()
        self._file = self._open_file()
        for name in self._topics:
            self._register(name)
        for name, (publish_ns, data) in self._latched.items():
            self._add(name, receive_ns, publish_ns, data)
        self.flush()

    def _finish_file(self) -> None:
        """Close the file that is written, with what ``ros2 bag reindex`` wants to find in it."""
        file = self._file
        topics = [
            replace(topic, message_count=file.counts.get(name, 0)) for name, topic in self._topics.items()
        ]
        record = file.record(topics)
        information = bag_information([record], topics, self._custom_data)
        file.writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(information).strip()})
        file.finish()
        self._finished.append(record)

    def write_message(self, topic: str, receive_ns: int, message: Any) -> None:
        """Write a message that ``beam_ros.messages`` built with ``BagTypes``."""
        if topic not in self._names:
            self.add_topic(topic)
        type_name = self._topics[self.full_name(topic)].type_name
        self.write(topic, receive_ns, self._types.serialize(message, type_name))

    def write_batch(self, topic: str, receive_ns: int, batch: SampleBatch) -> None:
        """Write a batch of ``hub/applied`` or ``hub/measured``."""
        self.write(topic, receive_ns, encode_batch(batch))

    def flush(self) -> None:
        """Close the chunk in the making: what was written until now survives a killed process."""
        file = self._file
        try:
            file.writer.flush()
            if file.unsaid_channels:
                file.writer.add_metadata(CHANNELS_NOTE, file.unsaid_channels)
                file.writer.flush()
        except OSError as err:
            raise self._failure("write", err) from err
        file.unsaid_channels = {}
        self._chunk_start_ns = None

    def topics(self) -> tuple[TopicRecord, ...]:
        """Return the topics with what was written on each so far."""
        return tuple(replace(t, message_count=self._counts[name]) for name, t in self._topics.items())

    def close(self) -> None:
        """Finish the bag: index, ``metadata.yaml``, no mark any more. A second time it does nothing.

        Raises
        ------
        BagError
            The disk refuses; the bag then keeps its mark, and ``beam recover`` can repair it.
        """
        if not self._is_open:
            return
        self._is_open = False
        metadata = self.path / METADATA_NAME
        draft = metadata.with_suffix(".yaml.tmp")
        try:
            self._finish_file()
            information = bag_information(self._finished, list(self.topics()), self._custom_data)
            draft.write_text(to_yaml({"rosbag2_bagfile_information": information}), encoding="utf-8")
            draft.replace(metadata)
            self._mark.lift()
        except OSError as err:
            self.abandon()
            raise self._failure("finish", err) from err

    def abandon(self) -> None:
        """Let go of a bag that the disk takes no more of; it keeps its mark and can be recovered."""
        self._is_open = False
        with contextlib.suppress(OSError):
            self._file.stream.close()
        self._mark.leave()

    def discard(self) -> None:
        """Give the bag up and remove its folder."""
        self.abandon()
        shutil.rmtree(self.path, ignore_errors=True)

    def _failure(self, what: str, err: OSError) -> BagError:
        return BagError(
            f"cannot {what} bag {self.path}: {err.strerror or err}; check the path, its permissions and the "
            "space on the disk"
        )

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()
