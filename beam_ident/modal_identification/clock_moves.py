"""Moves of clocks and low-passes that single outputs have of their own."""

from __future__ import annotations

from dataclasses import replace

from beam_ident.data.own_clocks import OwnClock
from beam_ident.modal_identification.conditions import Conditions
from beam_ident.modal_identification.estimation import End
from beam_ident.modal_identification.search_moves import Estimate, SearchMove

_STEPS = 3  # for every output: of clocks of their own, and the modes that show them
_ABOUT = "clocks that outputs have of their own"


class OwnClockSteps(SearchMove):
    """Clocks of outputs, and their low-passes, are moved on until they settle: each step finds the modes anew.

    Parameters
    ----------
    n_outputs : int -- each allows some steps
    """

    about = _ABOUT

    def __init__(self, n_outputs: int) -> None:
        self.steps_left = _STEPS * n_outputs - 1
        self._first: End | None = None
        self._best: End | None = None
        self._has_ended = False

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end with clocks one step further; at the last, the likeliest of all where they do not settle."""
        if self._has_ended:
            return None
        self._first = self._first or present
        if self._best is None or present.weighed.fit.cost < self._best.weighed.fit.cost:
            self._best = present
        further = present.search.further_clocks(present.weighed)
        better = present.search.better_low_passes(present.weighed)
        conditions = present.conditions
        if not (further or better):
            # Where outputs were explained better without clocks of their own, nothing says that these have settled.
            if self._best is not present and present.leaves_more_than(self._first):
                return self._unsettled(self._best, sorted(conditions.clocks))
            return None
        if self.steps_left <= 0:
            return self._unsettled(self._best, sorted({*further, *better}))
        self.steps_left -= 1
        moved = replace(
            conditions.moved(further),
            low_passes={**conditions.low_passes, **better},
            start=present.weighed.fit if better else conditions.start,
        )
        return estimate(moved, present)

    def _unsettled(self, best: End, names: list[str]) -> End:
        self._has_ended = True
        said = (
            f"The clocks of {', '.join(names)} did not settle: the likeliest of several fits is taken. State "
            "latency, clock rate or low_pass of these outputs where they are known, or identify them alone."
        )
        sentences = {**best.conditions.sentences, "clocks": said}
        return replace(best, conditions=replace(best.conditions, sentences=sentences))


class SensorLowPasses(SearchMove):
    """Outputs whose sensors show the motion through a low-pass that nobody stated.

    Parameters
    ----------
    steps : OwnClockSteps -- which a low-pass allows to go on
    """

    about = _ABOUT

    def __init__(self, steps: OwnClockSteps) -> None:
        self._steps = steps

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end behind the low-passes that are likely, unless it leaves more."""
        conditions, search = present.conditions, present.search
        new = search.further_low_passes(present.weighed, conditions.steady) if self._steps.steps_left else {}
        if not new:
            return None
        self._steps.steps_left += _STEPS * len(new) - 1
        clocks = conditions.clocks
        clearest = min(new, key=lambda name: new[name].left)
        start = new[clearest].modes
        if clearest in clocks:
            start = replace(start, clock=present.weighed.fit.clock)
        common = start.clock.latency
        late = {name: own.modes.clock.latency - common for name, own in new.items() if name in clocks}
        behind: Conditions = replace(
            conditions,
            clocks={**clocks, **{name: OwnClock(delay) for name, delay in late.items()}},
            low_passes={**conditions.low_passes, **{name: own.low_pass for name, own in new.items()}},
            start=start,
        )
        following = estimate(behind, present)
        return None if following.leaves_more_than(present) else following


class IdleClocks(SearchMove):
    """Clocks of outputs that do not differ from that which all share, after all, are left out again."""

    about = _ABOUT

    def __init__(self) -> None:
        self._dropped: set[str] = set()

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end without idle clocks, unless just these are asked for again."""
        idle = set(present.search.clocks.idle(present.weighed.fit)) - self._dropped
        if not idle:
            return None
        self._dropped |= idle
        kept = {name: own for name, own in present.conditions.clocks.items() if name not in idle}
        following = estimate(replace(present.conditions, clocks=kept), present)
        further = following.search.further_clocks(following.weighed)
        return None if further and self._dropped.issuperset(further) else following
