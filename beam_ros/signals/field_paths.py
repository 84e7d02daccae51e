"""Where a number stands in a message: ``linear_acceleration.x``, ``position[axis]``, ``transforms[0].transform...``.

A path goes from field to field. In brackets stands which element of a list is meant: its number, or its name, which
is looked up among the strings beside the list (``name`` of a JointState) or in the elements themselves
(``child_frame_id`` of a transform). The header that is nearest to the number says when it was measured.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from beam_ros.errors import UsageError, likeliest
from beam_ros.messages import SECOND_NS

_STEP = re.compile(r"([A-Za-z_]\w*)(?:\[([^\[\]]+)\])?")
_ELEMENT_NAMES = ("name", "child_frame_id")
_DEPTH = 4  # of messages within messages
_LISTED = 24  # fields in a sentence
_NAMED, _ARRAYS = 2, (3, 4)  # kinds of nodes of rosbags: another message; an array, a sequence


class StampedNumber(NamedTuple):
    """A number and its stamp [ns]; NaN where the message does not have it, None where no header is near."""

    value: float
    stamp_ns: int | None


@dataclass(frozen=True)
class PathStep:
    """One field of a path, and which element of it, where it is a list."""

    field: str
    key: str = ""

    def __str__(self) -> str:
        """Return the step as it is written."""
        return f"{self.field}[{self.key}]" if self.key else self.field


@dataclass(frozen=True)
class FieldPath:
    """A path to a number.

    Attributes
    ----------
    steps : tuple of PathStep
    """

    steps: tuple[PathStep, ...]

    @staticmethod
    def of(text: str) -> FieldPath:
        """Read a path.

        Raises
        ------
        UsageError
            It is none.
        """
        found = [_STEP.fullmatch(part.strip()) for part in _parts(text)]
        if not text.strip() or not all(found):
            raise UsageError(
                f"{text!r} is no path to a field; expected names with dots between, and in brackets which element of "
                "a list: linear_acceleration.x, position[axis], ranges[0]"
            )
        return FieldPath(tuple(PathStep(match[1], (match[2] or "").strip()) for match in found if match))

    def __str__(self) -> str:
        """Return the path as it is written."""
        return ".".join(map(str, self.steps))

    def read(self, message: Any) -> StampedNumber:
        """Return the number that a message has there.

        Raises
        ------
        UsageError
            There is no such field, a list without an element that is named, or no number.
        """
        stamp = None
        place = message
        for number, step in enumerate(self.steps):
            stamp = _stamp_ns(place, stamp)
            if not hasattr(place, step.field):
                raise UsageError(self._where(number, f"there is no field {step.field!r}"))
            value = getattr(place, step.field)
            is_list = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)
            if step.key and not is_list:
                raise UsageError(self._where(number, f"{step.field!r} is no list"))
            if is_list:
                if not step.key:
                    raise UsageError(
                        self._where(
                            number, f"{step.field!r} is a list of {len(value)}: say which, {step.field}[0]"
                        )
                    )
                element = _element(place, value, step.key)
                if element is None:
                    # A JointState need not hold every joint in every message.
                    return StampedNumber(np.nan, _stamp_ns(place, stamp))
                value = value[element]
            place = value
        if isinstance(place, bool | int | float | np.number | np.bool_):
            return StampedNumber(float(place), stamp)
        raise UsageError(self._where(len(self.steps) - 1, f"it is a {type(place).__name__}, no number"))

    def _where(self, number: int, what: str) -> str:
        before = ".".join(map(str, self.steps[:number]))
        return f"field {str(self)!r}: {what}{f' in {before!r}' if before else ''}"


def _parts(text: str) -> list[str]:
    """Split at the dots outside of brackets: names of joints may have some."""
    return re.split(r"\.(?![^\[]*\])", text)


def _element(place: Any, values: Any, key: str) -> int | None:
    """Return the index of an element by its number or name; None where the message has it not."""
    if re.fullmatch(r"-?\d+", key):
        index = int(key)
        return index if -len(values) <= index < len(values) else None
    for names in vars(place).values():
        if isinstance(names, list) and len(names) == len(values) and key in names:
            return names.index(key)
    for index, element in enumerate(values):
        if any(getattr(element, name, None) == key for name in _ELEMENT_NAMES):
            return index
    return None


def element_names(message: Any, path: FieldPath) -> list[str]:
    """Return the names that stand beside the last list of a path in a message, for who named another one."""
    place = message
    for step in path.steps:
        values = getattr(place, step.field)
        if step.key and not re.fullmatch(r"-?\d+", step.key):
            index = _element(place, values, step.key)
            if index is None:
                strings = [
                    names
                    for names in vars(place).values()
                    if isinstance(names, list) and names and all(isinstance(name, str) for name in names)
                ]
                own = [getattr(e, name, None) for e in values for name in _ELEMENT_NAMES]
                return strings[0] if strings else [name for name in own if isinstance(name, str)]
            values = values[index]
        elif step.key:
            values = values[int(step.key)]
        place = values
    return []


def _stamp_ns(place: Any, outer: int | None) -> int | None:
    """Return the stamp of a message's own header, else that of what it is part of."""
    stamp = getattr(getattr(place, "header", place), "stamp", None)
    if stamp is None or not hasattr(stamp, "nanosec"):
        return outer
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


def numeric_fields(type_name: str, fields_of: Callable[[str], Any]) -> list[str]:
    """Return the paths to all numbers of a message type, lists with empty brackets.

    Parameters
    ----------
    type_name : str -- "package/msg/Name"
    fields_of : callable -- from a type's name to its fields, as rosbags lists them
    """
    return list(_walk(type_name, fields_of, 0))


def _walk(type_name: str, fields_of: Callable[[str], Any], depth: int) -> Iterator[str]:
    for name, (kind, detail) in fields_of(type_name):
        path, inner_kind, inner = name, int(kind), detail
        if inner_kind in _ARRAYS:
            path = f"{name}[]"
            inner_kind, inner = int(detail[0][0]), detail[0][1]
        if inner_kind == _NAMED:
            if inner != "builtin_interfaces/msg/Time" and depth < _DEPTH and name != "header":
                yield from (f"{path}.{below}" for below in _walk(inner, fields_of, depth + 1))
        elif inner[0] != "string":
            yield path


def fields_sentence(path: str, known: Sequence[str]) -> str:
    """Say which fields there are, the likeliest one first."""
    near = likeliest(re.sub(r"\[[^\]]*\]", "[]", path), known)
    listed = ", ".join(known[:_LISTED]) + (
        f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
    )
    return f"{f'did you mean {near}? ' if near else ''}Its numbers are {listed or 'none'}"
