"""Identify a modal model from records, without hints.

Modes are added one at a time: the scan proposes where, the fit refines all of them
together, and the Bayesian information criterion decides whether the new one is
worth its parameters.  A mode must also pass gates: the fit converged, the pole is
known well enough to mean something, and its residues stand out of their
uncertainty at the outputs taken together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import (
    require_input,
    require_output,
    require_records,
    require_whole_number,
)
from beam_ident.data.bandwidth import Band, excited_band
from beam_ident.data.batches import Progress
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.identification_result import IdentificationResult, OrderEntry, OutputFit
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.modal_estimation.clock_search import clock_places
from beam_ident.modal_estimation.fitted_model import fitted_model
from beam_ident.modal_estimation.hub_friction import FrictionEstimate
from beam_ident.modal_estimation.mode_gates import mode_complaint, mode_significance
from beam_ident.modal_estimation.mode_scan import ModalScan
from beam_ident.modal_estimation.record_levels import record_levels, unweighed, weigh_records
from beam_ident.modal_estimation.variable_projection import ModalFit, fit_modes
from beam_ident.modal_estimation.weighted_fit import WeightedFit
from beam_ident.noise.input_noise import Smoothing, input_noise_share, noise_grid
from beam_ident.noise.outliers import outlier_warning
from beam_ident.noise.record_fit import RecordFit, in_units_of_level, pooled_scores
from beam_ident.noise.scores import Scores, Whiteness, is_coloured
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.levenberg_marquardt import HOPELESS

LATENCY_PRIOR = Prior(0.0, math.inf)
CLOCK_RATE_PRIOR = Prior(0.0, 50e-6)
MAX_MODES = 10
_MOST_MODES = 40

_NEGLIGIBLE_SHARE = 3e-4  # of an output's noise variance: more from the input widens some interval by 4 %
_VISIBLE_SHARE = 0.01  # of an output's noise variance: from here on a reader is told
# Without a complaint, a mode is given up for a fit that settles only where it is near another and explains little.
_BESIDE = 0.05  # of the frequency
_HARDLY_MORE = 1.1  # residuals without it over those with it
_ITERATIONS = 40
_TRIAL_ITERATIONS = 20  # a mode that is really there needs about six
_CLOCK_STARTS = 3
_CLOCK_ROUNDS = 3
_WORTH_A_LOOK = 1.0  # gain in log-likelihood
_SHORT = 8  # iterations of a fit on the way
# From here on most are spurious: a given order is reached by short fits, the last one in full.
_MANY_MODES = 12
_TRIES_PER_ORDER = 2


@on_one_thread
def identify(
    record: TimeRecord | Sequence[TimeRecord],
    structure: StructureKind | ModalStructure = "base_motion",
    n_modes: int | None = None,
    latency: Prior | None = None,
    clock_rate: Prior | None = None,
    input_name: str | None = None,
    max_modes: int = MAX_MODES,
    progress: Progress | None = None,
) -> IdentificationResult:
    """Identify a modal model with poles common to all outputs.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the model.  Every output weighs in each by the level of
        its noise there; where noise on the input matters, by one level in all of them.
    structure : str or ModalStructure
        Which model goes with the input; "base_motion" for a hub position.
    n_modes : int or None
        Number of modes; None lets the Bayesian information criterion decide.
    latency, clock_rate : Prior or None
        Knowledge about the outputs' clock against the input's: latency [s] and relative
        rate.  ``Prior(mean, 0)`` fixes them, ``Prior(0, inf)`` leaves them to the data.
        None is an unknown latency and a rate of 0 +- 50 ppm, as of a camera beside an axis;
        for a receptance, whose signals commonly share a clock, it is no error at all.
    input_name : str or None
        Which input, where a record has several.
    max_modes : int
        Bound on the modes tried when ``n_modes`` is None.
    progress : callable or None
        Called with a phrase and the share done, between 0 and 1.

    Returns
    -------
    IdentificationResult

    Raises
    ------
    EstimationError
        A record from which nothing can be identified: too few samples for the order,
        a constant output, an input and outputs at rest, an impossible order.
    """
    records = require_records(record, may_lack_outputs=True)
    terms = structure if isinstance(structure, ModalStructure) else ModalStructure(structure)
    if n_modes is not None:
        require_whole_number("n_modes", n_modes, 1, _MOST_MODES)
    require_whole_number("max_modes", max_modes, 1, _MOST_MODES)
    for name, prior in (("latency", latency), ("clock_rate", clock_rate)):
        if prior is not None and not isinstance(prior, Prior):
            raise EstimationError(
                f"{name} is {prior!r}; expected a Prior, as Prior({prior!r}) for a known one"
            )
    report = progress if progress is not None else _silent
    regression = ModalRegression(records, terms, input_name)
    _refuse_hopeless(regression, n_modes)
    shares_clock = terms.kind == "receptance"
    latency = latency or (Prior() if shares_clock else LATENCY_PRIOR)
    clock_rate = clock_rate or (Prior() if shares_clock else CLOCK_RATE_PRIOR)
    search = _Search(records, regression, latency, clock_rate, input_name, report)
    search.run(n_modes, max_modes)
    return search.result()


def _silent(phrase: str, share: float) -> None:
    del phrase, share


def _refuse_hopeless(regression: ModalRegression, n_modes: int | None) -> None:
    for drive in regression.drives:
        require_input(drive, is_needed=False)
    for name, values in zip(regression.output_names, regression.values, strict=True):
        require_output(name, values)
        needed = 4 * (regression.n_shared_fixed + regression.n_nuisance(n_modes or 1) + 3 * (n_modes or 1))
        if len(values) < needed:
            raise EstimationError(
                f"output {name!r} has {len(values)} usable samples for {n_modes or 1} modes; expected at "
                f"least {needed}. Record longer or ask for fewer modes"
            )


@dataclasses.dataclass(frozen=True, eq=False)
class _Weighed:
    """A fit weighed by the noise as it is, the regression that it belongs to, and that with weights for records."""

    fit: ModalFit
    regression: ModalRegression
    by_record: ModalRegression


class _Search:
    """The search over orders, and the best fit found so far."""

    def __init__(
        self,
        records: list[TimeRecord],
        regression: ModalRegression,
        latency: Prior,
        clock_rate: Prior,
        input_name: str | None,
        progress: Progress,
    ) -> None:
        self.plain = self.regression = regression
        self.records, self.input_name = records, input_name
        self.max_iterations = _ITERATIONS
        self.latency, self.clock_rate = latency, clock_rate
        self.progress = progress
        structure = regression.structure
        rate = max(len(t) for t in regression.times) / regression.duration_s
        bands = [
            excited_band(d, structure.differentiations, regression.duration_s, rate)
            for d in regression.drives
        ]
        self.band = Band(
            min(b.low_hz for b in bands), max(b.high_hz for b in bands), any(b.is_excited for b in bands)
        )
        if not self.band.is_excited:  # without an input there are no two clocks to compare
            self.latency, self.clock_rate = Prior(latency.mean), Prior(clock_rate.mean)
        self.scan = ModalScan(records, structure, input_name, self.band)
        self.base = self._fit(np.empty(0), np.empty(0), ClockState(latency.mean, clock_rate.mean), 0)
        self.chosen = self.base
        self.entries: list[OrderEntry] = [self._entry(self.base, "")]
        self.chosen_entry = 0
        self.is_order_given = False

    def _fit(
        self,
        omegas: FloatArray,
        zetas: FloatArray,
        clock: ClockState,
        n_modes: int,
        target: float = math.inf,
    ) -> ModalFit:
        if n_modes == 0 and not self.regression.structure.has_direct:
            latency, rate = Prior(self.latency.mean), Prior(self.clock_rate.mean)
        else:
            latency, rate = self.latency, self.clock_rate
        return fit_modes(self.regression, omegas, zetas, clock, latency, rate, self.max_iterations, target)

    def _untangled(self, fit: ModalFit) -> ModalFit:
        """Return the fit after a look for cycles that the clock may have slipped.

        What promises a higher likelihood on thinned data is fitted there, and then on all of it.
        """
        if len(fit.omegas) > _MANY_MODES:
            return fit
        thinned = self.scan.regression
        priors = self.latency, self.clock_rate
        for _ in range(_CLOCK_ROUNDS):
            places = clock_places(thinned, fit, *priors, _CLOCK_STARTS)
            places = [place for place in places if place.gain > _WORTH_A_LOOK]
            if not places:
                return fit
            here = fit_modes(thinned, fit.omegas, fit.zetas, fit.clock, *priors, _SHORT)
            starts = [fit_modes(thinned, fit.omegas, fit.zetas, p.clock, *priors, _SHORT) for p in places]
            start = min(starts, key=lambda start: start.cost)
            if not start.cost < here.cost - _WORTH_A_LOOK:
                return fit
            again = self._fit(start.omegas, start.zetas, start.clock, len(start.omegas))
            if not again.cost < fit.cost:
                return fit
            fit = again
        return fit

    def run(self, n_modes: int | None, max_modes: int) -> None:
        self.is_order_given = n_modes is not None
        limit = n_modes if n_modes is not None else max_modes
        self.max_iterations = _ITERATIONS if n_modes is not None else _TRIAL_ITERATIONS
        thorough = self.max_iterations
        while len(self.chosen.omegas) < limit:
            if len(self.records) > 1:
                self._weigh()
            current = self.chosen
            n = len(current.omegas)
            self.max_iterations = _SHORT if _MANY_MODES <= n < limit - 1 else thorough
            if n_modes is None and not self._affords(n + 1):
                break
            excluded: list[float] = []
            found = False
            for attempt in range(_TRIES_PER_ORDER if n_modes is None else 1):
                share = min(0.95, (n + 0.5 * attempt) / (limit if n_modes is not None else 5))
                self.progress(f"looking for mode {n + 1}", share)
                candidate = self.scan.propose(current, excluded)
                if candidate is None:
                    break
                omegas = np.append(current.omegas, candidate.omega)
                zetas = np.append(current.zetas, candidate.zeta)
                trial = self._fit(omegas, zetas, current.clock, n + 1, self._target(current, n_modes))
                if trial.reason != HOPELESS:
                    trial = self._untangled(trial)
                refusal = self._refusal(trial, current, n_modes is not None)
                self.entries.append(self._entry(trial, refusal))
                if not refusal or n_modes is not None:
                    self.chosen, self.chosen_entry, found = trial, len(self.entries) - 1, True
                    break
                excluded.append(candidate.omega)
            if not found:
                break

    def _weigh(self) -> None:
        """Let records weigh by what the present model leaves: a loud one hides what a quiet one shows."""
        levels = record_levels(self.regression, self.chosen)
        self.regression = self.plain.weighed(levels)
        self.scan.weigh(levels)
        fit = self.chosen
        self.chosen = self._fit(fit.omegas, fit.zetas, fit.clock, len(fit.omegas))

    def _affords(self, n_modes: int) -> bool:
        columns = self.regression.n_shared_fixed + n_modes + self.regression.n_nuisance(n_modes)
        return min(len(v) for v in self.regression.values) > 4 * (columns + 2 * n_modes)

    def _target(self, current: ModalFit, n_modes: int | None) -> float:
        """Return the cost below which one more mode is worth its parameters."""
        if n_modes is not None:
            return math.inf
        return current.cost - 0.5 * self.regression.n_parameters_of_a_mode * math.log(
            self.regression.n_samples
        )

    def _bic(self, fit: ModalFit) -> float:
        return 2.0 * fit.cost + fit.n_parameters * math.log(self.regression.n_samples)

    def _refusal(self, trial: ModalFit, current: ModalFit, is_given: bool) -> str:
        if trial.reason == HOPELESS:
            return "not worth its parameters by BIC"
        if not trial.converged:
            return f"the fit did not converge: {trial.reason}"
        for mode in range(len(trial.omegas)):
            complaint = mode_complaint(trial, self.regression, mode, self.band)
            if complaint:
                return complaint
        if not is_given and not self._bic(trial) < self._bic(current):
            return "not worth its parameters by BIC"
        return ""

    def _entry(self, fit: ModalFit, refusal: str) -> OrderEntry:
        shares, fits = [], []
        for values, residuals in zip(self.regression.values, fit.residuals, strict=True):
            scores = Scores.of(values, residuals)
            shares.append(scores.r_squared)
            fits.append(scores.fit_percent)
        return OrderEntry(
            n_modes=len(fit.omegas),
            n_parameters=fit.n_parameters,
            bic=self._bic(fit),
            aic=2.0 * fit.cost + 2.0 * fit.n_parameters,
            r_squared=min(shares),
            worst_fit_percent=min(fits),
            condition=fit.information_condition,
            converged=fit.converged,
            refused_because=refusal,
        )

    def result(self) -> IdentificationResult:
        fit, self.regression = unweighed(self.regression, self.chosen), self.plain
        n = len(fit.omegas)
        if n == 0:
            raise EstimationError(
                f"no mode between {self.band.low_hz:.3g} and {self.band.high_hz:.3g} Hz stands out of the "
                f"noise ({self.entries[-1].refused_because or 'no candidate'}). Excite more, record longer, "
                "or ask for a number of modes to see the best candidate"
            )
        self.progress("weighing by the noise as it is", 0.97)
        weighed = self._weighed(fit)
        if not self.is_order_given:
            weighed = self._confirmed(weighed)
        fit, regression, by_record = weighed.fit, weighed.regression, weighed.by_record
        self.chosen, self.regression = fit, regression
        model = fitted_model(fit, regression, self.latency.is_free, self.clock_rate.is_free)
        self.progress("done", 1.0)
        blocks = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
        outputs = tuple(
            self._output_fit(j, blocks[regression.block_of[j]].matrix, by_record.row_levels(j))
            for j in range(regression.n_outputs)
        )
        entries = [
            dataclasses.replace(entry, is_chosen=index == self.chosen_entry)
            for index, entry in enumerate(self.entries)
        ]
        return IdentificationResult(
            model=model,
            structure=regression.structure,
            outputs=outputs,
            orders=tuple(entries),
            band=self.band,
            converged=fit.converged,
            reason=fit.reason,
            iterations=fit.iterations,
            warnings=tuple(self._warnings(model, outputs)),
        )

    def _weighed(self, fit: ModalFit) -> _Weighed:
        """Return a fit with equal weights, weighed by the noise as it is."""
        regression = self.plain
        model = fitted_model(fit, regression, self.latency.is_free, self.clock_rate.is_free)
        smoothing = None
        shares = [_noise_share(model, drive) for drive in regression.drives]
        if self.band.is_excited and max(shares) > _NEGLIGIBLE_SHARE:
            smoothing = Smoothing(self.band.high_hz)
            regression = ModalRegression(self.records, regression.structure, self.input_name, smoothing)
            fit = fit_modes(regression, fit.omegas, fit.zetas, fit.clock, self.latency, self.clock_rate)
        by_record = regression
        if smoothing is None:
            by_record, fit = weigh_records(regression, fit, self.latency, self.clock_rate)
        weighted = WeightedFit(self.records, by_record, fit, self.latency, self.clock_rate, smoothing)
        return _Weighed(unweighed(by_record, weighted.result()), regression, by_record)

    def _confirmed(self, weighed: _Weighed) -> _Weighed:
        """Return the fit without modes that only equal weights had mistaken for more than noise.

        Noise on the input reaches the outputs through the modes, and a mode beside a true one can pass for it
        until every sample weighs by what the noise has left of it.
        """
        while len(weighed.fit.omegas) > 1:
            fit, regression = weighed.fit, weighed.regression
            modes = range(len(fit.omegas))
            complaints = [mode_complaint(fit, regression, mode, self.band) for mode in modes]
            if fit.converged and not any(complaints):
                break
            doubtful = [mode for mode in modes if complaints[mode]] or list(modes)
            weakest = min(doubtful, key=lambda mode: mode_significance(fit, regression, mode, self.band)[0])
            omegas, zetas = np.delete(fit.omegas, weakest), np.delete(fit.zetas, weakest)
            fewer = self._fit(omegas, zetas, fit.clock, len(omegas))
            following = self._weighed(fewer)
            if not fewer.converged or not following.fit.converged:
                break
            beside = np.min(np.abs(np.log(omegas / fit.omegas[weakest])))
            is_little = np.all(following.fit.sigmas < _HARDLY_MORE * fit.sigmas)
            if not any(complaints) and not (beside < _BESIDE and is_little):
                break
            reason = complaints[weakest] or fit.reason
            self.entries[self.chosen_entry] = dataclasses.replace(
                self.entries[self.chosen_entry], refused_because=f"weighed by the noise, {reason}"
            )
            self.entries.append(self._entry(fewer, ""))
            self.chosen_entry = len(self.entries) - 1
            weighed = following
        return weighed

    def _output_fit(self, j: int, matrix: FloatArray, levels: FloatArray) -> OutputFit:
        fit, regression = self.chosen, self.regression
        structure = regression.structure
        found = fit.coefficients[j]
        n, n_fixed = len(fit.omegas), regression.n_shared_fixed
        rigid = np.zeros_like(found)
        if structure.has_direct:
            rigid[0] = found[0]
        n_own = regression.n_nuisance(n)
        n_plain = int(structure.has_offset) + int(structure.has_ramp)
        starts = [n_fixed + n + n_own * k for k in range(len(regression.segments[j]))]
        for own in starts:
            rigid[own : own + n_plain] = found[own : own + n_plain]
        values, residuals = regression.values[j], fit.residuals[j]
        deflection = values - matrix @ rigid
        noise_sd = float(fit.sigmas[j]) * levels / math.sqrt(float(np.mean(np.square(levels))))
        records = tuple(
            RecordFit(
                name=self.records[index].name,
                times_s=regression.times[j][part],
                measured=values[part],
                modelled=values[part] - residuals[part],
                residuals=residuals[part],
                noise_sd=float(noise_sd[part.start]),
                scores=Scores.of(values[part], residuals[part]),
                whiteness=Whiteness.of(residuals[part]),
                offset=float(found[own]) if structure.has_offset else 0.0,
                ramp=float(found[own + int(structure.has_offset)]) if structure.has_ramp else 0.0,
            )
            for (index, part), own in zip(regression.segments[j], starts, strict=True)
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
            whiteness=Whiteness.of(in_units_of_level([residuals[part] for part in parts])),
            offset=records[0].offset,
            ramp=records[0].ramp,
            records=records,
        )

    def _warnings(self, model: ModalModel, outputs: tuple[OutputFit, ...]) -> list[str]:
        fit = self.chosen
        warnings = []
        if not fit.converged:
            warnings.append(f"The fit did not converge: {fit.reason}.")
        for mode in range(model.n_modes):
            complaint = mode_complaint(fit, self.regression, mode, self.band)
            if complaint:
                warnings.append(f"Mode {mode + 1}: {complaint}.")
        if model.structure == "force" and self.band.is_excited:
            friction = FrictionEstimate.of(fit, self.regression)
            if friction.is_visible:
                warnings.append(friction.warning())
        if fit.rank_deficient and self.band.is_excited:
            warnings.append(
                f"Some linear terms cannot be told apart at {', '.join(fit.rank_deficient)}; they were set "
                "to zero."
            )
        if not self.band.is_excited:
            warnings.append(
                "The input stands still: only the free decay was identified, residues mean nothing."
            )
        if said := outlier_warning([(output.name, output.records) for output in outputs]):
            warnings.append(said)
        shares = fit.input_noise_shares
        if np.max(shares) > _VISIBLE_SHARE:
            worst = int(np.argmax(shares))
            warnings.append(
                f"Noise on the input makes up {shares[worst]:.0%} of the noise variance of "
                f"{outputs[worst].name}. Inputs and outputs were weighed together; the standard deviations "
                "include it as far as the input's sigma is right."
            )
        else:
            coloured = [
                output.name
                for output in outputs
                if is_coloured(output.whiteness, output.measured, output.residuals)
            ]
            if coloured:
                warnings.append(
                    f"The residuals of {', '.join(coloured)} are not white. The fit is weighed by their "
                    "autocorrelation and the standard deviations include it; if it is unmodelled dynamics rather "
                    "than noise, a bias remains."
                )
        return warnings


def _noise_share(model: ModalModel, drive: InputSignal) -> float:
    """Return how much of the outputs' noise the noise on the input makes up."""
    if drive.sigma == 0.0:
        return 0.0
    omegas = noise_grid(model.frequencies_hz, model.damping_ratios, drive)
    return input_noise_share(model.frequency_response(omegas).response, omegas, drive, model.noise_sd)
