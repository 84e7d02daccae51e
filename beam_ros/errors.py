"""Errors of the rig suite: each says what was wrong, the value seen, what was expected and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_NEAR = 0.65
"""Share of two names that must be the same, in the same order, for one to be a slip of the other: of four letters
one may be wrong, of eight two."""


class RigError(Exception):
    """Base of the suite's own errors; a command-line verb turns it into one line and exit status 2."""


class ParameterFileError(RigError, ValueError):
    """A rig or plan file is missing, is no YAML, or holds an unknown key, a wrong type, unit or range."""


class RigUnavailableError(RigError, OSError):
    """A part of the rig is not there: a port, a device, a node or a service did not answer."""


class NodeFallenError(RigUnavailableError):
    """A node ended by itself, which it would do again."""


class UsageError(RigError, ValueError):
    """A command was called with arguments that do not go together."""


class InstallationError(RigError, OSError):
    """What the suite needs could not be installed on this machine."""


class RosMissingError(RigError, ImportError):
    """A node was asked for where ROS 2 is not installed."""


def faults_of_the_user() -> tuple[type[Exception], ...]:
    """Return the errors that a person at the command line can mend: told in one line, status 2."""
    from beam_ident.errors import IdentificationError
    from beam_model.errors import BeamModelError

    return (RigError, BeamModelError, IdentificationError)


def likeliest(name: str, known: Iterable[str]) -> str:
    """Return the known name that a misspelt one most likely means; empty where none is near.

    What two dotted names have in common by standing in one group makes them no nearer.
    """
    names = list(known)
    group, dot, leaf = name.rpartition(".")
    of_group = {other[len(group) + 1 :]: other for other in names if dot and other.startswith(f"{group}.")}
    near = difflib.get_close_matches(leaf, list(of_group), n=1, cutoff=_NEAR)
    if near:
        return of_group[near[0]]
    elsewhere = [other for other in names if dot and other.endswith(f".{leaf}")]
    if elsewhere or of_group:
        return elsewhere[0] if elsewhere else ""
    near = difflib.get_close_matches(name, names, n=1, cutoff=_NEAR)
    return near[0] if near else ""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Say which known name a misspelt one most likely means, or which names there are."""
    names = list(known)
    near = likeliest(name, names)
    return f"did you mean {near}?" if near else f"expected one of {', '.join(names)}"
