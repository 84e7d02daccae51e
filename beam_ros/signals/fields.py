"""The samples of any numeric field of any topic of a bag, with the stamps that their messages carry."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.data.stamp_order import StampOrder
from beam_ros.arrays import FloatArray, StampArray
from beam_ros.bags.errors import BagError, MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import Unreadable
from beam_ros.errors import UsageError, suggestion
from beam_ros.interfaces import graph
from beam_ros.messages import BATCH_FIELDS, SECOND_NS, BagTypes
from beam_ros.signals.field_paths import FieldPath, element_names, fields_sentence, numeric_fields

_HEADER_BYTES = 12  # of encapsulation and stamp
_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")


@dataclass(frozen=True)
class FieldSamples:
    """What a field of a topic said.

    Attributes
    ----------
    topic, field : str -- the topic's full name in the bag, and the path
    stamps_ns : ndarray of int64, shape (n,) -- strictly increasing [ns, UNIX]
    values : ndarray, shape (n,) -- in the field's own unit; NaN where the message has no value
    has_own_stamps : bool -- False: the messages have no header, and receive times stand in for stamps
    unstamped : int -- messages left out because their stamp is 0
    unreadable : Unreadable -- messages left out because they cannot be read
    order : StampOrder -- what was found in the order of the stamps
    """

    topic: str
    field: str
    stamps_ns: StampArray
    values: FloatArray
    has_own_stamps: bool
    unstamped: int
    unreadable: Unreadable
    order: StampOrder

    def notes(self, start_ns: int) -> list[str]:
        """Say what a reader must know; instants are counted from ``start_ns``."""
        what = f"{self.topic}:{self.field}"
        said = self.order.sentences(what, start_ns)
        if not self.has_own_stamps:
            said.append(
                f"{what} has no stamps: the times at which the recorder received the messages stand in for them, "
                "with its delay and jitter; record a type with a header instead"
            )
        if self.unstamped:
            said.append(f"{what}: {self.unstamped} messages have stamp 0 and are left out")
        if self.unreadable.count:
            said.append(
                f"{what}: {self.unreadable.count} messages cannot be read ({self.unreadable.first_reason})"
            )
        return said


def find_topic(bag: Bag, topic: str) -> tuple[str, str]:
    """Return a topic's full name and type in a bag.

    Parameters
    ----------
    bag : Bag
    topic : str -- its full name, its name within the rig's namespace, or the end of a name that no other topic has

    Raises
    ------
    MissingTopicsError
        There is no such topic, or it has no messages.
    """
    types = {row.name: row.type_name for row in bag.topics if row.message_count}
    ends = [name for name in types if name.endswith(f"/{topic.strip('/')}")]
    for name in (topic, bag.full_name(topic), f"/{topic}", *(ends if len(ends) == 1 else ())):
        if name in types:
            return name, types[name]
    raise MissingTopicsError(
        f"{bag.path} has no messages on {topic} ({suggestion(topic, types) if types else 'it is empty'}); "
        "`beam info` lists what it holds"
    )


def read_field(bag: Bag, topic: str, field: str) -> FieldSamples:
    """Return the samples of a field.

    Parameters
    ----------
    bag : Bag
    topic : str -- as for ``find_topic``
    field : str -- the path to a number; for batches of the hub one of positions, velocities, accelerations, efforts

    Raises
    ------
    MissingTopicsError
        There is no such topic.
    UsageError
        There is no such field.
    BagError
        No message can be read, or none has a stamp.
    """
    name, type_name = find_topic(bag, topic)
    if type_name == graph.JOINT_TRAJECTORY and field in BATCH_FIELDS:
        return _read_batches(bag, name, field)
    path = FieldPath.of(field)
    store = _store_of(bag, type_name)
    known = numeric_fields(type_name, lambda of: store.fielddefs[of][1])
    stamps: list[int] = []
    values: list[float] = []
    received: list[int] = []
    unreadable, first_reason, unstamped, last = 0, "", 0, None
    for raw in bag.raw_messages(name):
        try:
            message = store.deserialize_cdr(raw.data, type_name)
        except Exception as err:  # noqa: BLE001 - rosbags raises whatever damaged bytes lead it to
            unreadable += 1
            first_reason = (
                first_reason or f"{len(raw.data)} bytes that are no {type_name}: {type(err).__name__}"
            )
            continue
        try:
            reading = path.read(message)
        except UsageError as err:
            raise UsageError(f"{name} is a {type_name}: {err}. {fields_sentence(str(path), known)}") from err
        last = message
        if reading.stamp_ns == 0:
            unstamped += 1
            continue
        if reading.stamp_ns is not None:
            stamps.append(reading.stamp_ns)
        received.append(raw.receive_ns)
        values.append(reading.value)
    if not values:
        why = f": {first_reason}" if first_reason else ""
        raise BagError(
            f"{bag.path}: none of the messages on {name} can be used ({unstamped} with stamp 0, {unreadable} "
            f"unreadable{why}); expected a {type_name} whose header says when it was measured: mend the node that "
            "publishes it and record again"
        )
    found = np.array(values)
    if not np.any(np.isfinite(found)):
        names = element_names(last, path)
        raise UsageError(
            f"{name}: no message has a number at {field!r}"
            + (f"; {suggestion(_last_key(path), names)}" if names else "")
        )
    has_own_stamps = len(stamps) == len(values)
    own = np.array(stamps if has_own_stamps else received, dtype=np.int64)
    order = StampOrder.of(own)
    return FieldSamples(
        name,
        field,
        own[order.order],
        found[order.order],
        has_own_stamps,
        unstamped,
        Unreadable(unreadable, first_reason),
        order,
    )


def _last_key(path: FieldPath) -> str:
    return next((step.key for step in reversed(path.steps) if step.key), "")


def _read_batches(bag: Bag, name: str, field: str) -> FieldSamples:
    """Read what the hub publishes: many samples in a message."""
    samples = bag.hub_samples(name)
    values = getattr(samples, field)
    if values is None:
        there = [own for own in BATCH_FIELDS if getattr(samples, own) is not None]
        raise UsageError(f"{name} carries no {field}; {suggestion(field, there)}")
    n = len(samples.stamps_ns)
    order = StampOrder(np.arange(n), samples.duplicates, 0, ())
    return FieldSamples(name, field, samples.stamps_ns, values, True, 0, samples.unreadable, order)


def _store_of(bag: Bag, type_name: str) -> Any:
    """Return the definitions of messages: those of ROS 2 Jazzy, or the bag's own where it has others.

    Raises
    ------
    BagError
        The type is unknown, and the bag does not define it.
    """
    store = BagTypes().store
    definition = bag.definition(type_name)
    if type_name in store.types and (not definition or _is_same(store, type_name, definition.type_hash)):
        return store
    if not definition:
        raise BagError(
            f"{bag.path}: {type_name} is no message type of ROS 2 Jazzy's common interfaces, and the bag does not "
            "hold its definition; record to MCAP, which keeps definitions"
        )
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    read: Callable[..., Any] = get_types_from_idl if definition.is_idl else get_types_from_msg
    own = get_typestore(Stores.ROS2_JAZZY)
    try:
        types = read(definition.text) if definition.is_idl else read(definition.text, type_name)
        own.register({name: fields for name, fields in types.items() if name not in own.fielddefs})
        if type_name in store.types:
            own = get_typestore(Stores.EMPTY)
            own.register(types)
    except Exception as err:
        # rosbags raises whatever a definition that is none leads it to.
        raise BagError(
            f"{bag.path}: the definition of {type_name} that it holds cannot be read ({err}); record it anew, or "
            "choose another topic"
        ) from err
    return own


def _is_same(store: Any, type_name: str, type_hash: str) -> bool:
    return not type_hash or bool(store.hash_rihs01(type_name) == type_hash)


def message_stamps(bag: Bag, topic: str) -> tuple[StampArray, StampOrder]:
    """Return the stamps of a topic's messages in the order of the bag [ns], and what is to be said of that order.

    Messages without a header, and those with stamp 0, are left out.
    """
    name, type_name = find_topic(bag, topic)
    fields = _store_of(bag, type_name).fielddefs[type_name][1]
    if not fields or fields[0][0] != "header":
        return np.zeros(0, dtype=np.int64), StampOrder.of(np.zeros(0, dtype=np.int64))
    # In CDR the header comes first, behind four bytes that say which end of a number does.
    found = []
    for raw in bag.raw_messages(name):
        if len(raw.data) >= _HEADER_BYTES:
            seconds, rest = (_LITTLE if raw.data[1] & 1 else _BIG).unpack_from(raw.data, 4)
            found.append(seconds * SECOND_NS + rest)
    stamps = np.array([stamp for stamp in found if stamp > 0], dtype=np.int64)
    return stamps, StampOrder.of(stamps)
