"""What a check is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from beam_ros.hub.conformance.dialogue import Dialogue
from beam_ros.hub.errors import ConformanceError


@dataclass(frozen=True)
class Check:
    """One thing that a firmware must do.

    Parameters
    ----------
    name : str
        For people and programs.
    expected : str
        What the device does, as a sentence.
    run : callable
        Raises ``ConformanceError`` where it does not.
    moves : bool
        Whether the axis moves.
    needs_bench : bool
        Whether the axis must be one that is not there, so that its sensors can be interfered with.
    """

    name: str
    expected: str
    run: Callable[[Dialogue], None]
    moves: bool = False
    needs_bench: bool = False


def require(is_so: bool, otherwise: str) -> None:
    """Raise ``ConformanceError`` where something that must be is not."""
    if not is_so:
        raise ConformanceError(otherwise)
