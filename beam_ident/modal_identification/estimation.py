"""One estimate of the modes of records under given conditions: a search over orders, weighed by the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.data.argument_checks import require_input, require_output
from beam_ident.data.batches import Progress
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.mode_search import Stopped, Weighed
from beam_ident.modal_estimation.record_levels import gap_sentences
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.clock_search import OwnClocks
from beam_ident.modal_identification.conditions import Conditions
from beam_ident.modal_identification.fit_tests import THINNED
from beam_ident.modal_identification.signal_clocks import SignalClocks
from beam_ident.modal_identification.time_search import LongSearch, TimeSearch

_IN_MOTION = 1e-3  # chance to call a record that begins at rest one that begins in motion
_MANY_STAMPS = 100_000  # of an output: from here on the search begins with some of them


@dataclass(frozen=True, eq=False)
class End:
    """Where a search over orders ended.

    Attributes
    ----------
    conditions : Conditions -- what was believed of the records
    search : TimeSearch
    weighed : Weighed -- what it found, weighed by the noise
    n_modes : int or None -- as it was asked for
    """

    conditions: Conditions
    search: TimeSearch
    weighed: Weighed[ModalRegression]
    n_modes: int | None

    @cached_property
    def result(self) -> IdentificationResult:
        """What was found, with what must be known of it; EstimationError where the input explains nothing."""
        result = self.search.result(self.weighed, self.n_modes)
        return replace(result, warnings=(*result.warnings, *self.conditions.sentences.values()))

    def unfinished(self, stop: BaseException, missing: str) -> End:
        """Return the end as the best there is, since something stopped the search before its time."""
        return replace(self, weighed=self.weighed.unfinished(stop, missing))

    @property
    def stopped_by(self) -> BaseException | None:
        """What ended the search before its time, if anything did."""
        return self.weighed.stopped_by

    def leaves_more_than(self, other: End) -> bool:
        """Return whether no fewer modes leave more of the outputs than at another end, unweighed and weighed."""
        least = [min(map(_log_power, (own.search.chosen, own.weighed.fit))) for own in (self, other)]
        return len(self.weighed.fit.omegas) >= len(other.weighed.fit.omegas) and least[0] > least[1]


@dataclass(frozen=True)
class IdentificationTask:
    """What ``identify`` was asked for.

    Attributes
    ----------
    input_names : tuple of str
    n_modes, max_modes : int or None, int
    latency, clock_rate : Prior -- of the clock that outputs share
    progress : callable
    own_latencies, own_rates : mapping -- what is known of the clocks of single outputs, by name
    may_rest : bool -- whether motion at the beginning may be left out where a blow is told from it by a test only
    """

    input_names: tuple[str, ...]
    n_modes: int | None
    max_modes: int
    latency: Prior
    clock_rate: Prior
    progress: Progress
    own_latencies: Mapping[str, Prior] = field(default_factory=dict)
    own_rates: Mapping[str, Prior] = field(default_factory=dict)
    may_rest: bool = False

    def end(self, conditions: Conditions, after: End | None = None) -> End:
        """Return where the search over orders ends under some conditions.

        Parameters
        ----------
        conditions : Conditions
        after : End or None -- an end of nearly the same records: what it looked for in vain is not looked for again

        Raises
        ------
        EstimationError
            Nothing can be identified from the records, or no mode stands out of the noise.
        """
        regression = self._regression(conditions)
        search = self._begun(conditions, regression)
        if after is not None:
            search.spare(after.search)
        elif (at_rest := self._from_rest(conditions, regression, search)) is not None:
            return at_rest
        try:
            return End(conditions, *self._finished(search, regression), self.n_modes)
        except OwnClocks as own:
            with_clocks = replace(conditions, clocks=own.clocks)
            regression = self._regression(with_clocks)
            search = self._begun(with_clocks, regression)
            search.is_in_doubt = True
            return End(with_clocks, *self._finished(search, regression), self.n_modes)

    def plain_model(self, conditions: Conditions) -> ModalModel:
        """Return what a search with equal weights finds until its first doubt, which takes a fraction of the time."""
        regression = self._regression(conditions)
        search = self._begun(conditions, regression)
        search.looks.past_doubt = False
        try:
            fit = search.begun(self.n_modes, self.max_modes).fit
        except OwnClocks:
            return self.end(conditions).result.model
        if not len(fit.omegas):
            raise EstimationError("no mode was found: expected one at least. Record longer, or excite more")
        return search.model(fit)

    def _regression(self, conditions: Conditions) -> ModalRegression:
        """Return the regression of records under some conditions, or refuse what says nothing."""
        regression = ModalRegression(conditions.records, conditions.terms, self.input_names)
        for drive in regression.drives:
            require_input(drive, is_needed=False)
        n = self.n_modes or 1
        needed = 4 * (regression.n_shared(n) + regression.n_nuisance(n) + 2 * n)
        for name, values in zip(regression.output_names, regression.values, strict=True):
            require_output(name, values)
            if len(values) < needed:
                raise EstimationError(
                    f"output {name!r} has {len(values)} usable samples for {n} modes; expected at "
                    f"least {needed}. Record longer or ask for fewer modes"
                )
        return regression

    def _begun(self, conditions: Conditions, regression: ModalRegression) -> TimeSearch:
        is_long = max(len(times) for times in regression.times) > _MANY_STAMPS
        known, start = (self.own_latencies, self.own_rates), conditions.start
        search = TimeSearch(
            conditions.records,
            regression.thinned(THINNED) if is_long else regression,
            self.latency,
            self.clock_rate,
            self.input_names,
            self.progress,
            conditions.highest_hz,
            SignalClocks.of(regression, conditions.clocks, conditions.jumps, known, conditions.low_passes),
            start=start,
            found_noise=conditions.found_noise,
        )
        if start is not None:
            search.without_modes = search.fit(np.empty(0), np.empty(0), start.clock)
        if not (search.band.is_excited or conditions.terms.has_free_response):
            raise EstimationError(
                "the input stands still and the structure leaves out motion at the beginning: nothing shows a mode. "
                "Leave has_free_response as it is by default, or excite"
            )
        return search

    def _finished(
        self, search: TimeSearch, regression: ModalRegression
    ) -> tuple[TimeSearch, Weighed[ModalRegression]]:
        try:
            if search.plain is regression:
                return search, search.run(self.n_modes, self.max_modes)
            few = search.begun(self.n_modes, self.max_modes)
            if few.stopped_by is not None:
                return search, few
            try:
                following = LongSearch(regression, search)
            except Stopped as stop:
                if not len(search.chosen.omegas):
                    raise
                missing = f"the fit to more than {THINNED} stamps of a record, and the weighing by the noise"
                return search, search.ended_early(search.chosen, stop, missing)
            return following, following.run(self.n_modes, self.max_modes)
        except EstimationError as err:
            if not (gaps := gap_sentences(search.plain)):
                raise
            raise EstimationError(f"{err}. {' '.join(gaps)}") from err

    def _from_rest(
        self, conditions: Conditions, regression: ModalRegression, search: TimeSearch
    ) -> End | None:
        """Return the end from rest where a blow at the beginning is not told from motion that was there before."""
        if not (self.may_rest and search.band.is_excited and search.scan.is_tangled):
            return None
        # Of a decay alone, samples do not tell a frequency from its aliases: the lowest is meant.
        still = replace(
            conditions,
            terms=replace(conditions.terms, has_free_response=False),
            highest_hz=0.5 * regression.rate_hz,
        )
        from_rest = self._regression(still)
        try:
            end = End(still, *self._finished(self._begun(still, from_rest), from_rest), self.n_modes)
            model = end.result.model
        except EstimationError:
            return None  # a record that begins in motion may not fit at all
        # A likelihood ratio test of free motion beside the modes that were found without.
        with_motion, without = (
            fit_modes(
                own,
                model.natural_frequencies,
                model.damping_ratios,
                model.clock,
                self.latency,
                self.clock_rate,
            )
            for own in (regression, from_rest)
        )
        freedom = with_motion.n_parameters - without.n_parameters
        moves = 2.0 * (without.cost - with_motion.cost) > chi_squared_isf(freedom, _IN_MOTION)
        return None if moves else end


def _log_power(fit: ModalFit) -> float:
    """Return the sum over outputs of the number of samples times the logarithm of what is left."""
    return sum(len(left) * math.log(max(float(left @ left), 1e-300)) for left in fit.residuals)
