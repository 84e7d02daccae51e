"""The search for modes in records of time: ``mode_search`` with equal weights, and a last fit weighed by the noise.

Of a long record the search begins with a random choice of stamps.  What it finds there is fitted to everything, and
from there on a mode is tried only if everything promises, with all other poles held, that it is worth its parameters.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from beam_ident.data.bandwidth import Band, excited_band
from beam_ident.data.batches import Progress
from beam_ident.data.own_clocks import OwnClock, on_common_clock
from beam_ident.data.prior import Prior
from beam_ident.data.records import LowPass, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit, fitted_model
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.free_base import NO_BODY
from beam_ident.modal_estimation.input_disturbance import NEGLIGIBLE_SHARE, noise_shares
from beam_ident.modal_estimation.mode_scan import Candidate, ModalScan
from beam_ident.modal_estimation.mode_search import (
    MANY_MODES,
    SHORT,
    SLOW_NOISE,
    Looks,
    ModeSearch,
    Weighed,
)
from beam_ident.modal_estimation.record_levels import (
    BridgeUncertainty,
    SlowNoiseWeights,
    record_levels,
    restart_priors,
    stamp_jitters,
    unweighed,
    weigh_records,
)
from beam_ident.modal_estimation.variable_projection import fit_modes, held_cost
from beam_ident.modal_estimation.weighted_fit import WeightedFit
from beam_ident.modal_identification.clock_search import (
    OwnClocks,
    clock_places,
    contradicting_clocks,
    moved_alone,
    out_of_phase,
    own_clock_columns,
    own_delays,
    own_rates,
)
from beam_ident.modal_identification.fit_tests import (
    THINNED,
    VISIBLE_SHARE,
    SampledFit,
    unrelated,
)
from beam_ident.modal_identification.input_noise_weights import InputNoiseWeights
from beam_ident.modal_identification.sensor_low_passes import Sensor, likely_low_pass, suspected
from beam_ident.modal_identification.signal_clocks import SignalClocks
from beam_ident.modal_identification.time_result import Findings
from beam_ident.noise.input_noise import Smoothing
from beam_ident.sensing.stamp_jitter import is_any
from beam_ident.sensing.still_noise import StillNoise

_CLOCK_STARTS = 3
_CLOCK_SETTLED = 0.5  # standard deviations that the last turn may still move a clock of its own
_STRAY = 0.5  # of its lag: as far a low-pass may be moved at once
_LINEAR = 5e-3  # radians of the fastest mode: a step so small changes amplitudes by 1e-5
_CLOCK_TURNS = 3  # of clocks and the modes that show them
_ASKED = 3  # outputs by themselves, until one shows its modes without a doubt
_FAR_STARTS = 12  # crests that poles which were bent by a wrong clock are tried at
_GLANCE = 2  # iterations that sort them
_AS_GOOD = 10.0  # in log-likelihood: less than BIC charges for a mode
_BENT_LEVEL = 1e-3  # how often modes in phase with their input are taken not to be
_RESTART_TURNS = 4  # of the gaps that matter, and the noise that says so
WORTH_A_LOOK = 1.0  # gain in log-likelihood
_MOSTLY = 0.5  # of what a fit leaves
_HOPE = 5.0  # times what a mode promises with all other poles held, it may gain at most


class TimeSearch(ModeSearch[ModalRegression]):
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
        clocks: SignalClocks | None = None,
        scan: ModalScan | None = None,
        start: ModalFit | None = None,
        found_noise: Mapping[int, StillNoise] = MappingProxyType({}),
    ) -> None:
        self.is_in_doubt = False  # since a mode that explains much was not believed
        self.end_before: ModalFit | None = (
            None  # of structures inside, on clocks that have moved a little since
        )
        self.clocks = clocks or SignalClocks.of(regression)
        self.found_noise = found_noise
        self.records, self.input_names = records, input_names
        self.bridges: BridgeUncertainty | None = None
        self._samples: tuple[ModalFit, SampledFit] | None = None
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
        for _ in range(_CLOCK_TURNS):
            places = clock_places(thinned, fit, *priors, _CLOCK_STARTS)
            places = [place for place in places if place.gain > WORTH_A_LOOK]
            if not places:
                return fit
            here = fit_modes(thinned, fit.omegas, fit.zetas, fit.clock, *priors, SHORT)
            starts = [fit_modes(thinned, fit.omegas, fit.zetas, p.clock, *priors, SHORT) for p in places]
            start = min(starts, key=lambda start: start.cost)
            if not start.cost < here.cost - WORTH_A_LOOK:
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
        if not least < here.cost - WORTH_A_LOOK:
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
        seen = fit.converged and self.model(fit).no_body_p_value() < NO_BODY
        if seen and not self._unrelated(unweighed(self.problem, fit)):
            self.shows_clock = True
            return fit
        self.problem, self.plain = before
        return None

    def inside(self, n_modes: int) -> ModalFit | None:
        """Return where modes end by way of structures without initial motion, ramp or offset, where there is a doubt.

        Mode by mode every structure goes on from the best end of those inside it: one mode fewer, or one term fewer.
        A long record is not searched again: a start of some of its stamps has served it already.
        """
        if self.end_before is not None:
            return self.end_before
        regression, fit = self.plain, self.chosen
        is_long = len(regression.pieces) > 1 or max(map(len, regression.times)) > THINNED
        form = regression.structure
        present = ["has_offset"] * form.has_offset + ["has_ramp"] * form.has_ramp
        # Without an input there is nothing but this motion.
        present += ["has_free_response"] * (form.has_free_response and self.band.is_excited)
        if is_long or not present or (fit.converged and not self._doubtful(fit)):
            return None
        searches: dict[frozenset[str], TimeSearch] = {}
        for size in range(len(present) + 1):
            for kept in itertools.combinations(present, size):
                left_out: dict[str, Any] = dict.fromkeys(set(present).difference(kept), False)
                searches[frozenset(kept)] = self._with_terms(replace(form, **left_out))
        turned_from: dict[frozenset[str], ModalFit] = {}
        # Of many modes most are spurious: they are added in one go.
        for order in range(1, n_modes + 1) if n_modes <= MANY_MODES else [n_modes]:
            for terms, search in searches.items():
                search.run_plain(order)
                alone = search.chosen
                if order == n_modes and terms in turned_from and len(terms) < len(present):
                    # A better end of fewer modes may lead to a worse one of more: the structure by itself goes on
                    # from its own, as this one has done.
                    by_itself = self._with_terms(search.plain.structure, turned_from[terms])
                    by_itself.run_plain(n_modes)
                    search.go_on_from(by_itself.chosen)
                for term in terms:
                    search.go_on_from(searches[terms - {term}].chosen)
                if alone.cost - search.chosen.cost > WORTH_A_LOOK:
                    turned_from.setdefault(terms, alone)
        return search.chosen

    def _with_terms(self, terms: ModalStructure, start: ModalFit | None = None) -> TimeSearch:
        """Return a search of the same records with other terms, which asks no output by itself that was asked."""
        regression = ModalRegression(self.records, terms, self.input_names, restarts=self.plain.restarts)
        search = TimeSearch(
            self.records,
            regression,
            self.latency,
            self.clock_rate,
            self.input_names,
            self.progress,
            start=start,
        )
        search.is_in_doubt = self.is_in_doubt
        return search

    def doubt(self) -> None:
        """Ask every output by itself when it was measured, and begin anew where they do not agree.

        Raises
        ------
        OwnClocks
            Some outputs have a clock of their own.
        """
        may_ask = self.looks.past_doubt and not (self.is_in_doubt or self.clocks.own)
        self.is_in_doubt = True
        if not may_ask or self.plain.n_outputs < 2 or not self.band.is_excited:
            return
        searches = [own for name in self.plain.output_names if (own := self._alone(name)) is not None]
        most = len(self._believed.fit.omegas)
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
                # Poles that move before the clock has make up for it: first the clock, then both. Poles that are a
                # little off ask for another clock, too, where free motion takes its place: it must be the better one.
                either = known.clock, moved_alone(search.scan.regression, known)
                starts = [search.fit(known.omegas, known.zetas, clock) for clock in either]
                fit = search.untangled(min(starts, key=lambda start: start.cost))
            if fit.converged:
                fits[search.plain.output_names[0]] = fit
        is_known = not (self.latency.is_free or self.clock_rate.is_free)
        common = ClockState(self.latency.mean, self.clock_rate.mean) if is_known else None
        if clocks := contradicting_clocks(fits, common):
            raise OwnClocks(self._refined(clocks, known))

    def _refined(self, clocks: Mapping[str, OwnClock], modes: ModalFit) -> dict[str, OwnClock]:
        """Return clocks of outputs by themselves as all outputs together say, with modes that one of them shows."""
        found = dict(clocks)
        for _ in range(_CLOCK_TURNS):
            records = [on_common_clock(one, found) for one in self.records]
            regression = ModalRegression(records, self.plain.structure, self.input_names)
            if max(map(len, regression.times)) > THINNED:
                regression = regression.thinned(THINNED)
            search = TimeSearch(
                records,
                regression,
                self.latency,
                self.clock_rate,
                self.input_names,
                self.progress,
                clocks=SignalClocks.of(regression, found),
                scan=self.scan,
                start=modes,
            )
            search.problem = search.plain = search.clocks.estimated_in(regression, search.chosen, records)
            modes = search.fit(search.chosen.omegas, search.chosen.zetas, search.chosen.clock)
            for j, name in enumerate(regression.output_names):
                if name in found:
                    found[name] = found[name].moved(*search.clocks.beyond(j, modes)[0])
        return found

    def _alone(self, name: str) -> TimeSearch | None:
        """Return a search that ends at the first doubt, for one output and its own latency; None without data."""
        records = [one.select([name]) for one in self.records if name in one.output_names]
        latency = self.latency if self.latency.is_free else Prior(self.latency.mean, math.inf)
        try:
            regression = ModalRegression(records, self.plain.structure, self.input_names)
        except EstimationError:
            return None
        if max(map(len, regression.times)) > THINNED:
            regression = regression.thinned(THINNED)
        search = TimeSearch(records, regression, latency, self.clock_rate, self.input_names, self.progress)
        search.looks.past_doubt = False
        return search

    def spare(self, before: TimeSearch) -> None:
        """Look for nothing that a search of nearly the same records has looked for in vain."""
        self.is_in_doubt = before.is_in_doubt
        self.end_before = before.chosen if before.paid.inside else before.end_before
        self.looks = Looks(before.paid.past_doubt, self.end_before is not None)

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
        return Weighed(as_measured, self.plain, self.problem).unfinished(stop, missing)

    def reweigh(self) -> None:
        """Let records weigh by what the present model leaves: a loud one hides what a quiet one shows."""
        if self._is_driven_by_noise():
            self.weighed_by = "noise of the input"
            self._whiten()
        elif self.is_behind_noise:
            self.weighed_by = SLOW_NOISE
            weights = SlowNoiseWeights.of(self.plain, unweighed(self.problem, self.chosen))
            self.problem = weights.turned(self.plain)
            self.scan.turn(weights.turned)
        elif len(self.records) > 1:
            self.weighed_by = "levels of the records"
            levels = record_levels(self.problem, self.chosen)
            self.problem = self.plain.weighed(levels)
            self.scan.weigh(levels)
        else:
            return
        self._refit()

    def _noise_share(self, fit: ModalFit) -> float:
        """Return how much of what a fit leaves at some output is noise on the input, behind the modes of it.

        Parameters
        ----------
        fit : ModalFit -- with residuals as measured
        """
        if not (self._may_weigh_input and len(fit.omegas)) or not any(
            d.sigma > 0.0 for d in self.plain.drives
        ):
            return 0.0
        model = self.model(fit)
        return float(np.max([noise_shares(model.path(drive.name), drive) for drive in self.plain.drives]))

    def _is_driven_by_noise(self) -> bool:
        """Return whether noise on the input is seen in what the modes that are there leave."""
        if len(self.plain.pieces) > 1:
            return False
        return self._noise_share(unweighed(self.problem, self.chosen)) > VISIBLE_SHARE

    def _whiten(self) -> None:
        """Look at the most likely inputs, and at rows whitened by what is left of their noise."""
        smoothing, terms, restarts = Smoothing(self.band.high_hz), self.plain.structure, self.plain.restarts
        smooth = ModalRegression(self.records, terms, self.input_names, smoothing, restarts)
        fit = unweighed(self.problem, self.chosen)
        weights = InputNoiseWeights.of(self.records, smooth, fit, (self.latency, self.clock_rate), smoothing)
        self.problem = weights.turned(
            ModalRegression(weights.records, terms, self.input_names, restarts=restarts)
        )
        self.scan = ModalScan(weights.records, terms, self.input_names, self.band, restarts)
        self.scan.turn(weights.turned)

    def looks_behind_noise(self) -> bool:
        """Return whether slow noise makes up most of what the modes so far leave.

        A long record has been searched so at some of its stamps; what is curved, or driven by the input's noise, has
        no noise that a colour would describe.
        """
        if not self.band.is_excited or self.is_curved or len(self.plain.pieces) > 1:
            return False
        if self._is_driven_by_noise():
            return False
        return SlowNoiseWeights.of(self.plain, unweighed(self.problem, self.chosen)).is_loud

    @property
    def _may_weigh_input(self) -> bool:
        return self.plain.n_forced == 1 and self.band.is_excited

    def weighed(self, fit: ModalFit) -> Weighed[ModalRegression]:
        """Return a fit with equal weights, weighed by the colour of the outputs' noise or by that of the input."""
        fit, self.problem = unweighed(self.problem, fit), self.plain
        fit = self._restarted(fit)
        if self.clocks:
            self.problem = self.plain = self.clocks.estimated_in(self.plain, fit, self.records)
            fit = self.fit(fit.omegas, fit.zetas, fit.clock)
            if self.bridges is not None:  # which gaps are bridged is decided; there are more parameters now
                self.bridges = BridgeUncertainty.of(self.plain, fit, self.latency, self.clock_rate, math.inf)
        regression = self.plain
        model = self.model(fit)
        smoothing = None
        shares = [noise_shares(model.path(drive.name), drive) for drive in regression.drives]
        self._release()
        is_noisy = bool(np.max(shares) > NEGLIGIBLE_SHARE)
        if self._may_weigh_input and (is_noisy or is_any(stamp_jitters(regression, fit))):
            # Where only the stamps scatter the input is taken as it is.
            smoothing = Smoothing(self.band.high_hz if is_noisy else math.inf)
            regression = ModalRegression(
                self.records, regression.structure, self.input_names, smoothing, regression.restarts
            )
            if self.clocks:
                regression = self.clocks.estimated_in(regression, fit, self.records)
            fit = fit_modes(regression, fit.omegas, fit.zetas, fit.clock, self.latency, self.clock_rate)
        by_record = regression
        if smoothing is None:
            by_record, fit = weigh_records(regression, fit, self.latency, self.clock_rate)
        priors = self.clocks.priors(fit, self.latency, self.clock_rate)
        if self.bridges is not None:
            priors += [((place,), 0.0, sd) for place, sd in restart_priors(by_record, fit)]
        jitters = stamp_jitters(regression, fit) if smoothing is not None else ()
        weighted = WeightedFit(
            self.records, by_record, fit, self.latency, self.clock_rate, smoothing, priors, jitters
        )
        found = unweighed(by_record, weighted.result())
        if is_any(jitters):
            shares = [noise_shares(model, drive, smoothing) for drive in regression.drives]
            found = replace(found, input_noise_shares=is_noisy * np.max(shares, axis=0))
        if self.bridges is not None:
            found = replace(found, covariance=found.covariance + self.bridges.covariance)
        return Weighed(found, regression, by_record)

    def further_clocks(self, weighed: Weighed[ModalRegression]) -> dict[str, OwnClock]:
        """Return what is to be added to the clocks that outputs have of their own, by name."""
        if not self.band.is_excited or self.is_curved:  # what a curve leaves is late at some outputs
            return {}
        fit, regression = weighed.fit, weighed.problem
        names = regression.output_names
        late = [j for j, name in enumerate(names) if name in self.clocks.own]
        running = [j for j in late if self.clocks.own[names[j]].runs]
        found: dict[str, OwnClock] = {}
        # Noise that comes from the input through the modes is late at no output, and is not white at any.
        if len(names) > 1 and not self._noise_share(fit) > _MOSTLY:
            some = self.looked_at(fit, regression)
            by_delay, by_rate = zip(*own_clock_columns(some.regression, some.fit), strict=True)
            present = some.regression, some.fit, some.designs
            for j, delay in own_delays(*present, by_delay, self.latency, late).items():
                found[names[j]] = OwnClock(delay)
            rates = {} if found else own_rates(*present, by_rate, self.clock_rate, running)
            for j, rate in rates.items():
                found[names[j]] = OwnClock(0.0, rate, True)
        for j in late:
            if self._strays(j, fit):
                continue
            values, sds = self.clocks.beyond(j, fit)
            turns = fit.omegas[-1] * np.abs(values) * [1.0, 0.5 * regression.duration_s]
            if np.any((np.abs(values) > _CLOCK_SETTLED * sds) & (turns > _LINEAR)):
                rate = found.get(names[j], OwnClock()).rate
                found[names[j]] = OwnClock(float(values[0]), float(values[1]) + rate)
        return found

    def better_low_passes(self, weighed: Weighed[ModalRegression]) -> dict[str, LowPass]:
        """Return better low-passes of outputs that have one, by name."""
        fit, found = weighed.fit, {}
        for j, name in enumerate(weighed.problem.output_names):
            if (known := self.clocks.low_passes.get(name)) is not None and not self._strays(j, fit):
                values, sds = self.clocks.beyond_low_pass(j, fit)
                turns = np.abs(values) * fit.omegas[-1] ** np.array([1, 2])
                if np.any((np.abs(values) > _CLOCK_SETTLED * sds) & (turns > _LINEAR)):
                    found[name] = known.moved(*values)
        return found

    def _strays(self, output: int, fit: ModalFit) -> bool:
        """Return whether an output's low-pass would move further than its derivatives say anything of."""
        known = self.clocks.low_passes.get(self.clocks.output_names[output])
        return (
            known is not None and abs(self.clocks.beyond_low_pass(output, fit)[0][0]) > _STRAY * known.lag_s
        )

    def further_low_passes(
        self, weighed: Weighed[ModalRegression], measured: Sequence[TimeRecord]
    ) -> dict[str, Sensor]:
        """Return low-passes that outputs seem to have, by name.

        Parameters
        ----------
        weighed : Weighed
        measured : sequence of TimeRecord -- with stamps as they were before outputs' own clocks corrected them
        """
        fit, regression = weighed.fit, weighed.problem
        if not self.band.is_excited or self._noise_share(fit) > _MOSTLY:
            return {}
        found: dict[str, Sensor] = {}
        stated = [own.name for one in self.records for own in one.outputs if own.low_pass is not None]
        for name in suspected(self.looked_at(fit, regression), stated):
            late_s = fit.clock.latency + self.clocks.own.get(name, OwnClock()).delay
            if (
                likely := likely_low_pass(measured, self.plain, fit, name, late_s, self.clock_rate)
            ) is not None:
                found[name] = likely
        return found

    def looked_at(self, fit: ModalFit, regression: ModalRegression) -> SampledFit:
        """Return what tests need of a fit, made once for all of them."""
        if self._samples is None or self._samples[0] is not fit:
            self._samples = fit, SampledFit.of(regression, fit, self.latency, self.clock_rate)
        return self._samples[1]

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

    def model(self, fit: ModalFit) -> ModalModel:
        """Return a fit as a model, without clocks that outputs have of their own."""
        regression = self.plain
        clock_is_free = self.latency.is_free, self.clock_rate.is_free
        names = regression.input_names
        return fitted_model(fit, regression.structure, names, regression.output_names, clock_is_free)

    def _unrelated(self, fit: ModalFit) -> str:
        return unrelated(self.plain, self.without_modes, fit, self.band)

    def result(self, weighed: Weighed[ModalRegression], n_modes: int | None) -> IdentificationResult:
        """Return what was found.

        Raises
        ------
        EstimationError
            The modes explain no more than chance would, and nobody asked for their number.
        """
        if (said := self._unrelated(weighed.fit)) and n_modes is None:
            raise EstimationError(
                f"{said}. Check that input and outputs belong together and share a clock, excite more, or ask "
                "for a number of modes to see the best candidates"
            )
        with contextlib.suppress(TimeoutError):  # what is found is returned, however late
            self.progress("done", 1.0)
        return Findings(
            weighed,
            self.model(weighed.fit),
            self.plain,
            self.records,
            self.band,
            self.clocks,
            (self.latency, self.clock_rate),
            self.found_noise,
            lambda: self.looked_at(weighed.fit, weighed.problem),
        ).result(self.orders, said)


class LongSearch(TimeSearch):
    """The search on all stamps of a long record, from what some of them show.

    Parameters
    ----------
    regression : ModalRegression -- of all stamps
    before : TimeSearch -- of some of them, done
    """

    def __init__(self, regression: ModalRegression, before: TimeSearch) -> None:
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
        )
        self.without_modes = self.fit(np.empty(0), np.empty(0), before.without_modes.clock)
        self.looks, self.paid = replace(before.looks), replace(before.paid)
        self.is_curved = before.is_curved

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
    power = regression.structure.driving_power
    bands = [excited_band(d, power, regression.duration_s, regression.rate_hz) for d in regression.drives]
    high = min(max(b.high_hz for b in bands), highest_hz)
    is_excited = any(b.is_excited for b in bands)
    return Band(min(b.low_hz for b in bands), high, is_excited, 0.5 * regression.rate_hz)
