"""Results as plain lists and numbers, which JSON text carries without loss.

A stored result is a mapping with a ``type`` and a ``schema`` number beside its entries.  Numbers are written
as they are, ``NaN`` and infinities (which JSON does not have) as the strings "NaN", "Infinity" and "-Infinity",
complex numbers as their two parts.  What is read back is what was written, digit for digit; everything
else is refused by one exception that names the entry.
"""

from __future__ import annotations

import dataclasses
import math
import types
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from beam_ident.errors import ModelFormatError

T = TypeVar("T")

ADDED_LATER = {
    "added_later": True
}  # metadata of a field that what was stored before has not: its default holds


def written(value: Any, kind: str, schema: int) -> dict[str, Any]:
    """Return a frozen dataclass as plain lists and numbers, under its type and schema number."""
    return {"schema": schema, "type": kind, **_plain_fields(value)}


def read(kind: type[T], data: Mapping[str, Any], name: str, schema: int) -> T:
    """Rebuild a dataclass written by ``written``, by the types of its fields.

    Parameters
    ----------
    kind : type -- a dataclass
    data : mapping
    name : str -- the type that the mapping must state
    schema : int

    Raises
    ------
    ModelFormatError
        Another type or schema, a missing entry, or an entry of another kind.
    """
    return rebuilt(kind, checked_entries(data, name, schema), name)


def rebuilt(kind: type[T], entries: Mapping[str, Any], name: str) -> T:
    """Return a dataclass of the entries of a mapping, or raise ModelFormatError under a name."""
    with complaints_about(name):
        return _rebuilt_fields(kind, entries, "")


def checked_entries(data: Mapping[str, Any], name: str, schema: int) -> Mapping[str, Any]:
    """Return the entries of a mapping that states this type and schema, or raise ModelFormatError."""
    if not isinstance(data, Mapping):
        raise ModelFormatError(
            f"a {type(data).__name__} is not a stored result; expected the mapping that to_dict() returns "
            "(json.loads() makes one of JSON text)"
        )
    if data.get("type") != name or data.get("schema") != schema:
        raise ModelFormatError(
            f"this is a {data.get('type')!r} of schema {data.get('schema')!r}; expected a {name!r} of schema {schema}"
        )
    return data


@contextmanager
def complaints_about(name: str) -> Iterator[None]:
    """Turn what goes wrong with the entries of a stored result into ModelFormatError."""
    try:
        yield
    except ModelFormatError:
        raise
    except KeyError as err:
        raise ModelFormatError(f"{name}: the entry {err} is missing") from err
    except (TypeError, ValueError) as err:
        raise ModelFormatError(f"{name}: {err}") from err


def require_shapes(name: str, found: object, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ModelFormatError for arrays of a result whose shapes do not agree.

    Parameters
    ----------
    name : str -- of the result
    found : object
    shapes : mapping -- from an attribute of it to the shape that goes with the rest
    """
    for attribute, shape in shapes.items():
        own = np.shape(getattr(found, attribute))
        if own != shape:
            raise ModelFormatError(f"{name}: {attribute} has shape {own}; the rest goes with {shape}")


def plain(value: Any) -> Any:
    """Return a value, a list, an array or a dataclass as what JSON has."""
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return {"real": plain(value.real), "imag": plain(value.imag)}
        return value.tolist() if np.all(np.isfinite(value)) else plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"
    return _plain_fields(value) if dataclasses.is_dataclass(value) else value


def names_of(value: Any, where: str) -> tuple[str, ...]:
    """Return names that a list holds, or raise TypeError."""
    return tuple(_rebuilt(tuple[str, ...], value, where))


def _plain_fields(value: Any) -> dict[str, Any]:
    return {own.name: plain(getattr(value, own.name)) for own in dataclasses.fields(value)}


def _rebuilt_fields(kind: type[T], data: Mapping[str, Any], where: str) -> T:
    hints = get_type_hints(kind)
    values = {}
    for own in dataclasses.fields(kind):  # type: ignore[arg-type]
        place = f"{where}{own.name}"
        if own.name not in data:
            if ADDED_LATER.items() <= own.metadata.items():
                continue
            raise KeyError(place)
        values[own.name] = _rebuilt(hints[own.name], data[own.name], place)
    return kind(**values)


def _rebuilt(hint: Any, value: Any, where: str) -> Any:
    """Return the value that a type describes, from what JSON has."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        rest = [one for one in arguments if one is not types.NoneType]
        return None if value is None else _rebuilt(rest[0], value, where)
    if origin is np.ndarray:
        return _array(get_args(arguments[1])[0], value, where)
    if origin in (tuple, Sequence):
        if not isinstance(value, list | tuple):
            raise TypeError(f"{where} is {value!r}; expected a list")
        return tuple(_rebuilt(arguments[0], part, f"{where}[{k}]") for k, part in enumerate(value))
    if origin is Mapping:
        if not isinstance(value, Mapping):
            raise TypeError(f"{where} is {value!r:.60}; expected a mapping")
        return {str(key): _rebuilt(arguments[1], part, f"{where}[{key!r}]") for key, part in value.items()}
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if not isinstance(value, Mapping):
            raise TypeError(f"{where} is {value!r}; expected the entries of a {hint.__name__}")
        return _rebuilt_fields(hint, value, f"{where}.")
    if origin is Literal:
        if value not in arguments:
            raise ValueError(f"{where} is {value!r}; expected one of {', '.join(map(repr, arguments))}")
        return value
    return _number(value, where) if hint is float else _exactly(hint, value, where)


def _array(kind: type[np.generic], value: Any, where: str) -> Any:
    if issubclass(kind, np.complexfloating):
        if not (isinstance(value, Mapping) and {"real", "imag"} <= set(value)):
            raise TypeError(f"{where} is {value!r:.60}; expected the entries 'real' and 'imag'")
        # By its parts: j times infinity would make the real part NaN.
        real, imag = (_array(np.float64, value[part], where) for part in ("real", "imag"))
        result = np.empty(np.shape(real), dtype=np.complex128)
        result.real, result.imag = real, imag
        return result
    if not isinstance(value, list | tuple):
        raise TypeError(f"{where} is {value!r:.60}; expected a list of numbers")
    try:
        return np.asarray(value, dtype=kind)
    except (TypeError, ValueError) as err:
        raise ValueError(f"{where} is not an array of numbers ({err})") from err


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError(f"{where} is {value!r}; expected a number")
    return float(value)


def _exactly(kind: type, value: Any, where: str) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{where} is {value!r}; expected {kind.__name__}")
    return value
