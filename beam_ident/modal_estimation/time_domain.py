"""Identify a modal model from records, without hints.

The search (``mode_search``) works with equal weights; the last fit weighs every sample by the noise as it is.

Of a long record the search begins with a random choice of stamps.  What it finds there is fitted to everything, and
from there on a mode is tried only if everything promises, with all other poles held, that it is worth its parameters.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import (
    chosen_inputs,
    require_input,
    require_output,
    require_records,
)
from beam_ident.data.bandwidth import Band, excited_band
from beam_ident.data.batches import Progress
from beam_ident.data.own_clocks import OwnClock, middle_of, on_common_clock
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, is_after, possible_jumps, without_jumps
from beam_ident.errors import EstimationError, IdentificationError
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit, fitted_model
from beam_ident.modal.identification_result import IdentificationResult, OutputFit
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import MAX_LATENCY_S, ModalRegression
from beam_ident.modal.structure import ModalStructure, StructureKind, kinds_by_units
from beam_ident.modal_estimation.clock_search import (
    OwnClocks,
    clock_places,
    contradicting_clocks,
    out_of_phase,
    own_clock_columns,
    own_delays,
    own_rates,
)
from beam_ident.modal_estimation.free_base import NO_BODY, FrictionEstimate, with_kind_of
from beam_ident.modal_estimation.mode_gates import gain_warnings, mode_complaint, mode_warnings
from beam_ident.modal_estimation.mode_scan import Candidate, ModalScan
from beam_ident.modal_estimation.mode_search import (
    MANY_MODES,
    MAX_MODES,
    SHORT,
    ModeSearch,
    Stopped,
    Weighed,
    checked_limit,
    silent,
)
from beam_ident.modal_estimation.record_levels import (
    BridgeUncertainty,
    gap_sentences,
    record_levels,
    restart_priors,
    stamp_jitters,
    unweighed,
    weigh_records,
    without_outliers,
)
from beam_ident.modal_estimation.variable_projection import designs, fit_modes, held_cost
from beam_ident.modal_estimation.weighted_fit import WeightedFit
from beam_ident.noise.input_noise import Smoothing, input_noise_share, noise_grid
from beam_ident.noise.outliers import outlier_warning, outliers, spoiling
from beam_ident.noise.record_fit import RecordFit, in_units_of_level, pooled_scores
from beam_ident.noise.relation import innovation_criterion, without_drift
from beam_ident.noise.scores import Scores, ScoreTest, Whiteness, are_rounding, colour_warning
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.misfit_causes import bent_input_warning, misfit_warnings
from beam_ident.sensing.quantisation import rounding_warning, without_clipped
from beam_ident.sensing.stamp_jitter import is_any
from beam_ident.sensing.still_noise import StillNoise, found_noise_warning, with_found_noise

LATENCY_PRIOR = Prior(0.0, math.inf)
CLOCK_RATE_PRIOR = Prior(0.0, 50e-6)

_NEGLIGIBLE_SHARE = 3e-4  # of an output's noise variance: more from the input widens some interval by 4 %
_VISIBLE_SHARE = 0.01  # of an output's noise variance: from here on it is reported
_CLOCK_STARTS = 3
_CLOCK_SETTLED = 0.5  # standard deviations that the last turn may still move a clock of its own
_FAR_SD = 5.0  # standard deviations of a prior that are searched
_AT_THE_END = 0.98  # of the latencies that are searched
_TOO_LATE = (
    "The latency ends at {:.4g} s, where the search does, which looks {:g} s to either side: the stamps may be "
    "later, and the poles bent by that. Give what is known, as latency=Prior(0.5, 0.1)."
)
_OUTLIER_LOOKS = 3  # at records without the outliers seen so far
_LINEAR = 5e-3  # radians of the fastest mode: a step so small changes amplitudes by 1e-5
_MIN_SD = 1e-9, 1e-12  # of a latency [s], of a rate: what is known is known so well
_IDLE_CLOCK = 3.3  # standard deviations: an own clock that differs less from the common one is none
_CLOCK_TURNS = 3  # for every output: of clocks that outputs have of their own, and the modes that show them
_CLOCK_ROUNDS = 3
_ASKED = 3  # outputs by themselves, until one shows its modes without a doubt
_FAR_STARTS = 12  # crests that poles which were bent by a wrong clock are tried at
_GLANCE = 2  # iterations that sort them
_AS_GOOD = 10.0  # in log-likelihood: less than BIC charges for a mode
_BENT_LEVEL = 1e-3  # how often modes in phase with their input are taken not to be
_BENT_INPUT_LEVEL = 1e-5  # chance to call a sound input bent; of two outputs with one noise 1e-3
_RESTART_TURNS = 4  # of the gaps that matter, and the noise that says so
_JUMP_LEVEL = 1e-3  # how often a steady clock is taken to jump
_BEFORE = 1e-3  # of a stretch
_FEW = 1500  # stamps that tell a jump from lost samples
_LEFT_OUT_LEVEL = 1e-3  # how often motion at the beginning is warned of where there is none
_WORTH_A_LOOK = 1.0  # gain in log-likelihood
_IDLE_LEVEL = 1e-3  # an input that is less likely to do nothing is not said to
_IN_MOTION = 1e-3  # chance to call a record that begins at rest one that begins in motion
_MANY_STAMPS = 100_000  # of an output: from here on the search begins with some of them
_THINNED = 25_000  # of a record: so many
_CONTRADICTION = 4.0  # standard deviations: once in 16 000 records whose clock is as stated
_HOPE = 5.0  # times what a mode promises with all other poles held, it may gain at most


@on_one_thread
def identify(
    record: TimeRecord | Sequence[TimeRecord],
    structure: StructureKind | ModalStructure | None = None,
    n_modes: int | None = None,
    latency: Prior | Mapping[str, Prior | float] | None = None,
    clock_rate: Prior | Mapping[str, Prior | float] | None = None,
    input_name: str | Sequence[str] | None = None,
    max_modes: int = MAX_MODES,
    progress: Progress | None = None,
) -> IdentificationResult:
    """Identify a modal model with poles common to all outputs.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the model.  Every output weighs in each by the level, the colour
        and the outliers of its noise there; where noise on the input matters, by the level.  An input that is
        measured and states no ``sigma`` has that which its rest shows.
    structure : str, ModalStructure or None
        Which model goes with the input, or with every input; None goes by the units: "base_motion" for a hub position
        [m], and for a force [N] on what may be free or held whichever the data show, "force" or "receptance".
    n_modes : int or None
        Number of modes; None lets the Bayesian information criterion decide.
    latency, clock_rate : Prior, mapping or None
        Knowledge about the outputs' clock against the input's: latency [s] and relative
        rate.  ``Prior(mean, 0)`` fixes them, ``Prior(0, inf)`` leaves them to the data.
        None is an unknown latency and a rate of 0 +- 50 ppm, as of a camera beside an axis;
        for a receptance, mobility or accelerance, whose signals commonly share a clock, it is no error at all.
        A mapping from the names of some outputs to a Prior, or to a number that is known, is of their own clocks
        (a laser beside a camera); of what all others share it says nothing.
    input_name : str, sequence of str or None
        Which input, or which inputs together; None takes all that the records have.  Inputs share the poles and
        the clock; each has gains, residual terms, residues and a hold of its own (``ModalModel.path``).
    max_modes : int
        Bound on the modes tried when ``n_modes`` is None.
    progress : callable or None
        Called with a phrase and the share done, between 0 and 1.  A TimeoutError that it raises ends the
        estimation, as Ctrl-C does and too little memory: once there is a mode, the model so far is returned,
        not converged, and ``reason`` says what is missing.

    Returns
    -------
    IdentificationResult

    Raises
    ------
    EstimationError
        A record from which nothing can be identified: too few samples for the order,
        a constant output, an input and outputs at rest, an impossible order, no such input, no such output.
    """
    records = require_records(record, may_lack_outputs=True)
    drives = chosen_inputs(records[0], input_name)
    if structure is None:
        outputs = [output.unit for one in records for output in one.outputs]
        return with_kind_of(
            kinds_by_units([drive.unit for drive in drives], outputs),
            lambda kind: identify(
                records, kind, n_modes, latency, clock_rate, input_name, max_modes, progress
            ),
        )
    input_names = tuple(drive.name for drive in drives)
    terms = structure if isinstance(structure, ModalStructure) else ModalStructure(structure)
    checked_limit(n_modes, max_modes)
    names = list(dict.fromkeys(name for one in records for name in one.output_names))
    own_latencies, latency = _own_priors("latency", latency, names)
    if latency is not None and latency.mean and abs(latency.mean) + _FAR_SD * latency.sd > MAX_LATENCY_S:
        # A clock is looked for about 0, as far as the input is continued beyond its ends.
        near, about = [_earlier(one, latency.mean) for one in records], Prior(0.0, latency.sd)
        own = identify(near, structure, n_modes, about, clock_rate, input_name, max_modes, progress)
        return own.with_later_stamps(latency.mean)
    own_rates_known, clock_rate = _own_priors("clock_rate", clock_rate, names)
    if terms.is_test and any(_jumps_into(terms, own, input_names) for own in records):
        terms = replace(terms, has_residual=False)
    for one in records:
        for drive in chosen_inputs(one, input_names):
            require_input(drive, is_needed=False)
    records, found = with_found_noise(records, input_names)
    latency = latency or (Prior() if terms.is_test else LATENCY_PRIOR)
    clock_rate = clock_rate or (Prior() if terms.is_test else CLOCK_RATE_PRIOR)
    if not set(names) - set(own_latencies):  # nothing is left that could be in common
        latency = Prior()
    if not set(names) - set(own_rates_known):
        clock_rate = Prior()
    task = _Task(
        terms,
        may_rest=not isinstance(structure, ModalStructure) and not terms.is_motion,
        n_modes=n_modes,
        max_modes=max_modes,
        latency=latency,
        clock_rate=clock_rate,
        input_names=input_names,
        progress=progress or silent,
        found_noise=found,
        own_latencies=own_latencies,
        own_rates=own_rates_known,
    )
    result, said = without_clipped(records, names, task.result, _prediction)
    doubts = [said] if said else []
    if latency.is_free and abs(result.model.latency) > _AT_THE_END * MAX_LATENCY_S:
        doubts.append(_TOO_LATE.format(result.model.latency, MAX_LATENCY_S))
    doubts += [text for one in records for text in damage_warnings(one.outputs, one.inputs)]
    return replace(result, warnings=(*result.warnings, *doubts)) if doubts else result


@dataclass(frozen=True)
class _Task:
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

    def result(self, records: list[TimeRecord]) -> IdentificationResult:
        """Return what is found in some records, clocks that jump among them."""
        # Of several inputs one that is late moves a share of the outputs only.
        inputs = self.input_names if len(self.input_names) == 1 else ()
        places = [
            place for number, record in enumerate(records) for place in possible_jumps(record, number, inputs)
        ]
        jumps = self._jumps(records, places) if places else ()
        if jumps:
            with contextlib.suppress(EstimationError):
                found = self._seen_past_outliers(records, jumps)
                needed = math.sqrt(chi_squared_isf(1, _JUMP_LEVEL))
                if all(abs(jump.size_s) > needed * jump.size_sd for jump in found.clock_jumps):
                    return found
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

        The longest stretch of every record in which none can jump shows the model.  From there the likelihood of the
        whole says for each place how many samples were lost, and what is left for a jump.
        """
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
        places = list(places)
        while places:
            tried = [known, *((*known, jump) for place in places for jump in place)]
            costs = np.array([self._cost(records, jumps, model, stretches[0][0]) for jumps in tried])
            best = int(np.argmin(costs))
            if not 2.0 * (costs[0] - costs[best]) > chi_squared_isf(1, _JUMP_LEVEL / len(tried)):
                break
            known = tried[best]
            places = [place for place in places if known[-1] not in place]
        return known

    def _plain_model(self, records: list[TimeRecord]) -> ModalModel:
        """Return what a search with equal weights finds, in a fraction of the time of an outcome."""
        regression = ModalRegression(records, self.terms, self.input_names)
        _refuse_hopeless(regression, self.n_modes)
        search = self._begun(records, regression)
        try:
            fit = search.begun(self.n_modes, self.max_modes).fit
        except OwnClocks:
            return self._outcome(records, ()).model
        if not len(fit.omegas):
            raise EstimationError("no mode was found: expected one at least. Record longer, or excite more")
        return search._model(fit)

    def _cost(
        self, records: list[TimeRecord], jumps: tuple[ClockJump, ...], model: ModalModel, seen_s: float
    ) -> float:
        """Return what a model of a stretch that begins at ``seen_s`` costs where clocks jump, refined a little."""
        steady = [without_jumps(own, number, jumps) for number, own in enumerate(records)]
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
        clocks = self._known_clocks(measured)
        has_asked = False  # every output by itself
        known: tuple[_TimeSearch, Weighed[ModalRegression]] | None = None
        most = _CLOCK_TURNS * len(records[0].outputs)
        for turn in range(most):
            shifted = [on_common_clock(one, clocks) for one in measured]
            try:
                regression = ModalRegression(shifted, self.terms, self.input_names)
                _refuse_hopeless(regression, self.n_modes)
                search = self._begun(shifted, regression, clocks=clocks, jumps=jumps)
                search.is_in_doubt = has_asked
                if turn == 0 and (result := self._untangled(regression, search)) is not None:
                    return result
                try:
                    search, weighed = self._finished(search, regression)
                except EstimationError as err:
                    gaps = gap_sentences(search.plain)
                    if not gaps:
                        raise
                    raise EstimationError(f"{err}. {' '.join(gaps)}") from err
                if search.stopped_by is not None and known is not None:
                    raise search.stopped_by
                known = search, weighed
                goes_on = search.stopped_by is None and turn + 1 < most
                further = search.further_clocks(weighed) if goes_on else {}
            except OwnClocks as own:
                clocks, has_asked = own.clocks, True
                continue
            except Stopped as stop:
                if known is None:
                    raise
                search, weighed = known
                missing = "a further look for clocks that outputs have of their own"
                weighed, further = search.unfinished(weighed, stop, missing), {}
            if not further:
                idle = search.idle_clocks(weighed) if goes_on else []
                if not idle:
                    break
                clocks = {name: own for name, own in clocks.items() if name not in idle}
            clocks |= {
                name: clocks.get(name, OwnClock()).moved(own.delay, own.rate) for name, own in further.items()
            }
        return search.result(weighed, self.n_modes)

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
    ) -> _TimeSearch:
        is_long = max(len(times) for times in regression.times) > _MANY_STAMPS
        first = regression.thinned(_THINNED) if is_long else regression
        return _TimeSearch(
            records,
            first,
            self.latency,
            self.clock_rate,
            self.input_names,
            self.progress,
            highest_hz,
            clocks,
            found_noise=self.found_noise,
            jumps=jumps,
            known=(self.own_latencies, self.own_rates),
        )

    def _finished(
        self, search: _TimeSearch, regression: ModalRegression
    ) -> tuple[_TimeSearch, Weighed[ModalRegression]]:
        if search.plain is regression:
            return search, search.run(self.n_modes, self.max_modes)
        few = search.begun(self.n_modes, self.max_modes)
        if search.stopped_by is not None:
            return search, few
        try:
            following = _LongSearch(regression, search)
        except Stopped as stop:
            if not len(search.chosen.omegas):
                raise
            missing = f"the fit to more than {_THINNED} stamps of a record, and the weighing by the noise"
            return search, search.ended_early(search.chosen, stop, missing)
        return following, following.run(self.n_modes, self.max_modes)

    def _untangled(self, regression: ModalRegression, search: _TimeSearch) -> IdentificationResult | None:
        """Return the result from rest where a blow at the beginning is not told from motion that was there before."""
        if not (self.may_rest and search.band.is_excited and search.scan.is_tangled):
            return None
        # Of a decay alone, samples do not tell a frequency from its aliases: the lowest is meant.
        records = search.records
        still = ModalRegression(records, replace(self.terms, has_free_response=False), self.input_names)
        try:
            begun = self._begun(records, still, 0.5 * regression.rate_hz, search.clocks, search.jumps)
            from_rest, weighed = self._finished(begun, still)
            result = from_rest.result(weighed, self.n_modes)
        except EstimationError:
            return None  # a record that begins in motion may not fit at all
        clocks = self.latency, self.clock_rate
        return None if _begins_in_motion(regression, still, result.model, clocks) else result


def _earlier(record: TimeRecord, by_s: float) -> TimeRecord:
    """Return a record whose outputs' stamps are earlier by a time [s]."""
    return replace(record, outputs=tuple(replace(o, times_s=o.times_s - by_s) for o in record.outputs))


def _own_priors(
    what: str, given: Prior | Mapping[str, Prior | float] | None, names: Sequence[str]
) -> tuple[dict[str, Prior], Prior | None]:
    """Return what is known of single outputs, by name, and of the clock in common."""
    if given is None or isinstance(given, Prior):
        return {}, given
    if not isinstance(given, Mapping):
        raise EstimationError(
            f"{what} is {given!r}; expected a Prior, as Prior({given!r}) for a known one, or a mapping from names of "
            "outputs to such"
        )
    strangers = [name for name in given if name not in names]
    if strangers:
        raise EstimationError(
            f"{what} names {', '.join(map(repr, strangers))}, and the records have the outputs {', '.join(names)}; "
            "expected names of outputs"
        )
    found = {}
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, Prior | float | int):
            raise EstimationError(f"{what} of {name} is {value!r}; expected a number or a Prior")
        prior = value if isinstance(value, Prior) else Prior(float(value))
        if prior.sd < math.inf:  # else the data find it by themselves
            found[name] = prior
    return found, None


def _prediction(result: IdentificationResult, record: TimeRecord, name: str) -> FloatArray:
    """Return what a model says at the stamps of an output, from rest and with an offset; NaN outside the input."""
    model = result.model
    drives, output = chosen_inputs(record, model.input_names), record.output(name)
    first, last = max(drive.span_s[0] for drive in drives), min(drive.span_s[1] for drive in drives)
    late = model.latency + float(model.output_delays[model.output_names.index(name)])
    inside = output.is_within(first + max(late, 0.0), last + min(late, 0.0))
    said = np.full(len(inside), np.nan)
    if np.any(inside):
        simulated = model.simulate(drives, output.times_s[inside] - late, output.exposure_s)
        said[inside] = simulated[:, model.output_names.index(name)]
        said += float(np.nanmedian(output.values - said))
    return said


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


class _TimeSearch(ModeSearch[ModalRegression]):
    """The search in records of an input and outputs."""

    trial_iterations = 20  # each takes its time, and a mode that is really there needs about six

    def __init__(
        self,
        records: list[TimeRecord],
        regression: ModalRegression,
        latency: Prior,
        clock_rate: Prior,
        input_names: tuple[str, ...],
        progress: Progress,
        highest_hz: float = math.inf,
        clocks: Mapping[str, OwnClock] = MappingProxyType({}),
        scan: ModalScan | None = None,
        start: ModalFit | None = None,
        found_noise: Mapping[int, StillNoise] = MappingProxyType({}),
        jumps: Sequence[ClockJump] = (),
        known: tuple[Mapping[str, Prior], Mapping[str, Prior]] = ({}, {}),
    ) -> None:
        self.known = known  # of latency and clock rate of single outputs
        self.is_in_doubt = False  # since a mode that explains much was not believed
        self.clocks, self.found_noise, self.jumps = clocks, found_noise, tuple(jumps)
        self.records, self.input_names = records, input_names
        self.bridges: BridgeUncertainty | None = None
        self._samples: tuple[ModalFit, _Samples] | None = None
        structure = regression.structure
        if scan is None:
            band = _common_band(regression, highest_hz)
            scan = ModalScan(records, structure, input_names, band, regression.restarts)
        self.scan, band = scan, scan.band
        if not band.is_excited:  # without an input there are no two clocks to compare
            latency, clock_rate = Prior(latency.mean), Prior(clock_rate.mean)
        super().__init__(regression, band, latency, clock_rate, structure.is_motion, progress, start)

    def propose(self, fit: ModalFit, excluded: Sequence[float]) -> list[Candidate]:
        """Return the best place over the input's band, refined."""
        found = self.scan.propose(fit, excluded)
        return [] if found is None else [found]

    def untangled(self, fit: ModalFit) -> ModalFit:
        """Return the fit after a look for cycles that the clock may have slipped.

        What promises a higher likelihood on thinned data is fitted there, and then on all of it.
        """
        if len(fit.omegas) > MANY_MODES:
            return fit
        thinned = self.scan.regression
        priors = self.latency, self.clock_rate
        for _ in range(_CLOCK_ROUNDS):
            places = clock_places(thinned, fit, *priors, _CLOCK_STARTS)
            places = [place for place in places if place.gain > _WORTH_A_LOOK]
            if not places:
                return fit
            here = fit_modes(thinned, fit.omegas, fit.zetas, fit.clock, *priors, SHORT)
            starts = [fit_modes(thinned, fit.omegas, fit.zetas, p.clock, *priors, SHORT) for p in places]
            start = min(starts, key=lambda start: start.cost)
            if not start.cost < here.cost - _WORTH_A_LOOK:
                return fit
            again = self.fit(start.omegas, start.zetas, start.clock)
            if not again.cost < fit.cost:
                return fit
            fit = again
        return fit

    def retimed(self, fit: ModalFit) -> list[ModalFit]:
        """Return the modes of a fit at clocks far from its own that explain more.

        Notes
        -----
        A clock that is cycles away turns the phase of every mode, and the poles bend until as little as possible of
        that is seen: with them held, no other clock promises more. But a part a quarter of a cycle out of phase
        remains, which residues cannot have: a score test for it decides whether poles are fitted at other crests.
        """
        thinned, priors = self.scan.regression, (self.latency, self.clock_rate)
        if not self.latency.is_free or not self.band.is_excited or not len(fit.omegas):
            return []
        here = fit_modes(thinned, fit.omegas, fit.zetas, fit.clock, *priors, SHORT)
        if out_of_phase(thinned, here, *priors).p_value > _BENT_LEVEL:
            return []
        places = clock_places(thinned, here, *priors, _FAR_STARTS)
        starts = [fit_modes(thinned, fit.omegas, fit.zetas, p.clock, *priors, _GLANCE) for p in places]
        starts = sorted(starts, key=lambda start: start.cost)[:_CLOCK_STARTS]
        starts = [fit_modes(thinned, s.omegas, s.zetas, s.clock, *priors, SHORT) for s in starts]
        least = min(start.cost for start in starts)
        if not least < here.cost - _WORTH_A_LOOK:
            return []
        # Modes too many make up for what is wrong with a clock: those that need fewer are to be seen, too.
        near = [start for start in starts if start.cost < least + _AS_GOOD]
        again = [self.fit(start.omegas, start.zetas, start.clock) for start in near]
        return [own for own in again if own.cost < fit.cost]

    def is_promising(self, fit: ModalFit) -> bool:
        """Return whether modes that are still to be refined explain more than noise without an input would."""
        return len(self.plain.pieces) > 1 or not self._unrelated(unweighed(self.problem, fit))

    def body_alone(self) -> ModalFit | None:
        """Return a fit without modes whose outputs follow a rigid body under a force, beyond what noise does.

        Where no mode is seen, none is left out: there is no residual term, which would jump with a held force.
        """
        structure = replace(self.plain.structure, has_residual=False)
        if not structure.has_direct or structure.is_motion or not self.band.is_excited:
            return None
        before = self.problem, self.plain
        self.problem = self.plain = ModalRegression(
            self.records, structure, self.input_names, restarts=before[1].restarts
        )
        none = np.empty(0)
        fit = fit_modes(self.problem, none, none, self.chosen.clock, self.latency, self.clock_rate)
        seen = fit.converged and self._model(fit).no_body_p_value() < NO_BODY
        if seen and not self._unrelated(unweighed(self.problem, fit)):
            return fit
        self.problem, self.plain = before
        return None

    def inside(self, n_modes: int) -> Iterator[ModalFit]:
        """Yield what is found without initial motion, ramp or offset, where the fit or a mode of it is in doubt.

        A long record is not searched again: a start of some of its stamps has served it already.
        """
        regression, fit = self.plain, self.chosen
        is_long = len(regression.pieces) > 1 or max(map(len, regression.times)) > _THINNED
        doubts = [mode_complaint(fit, regression, mode, self.band) for mode in range(n_modes)]
        # Outliers are the likelier cause of doubts, and are looked after by themselves.
        is_long = is_long or any(spoiling(left, outliers(left)) for left in fit.residuals)
        if is_long or (fit.converged and not any(doubts)):
            return
        form = regression.structure
        simpler = [replace(form, has_free_response=False)] * form.has_free_response
        simpler += [replace(form, has_ramp=False)] * form.has_ramp
        simpler += [replace(form, has_offset=False)] * form.has_offset
        for structure in simpler:
            smaller = ModalRegression(self.records, structure, self.input_names, restarts=regression.restarts)
            search = _TimeSearch(
                self.records, smaller, self.latency, self.clock_rate, self.input_names, self.progress
            )
            search.run_plain(n_modes)
            yield search.chosen

    def doubt(self) -> None:
        """Ask every output by itself when it was measured, and begin anew where they do not agree.

        Raises
        ------
        OwnClocks
            Some outputs have a clock of their own.
        """
        may_ask, self.is_in_doubt = not (self.is_in_doubt or self.clocks or self.is_trusting), True
        if not may_ask or self.plain.n_outputs < 2 or not self.band.is_excited:
            return
        searches = [own for name in self.plain.output_names if (own := self._alone(name)) is not None]
        most = len(self._believed[0].omegas)
        for reference in searches[:_ASKED]:
            reference._extend(None, MANY_MODES)
            # One that shows less than others have is no judge of clocks: the modes that it misses bend its own.
            most, shown = max(most, len(reference.chosen.omegas)), len(reference.chosen.omegas)
            if 0 < shown == most and not reference.is_in_doubt:
                break
        else:
            return
        known, fits = reference.chosen, {}
        for search in searches:
            fit = known
            if search is not reference:
                fit = search.untangled(search.fit(known.omegas, known.zetas, known.clock))
            if fit.converged:
                fits[search.plain.output_names[0]] = fit
        if clocks := contradicting_clocks(fits):
            raise OwnClocks(self._refined(clocks, known))

    def _refined(self, clocks: Mapping[str, OwnClock], modes: ModalFit) -> dict[str, OwnClock]:
        """Return clocks of outputs by themselves as all outputs together say, with modes that one of them shows."""
        found = dict(clocks)
        for _ in range(_CLOCK_TURNS):
            records = [on_common_clock(one, found) for one in self.records]
            regression = ModalRegression(records, self.plain.structure, self.input_names)
            if max(map(len, regression.times)) > _THINNED:
                regression = regression.thinned(_THINNED)
            search = _TimeSearch(
                records,
                regression,
                self.latency,
                self.clock_rate,
                self.input_names,
                self.progress,
                clocks=found,
                scan=self.scan,
                start=modes,
            )
            search.problem = search.plain = search._with_own_clocks(regression, search.chosen)
            modes = search.fit(search.chosen.omegas, search.chosen.zetas, search.chosen.clock)
            for j, name in enumerate(regression.output_names):
                if name in found:
                    found[name] = found[name].moved(*search._own_clock(j, modes)[0])
        return found

    def _alone(self, name: str) -> _TimeSearch | None:
        """Return a search that ends at the first doubt, for one output and its own latency; None without data."""
        records = [one.select([name]) for one in self.records if name in one.output_names]
        latency = self.latency if self.latency.is_free else Prior(self.latency.mean, math.inf)
        try:
            regression = ModalRegression(records, self.plain.structure, self.input_names)
        except EstimationError:
            return None
        if max(map(len, regression.times)) > _THINNED:
            regression = regression.thinned(_THINNED)
        search = _TimeSearch(records, regression, latency, self.clock_rate, self.input_names, self.progress)
        search.is_trusting = True
        return search

    def run_plain(self, n_modes: int) -> None:
        """Search for as many modes with equal weights, and nowhere else."""
        self._extend_anew(n_modes, n_modes, self._extend(n_modes, n_modes))

    def begun(self, n_modes: int | None, max_modes: int) -> Weighed[ModalRegression]:
        """Search with equal weights, and return what was found, be it nothing."""
        with contextlib.suppress(EstimationError):
            return self.run(n_modes, max_modes, is_weighed=False)
        return Weighed(self.chosen, self.plain, self.problem)

    def ended_early(self, fit: ModalFit, stop: BaseException, missing: str) -> Weighed[ModalRegression]:
        """Return a fit with equal weights as the best there is."""
        as_measured = unweighed(self.problem, fit)
        return self.unfinished(Weighed(as_measured, self.plain, self.problem), stop, missing)

    def reweigh(self) -> None:
        """Let records weigh by what the present model leaves: a loud one hides what a quiet one shows."""
        if len(self.records) == 1:
            return
        levels = record_levels(self.problem, self.chosen)
        self.problem = self.plain.weighed(levels)
        self.scan.weigh(levels)
        self.chosen = self.fit(self.chosen.omegas, self.chosen.zetas, self.chosen.clock)

    def weighed(self, fit: ModalFit) -> Weighed[ModalRegression]:
        """Return a fit with equal weights, weighed by the colour of the outputs' noise or by that of the input."""
        fit, self.problem = unweighed(self.problem, fit), self.plain
        fit = self._restarted(fit)
        if self.clocks or self.jumps:
            self.problem = self.plain = self._with_own_clocks(self.plain, fit)
            fit = self.fit(fit.omegas, fit.zetas, fit.clock)
            if self.bridges is not None:  # which gaps are bridged is decided; there are more parameters now
                self.bridges = BridgeUncertainty.of(self.plain, fit, self.latency, self.clock_rate, math.inf)
        regression = self.plain
        model = self._model(fit)
        smoothing = None
        shares = [_noise_shares(model.path(drive.name), drive) for drive in regression.drives]
        self._release()
        is_noisy = bool(np.max(shares) > _NEGLIGIBLE_SHARE)
        is_weighable = regression.n_forced == 1 and self.band.is_excited
        if is_weighable and (is_noisy or is_any(stamp_jitters(regression, fit))):
            # Where only the stamps scatter the input is taken as it is.
            smoothing = Smoothing(self.band.high_hz if is_noisy else math.inf)
            regression = ModalRegression(
                self.records, regression.structure, self.input_names, smoothing, regression.restarts
            )
            if self.clocks or self.jumps:
                regression = self._with_own_clocks(regression, fit)
            fit = fit_modes(regression, fit.omegas, fit.zetas, fit.clock, self.latency, self.clock_rate)
        by_record = regression
        if smoothing is None:
            by_record, fit = weigh_records(regression, fit, self.latency, self.clock_rate)
        priors = self._clock_priors(fit)
        if self.bridges is not None:
            priors += [((place,), 0.0, sd) for place, sd in restart_priors(by_record, fit)]
        jitters = stamp_jitters(regression, fit) if smoothing is not None else ()
        weighted = WeightedFit(
            self.records, by_record, fit, self.latency, self.clock_rate, smoothing, priors, jitters
        )
        found = unweighed(by_record, weighted.result())
        if is_any(jitters):
            shares = [_noise_shares(model, drive, smoothing) for drive in regression.drives]
            found = replace(found, input_noise_shares=is_noisy * np.max(shares, axis=0))
        if self.bridges is not None:
            found = replace(found, covariance=found.covariance + self.bridges.covariance)
        return Weighed(found, regression, by_record)

    def further_clocks(self, weighed: Weighed[ModalRegression]) -> dict[str, OwnClock]:
        """Return what is to be added to the clocks that outputs have of their own, by name."""
        if not self.band.is_excited:
            return {}
        fit, regression = weighed.fit, weighed.problem
        names = regression.output_names
        late = [j for j, name in enumerate(names) if name in self.clocks]
        running = [j for j in late if self.clocks[names[j]].runs]
        found: dict[str, OwnClock] = {}
        if len(names) > 1:
            some = self._looked_at(fit, regression)
            by_delay, by_rate = zip(*own_clock_columns(some.regression, some.fit), strict=True)
            present = some.regression, some.fit, some.designs
            for j, delay in own_delays(*present, by_delay, self.latency, late).items():
                found[names[j]] = OwnClock(delay)
            rates = {} if found else own_rates(*present, by_rate, self.clock_rate, running)
            for j, rate in rates.items():
                found[names[j]] = OwnClock(0.0, rate, True)
        for j in late:
            values, sds = self._own_clock(j, fit)
            turns = fit.omegas[-1] * np.abs(values) * [1.0, 0.5 * regression.duration_s]
            if np.any((np.abs(values) > _CLOCK_SETTLED * sds) & (turns > _LINEAR)):
                rate = found.get(names[j], OwnClock()).rate
                found[names[j]] = OwnClock(float(values[0]), float(values[1]) + rate)
        return found

    def idle_clocks(self, weighed: Weighed[ModalRegression]) -> list[str]:
        """Return the outputs whose own clock does not differ from that of the others after all."""
        names = weighed.problem.output_names
        found = []
        stated = {*self.known[0], *self.known[1]}
        for name, own in self.clocks.items():
            if name in stated:
                continue
            values, sds = self._own_clock(names.index(name), weighed.fit)
            values += np.array([own.delay, own.rate])
            if np.all(np.abs(values) <= _IDLE_CLOCK * sds):
                found.append(name)
        return found

    def _looked_at(self, fit: ModalFit, regression: ModalRegression) -> _Samples:
        """Return what tests need of a fit, made once for all of them."""
        if self._samples is None or self._samples[0] is not fit:
            self._samples = fit, _Samples.of(regression, fit, self.latency, self.clock_rate)
        return self._samples[1]

    def _with_own_clocks(self, regression: ModalRegression, fit: ModalFit) -> ModalRegression:
        """Return a regression that knows own clocks of some outputs, and jumps of clocks, to be estimates."""
        slopes, columns = own_clock_columns(regression, fit), {}
        for j, (name, (by_delay, by_rate)) in enumerate(zip(regression.output_names, slopes, strict=True)):
            own = [by_delay, by_rate][: self._n_of_clock(name)]
            own += [by_delay * after for after in self._after_jumps(j, regression)]
            if own:
                columns[j] = np.stack(own, axis=1)
        return regression.with_own_columns(columns)

    def _n_of_clock(self, name: str) -> int:
        """Return how many parameters the own clock of an output has: none, a delay, or a delay and a rate."""
        return 1 + int(self.clocks[name].runs) if name in self.clocks else 0

    def _after_jumps(self, output: int, regression: ModalRegression) -> list[FloatArray]:
        """Return where the stamps of an output are late for each jump that it sees; -1 where they are early."""
        name, times = regression.output_names[output], regression.times[output]
        found = []
        for jump in self._jumps_of(name):
            # Jumps stand at stamps of the output's own clock.
            own = self.clocks.get(name, OwnClock())
            stamps = own.stamped(times, middle_of(self.records[jump.record]))
            after = is_after(jump, self.jumps, stamps)
            record = np.zeros_like(after)
            for number, part in regression.segments[output]:
                record[part] = float(number == jump.record)
            found.append(after * record * (1.0 if name in jump.signals else -1.0))
        return found

    def _jumps_of(self, name: str) -> list[ClockJump]:
        """Return the jumps that an output sees: of its own stamps, and of the input's."""
        inputs = {drive.name for drive in self.plain.drives}
        return [jump for jump in self.jumps if name in jump.signals or inputs.intersection(jump.signals)]

    def _own_places(self, output: int, fit: ModalFit) -> list[int]:
        """Return where among all parameters those of an output's own clock are: delay, then jumps."""
        name = self.plain.output_names[output]
        count = self._n_of_clock(name) + len(self._jumps_of(name))
        end = fit.n_theta + sum(len(found) for found in fit.coefficients[: output + 1])
        return list(range(end - count, end))

    def _own_clock(self, output: int, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """Return what an output's own delay [s] and rate are beyond what its stamps were corrected by, and sd."""
        places = self._own_places(output, fit)
        n = self._n_of_clock(self.plain.output_names[output])
        values, sds = np.zeros(2), np.zeros(2)
        values[:n] = fit.coefficients[output][-len(places) :][:n]
        sds[:n] = np.sqrt(np.maximum(np.diag(fit.covariance)[places[:n]], 0.0))
        return values, sds

    def _clock_priors(self, fit: ModalFit) -> list[tuple[tuple[int, ...], float, float]]:
        """Return what is known of the latencies and rates of single outputs: common and own part together."""
        found = []
        commons = (self.latency, self.clock_rate)
        place = 2 * len(fit.omegas)
        for kind, (known, common, least) in enumerate(zip(self.known, commons, _MIN_SD, strict=True)):
            shared = (place,) if common.is_free else ()
            place += len(shared)
            for name, prior in known.items():
                own, clock = self._own_places(self.plain.output_names.index(name), fit), self.clocks[name]
                corrected = (clock.delay, clock.rate)[kind] + (0.0 if common.is_free else common.mean)
                found.append(((*shared, own[kind]), prior.mean - corrected, max(prior.sd, least)))
        return found

    def _estimated_jumps(self, fit: ModalFit) -> tuple[ClockJump, ...]:
        """Return the jumps as what the outputs that see them say together."""
        found = []
        names = self.plain.output_names
        for jump in self.jumps:
            places, values = [], []
            for j, name in enumerate(names):
                seen = self._jumps_of(name)
                if jump not in seen:
                    continue
                own = self._own_places(j, fit)[-len(seen) :]
                places.append(own[seen.index(jump)])
                values.append(float(fit.coefficients[j][seen.index(jump) - len(seen)]))
            covariance = fit.covariance[np.ix_(places, places)]
            scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            weights = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-9, hermitian=True)
            weights = weights / np.outer(scale, scale)
            total = max(float(np.sum(weights)), 1e-300)
            further = float(np.sum(weights @ np.array(values))) / total
            found.append(replace(jump, size_s=jump.size_s + further, size_sd=total**-0.5))
        return tuple(found)

    def _restarted(self, fit: ModalFit) -> ModalFit:
        """Return the fit with the modes beginning anew at those gaps of the inputs where that is needed.

        Its noise decides, and the gaps that are bridged badly are in its noise: both take turns.
        """
        if self.plain.n_forced > 1 or not any(drive.gaps for drive in self.plain.drives):
            return fit
        for _ in range(_RESTART_TURNS):
            plain = self.plain
            self.bridges = BridgeUncertainty.of(plain, fit, self.latency, self.clock_rate)
            if self.bridges.restarts.is_near(plain.restarts):
                break
            self.problem = self.plain = ModalRegression(
                self.records, plain.structure, self.input_names, restarts=self.bridges.restarts
            )
            fit = self.fit(fit.omegas, fit.zetas, fit.clock)
        return fit

    def _release(self) -> None:
        """Let go of the signals of a long input that the weighing does not need."""
        if len(self.plain.pieces) > 1:
            for regression in (self.plain, self.scan.regression):
                regression.release()

    def _model(self, fit: ModalFit) -> ModalModel:
        regression = self.plain
        clock_is_free = self.latency.is_free, self.clock_rate.is_free
        names = regression.input_names
        return fitted_model(fit, regression.structure, names, regression.output_names, clock_is_free)

    def _clocked(self, model: ModalModel, fit: ModalFit) -> ModalModel:
        """Return the model with the clocks that outputs have of their own."""
        values, sds = np.zeros((len(fit.coefficients), 2)), np.zeros((len(fit.coefficients), 2))
        for j, name in enumerate(model.output_names):
            if (own := self.clocks.get(name)) is not None:
                further, sds[j] = self._own_clock(j, fit)
                values[j] = np.array([own.delay, own.rate]) + further
        return replace(
            model,
            output_delays=values[:, 0],
            output_delay_sd=sds[:, 0],
            output_rates=values[:, 1],
            output_rate_sd=sds[:, 1],
        )

    def result(self, weighed: Weighed[ModalRegression], n_modes: int | None) -> IdentificationResult:
        """Return what was found."""
        fit, regression = weighed.fit, weighed.problem
        unrelated = self._unrelated(fit)
        if unrelated and n_modes is None:
            raise EstimationError(
                f"{unrelated}. Check that input and outputs belong together and share a clock, excite more, or ask "
                "for a number of modes to see the best candidates"
            )
        model, jumps = self._clocked(self._model(fit), fit), self._estimated_jumps(fit)
        with contextlib.suppress(TimeoutError):  # what is found is returned, however late
            self.progress("done", 1.0)
        rigid = [self._rigid(j, fit, regression) for j in range(regression.n_outputs)]
        deflections = residuals_of(regression, fit.omegas, fit.zetas, fit.clock, rigid)
        outputs = tuple(
            self._output_fit(j, fit, regression, deflections[j], weighed.by_record.row_levels(j))
            for j in range(regression.n_outputs)
        )
        return IdentificationResult(
            model=model,
            structure=regression.structure,
            outputs=outputs,
            orders=self.orders,
            band=self.band,
            converged=fit.converged,
            reason=fit.reason,
            iterations=fit.iterations,
            warnings=tuple(
                [f"{unrelated}."] * bool(unrelated)
                + [_clock_sentence(name, own) for name, own in model.own_clocks.items()]
                + [jump.sentence for jump in jumps]
                + self._gain_warnings(model)
                + self._input_warnings(model)
                + self._warnings(fit, regression, outputs)
            ),
            doubts=tuple(mode_complaint(fit, regression, mode, self.band) for mode in range(len(fit.omegas))),
            clock_jumps=jumps,
        )

    def _gain_warnings(self, model: ModalModel) -> list[str]:
        if not (self.band.is_excited and self.plain.structure.is_motion) or self.plain.n_forced > 1:
            return []
        return gain_warnings(model.gains, model.gain_sd, model.output_names)

    def _input_warnings(self, model: ModalModel) -> list[str]:
        """Return what must be known of inputs that act together: one that does nothing, and noise on them."""
        if self.plain.n_forced == 1 or not self.band.is_excited:
            return []
        warnings = []
        for path in model.paths:
            p_value = path.nothing_p_value()
            if p_value > _IDLE_LEVEL:
                warnings.append(
                    f"Nothing that the outputs do is seen to come from input {path.input_name} (p = {p_value:.2g}); "
                    "without it, input_name of the others, the rest is known better."
                )
            drives = [drive for drive in self.plain.drives if drive.name == path.input_name]
            share = max(float(np.max(_noise_shares(path, drive))) for drive in drives)
            if share > _VISIBLE_SHARE:
                warnings.append(
                    f"Noise on input {path.input_name} makes up {share:.0%} of the noise variance of an output. "
                    "With several inputs it is not weighed: estimates may be biased, and standard deviations do "
                    "not include it."
                )
        return warnings

    def _unrelated(self, fit: ModalFit) -> str:
        """Return that modes explain no more of the outputs than noise of any colour would, or an empty string."""
        if not self.band.is_excited:
            return ""
        regression, terms = self.plain, self.plain.structure
        log_n = math.log(regression.n_samples)
        parts = [(j, part) for j, segments in enumerate(regression.segments) for _, part in segments]
        base = self.without_modes
        # Direct terms that were fitted as if noise were white may themselves make it look less predictable.
        measured = [(regression.times[j][part], regression.values[j][part]) for j, part in parts]
        drifts = (int(terms.has_offset) + int(terms.has_ramp)) * len(parts)
        without = (
            innovation_criterion(without_drift(measured, terms.has_offset, terms.has_ramp)) + drifts * log_n
        )
        if len(fit.omegas):
            direct = innovation_criterion([base.residuals[j][part] for j, part in parts])
            without = min(without, direct + base.n_parameters * log_n)
        with_modes = innovation_criterion([fit.residuals[j][part] for j, part in parts])
        are_exact = all(are_rounding(v, e) for v, e in zip(regression.values, fit.residuals, strict=True))
        if are_exact or with_modes + fit.n_parameters * log_n < without:
            return ""
        drives = ", ".join(map(repr, regression.input_names))
        return f"the modes driven by {drives} explain no more than chance would: BIC prefers noise without an input"

    def _starts(self, j: int, fit: ModalFit, regression: ModalRegression) -> list[int]:
        """Return where among an output's parameters those begin that belong to each of its records alone."""
        n = len(fit.omegas)
        first, n_own = regression.n_shared(n), regression.n_nuisance(n)
        return [first + n_own * k for k in range(len(regression.segments[j]))]

    def _rigid(self, j: int, fit: ModalFit, regression: ModalRegression) -> FloatArray:
        """Return an output's parameters with all zero but direct gains, offsets and ramps."""
        structure, found = regression.structure, fit.coefficients[j]
        rigid = np.zeros_like(found)
        if structure.has_direct:
            direct = slice(0, regression.n_shared_fixed, regression.n_fixed_of_input)
            rigid[direct] = found[direct]
        n_plain = int(structure.has_offset) + int(structure.has_ramp)
        for own in self._starts(j, fit, regression):
            rigid[own : own + n_plain] = found[own : own + n_plain]
        for _, place, _ in regression.restart_places(len(fit.omegas), j):
            drifts = slice(place, place + regression.restarts.n_drifts)
            rigid[drifts] = found[drifts]
        return rigid

    def _output_fit(
        self, j: int, fit: ModalFit, regression: ModalRegression, deflection: FloatArray, levels: FloatArray
    ) -> OutputFit:
        structure, found = regression.structure, fit.coefficients[j]
        starts = self._starts(j, fit, regression)
        values, residuals = regression.values[j], fit.residuals[j]
        noise_sd = float(fit.sigmas[j]) * levels / math.sqrt(float(np.mean(np.square(levels))))
        noises = fit.noises[j] if fit.noises else ("",) * len(starts)
        spread = fit.spreads[j] if fit.spreads else np.ones(len(values))
        records = tuple(
            RecordFit(
                name=self.records[index].name,
                times_s=regression.times[j][part],
                measured=values[part],
                modelled=values[part] - residuals[part],
                residuals=residuals[part],
                noise_sd=float(noise_sd[part.start]),
                scores=Scores.of(values[part], residuals[part]),
                whiteness=Whiteness.of(residuals[part] / spread[part]),
                offset=float(found[own]) if structure.has_offset else 0.0,
                ramp=float(found[own + int(structure.has_offset)]) if structure.has_ramp else 0.0,
                noise=noise,
                spread=spread[part],
            )
            for (index, part), own, noise in zip(regression.segments[j], starts, noises, strict=True)
        )
        parts = [part for _, part in regression.segments[j]]
        return OutputFit(
            name=regression.output_names[j],
            unit=regression.units[j],
            times_s=regression.times[j],
            measured=values,
            modelled=values - residuals,
            residuals=residuals,
            deflection=deflection,
            noise_sd=float(fit.sigmas[j]),
            scores=pooled_scores([(values[part], residuals[part]) for part in parts]),
            deflection_scores=pooled_scores([(deflection[part], residuals[part]) for part in parts]),
            whiteness=Whiteness.of(in_units_of_level([(residuals / spread)[part] for part in parts])),
            offset=records[0].offset,
            ramp=records[0].ramp,
            records=records,
        )

    def _left_out_motion(self, fit: ModalFit, regression: ModalRegression) -> list[str]:
        """Return what is to be said where motion at the beginning was left out by request, and is there."""
        some = self._looked_at(fit, regression)
        columns = some.regression.initial_motions(fit.omegas, fit.zetas, fit.clock)
        tested = zip(columns, some.designs, some.fit.residuals, some.regression.values, strict=True)
        p_value = ScoreTest.of(tested).p_value
        if p_value > _LEFT_OUT_LEVEL:
            return []
        return [
            f"The record began in motion (p = {p_value:.1g}), and the structure leaves that out: poles and damping "
            "ratios are biased. Leave has_free_response as it is by default."
        ]

    def _warnings(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        warnings = mode_warnings(fit, regression, self.band)
        warnings += gap_sentences(regression)
        if not regression.structure.has_free_response:
            warnings += self._left_out_motion(fit, regression)
        if regression.structure.kind == "force" and self.band.is_excited:
            some = self._looked_at(fit, regression)
            friction = FrictionEstimate.of(some.fit, some.regression)
            if friction.is_visible:
                warnings.append(friction.warning())
        # What begins anew where hardly a sample follows is known by the bridge all the same.
        if fit.rank_deficient and self.band.is_excited and not regression.restarts.count:
            names = ", ".join(regression.output_names[j] for j in fit.rank_deficient)
            warnings.append(f"Some linear terms cannot be told apart at {names}; they were set to zero.")
        if not self.band.is_excited:
            warnings.append(
                "The input stands still: only the free decay was identified, residues mean nothing."
            )
        if said := outlier_warning([(output.name, output.records) for output in outputs]):
            warnings.append(said)
        if said := rounding_warning([(output.name, output.records) for output in outputs]):
            warnings.append(said)
        warnings += misfit_warnings(
            [
                (
                    output.name,
                    [(own.times_s, own.modelled, own.residuals, own.spread) for own in output.records],
                )
                for output in outputs
            ]
        )
        if regression.n_forced == 1 and self.band.is_excited and len(regression.pieces) == 1:
            warnings += self._bent_input(fit, regression, outputs)
        warnings += _rate_warnings(fit.clock.rate, self.clock_rate)
        shares = fit.input_noise_shares
        if self.found_noise and np.max(shares) > 0.0:
            index = max(self.found_noise, key=lambda k: self.found_noise[k].sigma)
            treatment = (
                "Inputs and outputs were weighed together as if sigma of the InputSignal had stated it."
            )
            warnings.append(found_noise_warning(regression.drives[index], self.found_noise[index], treatment))
        if np.max(shares) > _VISIBLE_SHARE:
            worst = int(np.argmax(shares))
            warnings.append(
                f"Noise on the input makes up {shares[worst]:.0%} of the noise variance of "
                f"{outputs[worst].name}. Inputs and outputs were weighed together; the standard deviations "
                "include it as far as the input's sigma is right."
            )
        else:
            warnings += colour_warning(
                regression.output_names,
                *zip(*((o.whiteness, o.measured, o.residuals) for o in outputs), strict=True),
            )
        return warnings

    def _bent_input(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        """Return that the residuals of outputs hold the answer to the cube of the only input.

        What the model could explain by other values of its parameters counts for nothing. Noise on a measured input
        is in its cube as well as in the residuals: where it matters, nothing is said.
        """
        coloured = [j for j, output in enumerate(outputs) if not output.whiteness.is_white]
        if not coloured or np.max(fit.input_noise_shares) > _VISIBLE_SHARE:
            return []
        model, some, tested = self._model(fit), self._looked_at(fit, regression), []
        instants = regression.instants(fit.clock)
        for j in coloured:
            answers = []
            for index, part in regression.segments[j]:
                (drive,) = regression.inputs[index]
                half = 0.5 * self.records[index].output(outputs[j].name).exposure_s
                first, last = drive.span_s
                cube = (drive.values / max(float(np.std(drive.values)), 1e-300)) ** 3
                bent = replace(drive, values=cube, sigma=0.0, gaps=())
                inside = np.clip(instants[j][part], first + half, last - half)
                answers.append(model.simulate(bent, inside, 2.0 * half)[:, j])
            tested.append(
                (np.concatenate(answers)[:, None], some.designs[j], fit.residuals[j], regression.values[j])
            )
        if ScoreTest.of(tested).p_value > _BENT_INPUT_LEVEL:
            return []
        return [bent_input_warning(", ".join(outputs[j].name for j in coloured), regression.input_names[0])]


def _clock_sentence(name: str, own: OwnClock) -> str:
    """Return what must be known of an output with a clock of its own."""
    if not own.runs:
        return (
            f"The stamps of {name} are {1e3 * own.delay:.4g} ms later than those of the other outputs: its own delay "
            "was estimated along."
        )
    return (
        f"The clock of {name} runs {1e6 * own.rate:+.4g} ppm fast and is {1e3 * own.delay:.4g} ms later than that of "
        "the other outputs: its own delay and rate were estimated along."
    )


def _rate_warnings(found: float, known: Prior) -> list[str]:
    """Return what is to be said of a clock rate that contradicts what was known of it."""
    if not 0.0 < known.sd < math.inf or abs(found - known.mean) <= _CONTRADICTION * known.sd:
        return []
    return [
        f"The outputs' clock runs {1e6 * found:+.4g} ppm fast, {abs(found - known.mean) / known.sd:.2g} standard "
        f"deviations of clock_rate from what it states ({1e6 * known.mean:.4g} +- {1e6 * known.sd:.4g} ppm): are the "
        "stamps of both clocks seconds? Poles are biased, unless a wider clock_rate is given."
    ]


@dataclass(frozen=True, eq=False)
class _Samples:
    """A fit at some samples of a long record, for tests that need all columns at once."""

    regression: ModalRegression
    fit: ModalFit
    designs: list[FloatArray]  # derivatives of the model at every output by (theta, its linear parameters)

    @staticmethod
    def of(regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior) -> _Samples:
        """Choose them at random; a short record is taken as it is."""
        if len(regression.pieces) > 1:
            regression = regression.thinned(_THINNED)
            residuals = residuals_of(regression, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
            fit = replace(fit, residuals=tuple(residuals))
        return _Samples(regression, fit, designs(regression, fit, latency, clock_rate))


def _jumps_into(structure: ModalStructure, record: TimeRecord, input_names: Sequence[str]) -> bool:
    """Return whether a held input jumps where the residual term would differentiate it: to nothing at a sample."""
    drives = chosen_inputs(record, input_names)
    return structure.differentiations > 0 and any(drive.hold == "zoh" for drive in drives)


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


class _LongSearch(_TimeSearch):
    """The search on all stamps of a long record, from what some of them show.

    Parameters
    ----------
    regression : ModalRegression -- of all stamps
    before : _TimeSearch -- of some of them, done
    """

    def __init__(self, regression: ModalRegression, before: _TimeSearch) -> None:
        self.before = before
        before.progress("fitting to all samples", 0.9)
        super().__init__(
            before.records,
            regression,
            before.latency,
            before.clock_rate,
            before.input_names,
            before.progress,
            clocks=before.clocks,
            scan=before.scan,
            start=before.chosen,
            found_noise=before.found_noise,
            jumps=before.jumps,
            known=before.known,
        )
        self.without_modes = self.fit(np.empty(0), np.empty(0), before.without_modes.clock)

    def propose(self, fit: ModalFit, excluded: Sequence[float]) -> list[Candidate]:
        """Return the best place over the input's band, refined, if all stamps say that it may be worth a fit."""
        for candidate in super().propose(fit, excluded):
            omegas, zetas = np.append(fit.omegas, candidate.omega), np.append(fit.zetas, candidate.zeta)
            few = fit_modes(
                self.before.problem, omegas, zetas, fit.clock, self.latency, self.clock_rate, SHORT
            )
            # The new one is that which is farthest from all that were there.
            apart = np.abs(np.log(few.omegas[:, None] / fit.omegas)) if len(fit.omegas) else np.ones((1, 1))
            new = int(np.argmax(np.min(apart, axis=1)))
            found = Candidate(float(few.omegas[new]), float(few.zetas[new]), candidate.gain)
            with_it = np.append(fit.omegas, found.omega), np.append(fit.zetas, found.zeta)
            gain = held_cost(self.problem, fit.omegas, fit.zetas, fit.clock)
            gain -= held_cost(self.problem, *with_it, fit.clock)
            if _HOPE * gain > fit.cost - self._target(fit, None):
                return [found]
        return []


def _common_band(regression: ModalRegression, highest_hz: float) -> Band:
    """Return the band that the inputs of all records excite between them."""
    structure = regression.structure
    differentiations = structure.differentiations if structure.is_motion else 0
    bands = [
        excited_band(d, differentiations, regression.duration_s, regression.rate_hz)
        for d in regression.drives
    ]
    high = min(max(b.high_hz for b in bands), highest_hz)
    is_excited = any(b.is_excited for b in bands)
    return Band(min(b.low_hz for b in bands), high, is_excited, 0.5 * regression.rate_hz)


def _noise_shares(model: ModalModel, drive: InputSignal, smoothing: Smoothing | None = None) -> FloatArray:
    """Return how much of every output's noise the noise on the input makes up, shape (n_outputs,)."""
    if drive.sigma == 0.0:
        return np.zeros(len(model.output_names))
    omegas = noise_grid(model.frequencies_hz, model.damping_ratios, drive, smoothing)
    return input_noise_share(model.frequency_response(omegas).response, omegas, drive, model.noise_sd)
