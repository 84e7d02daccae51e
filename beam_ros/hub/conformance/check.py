"""What a check is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

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


def check(
    expected: str, *, moves: bool = False, needs_bench: bool = False
) -> Callable[[Callable[[Dialogue], None]], Check]:
    """Make a check of a function, which names it; ``expected``, ``moves`` and ``needs_bench`` are the check's."""
    return lambda run: Check(run.__name__.strip("_"), expected, run, moves, needs_bench)


def checks_of(module: ModuleType) -> tuple[Check, ...]:
    """Return a module's own checks, in their order."""
    found = [value for value in vars(module).values() if isinstance(value, Check)]
    return tuple(each for each in found if each.run.__module__ == module.__name__)


def require(is_so: bool, otherwise: str) -> None:
    """Raise ``ConformanceError`` where something that must be is not."""
    if not is_so:
        raise ConformanceError(otherwise)
