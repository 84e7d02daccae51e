"""The move of modes whose natural frequencies change while they are recorded, over time or over their swing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from beam_ident.modal.fit import ModalFit
from beam_ident.modal.mode_change import ModeChange, changes_of
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.estimation import End
from beam_ident.modal_identification.fit_tests import SampledFit
from beam_ident.modal_identification.mode_changes import change_columns, moved_on, possible_changes
from beam_ident.modal_identification.search_moves import Estimate, SearchMove
from beam_ident.modal_identification.time_search import WORTH_A_LOOK, TimeSearch
from beam_ident.noise.scores import ScoreTest, Tested


class ModeChanges(SearchMove):
    """Modes whose frequencies change, over time or over their swing: found by score tests, one after the other."""

    about = "modes whose frequencies change while they are recorded"

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end with one mode more that changes, where that explains more."""
        conditions, fit, search = present.conditions, present.weighed.fit, present.search
        if len(conditions.measured) > 1 or not search.band.is_excited or search.plain.restarts.count:
            return None
        if conditions.clocks or conditions.jumps:  # what these explain may have been a change, or the reverse
            return None
        some = search.looked_at(fit, present.weighed.problem)
        changes = conditions.terms.changes
        believed = [not doubt for doubt in present.result.doubts]
        likeliest = _likeliest(some, changes, believed)
        if likeliest is None:
            return None
        changes, start = _settled(search, (*changes, likeliest))
        terms = replace(conditions.terms, changes=changes)
        following = estimate(replace(conditions, terms=terms, start=start), present)
        gain = fit.cost - following.weighed.fit.cost
        pays = gain > 0.5 * _price(search.plain.n_samples, search.plain.n_outputs, 2 * len(fit.omegas))
        # What would move on by more than it is has not settled anywhere.
        has_settled = all(
            own.runs_forward and abs(further) < abs(own.share - further)
            for own, further, _ in following.search.clocks.estimated_changes(following.weighed.fit)
        )
        return following if pays and has_settled and not following.leaves_more_than(present) else None


def _settled(search: TimeSearch, changes: tuple[ModeChange, ...]) -> tuple[tuple[ModeChange, ...], ModalFit]:
    """Return changes that settle, by Gauss-Newton steps beside the poles, and the fit with equal weights."""
    regression, modes = search.plain.with_own_columns({}), search.chosen
    best: tuple[tuple[ModeChange, ...], ModalFit] | None = None
    while True:
        steady = regression.with_changes(changes)
        clocks = replace(search.clocks, changes=changes)
        problem = clocks.estimated_in(steady, modes, search.records)
        modes = fit_modes(problem, modes.omegas, modes.zetas, modes.clock, search.latency, search.clock_rate)
        if best is not None and not modes.cost < best[1].cost - WORTH_A_LOOK:
            return best
        best = changes, modes
        changes = tuple(moved_on(own, problem, modes) for own, _, _ in clocks.estimated_changes(modes))
        if not all(own.runs_forward for own in changes):
            return best


def _price(n_samples: int, n_parameters: int, n_places: int) -> float:
    """Return what parameters cost that were chosen among some places, as a chi-squared (Chen and Chen 2008)."""
    return n_parameters * math.log(n_samples) + 2.0 * math.log(n_places)


def _likeliest(
    some: SampledFit, changes: Sequence[ModeChange], believed: Sequence[bool]
) -> ModeChange | None:
    """Return the change of one more mode that what a fit leaves speaks for most clearly, to first order, if any.

    What would bring a frequency below zero is a broad peak that stands for something else.
    """
    changing = changes_of(changes, some.fit.omegas)
    steady = [mode for mode, is_believed in enumerate(believed) if is_believed and mode not in changing]
    asked = possible_changes(some.regression, some.fit, steady)
    columns = change_columns(some.regression, some.fit, asked)
    tests: list[Tested] = list(
        zip(columns, some.solutions, some.fit.residuals, some.regression.values, strict=True)
    )
    clearest, best = 0.0, None
    for place, change in enumerate(asked):
        alone: list[Tested] = [
            (own[:, place : place + 1], present, left, values) for own, present, left, values in tests
        ]
        test = ScoreTest.of(alone)
        price = _price(some.regression.n_samples, test.freedom, len(asked))
        if test.statistic <= max(price, clearest):
            continue
        top = bottom = 0.0
        for (own, solution, left, _), sigma in zip(alone, some.fit.sigmas.tolist(), strict=True):
            free = solution.left_of(own)[:, 0]
            top += float(free @ left) / sigma**2
            bottom += float(free @ free) / sigma**2
        found = replace(change, share=top / bottom)
        if found.runs_forward:
            clearest, best = test.statistic, found
    return best
