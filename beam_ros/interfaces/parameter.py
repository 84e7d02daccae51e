"""What one parameter of the rig may be: its kind, unit, range and words, and the check of a value.

A group of parameters is a frozen dataclass. A field's annotation is the parameter's kind, and ``setting`` says the
rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Literal, get_args, get_origin, get_type_hints

from beam_ros.errors import ParameterFileError, likeliest, suggestion

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]

_NOUNS: dict[object, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    tuple[float, ...]: "a list of numbers",
    tuple[str, ...]: "a list of words",
}
"""Every kind that a parameter may have, and how people call it."""


@dataclass(frozen=True)
class Parameter:
    """What one parameter may be.

    Attributes
    ----------
    name : str -- dotted name, "beam.length"
    kind : type -- bool, int, float, str, tuple[float, ...] or tuple[str, ...]
    description : str -- one line
    unit : str -- SI, "" where there is none
    minimum, maximum : float or None -- inclusive limits, for every element of a list
    choices : tuple of str -- the allowed words, empty where any text will do
    is_live : bool -- may be changed while a node runs
    within : (str, float) or None
        A parameter and the share of it that the magnitude may reach: a range that another parameter gives.
    """

    name: str
    kind: object
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    is_live: bool
    within: tuple[str, float] | None

    def meaning(self) -> str:
        """Say what it is, with its unit and what limits it."""
        unit = f" [{self.unit}]" if self.unit else ""
        if self.within is None:
            return f"{self.description}{unit}"
        limiting, share = self.within
        part = "" if share == 1.0 else f"{share:g} times "
        return f"{self.description}{unit}; limited by {part}{limiting}"

    def expectation(self) -> str:
        """Say in words which values are allowed."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        noun = _NOUNS[self.kind]
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        if self.minimum is None or self.maximum is None:
            return f"{noun}{f' in{unit}' if unit else ''}"
        return f"{noun} from {self.minimum:g} to {self.maximum:g}{unit}"

    def check(self, value: object) -> Value:
        """Return ``value`` in this parameter's type.

        Whole numbers pass for numbers; YAML's bare ``off`` and ``on``, which ROS reads as booleans, pass for the
        words where these are among the choices.

        Raises
        ------
        ParameterFileError
            The type, the word or the range is wrong.
        """
        if self.kind in (bool, int, float):
            return self._scalar(value, value)
        if self.kind is str:
            if isinstance(value, bool) and self.choices:
                value = "on" if value else "off"
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                raise self._refusal(value)
            return value
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) == 0:
            raise self._refusal(value)
        if self.kind == tuple[float, ...]:
            return tuple(float(self._scalar(item, value)) for item in value)
        if not all(isinstance(item, str) and item for item in value):
            raise self._refusal(value)
        return tuple(value)

    def _scalar(self, item: object, whole: object) -> bool | int | float:
        if self.kind is bool:
            if not isinstance(item, bool):
                raise self._refusal(whole)
            return item
        types = int if self.kind is int else (int, float)
        if isinstance(item, bool) or not isinstance(item, types) or not math.isfinite(item):
            raise self._refusal(whole)
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not low <= item <= high:
            raise self._refusal(whole)
        return int(item) if self.kind is int else float(item)

    def _refusal(self, value: object) -> ParameterFileError:
        value = list(value) if isinstance(value, tuple) else value
        seen = repr(value) if isinstance(value, str) else str(value)
        has_unit = self.unit not in ("", "1")
        unit = f" {self.unit}" if has_unit and isinstance(value, (int, float)) else ""
        remedy = f"; give it in {self.unit}" if has_unit else ""
        if isinstance(value, str) and likeliest(value, self.choices):
            remedy = f"; {suggestion(value, self.choices)}"
        return ParameterFileError(f"{self.name} is {seen}{unit}: expected {self.expectation()}{remedy}")


def setting(
    description: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    choices: tuple[str, ...] = (),
    is_live: bool = False,
    within: tuple[str, float] | None = None,
) -> Any:
    """Describe a field of a group; its arguments are those of ``Parameter``, and its default stands in rig.yaml."""
    row = Parameter("", None, description, unit, minimum, maximum, choices, is_live, within)
    return field(metadata={"parameter": row})


live = partial(setting, is_live=True)
"""Describe a field that may change while a node runs."""


def parameters_of(group: type, prefix: str) -> Iterator[Parameter]:
    """Yield the parameters that a group's fields declare, named ``prefix.field``; words of a Literal are choices."""
    hints = get_type_hints(group)
    for declared in fields(group):
        kind, row = hints[declared.name], declared.metadata["parameter"]
        if get_origin(kind) is Literal:
            kind, row = str, replace(row, choices=get_args(kind))
        yield replace(row, name=f"{prefix}.{declared.name}", kind=kind)
