"""One identification: one search or several, where clocks jump, outputs are late by themselves, outliers hide modes,
or a blow looks like motion that was there before.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.data.argument_checks import (
    chosen_inputs,
    require_input,
    require_output,
)
from beam_ident.data.batches import Progress
from beam_ident.data.own_clocks import OwnClock, on_common_clock, with_low_passes
from beam_ident.data.prior import Prior
from beam_ident.data.records import LowPass, TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, possible_jumps, without_jumps
from beam_ident.errors import EstimationError, IdentificationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.mode_search import (
    SHORT,
    Stopped,
    Weighed,
)
from beam_ident.modal_estimation.record_levels import (
    gap_sentences,
    without_outliers,
)
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.clock_search import (
    OwnClocks,
)
from beam_ident.modal_identification.fit_tests import THINNED
from beam_ident.modal_identification.sensor_low_passes import Sensor
from beam_ident.modal_identification.signal_clocks import SignalClocks
from beam_ident.modal_identification.time_search import LongSearch, TimeSearch
from beam_ident.sensing.still_noise import StillNoise

_OUTLIER_LOOKS = 3  # at records without the outliers seen so far
_CLOCK_TURNS = 3  # for every output: of clocks that outputs have of their own, and the modes that show them
_JUMP_LEVEL = 1e-3  # how often a steady clock is taken to jump
_BEFORE = 1e-3  # of a stretch
_FEW = 1500  # stamps that tell a jump from lost samples
_IN_MOTION = 1e-3  # chance to call a record that begins at rest one that begins in motion
_MANY_STAMPS = 100_000  # of an output: from here on the search begins with some of them

_End = tuple[TimeSearch, Weighed[ModalRegression]]
"""A search, and what it found, weighed by the noise."""


@dataclass
class _Turns:
    """Where the turns of a search stand: each finds modes with what is known of the outputs' clocks and low-passes.

    Attributes
    ----------
    clocks, low_passes : dict -- of outputs by name, as far as they are known
    most : int -- turns, at most
    start : ModalFit or None -- where the next one begins
    has_asked : bool -- every output by itself
    looks_inside, is_persistent : bool -- whether the next one looks where simpler structures end, and goes on past
        orders that are not believed
    end_inside : ModalFit or None -- where simpler structures led to
    first, known, best : (TimeSearch, Weighed) or None -- the first end, the last, and the likeliest
    before_new, before_idle : the same or None -- without low-passes, and with clocks that were not needed
    dropped : set of str -- outputs whose own clock was left out again
    unsettled : list of str -- outputs that would have moved on after the last turn
    """

    clocks: dict[str, OwnClock]
    most: int
    low_passes: dict[str, LowPass] = field(default_factory=dict)
    start: ModalFit | None = None
    has_asked: bool = False
    looks_inside: bool = True
    is_persistent: bool = True
    end_inside: ModalFit | None = None
    first: _End | None = None
    known: _End | None = None
    best: _End | None = None
    before_new: _End | None = None
    before_idle: _End | None = None
    dropped: set[str] = field(default_factory=set)
    unsettled: list[str] = field(default_factory=list)

    def instruct(self, search: TimeSearch) -> None:
        """Tell a search what the turns before it have looked for in vain."""
        search.is_in_doubt, search.looks_inside = self.has_asked, self.looks_inside
        search.is_persistent, search.end_before = self.is_persistent, self.end_inside

    def note(self, end: _End) -> None:
        """Take note of where a turn ended.

        A clock that moves a little leaves in vain what was in vain, and a better end where it was.
        """
        search, weighed = self.known = end
        self.first = self.first or end
        if self.best is None or weighed.fit.cost < self.best[1].fit.cost:
            self.best = end
        self.is_persistent = search.is_worth_persisting
        if search.is_better_inside:
            self.end_inside = search.chosen
        self.looks_inside = self.end_inside is not None

    def look_behind(self, new: Mapping[str, Sensor], end: _End) -> None:
        """Look behind low-passes that are likely."""
        self.before_new = self.before_new or self.known
        self.most += _CLOCK_TURNS * len(new)
        clearest = min(new, key=lambda name: new[name].left)
        self.start = new[clearest].modes
        if clearest in self.clocks:
            self.start = replace(self.start, clock=end[1].fit.clock)
        common = self.start.clock.latency
        late = {name: own.modes.clock.latency - common for name, own in new.items() if name in self.clocks}
        self.clocks = {**self.clocks, **{name: OwnClock(delay) for name, delay in late.items()}}
        self.low_passes = {**self.low_passes, **{name: own.low_pass for name, own in new.items()}}

    def go_on(self, further: Mapping[str, OwnClock], better: Mapping[str, LowPass], end: _End) -> None:
        """Go on with clocks that move further, and better low-passes."""
        if better:
            self.start = end[1].fit
        # The ends so far keep the clocks that they were found with.
        self.low_passes = {**self.low_passes, **better}
        moved = {
            name: self.clocks.get(name, OwnClock()).moved(own.delay, own.rate)
            for name, own in further.items()
        }
        self.clocks = {**self.clocks, **moved}

    def leaves_out_idle(self, end: _End) -> bool:
        """Leave out clocks of outputs that do not differ from the common one; False where there are none."""
        search, weighed = end
        idle = set(search.clocks.idle(weighed.fit)) - self.dropped
        if idle:
            self.before_idle, self.dropped = self.known, self.dropped | idle
            self.clocks = {name: own for name, own in self.clocks.items() if name not in idle}
        return bool(idle)


@dataclass(frozen=True)
class IdentificationTask:
    """What ``identify`` was asked for.

    Attributes
    ----------
    terms : ModalStructure
    may_rest : bool -- whether motion at the beginning may be left out where a blow is told from it by a test only
    n_modes, max_modes : int or None, int
    latency, clock_rate : Prior
    input_names : tuple of str
    progress : callable
    found_noise : mapping -- of the records whose input did not state its own
    own_latencies, own_rates : mapping -- what is known of the clocks of single outputs, by name
    first_clocks : mapping -- clocks of single outputs that the search begins with, by name
    """

    terms: ModalStructure
    may_rest: bool
    n_modes: int | None
    max_modes: int
    latency: Prior
    clock_rate: Prior
    input_names: tuple[str, ...]
    progress: Progress
    found_noise: Mapping[int, StillNoise]
    own_latencies: Mapping[str, Prior]
    own_rates: Mapping[str, Prior]
    first_clocks: Mapping[str, OwnClock] = field(default_factory=dict)

    def result(self, records: list[TimeRecord]) -> IdentificationResult:
        """Return what is found in some records, clocks that jump among them."""
        # Of several inputs one that is late moves a share of the outputs only.
        inputs = self.input_names if len(self.input_names) == 1 else ()
        places = [
            place for number, record in enumerate(records) for place in possible_jumps(record, number, inputs)
        ]
        jumps = self._jumps(records, places) if places else ()
        while jumps:
            try:
                found = self._seen_past_outliers(records, jumps)
            except EstimationError:
                break
            upheld = self._upheld(records, jumps, found)
            if upheld == jumps:
                return found
            jumps = upheld
        return self._seen_past_outliers(records, ())

    def _seen_past_outliers(
        self, records: list[TimeRecord], jumps: tuple[ClockJump, ...]
    ) -> IdentificationResult:
        """Return the outcome, without the outliers where the search, by least squares, finds other modes so.

        The last fit weighs outliers as what they are, but it has the modes that the search has found beside them.
        Every look without those that are seen may show smaller ones.
        """
        found = before = self._outcome(records, jumps)
        for _ in range(_OUTLIER_LOOKS):
            has_own_stamps = found.model.own_clocks or found.clock_jumps
            cleaned = None if has_own_stamps else without_outliers(records, found.outputs)
            if cleaned is None:
                break
            try:
                following = self._outcome(cleaned, jumps)
            except EstimationError:
                break
            if self.n_modes is None:
                is_better = following.model.n_modes != found.model.n_modes
            else:
                is_better = sum(map(bool, following.doubts)) < sum(map(bool, found.doubts))
            if not is_better:
                break
            counts = [
                f"{missing} of {len(was.times_s)} samples of {was.name}"
                for was, own in zip(before.outputs, following.outputs, strict=True)
                if (missing := len(was.times_s) - len(own.times_s))
            ]
            said = (
                f"Outliers: {', '.join(counts)} hid modes from the search, or feigned some, and are left out."
            )
            records, found = cleaned, replace(following, warnings=(*following.warnings, said))
        return found

    def _jumps(self, records: list[TimeRecord], places: list[list[ClockJump]]) -> tuple[ClockJump, ...]:
        """Return by how much clocks jump at some of the places where they may.

        Where no jump does better with the modes that the whole shows, there is none.  Else the longest stretch of
        every record in which no clock can jump shows the modes: with them the likelihood of the whole says for each
        place how many samples were lost, and what is left for a jump.
        """
        compared = self._seen_either_way(records, [jump for place in places for jump in place])
        with contextlib.suppress(IdentificationError):
            whole = self._plain_model(records)
            if self._further_jump(compared, (), places, whole, -math.inf) is None:
                return ()
        stretches = []
        for number, record in enumerate(records):
            ends = [place[0].at_s for place in places if place[0].record == number]
            borders = np.sort([*ends, record.input(self.input_names[0]).times_s[0], math.inf])
            last = max(own.times_s[-1] for own in record.outputs)
            longest = int(np.argmax(np.diff(np.minimum(borders, last))))
            stretches.append((float(borders[longest]), float(borders[longest + 1])))
        try:
            # Nothing of the interval itself, at whose other end the clock still is as it was before.
            pieces = [
                own.between(first, last - _BEFORE * (last - first) if math.isfinite(last) else last)
                for own, (first, last) in zip(records, stretches, strict=True)
            ]
            model = self._plain_model(pieces)
        except IdentificationError:
            return ()
        known: tuple[ClockJump, ...] = ()
        while further := self._further_jump(compared, known, places, model, stretches[0][0]):
            known = (*known, further)
            places = [place for place in places if further not in place]
        return known

    def _further_jump(
        self,
        records: list[TimeRecord],
        known: tuple[ClockJump, ...],
        places: Sequence[Sequence[ClockJump]],
        model: ModalModel,
        seen_s: float,
    ) -> ClockJump | None:
        """Return the jump that explains most beside those that are known; None where chance explains as much."""
        tried = [jump for place in places for jump in place]
        if not tried:
            return None
        costs = [self._cost(records, (*known, jump), model, seen_s) for jump in tried]
        gain = self._cost(records, known, model, seen_s) - min(costs)
        is_chance = 2.0 * gain < chi_squared_isf(1, _JUMP_LEVEL / len(tried))
        return None if is_chance else tried[int(np.argmin(costs))]

    def _upheld(
        self, records: list[TimeRecord], jumps: tuple[ClockJump, ...], found: IdentificationResult
    ) -> tuple[ClockJump, ...]:
        """Return those of some jumps that the model found with them does not do better without.

        A mode that the stretch without jumps does not show is nobody's but a jump's until it is found.
        """
        needed = chi_squared_isf(1, _JUMP_LEVEL)
        records = self._seen_either_way(records, jumps)
        cost = self._cost(records, jumps, found.model, -math.inf)
        upheld = []
        for jump, estimated in zip(jumps, found.clock_jumps, strict=True):
            others = tuple(own for own in jumps if own is not jump)
            gain = self._cost(records, others, found.model, -math.inf) - cost
            is_seen = estimated.size_s**2 > needed * estimated.size_sd**2
            if is_seen and 2.0 * gain > needed:
                upheld.append(jump)
        return tuple(upheld)

    def _seen_either_way(self, records: list[TimeRecord], jumps: Sequence[ClockJump]) -> list[TimeRecord]:
        """Return records without the samples that some jumps alone show, or hide: in a gap, and at the end."""
        result = []
        for number, record in enumerate(records):
            own = [jump for jump in jumps if jump.record == number]
            at_end = max((abs(jump.size_s) for jump in own), default=0.0)
            drives = chosen_inputs(record, self.input_names)
            last = min(drive.span_s[1] for drive in drives) - at_end
            gaps = [
                (jump.at_s - jump.size_s, jump.at_s)
                for jump in own
                if set(jump.signals).intersection(self.input_names)
            ]
            outputs = []
            for output in record.outputs:
                times = output.times_s
                hidden = np.any(
                    [(times > start) & (times < end) for start, end in [*gaps, (last, np.inf)]], axis=0
                )
                outputs.append(replace(output, values=np.where(hidden, np.nan, output.values)))
            result.append(replace(record, outputs=tuple(outputs)))
        return result

    def _plain_model(self, records: list[TimeRecord]) -> ModalModel:
        """Return what a search with equal weights finds until its first doubt, in a fraction of an outcome's time."""
        regression = ModalRegression(records, self.terms, self.input_names)
        _refuse_hopeless(regression, self.n_modes)
        search = self._begun(records, regression)
        search.is_persistent = False
        try:
            fit = search.begun(self.n_modes, self.max_modes).fit
        except OwnClocks:
            return self._outcome(records, ()).model
        if not len(fit.omegas):
            raise EstimationError("no mode was found: expected one at least. Record longer, or excite more")
        return search.model(fit)

    def _cost(
        self, records: list[TimeRecord], jumps: tuple[ClockJump, ...], model: ModalModel, seen_s: float
    ) -> float:
        """Return what a model of a stretch that begins at ``seen_s`` costs where clocks jump, refined a little."""
        steady = [
            on_common_clock(without_jumps(own, number, jumps), model.own_clocks)
            for number, own in enumerate(records)
        ]
        regression = ModalRegression(steady, self.terms, self.input_names).thinned(_FEW)
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
            self.latency,
            self.clock_rate,
            SHORT,
        )
        # A few stamps more or fewer may be within the input's span.
        powers = [max(float(np.mean(np.square(left))), 1e-300) for left in fit.residuals]
        sizes = [
            sum(len(own.output(name).times_s) for own in records if name in own.output_names)
            for name in regression.output_names
        ]
        return 0.5 * float(np.minimum(sizes, _FEW * len(records)) @ np.log(powers))

    def _outcome(self, records: list[TimeRecord], jumps: tuple[ClockJump, ...]) -> IdentificationResult:
        """Return what is found in some records with the jumps of their clocks, and outputs late by themselves."""
        measured = [without_jumps(own, k, jumps) for k, own in enumerate(records)]
        turns = _Turns(
            {**self.first_clocks, **self._known_clocks(measured)}, _CLOCK_TURNS * len(records[0].outputs)
        )
        for turn in itertools.count():
            shifted = with_low_passes(
                [on_common_clock(one, turns.clocks) for one in measured], turns.low_passes
            )
            further, better, new = dict[str, OwnClock](), dict[str, LowPass](), dict[str, Sensor]()
            try:
                regression = ModalRegression(shifted, self.terms, self.input_names)
                _refuse_hopeless(regression, self.n_modes)
                search = self._begun(
                    shifted,
                    regression,
                    clocks=turns.clocks,
                    jumps=jumps,
                    low_passes=turns.low_passes,
                    start=turns.start,
                )
                turns.instruct(search)
                if turn == 0 and (result := self._untangled(regression, search)) is not None:
                    return result
                try:
                    end = self._finished(search, regression)
                except EstimationError as err:
                    if turns.known is not None:  # no mode was believed without the clocks that it needs
                        end = turns.known
                        break
                    gaps = gap_sentences(search.plain)
                    if not gaps:
                        raise
                    raise EstimationError(f"{err}. {' '.join(gaps)}") from err
                search, weighed = end
                if search.stopped_by is not None and turns.known is not None:
                    raise search.stopped_by
                turns.note(end)
                is_done = search.stopped_by is None
                goes_on = is_done and turn + 1 < turns.most
                further = search.further_clocks(weighed) if is_done else {}
                better = search.better_low_passes(weighed) if is_done else {}
                if (further or better) and not goes_on:
                    turns.unsettled = sorted({*further, *better})
                    end = turns.best or end  # the last turn may have got worse
                    break
                if goes_on and not (further or better):
                    new = search.further_low_passes(weighed, measured)
            except OwnClocks as own:
                turns.clocks, turns.has_asked = own.clocks, True
                continue
            except Stopped as stop:
                if turns.known is None:
                    raise
                search, weighed = turns.known
                missing = "a further look for clocks that outputs have of their own"
                end, goes_on = (search, search.unfinished(weighed, stop, missing)), False
            if turns.before_idle is not None and further and turns.dropped.issuperset(further):
                end = turns.before_idle  # without them they are asked for again
                break
            if new:
                turns.look_behind(new, end)
            elif further or better:
                turns.go_on(further, better, end)
            elif not (goes_on and turns.leaves_out_idle(end)):
                break
        return self._said(turns, end)

    def _said(self, turns: _Turns, end: _End) -> IdentificationResult:
        """Return the result of the last turn, or of the one before its low-passes, and whether the clocks settled."""
        if turns.before_new is not None and _leaves_more(end, turns.before_new):
            end = turns.before_new
        if turns.first is not None and turns.best is not None and _leaves_more(end, turns.first):
            # Without clocks of their own outputs were explained better: these settled where nothing says so.
            end, turns.unsettled = turns.best, sorted(turns.clocks) or turns.unsettled
        search, weighed = end
        result = search.result(weighed, self.n_modes)
        if turns.unsettled:
            said = (
                f"The clocks of {', '.join(turns.unsettled)} did not settle: the likeliest of {turns.most} fits is "
                "taken. State latency, clock rate or low_pass of these outputs where they are known, or identify "
                "them alone."
            )
            result = replace(result, warnings=(*result.warnings, said))
        return result

    def _known_clocks(self, records: list[TimeRecord]) -> dict[str, OwnClock]:
        """Return the clocks that outputs are known to have against that which the others share."""
        known = {*self.own_latencies, *self.own_rates}
        if not known:
            return {}
        latency, rate = self.latency.mean, self.clock_rate.mean
        rest = [
            one.select(left) for one in records if (left := [n for n in one.output_names if n not in known])
        ]
        if rest and len(rest) == len(records):
            with contextlib.suppress(IdentificationError):
                model = replace(self, own_latencies={}, own_rates={}).result(rest).model
                latency, rate = model.latency, model.clock_rate
        return {
            name: OwnClock(
                self.own_latencies[name].mean - latency if name in self.own_latencies else 0.0,
                self.own_rates[name].mean - rate if name in self.own_rates else 0.0,
                name in self.own_rates,
            )
            for name in known
        }

    def _begun(
        self,
        records: list[TimeRecord],
        regression: ModalRegression,
        highest_hz: float = math.inf,
        clocks: Mapping[str, OwnClock] = MappingProxyType({}),
        jumps: Sequence[ClockJump] = (),
        low_passes: Mapping[str, LowPass] = MappingProxyType({}),
        start: ModalFit | None = None,
    ) -> TimeSearch:
        is_long = max(len(times) for times in regression.times) > _MANY_STAMPS
        first = regression.thinned(THINNED) if is_long else regression
        search = TimeSearch(
            records,
            first,
            self.latency,
            self.clock_rate,
            self.input_names,
            self.progress,
            highest_hz,
            SignalClocks.of(regression, clocks, jumps, (self.own_latencies, self.own_rates), low_passes),
            start=start,
            found_noise=self.found_noise,
        )
        if start is not None:
            search.without_modes = search.fit(np.empty(0), np.empty(0), start.clock)
        if not (search.band.is_excited or self.terms.has_free_response):
            raise EstimationError(
                "the input stands still and the structure leaves out motion at the beginning: nothing shows a mode. "
                "Leave has_free_response as it is by default, or excite"
            )
        return search

    def _finished(
        self, search: TimeSearch, regression: ModalRegression
    ) -> tuple[TimeSearch, Weighed[ModalRegression]]:
        if search.plain is regression:
            return search, search.run(self.n_modes, self.max_modes)
        few = search.begun(self.n_modes, self.max_modes)
        if search.stopped_by is not None:
            return search, few
        try:
            following = LongSearch(regression, search)
        except Stopped as stop:
            if not len(search.chosen.omegas):
                raise
            missing = f"the fit to more than {THINNED} stamps of a record, and the weighing by the noise"
            return search, search.ended_early(search.chosen, stop, missing)
        return following, following.run(self.n_modes, self.max_modes)

    def _untangled(self, regression: ModalRegression, search: TimeSearch) -> IdentificationResult | None:
        """Return the result from rest where a blow at the beginning is not told from motion that was there before."""
        if not (self.may_rest and search.band.is_excited and search.scan.is_tangled):
            return None
        # Of a decay alone, samples do not tell a frequency from its aliases: the lowest is meant.
        records = search.records
        still = ModalRegression(records, replace(self.terms, has_free_response=False), self.input_names)
        try:
            begun = self._begun(
                records, still, 0.5 * regression.rate_hz, search.clocks.own, search.clocks.jumps
            )
            from_rest, weighed = self._finished(begun, still)
            result = from_rest.result(weighed, self.n_modes)
        except EstimationError:
            return None  # a record that begins in motion may not fit at all
        clocks = self.latency, self.clock_rate
        return None if _begins_in_motion(regression, still, result.model, clocks) else result


def _refuse_hopeless(regression: ModalRegression, n_modes: int | None) -> None:
    for drive in regression.drives:
        require_input(drive, is_needed=False)
    for name, values in zip(regression.output_names, regression.values, strict=True):
        require_output(name, values)
        n = n_modes or 1
        needed = 4 * (regression.n_shared(n) + regression.n_nuisance(n) + 2 * n)
        if len(values) < needed:
            raise EstimationError(
                f"output {name!r} has {len(values)} usable samples for {n} modes; expected at "
                f"least {needed}. Record longer or ask for fewer modes"
            )


def _begins_in_motion(
    regression: ModalRegression, still: ModalRegression, model: ModalModel, clocks: tuple[Prior, Prior]
) -> bool:
    """Return whether free motion explains more of the records than chance would (a likelihood ratio test).

    Parameters
    ----------
    regression, still : ModalRegression -- of the same records, with free motion and without
    model : ModalModel -- estimated without
    clocks : tuple of Prior
    """
    with_motion, without = (
        fit_modes(own, model.natural_frequencies, model.damping_ratios, model.clock, *clocks)
        for own in (regression, still)
    )
    freedom = with_motion.n_parameters - without.n_parameters
    return bool(2.0 * (without.cost - with_motion.cost) > chi_squared_isf(freedom, _IN_MOTION))


def _leaves_more(end: _End, other: _End) -> bool:
    """Return whether no fewer modes leave more of the outputs than at another end, before and behind the noise."""

    def log_power(fit: ModalFit) -> float:
        return sum(len(left) * math.log(max(float(left @ left), 1e-300)) for left in fit.residuals)

    least = [min(log_power(search.chosen), log_power(weighed.fit)) for search, weighed in (end, other)]
    return len(end[1].fit.omegas) >= len(other[1].fit.omegas) and least[0] > least[1]
