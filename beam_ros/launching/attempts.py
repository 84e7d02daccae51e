"""What is done where a computer is too slow for an experiment in real time: again, with more patience, then without.

The policy alone: what an attempt is, and what stands in for it, comes in as arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from beam_ros.errors import NodeFallenError, RigUnavailableError

PATIENCE = (1.0, 4.0)
"""Of one attempt after the other: what the start lead and the limits on waiting are multiplied by."""


@dataclass
class Attempt:
    """One attempt at the experiment.

    Attributes
    ----------
    number : int -- from 1
    patience : float -- what start lead and limits on waiting are multiplied by
    has_moved : bool -- the axis had begun to follow the excitation; set by the one who carries the attempt out
    circumstances : str -- how busy the computer was, for the one who waits; likewise
    """

    number: int
    patience: float
    has_moved: bool = False
    circumstances: str = ""


@dataclass(frozen=True)
class Failure:
    """An attempt that came to nothing.

    Attributes
    ----------
    attempt : Attempt
    reason : str
    """

    attempt: Attempt
    reason: str

    def lines(self) -> tuple[str, ...]:
        """Say what happened, what moved, and how busy the computer was."""
        moved = (
            "the axis had begun to move, and stopped by itself: nothing real is on it"
            if self.attempt.has_moved
            else "the excitation did not begin: nothing moved"
        )
        circumstances = (self.attempt.circumstances,) if self.attempt.circumstances else ()
        return (self.reason, moved, *circumstances)


@dataclass(frozen=True)
class DemoOutcome:
    """What came of it.

    Attributes
    ----------
    result : dict -- of the attempt that went well, or of what stood in for it
    failures : tuple of Failure -- attempts that came to nothing
    is_by_nodes : bool -- an attempt went well
    """

    result: dict[str, Any]
    failures: tuple[Failure, ...] = field(default=())
    is_by_nodes: bool = True


def persist(
    carry_out: Callable[[Attempt], dict[str, Any]],
    stand_in: Callable[[], dict[str, Any]],
    on_failure: Callable[[Failure, str], None],
) -> DemoOutcome:
    """Try, try again with more patience, and at last do without.

    Parameters
    ----------
    carry_out : callable -- makes one attempt and returns its result, or raises ``RigUnavailableError``
    stand_in : callable -- does the same without real time
    on_failure : callable -- called with a failure and with what is done next

    Notes
    -----
    A node that has fallen would fall again: then there is no second attempt.
    """
    failures: list[Failure] = []
    for number, patience in enumerate(PATIENCE, start=1):
        attempt = Attempt(number, patience)
        try:
            return DemoOutcome(carry_out(attempt), tuple(failures))
        except RigUnavailableError as err:
            failures.append(Failure(attempt, str(err)))
            if isinstance(err, NodeFallenError) or number == len(PATIENCE):
                break
        on_failure(failures[-1], f"trying again, with a start {PATIENCE[number]:g} times as far ahead")
    on_failure(
        failures[-1], "making the same experiment with the core of `beam simulate`, which needs no real time"
    )
    return DemoOutcome(stand_in(), tuple(failures), is_by_nodes=False)
