"""Bags read for identification: samples of the hub, displacements, clocks and the experiment's texts.

``Bag`` opens what ROS 2's recorder, rosbags or this suite wrote, MCAP or SQLite, on a disk or in an object store, and
extracts each kind of content as arrays. All topics that are asked for together are read in one pass, in whole or
between two times. A bag that cannot be opened is refused with the remedy.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from rosbags.rosbag2 import Reader, ReaderError

from beam_ros.bags.blocks import (
    FOREVER_NS,
    Block,
    ChunkedFile,
    Haul,
    IndexedBag,
    ScannedBag,
    Span,
    TypedTopic,
)
from beam_ros.bags.errors import (
    BagError,
    BagNotFoundError,
    BagTruncatedError,
    MissingTopicsError,
    NotABagError,
)
from beam_ros.bags.mcap_pieces import MAGIC, damage_of, find_pieces, open_file
from beam_ros.bags.metadata import METADATA_NAME, PROVENANCE_NOTE, read_file_names
from beam_ros.bags.recording_mark import MARK_NAME, is_being_written
from beam_ros.bags.signals import (
    ClockIntake,
    DisplacementIntake,
    Displacements,
    HubIntake,
    HubSamples,
    Intake,
    Unreadable,
    message_decoder,
)
from beam_ros.hub.contract import ClockSync
from beam_ros.interfaces import graph
from beam_ros.messages import SECOND_NS, BagTypes, read_diagnostics, read_json
from beam_ros.messages.health import Health
from beam_ros.process.remote_paths import AnyPath, any_path

AnyIntake = TypeVar("AnyIntake", bound=Intake[Any])

STORAGE_SUFFIXES = (".mcap", ".db3")


class RawMessage(NamedTuple):
    """A message as the bag holds it: topic's full name, type, receive time [ns, UNIX], CDR bytes."""

    topic: str
    type_name: str
    receive_ns: int
    data: bytes


@dataclass(frozen=True)
class TopicCount:
    """A topic of a bag with its type and its number of messages."""

    name: str
    type_name: str
    message_count: int


class Definition(NamedTuple):
    """What a bag itself says of a message type: its text, whether that is IDL, and the type's hash."""

    text: str
    is_idl: bool
    type_hash: str


class Bag:
    """An open bag; a context manager.

    Parameters
    ----------
    path : Path, RemotePath or str
        The bag's folder, or a single ``.mcap`` or ``.db3`` file; a text with ``://`` is a URL, as of an object store.
    namespace : str, optional
        Of the rig whose topics are read; needed only where a bag holds several.
    start_s, end_s : float, optional
        Receive times after that of the bag's first message [s]: only what came from ``start_s`` on and before
        ``end_s`` is read. Of latched topics, which hold until they are said anew, also what came before.

    Attributes
    ----------
    path : Path or RemotePath
    topics : tuple of TopicCount -- sorted by name
    message_count : int
    start_ns : int -- receive time of the first message [ns, UNIX]; 0 in an empty bag
    duration_ns : int -- between the first and the last receive time [ns]
    begins_ns : int -- receive time from which on it is read [ns, UNIX]
    is_whole : bool -- neither ``start_s`` nor ``end_s`` is given
    storage : str -- "mcap" or "sqlite3"
    namespace : str -- of the rig's topics, "" for none

    Raises
    ------
    BagNotFoundError
        There is nothing at the path.
    NotABagError
        What is there is no ROS 2 bag.
    BagTruncatedError
        The recording was cut off, still runs, or the file is damaged.
    """

    def __init__(
        self,
        path: AnyPath | str,
        *,
        namespace: str | None = None,
        start_s: float | None = None,
        end_s: float | None = None,
    ) -> None:
        self.path = any_path(path) if isinstance(path, str) else path
        self._types = BagTypes()
        self._reader = _open_reader(self.path)
        self._source = _open_source(self.path, self._reader)
        connections = self._reader.connections
        counts: dict[tuple[str, str], int] = {}
        for connection in connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        self.topics = tuple(TopicCount(*key, count) for key, count in sorted(counts.items()))
        self.message_count = self._reader.message_count
        self.start_ns = self._reader.start_time if self.message_count else 0
        self.duration_ns = max(0, self._reader.duration - 1) if self.message_count else 0
        self._span = Span(
            self.start_ns + round((start_s or 0.0) * SECOND_NS),
            FOREVER_NS if end_s is None else self.start_ns + round(end_s * SECOND_NS),
        )
        if self.message_count and self._span.start_ns > self.start_ns + self.duration_ns:
            self.close()
            raise MissingTopicsError(
                f"{self.path} has nothing after {start_s:g} s: expected a time before its end at "
                f"{self.duration_ns / SECOND_NS:.3f} s; choose an earlier one"
            )
        self.begins_ns = self._span.start_ns
        self.is_whole = start_s is None and end_s is None
        self._kept: dict[str, Intake[Any]] = {}
        self.storage = "sqlite3" if _storage_file(self.path).suffix == ".db3" else "mcap"
        self.namespace = _find_namespace(self) if namespace is None else namespace.strip("/")

    # --- whatever is in it

    def full_name(self, topic: str) -> str:
        """Return the name in the bag of a topic of the rig's table."""
        if topic.startswith("/"):
            return topic
        return f"/{self.namespace}/{topic}" if self.namespace else f"/{topic}"

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic, 0 where there is none."""
        name = self.full_name(topic)
        return sum(row.message_count for row in self.topics if row.name == name)

    def require(self, *topics: str) -> None:
        """Check that topics are there with at least one message.

        Raises
        ------
        MissingTopicsError
            One is not.
        """
        missing = [topic for topic in topics if not self.count(topic)]
        if missing:
            there = ", ".join(f"{row.name} ({row.message_count})" for row in self.topics) or "no topics"
            wanted = ", ".join(self.full_name(topic) for topic in missing)
            raise MissingTopicsError(
                f"{self.path} has no messages on {wanted}: it holds {there}; record with the nodes running "
                f"that publish {'it' if len(missing) == 1 else 'them'}, or choose another bag"
            )

    def definition(self, type_name: str) -> Definition | None:
        """Return the definition of a message type that the bag holds, None where it holds none."""
        for connection in self._reader.connections:
            if connection.msgtype == type_name and connection.msgdef.data:
                is_idl = connection.msgdef.format.name == "IDL"
                return Definition(connection.msgdef.data, is_idl, connection.digest)
        return None

    def raw_messages(self, *topics: str) -> Iterator[RawMessage]:
        """Yield messages in the order of their receive times, of some topics or of all.

        Raises
        ------
        BagTruncatedError
            The file is damaged further on.
        """
        waiting: list[tuple[int, Block, int]] = []
        for haul in self._hauls({self.full_name(topic) for topic in topics}):
            receive_ns = np.concatenate([block.receive_ns for block in haul.blocks])
            starts = np.concatenate([block.starts for block in haul.blocks])
            found = [(block, k) for block in haul.blocks for k in range(len(block.starts))]
            order = np.lexsort((starts, receive_ns)).tolist()
            waiting += [(int(receive_ns[k]), *found[k]) for k in order]
            waiting.sort(key=itemgetter(0))
            n_due = bisect_left(waiting, haul.complete_until_ns, key=itemgetter(0))
            for at_ns, block, k in waiting[:n_due]:
                yield RawMessage(*block.topic, at_ns, block.message(k))
            del waiting[:n_due]
        for at_ns, block, k in waiting:
            yield RawMessage(*block.topic, at_ns, block.message(k))

    def _hauls(self, names: set[str]) -> Iterator[Haul]:
        """Yield the messages of topics by their full names, or of all, in the time that is asked for."""
        wanted = {
            TypedTopic(row.name, row.type_name): self._span_of(row.name)
            for row in self.topics
            if not names or row.name in names
        }
        hauls = self._source.hauls(wanted)
        while True:
            try:
                haul = next(hauls)
            except StopIteration:
                return
            except Exception as err:
                raise _damaged(self.path, err) from err
            if haul.blocks:
                yield haul

    def _span_of(self, name: str) -> Span:
        topic = graph.TOPICS.get(name) or graph.TOPICS.get(self._relative(name))
        return self._span._replace(start_ns=0) if topic is not None and topic.qos.is_latched else self._span

    def _relative(self, name: str) -> str:
        return name.removeprefix(f"/{self.namespace}/" if self.namespace else "/")

    # --- the rig's content

    def read(self, *topics: str) -> None:
        """Read several topics of the rig in one pass and keep what they say for the methods below.

        Parameters
        ----------
        topics : str -- of ``hub/measured``, ``hub/applied``, ``beam/displacement``, ``hub/clock_sync`` and topics of
            texts; those that the bag lacks are passed over

        Raises
        ------
        BagTruncatedError
            The file is damaged.
        """
        for topic in topics:
            if self.count(topic):
                name = self.full_name(topic)
                self._kept.setdefault(name, self._new_intake(topic))
        self._fill(self._kept)

    def _new_intake(self, topic: str) -> Intake[Any]:
        if topic in ("hub/measured", "hub/applied"):
            return HubIntake(self._types, self.full_name(topic))
        if topic == "beam/displacement":
            return DisplacementIntake(self._types)
        if topic == "hub/clock_sync":
            return ClockIntake(self._types)
        if topic == "/diagnostics":
            return Intake(
                graph.DIAGNOSTICS, message_decoder(self._types, graph.DIAGNOSTICS, read_diagnostics)
            )
        return Intake(graph.STRING, message_decoder(self._types, graph.STRING, read_json))

    def _fill(self, intakes: dict[str, Intake[Any]]) -> None:
        """Read the topics of intakes, by their full names, in one pass."""
        empty = {name: intake for name, intake in intakes.items() if not intake.is_filled}
        if empty:
            for haul in self._hauls(set(empty)):
                for block in haul.blocks:
                    empty[block.topic.name].take(block)
        for intake in empty.values():
            intake.is_filled = True

    def _filled(self, topic: str, kind: type[AnyIntake], intake: AnyIntake) -> AnyIntake:
        """Return what was kept of a topic, or else fill an intake with it."""
        kept = self._kept.pop(self.full_name(topic), None)
        if isinstance(kept, kind):
            return kept
        self._fill({self.full_name(topic): intake})
        return intake

    def hub_samples(self, topic: str = "hub/measured") -> HubSamples:
        """Return ``hub/measured`` or ``hub/applied`` as one signal.

        Raises
        ------
        MissingTopicsError
            The topic is missing, or none of its messages can be read.
        """
        self.require(topic)
        intake = self._filled(topic, HubIntake, HubIntake(self._types, self.full_name(topic)))
        samples = intake.samples()
        if samples is None:
            raise self._nothing_readable(topic, intake.unreadable)
        return samples

    def displacements(self, topic: str = "beam/displacement") -> Displacements:
        """Return the markers' displacements as one table.

        Raises
        ------
        MissingTopicsError
            The topic is missing, or none of its messages can be read.
        """
        self.require(topic)
        intake = self._filled(topic, DisplacementIntake, DisplacementIntake(self._types))
        table = intake.table()
        if table is None:
            raise self._nothing_readable(topic, intake.unreadable)
        return table

    def clock_syncs(self, topic: str = "hub/clock_sync") -> tuple[ClockSync, ...]:
        """Return the comparisons of device and host clock, sorted by host time, if there are any."""
        return self._filled(topic, ClockIntake, ClockIntake(self._types)).syncs()

    def texts(self, topic: str) -> tuple[dict[str, Any], ...]:
        """Return the JSON objects of a String topic in their order; empty where there are none."""
        texts = Intake(graph.STRING, message_decoder(self._types, graph.STRING, read_json))
        return tuple(self._filled(topic, Intake, texts).items())

    def excitation_info(self) -> dict[str, Any] | None:
        """Return the newest recipe of the excitation, or None where none was recorded."""
        infos = self.texts("excitation/info")
        return infos[-1] if infos else None

    def healths(self) -> tuple[Health, ...]:
        """Return what the nodes said of their health; empty where nothing was recorded of it."""
        if not self.count("/diagnostics"):
            return ()
        said = self._filled("/diagnostics", Intake, self._new_intake("/diagnostics")).items()
        return tuple(one for message in said for one in message)

    def sequence_states(self) -> tuple[dict[str, Any], ...]:
        """Return what became of the sequences, in the order in which it was reported."""
        return self.texts("hub/sequence_state")

    def _nothing_readable(self, topic: str, unreadable: Unreadable) -> MissingTopicsError:
        name = self.full_name(topic)
        if not unreadable.count:
            return MissingTopicsError(
                f"{self.path} has no messages on {name} in the time that is asked for: it holds "
                f"{self.duration_ns / SECOND_NS:.3f} s, expected a time within; choose others"
            )
        return MissingTopicsError(
            f"{self.path}: none of the {unreadable.count} messages on {name} can be read "
            f"({unreadable.first_reason}); expected what the rig's nodes publish there"
        )

    def provenance(self) -> dict[str, str]:
        """Return how the recording came about (versions, host, operator, rig, camera ..), as far as it says so."""
        return self._source.note(PROVENANCE_NOTE)

    # --- its end

    @property
    def is_checked(self) -> bool:
        """Whether ``damage`` looks at the whole of it: it lies here, and no part of it is asked for."""
        return self.is_whole and isinstance(self.path, Path)

    def damage(self) -> Iterator[str]:
        """Yield what is amiss with the bag's files, in words: checksums, torn ends, bytes that are no record.

        Notes
        -----
        Of a bag elsewhere, or of a part of one, only what is read is checked, when it is read.
        """
        if not self.is_checked:
            return
        assert isinstance(self.path, Path)
        files = [self.path] if self.path.is_file() else sorted(self.path.iterdir())
        for file in files:
            if file.suffix == ".mcap":
                data = open_file(file)
                for damage in damage_of(data, find_pieces(data)):
                    yield f"{file.name}: {damage}"

    def close(self) -> None:
        """Close the bag's files."""
        self._source.close()
        self._reader.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


# --- opening ---------------------------------------------------------------------------------------------


def _damaged(path: AnyPath, err: Exception) -> BagTruncatedError:
    reason = str(err) or type(err).__name__
    return BagTruncatedError(
        f"{path} is cut off or damaged ({reason.rstrip('.')}): expected a whole bag; "
        f"`beam recover {path}` saves what can be read"
    )


def _storage_file(path: AnyPath) -> AnyPath:
    if path.is_file():
        return path
    files = [file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES]
    return min(files, key=str, default=path)


def _open_reader(path: AnyPath) -> Reader:
    if not path.exists():
        raise BagNotFoundError(f"{path} does not exist: expected a bag's folder, or a .mcap or .db3 file")
    try:
        target = _check_is_bag(path)
    except OSError as err:
        if isinstance(err, BagError):
            raise
        raise BagError(f"{path} cannot be read: {err.strerror or err}; check its permissions") from err
    try:
        reader = Reader(cast(Any, target))
        reader.open()
    except Exception as err:
        # rosbags raises ReaderError for what it expects, and whatever a damaged file leads it to.
        storage = _storage_file(path)
        if storage.suffix == ".mcap" and storage.is_file() and not _begins_as_mcap(storage):
            raise NotABagError(f"{storage} is no MCAP file ({err}); choose a bag of ROS 2") from err
        if isinstance(err, ReaderError) and "etadata" in str(err):
            raise NotABagError(
                f"{path} has a {METADATA_NAME} that cannot be read ({err}); `beam recover {path}` "
                "writes a new one"
            ) from err
        raise _damaged(path, err) from err
    return reader


def _open_source(path: AnyPath, reader: Reader) -> IndexedBag | ScannedBag:
    """Return what reads the bag's messages: by their indexes where all of its files have them."""
    files = [path] if path.is_file() else [path / name for name in read_file_names(path / METADATA_NAME)]
    files = files or [_storage_file(path)]
    if reader.compression_mode or any(file.suffix != ".mcap" for file in files):
        return ScannedBag(reader)
    opened: list[ChunkedFile] = []
    try:
        opened += [ChunkedFile(file.open("rb")) for file in files]
    except Exception as err:  # a summary that is damaged leads the library anywhere
        for chunked in opened:
            chunked.close()
        raise _damaged(path, err) from err
    indexed = IndexedBag(opened)
    if all(file.is_indexed for file in opened):
        return indexed
    indexed.close()
    return ScannedBag(reader)


def _check_is_bag(path: AnyPath) -> AnyPath:
    """Return what rosbags is to open, or say why nothing there is a bag."""
    if path.is_file():
        if path.suffix not in STORAGE_SUFFIXES:
            raise NotABagError(f"{path} is no bag: expected a bag's folder, or a .mcap or .db3 file")
        return path
    if isinstance(path, Path) and is_being_written(path):
        raise BagTruncatedError(
            f"{path} is still being recorded: expected a finished bag; call recorder/stop or end the recorder"
        )
    if (path / MARK_NAME).is_file():
        raise BagTruncatedError(
            f"{path} was cut off while it was recorded: expected a finished bag; `beam recover {path}` saves "
            "what can be read"
        )
    if (path / METADATA_NAME).is_file():
        return path
    storage = _storage_file(path)
    others = [file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES][1:]
    if others:
        raise BagTruncatedError(
            f"{path} holds {len(others) + 1} files and no {METADATA_NAME} that says how they belong together; "
            f"`beam recover {path}` joins them, or choose one of them"
        )
    if storage == path:
        raise NotABagError(
            f"{path} holds neither {METADATA_NAME} nor a .mcap or .db3 file: expected the folder of a "
            "ROS 2 bag"
        )
    return storage


def _begins_as_mcap(path: AnyPath) -> bool:
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _find_namespace(bag: Bag) -> str:
    relative = [name for name in graph.TOPICS if not name.startswith("/")]
    found = {
        row.name[: -len(name)].strip("/")
        for row in bag.topics
        for name in relative
        if row.name.endswith(f"/{name}")
    }
    if len(found) > 1:
        # A camera in a namespace of its own is no rig: a hub makes one.
        has_hub = {
            name
            for name in found
            if any(row.name.startswith(f"/{name}/hub/".replace("//", "/")) for row in bag.topics)
        }
        found = has_hub if len(has_hub) == 1 else found
    if len(found) > 1:
        names = ", ".join(sorted(f"/{name}" for name in found))
        bag.close()
        raise MissingTopicsError(
            f"{bag.path} holds several rigs in the namespaces {names}: expected one; name the one to read"
        )
    return found.pop() if found else ""
