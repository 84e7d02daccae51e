"""Bags read for identification: samples of the hub, displacements, clocks and the experiment's texts.

``Bag`` opens what ROS 2's recorder, rosbags or this suite wrote, MCAP or SQLite, and extracts each kind of
content as arrays. Only header stamps carry time; receive times order nothing. A message that cannot be read
is left out and counted, never a reason to stop; a bag that cannot be opened is refused with the remedy.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from rosbags.rosbag2 import Reader, ReaderError

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.bags.batches import decode_batch
from beam_ros.bags.errors import (
    BagError,
    BagNotFoundError,
    BagTruncatedError,
    MessageDecodeError,
    MissingTopicsError,
    NotABagError,
)
from beam_ros.bags.mcap_pieces import MAGIC, damage_of, find_pieces, open_file
from beam_ros.bags.metadata import METADATA_NAME
from beam_ros.bags.recording_mark import is_being_written, is_marked
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.interfaces import graph
from beam_ros.messages import (
    BATCH_FIELDS,
    BagTypes,
    Displacement,
    MessageContentError,
    read_clock_sync,
    read_displacement,
    read_json,
)

_T = TypeVar("_T")
_Stamped = TypeVar("_Stamped", SampleBatch, Displacement)

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


@dataclass(frozen=True)
class Unreadable:
    """Messages of a topic that were left out.

    Attributes
    ----------
    count : int -- how many
    first_reason : str -- why the first one was; empty where there is none
    """

    count: int = 0
    first_reason: str = ""


@dataclass(frozen=True)
class Gap:
    """A piece of a sampled signal that is missing.

    Attributes
    ----------
    start_ns, end_ns : int -- the last sample before and the first one after it [ns, UNIX]
    missing : int -- samples that would have fitted between
    is_new_epoch : bool -- the device restarted here
    """

    start_ns: int
    end_ns: int
    missing: int
    is_new_epoch: bool


@dataclass(frozen=True)
class HubSamples:
    """All batches of one topic of the hub as one signal; gaps are left as gaps.

    Attributes
    ----------
    topic : str -- full name in the bag
    stamps_ns : ndarray of int64, shape (n,) -- strictly increasing [ns, UNIX]
    period_ns : int -- the device's period [ns of device time]; 0: every sample has a stamp of its own
    epochs : ndarray of int64, shape (n,) -- clock epoch of each sample
    positions, velocities, accelerations, efforts : ndarray, shape (n,), or None -- [m], [m/s], [m/s^2], [N];
        NaN where only some batches carry the quantity
    gaps : tuple of Gap -- in order of time
    duplicates : int -- samples left out because their time was already there
    unreadable : Unreadable
    """

    topic: str
    stamps_ns: StampArray
    period_ns: int
    epochs: StampArray
    positions: FloatArray | None
    velocities: FloatArray | None
    accelerations: FloatArray | None
    efforts: FloatArray | None
    gaps: tuple[Gap, ...]
    duplicates: int
    unreadable: Unreadable

    @property
    def lost(self) -> int:
        """Number of samples missing in all gaps."""
        return sum(gap.missing for gap in self.gaps)


@dataclass(frozen=True)
class Displacements:
    """All messages of ``beam/displacement`` as one table.

    Attributes
    ----------
    names : tuple of str, length m -- markers, in the order of the first message
    stamps_ns : ndarray of int64, shape (n,) -- strictly increasing [ns, UNIX]
    positions : ndarray, shape (n, m) -- absolute displacement u [m]; NaN where not seen
    duplicates : int -- values left out because the marker had one at that time already
    unreadable : Unreadable
    """

    names: tuple[str, ...]
    stamps_ns: StampArray
    positions: FloatArray
    duplicates: int
    unreadable: Unreadable


class _Contents(Generic[_T]):
    """Decoded messages, one after the other; ``unreadable`` counts what was left out so far."""

    def __init__(self, messages: Iterator[RawMessage], type_name: str, decode: Callable[[bytes], _T]) -> None:
        self._messages, self._type_name, self._decode = messages, type_name, decode
        self.unreadable = Unreadable()

    def leave_out(self, reason: str) -> None:
        """Count a message that is left out."""
        self.unreadable = Unreadable(self.unreadable.count + 1, self.unreadable.first_reason or reason)

    def __iter__(self) -> Iterator[_T]:
        for message in self._messages:
            try:
                if message.type_name != self._type_name:
                    raise MessageDecodeError(f"type {message.type_name}: expected {self._type_name}")
                content = self._decode(message.data)
            except (MessageDecodeError, MessageContentError) as err:
                self.leave_out(str(err))
                continue
            yield content


class Bag:
    """An open bag; a context manager.

    Parameters
    ----------
    path : Path or str
        The bag's folder, or a single ``.mcap`` or ``.db3`` file.
    namespace : str, optional
        Of the rig whose topics are read; needed only where a bag holds several.

    Attributes
    ----------
    path : Path
    topics : tuple of TopicCount -- sorted by name
    message_count : int
    start_ns : int -- receive time of the first message [ns, UNIX]; 0 in an empty bag
    duration_ns : int -- between the first and the last receive time [ns]
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

    def __init__(self, path: Path | str, *, namespace: str | None = None) -> None:
        self.path = Path(path)
        self._types = BagTypes()
        self._reader = _open_reader(self.path)
        connections = self._reader.connections
        counts: dict[tuple[str, str], int] = {}
        for connection in connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        self.topics = tuple(TopicCount(*key, count) for key, count in sorted(counts.items()))
        self.message_count = self._reader.message_count
        self.start_ns = self._reader.start_time if self.message_count else 0
        self.duration_ns = max(0, self._reader.duration - 1) if self.message_count else 0
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
        names = {self.full_name(topic) for topic in topics}
        chosen = [c for c in self._reader.connections if not names or c.topic in names]
        if not chosen:
            return
        messages = self._reader.messages(chosen)
        while True:
            try:
                connection, receive_ns, data = next(messages)
            except StopIteration:
                return
            except Exception as err:
                raise _damaged(self.path, err) from err
            yield RawMessage(connection.topic, connection.msgtype, receive_ns, bytes(data))

    def _read(self, topic: str, type_name: str, decode: Callable[[bytes], _T]) -> _Contents[_T]:
        """Return the decoded messages of a topic, one after the other; what cannot be decoded is left out."""
        return _Contents(self.raw_messages(topic), type_name, decode)

    def _message_decoder(self, type_name: str, read: Callable[[Any], _T]) -> Callable[[bytes], _T]:
        def decode(data: bytes) -> _T:
            try:
                message = self._types.deserialize(data, type_name)
            except Exception as err:
                # rosbags raises whatever damaged bytes lead it to.
                raise MessageDecodeError(
                    f"{len(data)} bytes that are no {type_name} ({type(err).__name__}: {err})"
                ) from err
            return read(message)

        return decode

    # --- the rig's content

    def hub_samples(self, topic: str = "hub/measured") -> HubSamples:
        """Return ``hub/measured`` or ``hub/applied`` as one signal.

        Raises
        ------
        MissingTopicsError
            The topic is missing, or none of its messages can be read.
        """
        self.require(topic)
        contents = self._read(topic, graph.JOINT_TRAJECTORY, decode_batch)
        batches = self._stamped(topic, contents, "batch")
        return replace(
            join_batches(self.full_name(topic), batches, Unreadable()), unreadable=contents.unreadable
        )

    def displacements(self, topic: str = "beam/displacement") -> Displacements:
        """Return the markers' displacements as one table.

        Raises
        ------
        MissingTopicsError
            The topic is missing, or none of its messages can be read.
        """
        self.require(topic)
        decode = self._message_decoder(graph.JOINT_STATE, read_displacement)
        contents = self._read(topic, graph.JOINT_STATE, decode)
        rows = self._stamped(topic, contents, "displacement")
        return replace(join_displacements(rows, Unreadable()), unreadable=contents.unreadable)

    def clock_syncs(self, topic: str = "hub/clock_sync") -> tuple[ClockSync, ...]:
        """Return the comparisons of device and host clock, sorted by host time, if there are any."""
        type_name = graph.TOPICS["hub/clock_sync"].type_name
        syncs = self._read(topic, type_name, self._message_decoder(type_name, read_clock_sync))
        return tuple(sorted(syncs, key=lambda sync: sync.host_ns))

    def texts(self, topic: str) -> tuple[dict[str, Any], ...]:
        """Return the JSON objects of a String topic in their order; empty where there are none."""
        contents = self._read(topic, graph.STRING, self._message_decoder(graph.STRING, read_json))
        return tuple(contents)

    def excitation_info(self) -> dict[str, Any] | None:
        """Return the newest recipe of the excitation, or None where none was recorded."""
        infos = self.texts("excitation/info")
        return infos[-1] if infos else None

    def sequence_states(self) -> tuple[dict[str, Any], ...]:
        """Return what became of the sequences, in the order in which it was reported."""
        return self.texts("hub/sequence_state")

    def _stamped(self, topic: str, contents: _Contents[_Stamped], what: str) -> Iterator[_Stamped]:
        """Yield what has a stamp: a receive time never stands in for it.

        Raises
        ------
        MissingTopicsError
            Nothing has one.
        """
        is_empty = True
        for item in contents:
            if item.stamp_ns > 0:
                is_empty = False
                yield item
            else:
                contents.leave_out(f"{what} with stamp 0: expected the time of its first sample")
        if is_empty:
            unreadable = contents.unreadable
            raise MissingTopicsError(
                f"{self.path}: none of the {unreadable.count} messages on {self.full_name(topic)} can be read "
                f"({unreadable.first_reason}); expected what the rig's nodes publish there"
            )

    # --- its end

    def damage(self) -> Iterator[str]:
        """Yield what is amiss with the bag's files, in words: checksums, torn ends, bytes that are no record."""
        files = [self.path] if self.path.is_file() else sorted(self.path.iterdir())
        for file in files:
            if file.suffix == ".mcap":
                data = open_file(file)
                for damage in damage_of(data, find_pieces(data)):
                    yield f"{file.name}: {damage}"

    def close(self) -> None:
        """Close the bag's files."""
        self._reader.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


# --- opening ---------------------------------------------------------------------------------------------


def _damaged(path: Path, err: Exception) -> BagTruncatedError:
    reason = str(err) or type(err).__name__
    return BagTruncatedError(
        f"{path} is cut off or damaged ({reason.rstrip('.')}): expected a whole bag; "
        f"`beam recover {path}` saves what can be read"
    )


def _storage_file(path: Path) -> Path:
    if path.is_file():
        return path
    files = sorted(file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES)
    return files[0] if files else path


def _open_reader(path: Path) -> Reader:
    if not path.exists():
        raise BagNotFoundError(f"{path} does not exist: expected a bag's folder, or a .mcap or .db3 file")
    try:
        target = _check_is_bag(path)
    except OSError as err:
        if isinstance(err, BagError):
            raise
        raise BagError(f"{path} cannot be read: {err.strerror or err}; check its permissions") from err
    try:
        reader = Reader(target)
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


def _check_is_bag(path: Path) -> Path:
    """Return what rosbags is to open, or say why nothing there is a bag."""
    if path.is_file():
        if path.suffix not in STORAGE_SUFFIXES:
            raise NotABagError(f"{path} is no bag: expected a bag's folder, or a .mcap or .db3 file")
        return path
    if is_being_written(path):
        raise BagTruncatedError(
            f"{path} is still being recorded: expected a finished bag; call recorder/stop or end the recorder"
        )
    if is_marked(path):
        raise BagTruncatedError(
            f"{path} was cut off while it was recorded: expected a finished bag; `beam recover {path}` saves "
            "what can be read"
        )
    if (path / METADATA_NAME).is_file():
        return path
    storage = _storage_file(path)
    if storage == path:
        raise NotABagError(
            f"{path} holds neither {METADATA_NAME} nor a .mcap or .db3 file: expected the folder of a "
            "ROS 2 bag"
        )
    return storage


def _begins_as_mcap(path: Path) -> bool:
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
        names = ", ".join(sorted(f"/{name}" for name in found))
        bag.close()
        raise MissingTopicsError(
            f"{bag.path} holds several rigs in the namespaces {names}: expected one; name the one to read"
        )
    return found.pop() if found else ""


# --- joining ---------------------------------------------------------------------------------------------

OWN_STAMPS_GAP = 5.0
"""Samples that are asked for one by one come unevenly; further apart than so many usual steps, some are missing."""


class _BatchColumns:
    """Batches as they come, in a few long columns: an hour of them is no heap of small arrays."""

    def __init__(self) -> None:
        self.stamps, self.periods, self.epochs, self.lengths = (array("q") for _ in range(4))
        self.quantities: dict[str, array[float]] = {}
        self.n_samples = 0

    def add(self, batch: SampleBatch) -> None:
        """Take in a batch; a quantity that it lacks is NaN where others have it."""
        n = len(batch)
        for column, number in (
            (self.stamps, batch.stamp_ns),
            (self.periods, batch.period_ns),
            (self.epochs, batch.epoch),
            (self.lengths, n),
        ):
            column.append(number)
        for name in BATCH_FIELDS:
            values = getattr(batch, name)
            if values is not None:
                own = self.quantities.setdefault(name, array("d", [math.nan]) * self.n_samples)
                own.frombytes(np.asarray(values, dtype=np.float64).tobytes())
            elif name in self.quantities:
                self.quantities[name].extend([math.nan] * n)
        self.n_samples += n


def join_batches(topic: str, batches: Iterable[SampleBatch], unreadable: Unreadable) -> HubSamples:
    """Put batches together in the order of their stamps.

    Parameters
    ----------
    topic : str -- for the result
    batches : iterable of SampleBatch -- at least one
    unreadable : Unreadable -- for the result

    Returns
    -------
    HubSamples

    Notes
    -----
    Within a batch, sample k lies at the stamp plus k periods; the host's map moves by less than a part in a
    thousand of a period in that time. Loss is a distance of more than one and a half periods. Where every sample has
    a stamp of its own and no period is named, loss is a distance of more than ``OWN_STAMPS_GAP`` usual ones.
    """
    found = _BatchColumns()
    for batch in batches:
        found.add(batch)
    begun, periods, epochs, lengths = (
        np.frombuffer(column, dtype=np.int64)
        for column in (found.stamps, found.periods, found.epochs, found.lengths)
    )
    order = np.argsort(begun, kind="stable")
    named = periods[periods > 0]
    period_ns = int(np.median(named)) if len(named) else 0
    # Which samples, in the order of the bag, stand where in the order of time.
    offsets, sizes = (np.cumsum(lengths) - lengths)[order], lengths[order]
    within = np.arange(found.n_samples) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    sources = np.repeat(offsets, sizes) + within
    stamps = np.repeat(begun[order], sizes) + within * np.repeat(periods[order], sizes)
    del within

    latest_before = np.maximum.accumulate(stamps)
    keep = np.ones(len(stamps), dtype=bool)
    keep[1:] = stamps[1:] > latest_before[:-1]
    stamps = stamps[keep]
    epochs = np.repeat(epochs[order], sizes)[keep]
    sources = sources[keep]
    quantities: dict[str, FloatArray | None] = {
        name: np.frombuffer(found.quantities[name])[sources] if name in found.quantities else None
        for name in BATCH_FIELDS
    }

    steps = np.diff(stamps)
    usual_ns = period_ns or (float(np.median(steps)) if len(steps) else 1.0)
    widest_ns = 1.5 * period_ns or OWN_STAMPS_GAP * usual_ns
    gaps = tuple(
        Gap(
            int(stamps[k]),
            int(stamps[k + 1]),
            max(1, round(int(steps[k]) / usual_ns) - 1),
            bool(epochs[k + 1] != epochs[k]),
        )
        for k in np.flatnonzero(steps > widest_ns)
    )
    return HubSamples(
        topic=topic,
        stamps_ns=stamps,
        period_ns=period_ns,
        epochs=epochs,
        gaps=gaps,
        duplicates=int(np.count_nonzero(~keep)),
        unreadable=unreadable,
        **quantities,
    )


def join_displacements(rows: Iterable[Displacement], unreadable: Unreadable) -> Displacements:
    """Put messages of ``beam/displacement`` together: a row for each distinct time, a column for each marker.

    Parameters
    ----------
    rows : iterable of Displacement -- at least one
    unreadable : Unreadable -- for the result

    Returns
    -------
    Displacements
    """
    column: dict[str, int] = {}
    stamps, columns, values = array("q"), array("q"), array("d")
    for row in rows:
        columns.extend(column.setdefault(name, len(column)) for name in row.names)
        stamps.extend([row.stamp_ns] * len(row.names))
        values.frombytes(row.positions.tobytes())
    distinct, row_of = np.unique(np.frombuffer(stamps, dtype=np.int64), return_inverse=True)
    # Of several values of a marker at one time the first one stays.
    places, first = np.unique(
        row_of * len(column) + np.frombuffer(columns, dtype=np.int64), return_index=True
    )
    positions = np.full((len(distinct), len(column)), np.nan)
    positions.ravel()[places] = np.frombuffer(values)[first]
    return Displacements(tuple(column), distinct, positions, len(values) - len(places), unreadable)
