"""The search over what ails records: moves, each a change of what is believed of them beside their modes.

A move looks at what the present end leaves.  Where that speaks for a change, the modes are estimated anew under
it, and the end that explains the records better stays.  After a change all moves are asked again, from the first;
the search ends where none has anything to offer.  A new kind of ailment is one class and its place in one table.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from beam_ident.errors import EstimationError
from beam_ident.modal_estimation.mode_search import Stopped
from beam_ident.modal_identification.conditions import Conditions
from beam_ident.modal_identification.estimation import End

Estimate = Callable[[Conditions, End | None], End]
"""Estimates the modes under conditions; what an end that is given looked for in vain is not looked for again."""


class SearchMove(ABC):
    """One kind of change; an object serves one search, and may remember what it has tried."""

    about: str  # what is missing where the search is stopped before the move is asked

    @abstractmethod
    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return a better end than the present one, or None.

        Raises
        ------
        EstimationError
            Nothing can be estimated under the change, which is then not made.
        """


def explored(estimate: Estimate, conditions: Conditions, moves: Sequence[SearchMove]) -> End:
    """Return where a search ends that no move leads on from.

    Parameters
    ----------
    estimate : callable
    conditions : Conditions -- where it begins
    moves : sequence of SearchMove -- in the order in which they are asked

    Raises
    ------
    EstimationError
        No mode is believed where it begins.
    """
    present, place = estimate(conditions, None), 0
    while place < len(moves) and present.stopped_by is None:
        try:
            following = moves[place].end(present, estimate)
        except EstimationError:
            following = None
        except Stopped as stop:
            return present.unfinished(stop, f"a further look for {moves[place].about}")
        if following is not None and following.stopped_by is not None:
            return present.unfinished(following.stopped_by, f"a further look for {moves[place].about}")
        present, place = (present, place + 1) if following is None else (following, 0)
    return present
