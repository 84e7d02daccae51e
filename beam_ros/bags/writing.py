"""Bags written as ROS 2 Jazzy's recorder writes them, but so that a killed writer loses a second at most.

A bag is a folder with one MCAP file ``<folder>_0.mcap`` and ``metadata.yaml``. Messages are gathered in chunks;
a chunk reaches the file when the messages' receive times have advanced by half a second or when ``flush`` is
called, and from then on it survives whatever happens to the process. Until ``close``, the folder carries the
mark ``RECORDING`` and has no ``metadata.yaml``, so that nobody takes it for a finished bag.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from beam_ros.bags.batches import encode_batch
from beam_ros.bags.errors import BagError, BagExistsError
from beam_ros.bags.metadata import METADATA_NAME, TopicRecord, bag_information, qos_profiles, to_yaml
from beam_ros.bags.recording_mark import RecordingMark
from beam_ros.hub.contract import SampleBatch
from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.messages import BagTypes

CHUNK_NS = 500_000_000
"""Receive time after which a chunk is closed [ns]."""

CHANNELS_NOTE = "beam_ros/channels"
"""Metadata record that says again, outside of the first chunk, which topic each channel is: "name type" by number."""

_EMPTY_START_NS = 2**63 - 1
"""Starting time of a bag without messages, as rosbag2 writes it."""


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
        self, path: Path | str, *, namespace: str = "", custom_data: Mapping[str, str] | None = None
    ) -> None:
        self.path = Path(path)
        self.message_count = 0
        self._namespace = namespace.strip("/")
        self._custom_data = dict(custom_data or {})
        self._types = BagTypes()
        self._topics: dict[str, TopicRecord] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._unsaid_channels: dict[str, str] = {}
        self._first_ns = _EMPTY_START_NS
        self._last_ns = 0
        self._chunk_start_ns: int | None = None
        self._is_open = False
        file_name = f"{self.path.resolve().name}_0.mcap"
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as err:
            raise BagExistsError(
                f"{self.path} exists already: expected a new path; give another one or move it away"
            ) from err
        except OSError as err:
            raise self._failure("create", err) from err
        try:
            self._mark = RecordingMark(self.path, file_name)
            self._file = (self.path / file_name).open("xb")
        except OSError as err:
            raise self._failure("create", err) from err
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library="beam_ros")
        self._is_open = True
        self.flush()

    @property
    def file(self) -> Path:
        """Path of the MCAP file."""
        return Path(self._file.name)

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
        if type_name not in self._schemas:
            definition, _ = store.generate_msgdef(type_name, ros_version=2)
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", definition.encode())
        record = TopicRecord(name, type_name, store.hash_rihs01(type_name), qos)
        # `ros2 bag reindex` has nothing but these to make the metadata from.
        metadata = {
            "offered_qos_profiles": to_yaml(qos_profiles(qos)).strip(),
            "topic_type_hash": record.type_hash,
        }
        channel = self._writer.register_channel(name, "cdr", self._schemas[type_name], metadata)
        self._topics[name] = record
        self._channels[topic] = self._channels[name] = channel
        self._counts[name] = 0
        self._unsaid_channels[str(channel)] = f"{name} {type_name}"

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
        if topic not in self._channels:
            self.add_topic(topic)
            self._channels[topic] = self._channels[self.full_name(topic)]
        receive_ns = max(0, receive_ns)
        try:
            self._writer.add_message(
                self._channels[topic],
                receive_ns,
                data,
                receive_ns if publish_ns is None or publish_ns < 0 else publish_ns,
            )
            if self._chunk_start_ns is None:
                self._chunk_start_ns = receive_ns
            elif abs(receive_ns - self._chunk_start_ns) >= CHUNK_NS:
                self.flush()
        except OSError as err:
            raise self._failure("write", err) from err
        self._first_ns = min(self._first_ns, receive_ns)
        self._last_ns = max(self._last_ns, receive_ns)
        self._counts[self.full_name(topic)] += 1
        self.message_count += 1

    def write_message(self, topic: str, receive_ns: int, message: Any) -> None:
        """Write a message that ``beam_ros.messages`` built with ``BagTypes``."""
        if topic not in self._channels:
            self.add_topic(topic)
        type_name = self._topics[self.full_name(topic)].type_name
        self.write(topic, receive_ns, self._types.serialize(message, type_name))

    def write_batch(self, topic: str, receive_ns: int, batch: SampleBatch) -> None:
        """Write a batch of ``hub/applied`` or ``hub/measured``."""
        self.write(topic, receive_ns, encode_batch(batch))

    def flush(self) -> None:
        """Close the chunk in the making: what was written until now survives a killed process."""
        try:
            self._writer.flush()
            if self._unsaid_channels:
                self._writer.add_metadata(CHANNELS_NOTE, self._unsaid_channels)
                self._writer.flush()
        except OSError as err:
            raise self._failure("write", err) from err
        self._unsaid_channels = {}
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
        is_empty = self.message_count == 0
        information = bag_information(
            self.file.name,
            list(self.topics()),
            self._first_ns,
            0 if is_empty else self._last_ns - self._first_ns,
            self._custom_data,
        )
        metadata = self.path / METADATA_NAME
        draft = metadata.with_suffix(".yaml.tmp")
        try:
            self._writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(information).strip()})
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
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
            self._file.close()
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
