"""Messages of one shape read as columns of numbers, without a Python object for any of them.

In CDR the place of a number depends only on the type and on the lengths of the texts and lists before it. Where a
message of the same size has the same texts and the same lengths as another, all its numbers lie at the same places:
many such messages are the rows of a table, and a field is some columns of it. A shape is learnt from one message by a
walk through its type; that the others share it is compared byte by byte, padding left out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from beam_ros.arrays import ByteArray, FloatArray, IndexArray, StampArray
from beam_ros.bags.blocks import Block
from beam_ros.bags.errors import MessageDecodeError

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, which is what every ROS 2 middleware on x86 and ARM writes."""

_MIN_ALIKE = 4
"""A shape that fewer messages of a block share is not worth the walk: they are decoded one by one."""

_MAX_SHAPES = 16
"""Shapes of one size that are tried in a block before the rest is decoded one by one."""

_KINDS = {
    "bool": "<u1",
    "byte": "<u1",
    "char": "<u1",
    **{f"{sign}int{bits}": f"<{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
    "float32": "<f4",
    "float64": "<f8",
}


@dataclass(frozen=True)
class _Leaves:
    """Where the numbers of one field lie [bytes from the message's body], and what they are."""

    kind: np.dtype[Any]
    places: IndexArray


class Layout:
    """Where everything lies in the messages of one shape.

    Parameters
    ----------
    store : Typestore -- of ``rosbags``, which knows the type
    type_name : str -- "package/msg/Name"
    sample : bytes -- CDR bytes of one message
    free_texts : collection of str -- paths of texts that may differ, as long as their length does not

    Attributes
    ----------
    sample : bytes
    size : int -- of every message of the shape [bytes]

    Raises
    ------
    MessageDecodeError
        The sample is no message of the type, or of another byte order.

    Notes
    -----
    The path of a field is the names from the message down to it with dots between; elements of lists have no name of
    their own: ``points.positions`` are the positions of all points.
    """

    def __init__(self, store: Any, type_name: str, sample: bytes, free_texts: Collection[str] = ()) -> None:
        if sample[:2] != ENCAPSULATION[:2] or len(sample) <= len(ENCAPSULATION):
            raise MessageDecodeError(f"{len(sample)} bytes that are no little-endian {type_name}")
        self.sample, self.size = sample, len(sample)
        self._store, self._free_texts = store, free_texts
        self._texts: dict[str, slice] = {}
        self._body = np.frombuffer(sample, dtype=np.uint8, offset=len(ENCAPSULATION))
        self._is_fixed = np.zeros(-(-len(self._body) // 8) * 8, dtype=bool)
        self._found: dict[str, list[tuple[str, IndexArray]]] = {}
        end = self._walk_message(type_name, "", 0)
        # The middleware fills messages up to whole words.
        if not end <= len(self._body) < end + 4:
            raise MessageDecodeError(f"{len(self._body)} bytes that are no {type_name}, which has {end} here")
        self._leaves = {
            path: _Leaves(np.dtype(found[0][0]), np.concatenate([places for _, places in found]))
            for path, found in self._found.items()
        }
        self._shape = np.zeros(len(self._is_fixed), dtype=np.uint8)
        self._shape[: len(self._body)] = self._body
        self._mask = np.where(self._is_fixed, 0xFF, 0).astype(np.uint8).view(np.uint64)

    @property
    def paths(self) -> tuple[str, ...]:
        """The fields that hold numbers, in the order of the type."""
        return tuple(self._leaves)

    def rows(self, block: Block, chosen: IndexArray) -> ByteArray:
        """Return the bodies of some messages of this size, shape (n, width); behind each only zeros follow."""
        n_body = self.size - len(ENCAPSULATION)
        every = np.ndarray(
            (len(block.data) - self.size + 1,), f"V{n_body}", block.data, len(ENCAPSULATION), (1,)
        )
        bodies: ByteArray = every[block.starts[chosen]].view(np.uint8).reshape(len(chosen), n_body)
        if n_body == len(self._shape):
            return bodies
        rows = np.zeros((len(chosen), len(self._shape)), dtype=np.uint8)
        rows[:, :n_body] = bodies
        return rows

    def fits(self, rows: ByteArray) -> Any:
        """Return of each row whether it has this shape, shape (n,)."""
        other = rows.view(np.uint64) ^ self._shape.view(np.uint64)
        other &= self._mask
        return ~other.any(axis=1)

    def numbers(self, path: str, rows: ByteArray) -> Any:
        """Return a field of some messages, shape (n, elements), in the type that it has in the message."""
        leaves = self._leaves.get(path)
        if leaves is None:
            return np.zeros((len(rows), 0))
        return rows.view(leaves.kind)[:, leaves.places // leaves.kind.itemsize]

    def times_ns(self, path: str, rows: ByteArray) -> StampArray:
        """Return a field of type Time or Duration [ns], shape (n, elements)."""
        seconds = self.numbers(f"{path}.sec", rows).astype(np.int64)
        nanoseconds = self.numbers(f"{path}.nanosec", rows)
        times: StampArray = seconds * 1_000_000_000 + nanoseconds
        return times

    def texts(self, path: str, rows: ByteArray) -> list[str]:
        """Return a text that may differ, of each of some messages."""
        return [text.decode(errors="replace") for text in map(bytes, rows[:, self._texts[path]])]

    # --- the walk through the type

    def _walk_message(self, type_name: str, path: str, at: int) -> int:
        _, fields = self._store.fielddefs[type_name]
        for name, description in fields:
            at = self._walk(description, f"{path}.{name}" if path else name, at)
        return at

    def _walk(self, description: Any, path: str, at: int) -> int:
        kind, what = description
        if kind == Nodetype.NAME:
            return self._walk_message(what, path, at)
        if kind == Nodetype.BASE:
            return self._walk_base(what[0], path, at, 1)
        element, count = what
        if kind == Nodetype.SEQUENCE:
            count, at = self._count(at)
        if element[0] == Nodetype.BASE and element[1][0] in _KINDS:
            return self._walk_base(element[1][0], path, at, count) if count else at
        for _ in range(count):
            at = self._walk(element, path, at)
        return at

    def _walk_base(self, name: str, path: str, at: int, count: int) -> int:
        if name == "string":
            length, at = self._count(at)
            if path in self._free_texts:
                self._texts[path] = slice(at, at + max(0, length - 1))
            else:
                self._is_fixed[at : at + length] = True
            return at + length
        if name not in _KINDS:
            raise MessageDecodeError(f"fields of type {name} are not read as columns")
        size = np.dtype(_KINDS[name]).itemsize
        at += -at % size
        if at + size * count > len(self._body):
            raise MessageDecodeError(f"{self.size} bytes that end within {path}")
        places = at + size * np.arange(count)
        self._found.setdefault(path, []).append((_KINDS[name], places))
        return at + size * count

    def _count(self, at: int) -> tuple[int, int]:
        """Return the length at a place and where what it counts begins."""
        at += -at % 4
        if at + 4 > len(self._body):
            raise MessageDecodeError(f"{self.size} bytes that end within a length")
        self._is_fixed[at : at + 4] = True
        count = int.from_bytes(self._body[at : at + 4].tobytes(), "little")
        if count > len(self._body):
            raise MessageDecodeError(f"{self.size} bytes with a list or text of {count}")
        return count, at + 4


@dataclass(frozen=True)
class Alike:
    """Messages of a block that have one shape.

    Attributes
    ----------
    layout : Layout
    rows : ndarray of uint8, shape (n, width) -- their bodies
    numbers : ndarray of int, shape (n,) -- which messages of the block they are
    """

    layout: Layout
    rows: ByteArray
    numbers: IndexArray


class Shapes:
    """The shapes that the messages of one topic have been seen to have.

    Parameters
    ----------
    store : Typestore -- of ``rosbags``
    type_name : str
    free_texts : collection of str -- paths of texts that may differ within a shape
    """

    def __init__(self, store: Any, type_name: str, free_texts: Collection[str] = ()) -> None:
        self._store, self._type_name, self._free_texts = store, type_name, free_texts
        self._known: dict[int, list[Layout]] = {}

    def sort(self, block: Block) -> Iterator[Alike | IndexArray]:
        """Yield the messages of a block by their shapes, and last the numbers of those that share theirs with few."""
        alone = []
        sizes, of_size, counts = np.unique(block.sizes, return_inverse=True, return_counts=True)
        for k, size in enumerate(sizes.tolist()):
            left = np.flatnonzero(of_size == k)
            known = self._known.setdefault(size, [])
            if counts[k] >= _MIN_ALIKE or known:
                for layout in known:
                    alike, left = _split(layout, block, left)
                    if alike is not None:
                        yield alike
                while len(left) >= _MIN_ALIKE and len(known) < _MAX_SHAPES:
                    try:
                        sample = block.message(int(left[0]))
                        layout = Layout(self._store, self._type_name, sample, self._free_texts)
                    except MessageDecodeError:
                        break
                    known.append(layout)
                    alike, left = _split(layout, block, left)
                    if alike is not None:
                        yield alike
            alone.append(left)
        if alone:
            yield np.sort(np.concatenate(alone))


def _split(layout: Layout, block: Block, numbers: IndexArray) -> tuple[Alike | None, IndexArray]:
    """Return those messages that have a shape, and the numbers of the others."""
    if not len(numbers):
        return None, numbers
    starts = block.starts[numbers]
    rows = layout.rows(block, numbers)
    fits = layout.fits(rows)
    for k in range(2):
        fits &= block.data[starts + k] == ENCAPSULATION[k]
    if fits.all():
        return Alike(layout, rows, numbers), numbers[:0]
    if not fits.any():
        return None, numbers
    return Alike(layout, rows[fits], numbers[fits]), numbers[~fits]


def as_floats(numbers: Any) -> FloatArray:
    """Return numbers of any type as float64."""
    floats: FloatArray = np.ascontiguousarray(numbers, dtype=np.float64)
    return floats
