"""What other installed packages add to a table, such as an estimator of a laboratory's own.

A package names what it adds in its metadata, as an entry point of the table's group; nothing here is edited. The
metadata is read only when a name is asked for that the table does not have, or one that nobody has.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = TypeVar("Kind")


def plug_ins(group: str) -> dict[str, EntryPoint]:
    """Return what installed packages add under an entry-point group, by name; nothing of it is imported."""
    from importlib.metadata import entry_points

    return {found.name: found for found in entry_points(group=group)}


def find_kind(
    what: str,
    name: str,
    own: Mapping[str, Kind],
    group: str,
    unknown: type[Exception],
    unavailable: type[Exception],
) -> Kind:
    """Return what a name stands for: from a table, else from the package that adds it.

    Parameters
    ----------
    what : str -- what is chosen by name, such as ``axis.kind``
    name : str
    own : mapping of str to object -- the table; no plug-in replaces a line of it
    group : str -- entry-point group under which packages add theirs
    unknown, unavailable : type of exception
        Raised where neither the table nor a package has the name, and where its package cannot be imported.
    """
    if name in own:
        return own[name]
    others = plug_ins(group)
    if name not in others:
        known = [*own, *sorted(set(others) - set(own))]
        near = difflib.get_close_matches(name, known, 1, 0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"a package adds one as entry point of {group}"
        raise unknown(f"{what} is {name!r}: expected one of {', '.join(known)}; {hint}")
    try:
        kind: Any = others[name].load()
    except (ImportError, AttributeError) as err:
        raise unavailable(
            f"{what} is {name!r}: its package cannot be loaded from {others[name].value} ({err}); expected an "
            f"entry point of {group} that can be imported; install that package anew"
        ) from err
    found: Kind = kind
    return found
