"""The contents of a rig's topics as arrays: samples of the hub, displacements, clocks.

An intake takes the messages of one topic as they are read, block by block, and makes one signal of them at the end.
Messages of one shape are taken as columns (``beam_ros.bags.layouts``), all others one by one. Only header stamps
carry time: receive times order nothing. A message that cannot be read is left out and counted.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from beam_ros.arrays import FloatArray, IndexArray, StampArray
from beam_ros.bags.batches import decode_batch
from beam_ros.bags.blocks import Block
from beam_ros.bags.errors import MessageDecodeError
from beam_ros.bags.layouts import Alike, Shapes, as_floats
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.interfaces import graph
from beam_ros.messages import (
    BATCH_FIELDS,
    BagTypes,
    Displacement,
    MessageContentError,
    read_clock_sync,
    read_displacement,
)
from beam_ros.messages.texts import key_values

_T = TypeVar("_T")

OWN_STAMPS_GAP = 5.0
"""Samples that are asked for one by one come unevenly; further apart than so many usual steps, some are missing."""


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
    is_in_order : bool -- messages stand in the bag in the order of their stamps
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
    is_in_order: bool

    @property
    def stretches(self) -> tuple[slice, ...]:
        """Which samples one clock has counted, without a hole that is longer than all of them together."""
        steps = np.diff(self.stamps_ns)
        usual_ns = self.period_ns or (float(np.median(steps)) if len(steps) else 1.0)
        is_border = (np.diff(self.epochs) != 0) | (steps > usual_ns * len(self.stamps_ns))
        borders = [0, *(np.flatnonzero(is_border) + 1).tolist(), len(self.stamps_ns)]
        return tuple(slice(first, last) for first, last in itertools.pairwise(borders))

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
    is_in_order : bool -- messages stand in the bag in the order of their stamps
    """

    names: tuple[str, ...]
    stamps_ns: StampArray
    positions: FloatArray
    duplicates: int
    unreadable: Unreadable
    is_in_order: bool


def message_decoder(types: BagTypes, type_name: str, read: Callable[[Any], _T]) -> Callable[[bytes], _T]:
    """Return what makes content of a message's CDR bytes by a reader of its fields.

    The decoder raises ``MessageDecodeError`` for bytes that are no message of the type, and whatever ``read`` raises.
    """

    def decode(data: bytes) -> _T:
        try:
            message = types.deserialize(data, type_name)
        except Exception as err:
            # rosbags raises whatever damaged bytes lead it to.
            raise MessageDecodeError(
                f"{len(data)} bytes that are no {type_name} ({type(err).__name__}: {err})"
            ) from err
        return read(message)

    return decode


class Intake(Generic[_T]):
    """Takes the messages of a topic; this one keeps each of them, decoded.

    Parameters
    ----------
    type_name : str -- "package/msg/Name" that they must be of
    decode : callable -- from a message's CDR bytes to what it says

    Attributes
    ----------
    unreadable : Unreadable -- what was left out so far
    is_filled : bool -- the bag has been read to its end
    n_seen : int -- messages that were taken so far, readable or not
    """

    def __init__(self, type_name: str, decode: Callable[[bytes], _T]) -> None:
        self.unreadable = Unreadable()
        self.is_filled = False
        self._type_name, self._decode = type_name, decode
        self._items: list[tuple[int, int, _T]] = []
        self.n_seen = 0

    def take(self, block: Block) -> None:
        """Take the messages of a block."""
        if block.topic.type_name == self._type_name:
            self._take(block)
        elif len(block.starts):
            reason = f"type {block.topic.type_name}: expected {self._type_name}"
            self.leave_out(reason, len(block.starts))
        self.n_seen += len(block.starts)

    def items(self) -> list[_T]:
        """Return what was decoded one by one, in the order in which it came."""
        return [item for *_, item in sorted(self._items, key=lambda item: item[0])]

    def forget(self, n_first: int) -> None:
        """Let go of what the first messages said, so many as are counted from the very first one."""
        self._items = [kept for kept in self._items if kept[1] >= n_first]

    def leave_out(self, reason: str, count: int = 1) -> None:
        """Count messages that are left out."""
        self.unreadable = Unreadable(self.unreadable.count + count, self.unreadable.first_reason or reason)

    def _take(self, block: Block) -> None:
        self._take_singly(block, np.arange(len(block.starts)))

    def _take_singly(self, block: Block, numbers: IndexArray) -> None:
        for k in numbers.tolist():
            try:
                item = self._decode(block.message(k))
            except (MessageDecodeError, MessageContentError) as err:
                self.leave_out(str(err))
            else:
                self._keep(int(block.receive_ns[k]), self.n_seen + k, item)

    def _keep(self, receive_ns: int, number: int, item: _T) -> None:
        self._items.append((receive_ns, number, item))


class _TableIntake(Intake[_T], ABC):
    """Takes messages of one shape as a table.

    Parameters
    ----------
    types : BagTypes
    type_name, decode : as of ``Intake``
    free_texts : tuple of str -- paths of texts that may differ within a shape
    """

    def __init__(
        self, types: BagTypes, type_name: str, decode: Callable[[bytes], _T], free_texts: tuple[str, ...] = ()
    ) -> None:
        super().__init__(type_name, decode)
        self._shapes = Shapes(types.store, type_name, free_texts)
        self._samples: dict[bytes, _T | None] = {}

    def _take(self, block: Block) -> None:
        for part in self._shapes.sort(block):
            if isinstance(part, Alike):
                sample = self._sample(part.layout.sample)
                taken = np.zeros(len(part.numbers), dtype=bool)
                if sample is not None:
                    taken = self._take_table(part, sample)
                self._take_singly(block, part.numbers[~taken])
            else:
                self._take_singly(block, part)

    def _sample(self, data: bytes) -> _T | None:
        """Return what the message says that a shape was learnt from, None where it cannot be read."""
        if data not in self._samples:
            try:
                self._samples[data] = self._decode(data)
            except (MessageDecodeError, MessageContentError):
                self._samples[data] = None
        return self._samples[data]

    @abstractmethod
    def _take_table(self, alike: Alike, sample: _T) -> Any:
        """Take messages of the sample's shape; return which of them were taken, shape (n,)."""


# --- the hub's samples -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Batches:
    """Batches of equal length and period: numbers of the messages, stamps, quantities of shape (n, length)."""

    numbers: StampArray
    stamps_ns: StampArray
    period_ns: int
    epoch: int
    length: int
    quantities: Mapping[str, FloatArray]

    def later(self, n_first: int) -> _Batches:
        """Return those from a number on."""
        kept = self.numbers >= n_first
        if kept.all():
            return self
        quantities = {name: values[kept] for name, values in self.quantities.items()}
        return replace(
            self, numbers=self.numbers[kept], stamps_ns=self.stamps_ns[kept], quantities=quantities
        )


class HubIntake(_TableIntake[SampleBatch]):
    """Makes one signal of the batches of ``hub/measured`` or ``hub/applied``.

    Parameters
    ----------
    types : BagTypes
    topic : str -- full name, for the result
    """

    def __init__(self, types: BagTypes, topic: str) -> None:
        super().__init__(types, graph.JOINT_TRAJECTORY, decode_batch)
        self._topic = topic
        self._batches: list[_Batches] = []

    def _take_table(self, alike: Alike, sample: SampleBatch) -> Any:
        layout, rows = alike.layout, alike.rows
        times_ns = layout.times_ns("points.time_from_start", rows)
        stamps_ns = layout.times_ns("header.stamp", rows)[:, 0]
        taken = (times_ns == np.arange(len(sample)) * sample.period_ns).all(axis=1) & (stamps_ns > 0)
        if not taken.all():
            rows = rows[taken]
        quantities = {
            name: as_floats(layout.numbers(f"points.{field}", rows))
            for name, field in BATCH_FIELDS.items()
            if getattr(sample, name) is not None
        }
        numbers = self.n_seen + alike.numbers[taken]
        self._batches.append(
            _Batches(numbers, stamps_ns[taken], sample.period_ns, sample.epoch, len(sample), quantities)
        )
        return taken

    def _keep(self, receive_ns: int, number: int, item: SampleBatch) -> None:
        del receive_ns
        if item.stamp_ns <= 0:
            self.leave_out("batch with stamp 0: expected the time of its first sample")
            return
        self._batches.append(_as_table(number, item))

    def forget(self, n_first: int) -> None:
        """Let go of the first batches."""
        self._batches = [later for own in self._batches if len((later := own.later(n_first)).numbers)]

    def samples(self) -> HubSamples | None:
        """Return the signal, None where there is nothing that can be read."""
        batches = [batches for batches in self._batches if len(batches.numbers)]
        return _join(self._topic, batches, self.unreadable) if batches else None


def _as_table(number: int, batch: SampleBatch) -> _Batches:
    return _Batches(
        np.array([number]),
        np.array([batch.stamp_ns]),
        batch.period_ns,
        batch.epoch,
        len(batch),
        {
            name: np.asarray(values, dtype=np.float64)[np.newaxis]
            for name in BATCH_FIELDS
            if (values := getattr(batch, name)) is not None
        },
    )


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
    return _join(topic, [_as_table(k, batch) for k, batch in enumerate(batches)], unreadable)


def _join(topic: str, tables: list[_Batches], unreadable: Unreadable) -> HubSamples:
    counts = np.array([len(table.numbers) for table in tables])
    begun = np.concatenate([table.stamps_ns for table in tables])
    # Of two batches with one stamp the one that came first stands first.
    numbers = np.concatenate([table.numbers for table in tables])
    order = np.lexsort((numbers, begun))
    is_in_order = bool((np.diff(numbers[order]) > 0).all())
    periods = np.repeat([table.period_ns for table in tables], counts)
    lengths = np.repeat([table.length for table in tables], counts)
    named = periods[periods > 0]
    period_ns = int(np.median(named)) if len(named) else 0
    sizes = lengths[order]
    within = np.arange(int(np.sum(sizes))) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    stamps = np.repeat(begun[order], sizes) + within * np.repeat(periods[order], sizes)
    keep = np.ones(len(stamps), dtype=bool)
    keep[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
    # Which samples, in the order in which they were read, stand where in the order of time.
    sources: IndexArray | None = None
    if not (order[1:] > order[:-1]).all() or not keep.all():
        sources = (np.repeat((np.cumsum(lengths) - lengths)[order], sizes) + within)[keep]
        stamps = stamps[keep]
    del within
    epochs = np.repeat(np.repeat([table.epoch for table in tables], counts)[order], sizes)
    quantities = {name: _quantity(tables, name, sources) for name in BATCH_FIELDS}

    steps = np.diff(stamps)
    usual_ns = period_ns or (float(np.median(steps)) if len(steps) else 1.0)
    widest_ns = 1.5 * period_ns or OWN_STAMPS_GAP * usual_ns
    epochs = epochs if sources is None else epochs[keep]
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
        is_in_order=is_in_order,
        **quantities,
    )


def _quantity(tables: list[_Batches], name: str, sources: IndexArray | None) -> FloatArray | None:
    """Return a quantity of all samples, NaN where a batch lacks it; None where all do."""
    if not any(name in table.quantities for table in tables):
        return None
    values = np.concatenate(
        [
            table.quantities[name].ravel()
            if name in table.quantities
            else np.full(len(table.numbers) * table.length, np.nan)
            for table in tables
        ]
    )
    return values if sources is None else values[sources]


# --- displacements ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Frames:
    """Displacements of the same markers: numbers of the messages, stamps, positions of shape (n, markers)."""

    numbers: StampArray
    names: tuple[str, ...]
    stamps_ns: StampArray
    positions: FloatArray

    def later(self, n_first: int) -> _Frames:
        """Return those from a number on."""
        kept = self.numbers >= n_first
        if kept.all():
            return self
        return _Frames(self.numbers[kept], self.names, self.stamps_ns[kept], self.positions[kept])


class DisplacementIntake(_TableIntake[Displacement]):
    """Makes one table of the messages of ``beam/displacement``.

    Parameters
    ----------
    types : BagTypes
    """

    def __init__(self, types: BagTypes) -> None:
        decode = message_decoder(types, graph.JOINT_STATE, read_displacement)
        super().__init__(types, graph.JOINT_STATE, decode)
        self._frames: list[_Frames] = []

    def _take_table(self, alike: Alike, sample: Displacement) -> Any:
        layout = alike.layout
        stamps_ns = layout.times_ns("header.stamp", alike.rows)[:, 0]
        taken = stamps_ns > 0
        positions = as_floats(layout.numbers("position", alike.rows[taken]))
        numbers = self.n_seen + alike.numbers[taken]
        self._frames.append(_Frames(numbers, sample.names, stamps_ns[taken], positions))
        return taken

    def _keep(self, receive_ns: int, number: int, item: Displacement) -> None:
        del receive_ns
        if item.stamp_ns <= 0:
            self.leave_out("displacement with stamp 0: expected the time of its exposure")
            return
        positions = np.asarray(item.positions, dtype=np.float64)[np.newaxis]
        self._frames.append(_Frames(np.array([number]), item.names, np.array([item.stamp_ns]), positions))

    def forget(self, n_first: int) -> None:
        """Let go of the first frames."""
        self._frames = [later for own in self._frames if len((later := own.later(n_first)).numbers)]

    def table(self) -> Displacements | None:
        """Return the table, None where there is nothing that can be read.

        Notes
        -----
        It has a row for each distinct time and a column for each marker. Of several values of a marker at one time
        the first one stays.
        """
        frames = sorted(
            (frames for frames in self._frames if len(frames.numbers)),
            key=lambda frames: int(frames.numbers[0]),
        )
        if not frames:
            return None
        column: dict[str, int] = {}
        for part in frames:
            for name in part.names:
                column.setdefault(name, len(column))
        numbers = np.concatenate([part.numbers for part in frames])
        stamps = np.concatenate([part.stamps_ns for part in frames])
        values = np.full((len(stamps), len(column)), np.nan)
        is_given = np.zeros(values.shape, dtype=bool)
        first = 0
        for part in frames:
            rows = slice(first, first + len(part.numbers))
            columns = [column[name] for name in part.names]
            values[rows, columns] = part.positions
            is_given[rows, columns] = True
            first = rows.stop
        order = np.lexsort((numbers, stamps))
        is_in_order = bool((np.diff(numbers[order]) > 0).all())
        if not (order[1:] > order[:-1]).all():
            stamps, values, is_given = stamps[order], values[order], is_given[order]
        begins = np.flatnonzero(np.append(True, stamps[1:] != stamps[:-1]))
        if len(begins) == len(stamps):
            return Displacements(tuple(column), stamps, values, 0, self.unreadable, is_in_order)
        positions = np.full((len(begins), len(column)), np.nan)
        row_of = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(stamps))))
        n_kept = 0
        for k in range(len(column)):
            own = np.flatnonzero(is_given[:, k])
            distinct, earliest = np.unique(row_of[own], return_index=True)
            positions[distinct, k] = values[own[earliest], k]
            n_kept += len(distinct)
        duplicates = int(np.count_nonzero(is_given)) - n_kept
        return Displacements(
            tuple(column), stamps[begins], positions, duplicates, self.unreadable, is_in_order
        )


# --- clocks ----------------------------------------------------------------------------------------------


class ClockIntake(_TableIntake[ClockSync]):
    """Takes the comparisons of ``hub/clock_sync``, whose texts name numbers of their own.

    Parameters
    ----------
    types : BagTypes
    """

    def __init__(self, types: BagTypes) -> None:
        type_name = graph.TOPICS["hub/clock_sync"].type_name
        super().__init__(types, type_name, message_decoder(types, type_name, read_clock_sync), ("source",))

    def _take_table(self, alike: Alike, sample: ClockSync) -> Any:
        del sample
        host_ns = alike.layout.times_ns("header.stamp", alike.rows)[:, 0].tolist()
        device_ns = alike.layout.times_ns("time_ref", alike.rows)[:, 0].tolist()
        taken = np.zeros(len(host_ns), dtype=bool)
        for k, text in enumerate(alike.layout.texts("source", alike.rows)):
            values = key_values(text)
            if {"epoch", "rtt_ns"} <= set(values):
                sync = ClockSync(host_ns[k], device_ns[k], values["epoch"], values["rtt_ns"])
                self._keep(0, self.n_seen + int(alike.numbers[k]), sync)
                taken[k] = True
        return taken

    def syncs(self) -> tuple[ClockSync, ...]:
        """Return the comparisons, sorted by host time."""
        return tuple(sorted(self.items(), key=lambda sync: sync.host_ns))
