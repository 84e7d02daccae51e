"""Jumps of clocks in the middle of a record: which of the possible ones the outputs confirm.

Jumps are looked for before the modes, which a clock that jumps would bend; and judged again with the modes that were
found beside them.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.data.argument_checks import chosen_inputs
from beam_ident.data.own_clocks import on_common_clock
from beam_ident.data.records import TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, possible_jumps, without_jumps
from beam_ident.errors import EstimationError, IdentificationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.mode_search import SHORT
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.conditions import Conditions
from beam_ident.modal_identification.estimation import End, IdentificationTask
from beam_ident.modal_identification.search_moves import Estimate, SearchMove

_JUMP_LEVEL = 1e-3  # how often a steady clock is taken to jump
_BEFORE = 1e-3  # of a stretch
_FEW = 1500  # stamps that tell a jump from lost samples


class ClockJumps(SearchMove):
    """Jumps of clocks that the modes found with them do not need are left out again.

    Parameters
    ----------
    estimation : IdentificationTask
    """

    about = "jumps of clocks that are none"

    def __init__(self, estimation: IdentificationTask) -> None:
        self._asked = estimation

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end with those jumps alone that the present one upholds."""
        conditions = present.conditions
        upheld = self._upheld(conditions, present)
        if upheld == conditions.jumps:
            return None
        try:
            return estimate(replace(conditions, jumps=upheld), None)
        except EstimationError:
            return estimate(replace(conditions, jumps=()), None)

    def likely(self, conditions: Conditions) -> tuple[ClockJump, ...]:
        """Return the jumps that a search for modes should begin with."""
        # Of several inputs one that is late moves a share of the outputs only.
        names = self._asked.input_names
        inputs = names if len(names) == 1 else ()
        places = [
            place
            for number, record in enumerate(conditions.measured)
            for place in possible_jumps(record, number, inputs)
        ]
        return self._jumps(conditions, places) if places else ()

    def _jumps(self, conditions: Conditions, places: list[list[ClockJump]]) -> tuple[ClockJump, ...]:
        """Return by how much clocks jump at some of the places where they may.

        Where no jump does better with the modes that the whole shows, there is none.  Else the longest stretch of
        every record in which no clock can jump shows the modes: with them the likelihood of the whole says for each
        place how many samples were lost, and what is left for a jump.
        """
        records = conditions.measured
        compared = self._seen_either_way(conditions, [jump for place in places for jump in place])
        with contextlib.suppress(IdentificationError):
            whole = self._asked.plain_model(conditions)
            if self._further_jump(compared, (), places, whole, -math.inf) is None:
                return ()
        stretches = []
        for number, record in enumerate(records):
            ends = [place[0].at_s for place in places if place[0].record == number]
            borders = np.sort([*ends, record.input(self._asked.input_names[0]).times_s[0], math.inf])
            last = max(own.times_s[-1] for own in record.outputs)
            longest = int(np.argmax(np.diff(np.minimum(borders, last))))
            stretches.append((float(borders[longest]), float(borders[longest + 1])))
        try:
            # Nothing of the interval itself, at whose other end the clock still is as it was before.
            pieces = [
                own.between(first, last - _BEFORE * (last - first) if math.isfinite(last) else last)
                for own, (first, last) in zip(records, stretches, strict=True)
            ]
            model = self._asked.plain_model(replace(conditions, measured=pieces))
        except IdentificationError:
            return ()
        known: tuple[ClockJump, ...] = ()
        while further := self._further_jump(compared, known, places, model, stretches[0][0]):
            known = (*known, further)
            places = [place for place in places if further not in place]
        return known

    def _further_jump(
        self,
        conditions: Conditions,
        known: tuple[ClockJump, ...],
        places: Sequence[Sequence[ClockJump]],
        model: ModalModel,
        seen_s: float,
    ) -> ClockJump | None:
        """Return the jump that explains most beside those that are known; None where chance explains as much."""
        tried = [jump for place in places for jump in place]
        if not tried:
            return None
        costs = [self._cost(conditions, (*known, jump), model, seen_s) for jump in tried]
        gain = self._cost(conditions, known, model, seen_s) - min(costs)
        is_chance = 2.0 * gain < chi_squared_isf(1, _JUMP_LEVEL / len(tried))
        return None if is_chance else tried[int(np.argmin(costs))]

    def _upheld(self, conditions: Conditions, present: End) -> tuple[ClockJump, ...]:
        """Return those of the jumps that the model found with them does not do better without.

        A mode that the stretch without jumps does not show is nobody's but a jump's until it is found.
        """
        jumps = conditions.jumps
        if not jumps:
            return ()
        found, needed = present.result, chi_squared_isf(1, _JUMP_LEVEL)
        compared = self._seen_either_way(conditions, jumps)
        cost = self._cost(compared, jumps, found.model, -math.inf)
        upheld = []
        for jump, estimated in zip(jumps, found.clock_jumps, strict=True):
            others = tuple(own for own in jumps if own is not jump)
            gain = self._cost(compared, others, found.model, -math.inf) - cost
            is_seen = estimated.size_s**2 > needed * estimated.size_sd**2
            if is_seen and 2.0 * gain > needed:
                upheld.append(jump)
        return tuple(upheld)

    def _seen_either_way(self, conditions: Conditions, jumps: Sequence[ClockJump]) -> Conditions:
        """Return records without the samples that some jumps alone show, or hide: in a gap, and at the end."""
        result: list[TimeRecord] = []
        for number, record in enumerate(conditions.measured):
            own = [jump for jump in jumps if jump.record == number]
            at_end = max((abs(jump.size_s) for jump in own), default=0.0)
            drives = chosen_inputs(record, self._asked.input_names)
            last = min(drive.span_s[1] for drive in drives) - at_end
            gaps = [
                (jump.at_s - jump.size_s, jump.at_s)
                for jump in own
                if set(jump.signals).intersection(self._asked.input_names)
            ]
            outputs = []
            for output in record.outputs:
                times = output.times_s
                hidden = np.any(
                    [(times > start) & (times < end) for start, end in [*gaps, (last, np.inf)]], axis=0
                )
                outputs.append(replace(output, values=np.where(hidden, np.nan, output.values)))
            result.append(replace(record, outputs=tuple(outputs)))
        return replace(conditions, measured=result)

    def _cost(
        self, conditions: Conditions, jumps: tuple[ClockJump, ...], model: ModalModel, seen_s: float
    ) -> float:
        """Return what a model of a stretch that begins at ``seen_s`` costs where clocks jump, refined a little."""
        asked, records = self._asked, conditions.measured
        steady = [
            on_common_clock(without_jumps(own, number, jumps), model.own_clocks)
            for number, own in enumerate(records)
        ]
        regression = ModalRegression(steady, conditions.terms, asked.input_names).thinned(_FEW)
        # The stretch may be late by the jumps before it.
        late = [
            jump.size_s * (-1.0 if model.input_names[0] in jump.signals else 1.0)
            for jump in jumps
            if jump.record == 0 and jump.at_s <= seen_s
        ]
        clock = replace(model.clock, latency=model.clock.latency - sum(late))
        fit = fit_modes(
            regression,
            model.natural_frequencies,
            model.damping_ratios,
            clock,
            asked.latency,
            asked.clock_rate,
            SHORT,
        )
        # A few stamps more or fewer may be within the input's span.
        powers = [max(float(np.mean(np.square(left))), 1e-300) for left in fit.residuals]
        sizes = [
            sum(len(own.output(name).times_s) for own in records if name in own.output_names)
            for name in regression.output_names
        ]
        return 0.5 * float(np.minimum(sizes, _FEW * len(records)) @ np.log(powers))
