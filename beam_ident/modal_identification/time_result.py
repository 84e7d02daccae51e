"""What a search in records of time has found, as a result with its warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.bandwidth import Band
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import IdentificationResult, OrderEntry, OutputFit
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import MAX_WHOLE, ModalRegression
from beam_ident.modal_estimation.free_base import FrictionEstimate
from beam_ident.modal_estimation.input_disturbance import noise_shares
from beam_ident.modal_estimation.mode_gates import gain_warnings, mode_complaint, mode_warnings
from beam_ident.modal_estimation.mode_search import (
    Weighed,
)
from beam_ident.modal_estimation.record_levels import (
    gap_sentences,
)
from beam_ident.modal_identification.fit_tests import (
    VISIBLE_SHARE,
    SampledFit,
    bent_input,
    left_out_motion,
    no_body_alone,
    rate_warnings,
)
from beam_ident.modal_identification.input_noise_weights import InputNoiseWeights
from beam_ident.modal_identification.signal_clocks import SignalClocks, clock_sentences, hold_warnings
from beam_ident.noise.input_noise import Smoothing
from beam_ident.noise.outliers import outlier_warning
from beam_ident.noise.record_fit import RecordFit, in_units_of_level, pooled_scores
from beam_ident.noise.scores import Scores, Whiteness, colour_warning
from beam_ident.sensing.misfit_causes import Noise, misfit_warnings
from beam_ident.sensing.quantisation import rounding_warning
from beam_ident.sensing.still_noise import StillNoise, counted_input_warning, found_noise_warning

_IDLE_LEVEL = 1e-3  # an input that is less likely to do nothing is not said to


@dataclass(frozen=True, eq=False)
class Findings:
    """What a search has found, to be made into a result.

    Attributes
    ----------
    weighed : Weighed -- by the noise as it is
    found : ModalModel -- of it, without clocks that outputs have of their own
    plain : ModalRegression -- of the same records with equal weights
    records : sequence of TimeRecord
    band : Band -- where modes were looked for
    clocks : SignalClocks
    priors : tuple of Prior -- of latency and clock rate
    found_noise : mapping -- of inputs that did not state theirs
    samples : callable -- returns some samples of the fit, for tests
    """

    weighed: Weighed[ModalRegression]
    found: ModalModel
    plain: ModalRegression
    records: Sequence[TimeRecord]
    band: Band
    clocks: SignalClocks
    priors: tuple[Prior, Prior]
    found_noise: Mapping[int, StillNoise]
    samples: Callable[[], SampledFit]

    def result(self, orders: tuple[OrderEntry, ...], unrelated: str) -> IdentificationResult:
        """Return the result.

        Parameters
        ----------
        orders : tuple of OrderEntry -- that were tried
        unrelated : str -- why the input may not drive the outputs at all, or nothing
        """
        fit, regression = self.weighed.fit, self.weighed.problem
        model, jumps = self.clocks.clocked(self.found, fit), self.clocks.estimated_jumps(fit)
        changes = self.clocks.frequency_changes(fit)
        rigid = [self._rigid(j, fit, regression) for j in range(regression.n_outputs)]
        deflections: Sequence[FloatArray] = regression.values
        if any(map(np.any, rigid)):
            deflections = residuals_of(regression, fit.omegas, fit.zetas, fit.clock, rigid)
        outputs = tuple(
            self._output_fit(j, fit, regression, deflections[j], self.weighed.by_record.row_levels(j))
            for j in range(regression.n_outputs)
        )
        return IdentificationResult(
            model=model,
            structure=replace(regression.structure, changes=()),  # they are of these records
            outputs=outputs,
            orders=orders,
            band=self.band,
            converged=fit.converged,
            reason=fit.reason,
            iterations=fit.iterations,
            warnings=tuple(
                [f"{unrelated}."] * bool(unrelated)
                + clock_sentences(model)
                + hold_warnings(model, self.plain.drives, not self.priors[0].is_free)
                + [jump.sentence for jump in jumps]
                + [change.sentence for change in changes]
                + self._gain_warnings(model)
                + self._input_warnings(model)
                + self._warnings(fit, regression, outputs)
            ),
            doubts=tuple(mode_complaint(fit, regression, mode, self.band) for mode in range(len(fit.omegas))),
            clock_jumps=jumps,
            frequency_changes=changes,
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
            share = max(float(np.max(noise_shares(path, drive))) for drive in drives)
            if share > VISIBLE_SHARE:
                warnings.append(
                    f"Noise on input {path.input_name} makes up {share:.0%} of the noise variance of an output. "
                    "With several inputs it is not weighed: estimates may be biased, and standard deviations do "
                    "not include it."
                )
        return warnings

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
                innovations=fit.innovations[j][part] if fit.innovations else np.empty(0),
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

    def _noises(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[list[Noise]]:
        """Return what is known of the noise in every record of every output: where it is loud, or from the input."""
        if not np.max(fit.input_noise_shares) > VISIBLE_SHARE or len(self.plain.pieces) > 1:
            return [[Noise(own.spread) for own in output.records] for output in outputs]
        weights = InputNoiseWeights.of_residuals(self.records, regression, fit, Smoothing(self.band.high_hz))
        return [
            [Noise(turn=turn) for turn in weights.turns(regression, j)] for j in range(regression.n_outputs)
        ]

    def _warnings(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        records = [(output.name, output.records) for output in outputs]
        parts = [
            (name, [(own.times_s, own.modelled, own.residuals) for own in fits]) for name, fits in records
        ]
        return [
            *mode_warnings(fit, regression, self.band),
            *gap_sentences(regression),
            *self._motion_warnings(fit, regression, outputs),
            *filter(None, (outlier_warning(records), rounding_warning(records))),
            *misfit_warnings(parts, self._noises(fit, regression, outputs)),
            *self._path_warnings(fit, regression, outputs),
            *rate_warnings(fit.clock.rate, self.priors[1]),
            *self._noise_warnings(fit, regression, outputs),
        ]

    def _motion_warnings(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        """Return what must be known of motion that the structure leaves out, or that nothing shows."""
        warnings = []
        if not regression.structure.has_free_response:
            warnings += left_out_motion(fit, self.samples())
        if not self.band.is_excited:
            return [
                *warnings,
                "The input stands still: only the free decay was identified, residues mean nothing.",
            ]
        if regression.structure.kind == "force":
            some = self.samples()
            friction = FrictionEstimate.of(some.fit, some.regression)
            warnings += [friction.warning()] * friction.is_visible
        # What begins anew where hardly a sample follows is known by the bridge all the same.
        if fit.rank_deficient and not regression.restarts.count:
            names = ", ".join(outputs[j].name for j in fit.rank_deficient)
            warnings.append(f"Some linear terms cannot be told apart at {names}; they were set to zero.")
        return warnings

    def _path_warnings(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        """Return what must be known of the way from the only input to the outputs."""
        if regression.n_forced > 1 or not self.band.is_excited:
            return []
        warnings = no_body_alone(self.found, regression, outputs, self.records)
        if len(regression.pieces) == 1:
            warnings += bent_input(self.found, fit, regression, outputs, self.samples, self.records)
        return warnings

    def _noise_warnings(
        self, fit: ModalFit, regression: ModalRegression, outputs: tuple[OutputFit, ...]
    ) -> list[str]:
        """Return what must be known of noise on the input, or of the colour of that on the outputs."""
        shares, warnings = fit.input_noise_shares, []
        if self.found_noise and np.max(shares) > 0.0:
            index = max(self.found_noise, key=lambda k: self.found_noise[k].sigma)
            treatment = (
                "Inputs and outputs were weighed together as if sigma of the InputSignal had stated it."
            )
            warnings.append(found_noise_warning(regression.drives[index], self.found_noise[index], treatment))
        is_visible = np.max(shares) > VISIBLE_SHARE
        if is_visible or not fit.converged:
            warnings += [said for drive in self.plain.drives if (said := counted_input_warning(drive))]
        if not is_visible:
            figures = ((own.whiteness, own.measured, own.residuals) for own in outputs)
            return warnings + colour_warning(regression.output_names, *zip(*figures, strict=True))
        worst = int(np.argmax(shares))
        is_hidden = self.band.high_hz < self.band.unfolded_hz
        warnings.append(
            f"Noise on the input makes up {shares[worst]:.0%} of the noise variance of "
            f"{outputs[worst].name}. Inputs and outputs were weighed together; the standard deviations "
            "include it as far as the input's sigma is right."
            + f" Above {self.band.high_hz:.3g} Hz what moves the input does not stand out of it, and modes are "
            "missed." * is_hidden
        )
        if len(self.plain.pieces) > 1:
            warnings.append(
                f"A record of more than {MAX_WHOLE} samples was searched as if {regression.input_names[0]} had "
                "no noise, which was weighed in the last fit alone: modes may be missing, or too many. Compare "
                "with what a stretch of fewer samples shows, or give n_modes."
            )
        return warnings
