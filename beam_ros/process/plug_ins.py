"""Kinds that another installed package adds to a table of the suite, such as an axis link of a laboratory's own.

A package names what it adds in its metadata, as an entry point of the table's group; nothing of the suite is
edited. The metadata is read only when a kind is asked for that the suite itself does not have, or one that
nobody has.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from beam_ros.errors import ParameterFileError, RigUnavailableError, likeliest

Kind = TypeVar("Kind")


def plug_ins(group: str) -> dict[str, EntryPoint]:
    """Return what installed packages add under an entry-point group, by name; nothing of it is imported."""
    return {found.name: found for found in entry_points(group=group)}


def find_kind(parameter: str, name: str, own: Mapping[str, Kind], group: str) -> Kind:
    """Return what a rig parameter chooses by name: from the suite's own table, else from a plug-in.

    Parameters
    ----------
    parameter : str -- the rig parameter, such as ``axis.kind``
    name : str -- its value
    own : mapping of str to object -- the suite's own kinds; no plug-in replaces one of them
    group : str -- entry-point group under which packages add theirs

    Raises
    ------
    ParameterFileError
        Neither the table nor a package has the name.
    RigUnavailableError
        The package that has it cannot be imported.
    """
    if name in own:
        return own[name]
    others = plug_ins(group)
    if name not in others:
        known = [*own, *sorted(set(others) - set(own))]
        near = likeliest(name, known)
        hint = f"did you mean {near!r}?" if near else f"a package adds one as entry point of {group}"
        raise ParameterFileError(f"{parameter} is {name!r}: expected one of {', '.join(known)}; {hint}")
    try:
        kind: Any = others[name].load()
    except (ImportError, AttributeError) as err:
        raise RigUnavailableError(
            f"{parameter} is {name!r}: its package cannot be loaded from {others[name].value} ({err}); expected "
            f"an entry point of {group} that can be imported; install that package anew"
        ) from err
    found: Kind = kind
    return found
