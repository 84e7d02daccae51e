"""Tests of what a fit leaves unsaid: an input that does not drive it, motion left out, an input bent on its way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.bandwidth import Band
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import OutputFit
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.variable_projection import designs
from beam_ident.noise.relation import innovation_criterion, leaves_less, without_drift
from beam_ident.noise.scores import ScoreTest, are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.sensing.misfit_causes import bent_input_warning, cubed, input_misfit_warnings

_BENT_INPUT_LEVEL = 1e-5  # chance to call a sound input bent; of two outputs with one noise 1e-3
_LEFT_OUT_LEVEL = 1e-3  # how often motion at the beginning is warned of where there is none
THINNED = 25_000  # of a record: so many
_CONTRADICTION = 4.0  # standard deviations: once in 16 000 records whose clock is as stated
VISIBLE_SHARE = 0.01  # of an output's noise variance: from here on it is reported


@dataclass(frozen=True, eq=False)
class SampledFit:
    """A fit at some samples of a long record, for tests that need all columns at once."""

    regression: ModalRegression
    fit: ModalFit
    designs: list[FloatArray]  # derivatives of the model at every output by (theta, its linear parameters)

    @cached_property
    def solutions(self) -> list[LinearSolution]:
        """The same, decomposed."""
        return [LinearSolution.of(design) for design in self.designs]

    @staticmethod
    def of(regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior) -> SampledFit:
        """Choose them at random; a short record is taken as it is."""
        if len(regression.pieces) > 1:
            regression = regression.thinned(THINNED)
            residuals = residuals_of(regression, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
            fit = replace(fit, residuals=tuple(residuals))
        return SampledFit(regression, fit, designs(regression, fit, latency, clock_rate))


def unrelated(regression: ModalRegression, base: ModalFit, fit: ModalFit, band: Band) -> str:
    """Return that modes explain no more of the outputs than noise of any colour would, or an empty string."""
    if not band.is_excited:
        return ""
    if all(are_rounding(v, e) for v, e in zip(regression.values, fit.residuals, strict=True)):
        return ""
    terms = regression.structure
    log_n = math.log(regression.n_samples)
    parts = [(j, part) for j, segments in enumerate(regression.segments) for _, part in segments]
    measured = [(regression.times[j][part], regression.values[j][part]) for j, part in parts]
    drifts = (int(terms.has_offset) + int(terms.has_ramp)) * len(parts)
    without = innovation_criterion(without_drift(measured, terms.has_offset, terms.has_ramp)) + drifts * log_n
    if len(fit.omegas) and base.n_parameters > drifts:
        # Direct terms that were fitted as if noise were white may themselves make it look less predictable.
        direct = innovation_criterion([base.residuals[j][part] for j, part in parts])
        without = min(without, direct + base.n_parameters * log_n)
    if leaves_less([fit.residuals[j][part] for j, part in parts], fit.n_parameters * log_n, without):
        return ""
    drives = ", ".join(map(repr, regression.input_names))
    return (
        f"the modes driven by {drives} explain no more than chance would: BIC prefers noise without an input"
    )


def left_out_motion(fit: ModalFit, some: SampledFit) -> list[str]:
    """Return what is to be said where motion at the beginning was left out by request, and is there."""
    columns = some.regression.initial_motions(fit.omegas, fit.zetas, fit.clock)
    tested = zip(columns, some.solutions, some.fit.residuals, some.regression.values, strict=True)
    p_value = ScoreTest.of(tested).p_value
    if p_value > _LEFT_OUT_LEVEL:
        return []
    return [
        f"The record began in motion (p = {p_value:.1g}), and the structure leaves that out: poles and damping "
        "ratios are biased. Leave has_free_response as it is by default."
    ]


def bent_input(
    model: ModalModel,
    fit: ModalFit,
    regression: ModalRegression,
    outputs: tuple[OutputFit, ...],
    some: Callable[[], SampledFit],
    records: Sequence[TimeRecord],
) -> list[str]:
    """Return that the residuals of outputs hold the answer to the cube of the only input.

    What the model could explain by other values of its parameters counts for nothing. Noise on a measured input
    is in its cube as well as in the residuals: where it matters, nothing is said.
    """
    coloured = [j for j, output in enumerate(outputs) if not output.whiteness.is_white]
    if not coloured or np.max(fit.input_noise_shares) > VISIBLE_SHARE:
        return []
    tested = []
    solutions = some().solutions
    instants = regression.instants(fit.clock)
    for j in coloured:
        answers = []
        for index, part in regression.segments[j]:
            (drive,) = regression.inputs[index]
            seen = records[index].output(outputs[j].name)
            half = 0.5 * seen.exposure_s
            first, last = drive.span_s
            bent = cubed(drive).seen_through(seen.low_pass)
            # What a late clock sees beyond the input's ends stands there more than once.
            inside, rows = np.unique(
                np.clip(instants[j][part], first + half, last - half), return_inverse=True
            )
            answers.append(model.simulate(bent, inside, 2.0 * half)[rows, j])
        tested.append(
            (np.concatenate(answers)[:, None], solutions[j], fit.residuals[j], regression.values[j])
        )
    if ScoreTest.of(tested).p_value > _BENT_INPUT_LEVEL:
        return []
    return [bent_input_warning(", ".join(outputs[j].name for j in coloured), regression.input_names[0])]


def no_body_alone(
    model: ModalModel,
    regression: ModalRegression,
    outputs: tuple[OutputFit, ...],
    records: Sequence[TimeRecord],
) -> list[str]:
    """Return which outputs do more with the only input than a rigid body alone does, where no mode was found."""
    if len(model.natural_frequencies):
        return []

    def goes_with_the_input(j: int) -> bool:
        for (index, _), own in zip(regression.segments[j], outputs[j].records, strict=True):
            drive = records[index].input(model.input_name)
            exposure_s = records[index].output(outputs[j].name).exposure_s
            part = (own.times_s, own.modelled, own.residuals)

            def respond(
                drive: InputSignal, times: FloatArray = own.times_s, exposure_s: float = exposure_s
            ) -> FloatArray:
                return model.simulate(drive, times, exposure_s)[:, j]

            if input_misfit_warnings(outputs[j].name, drive, part, respond):
                return True
        return False

    shares = [
        f"{1.0 - own.scores.r_squared:.0%} of {own.name}"
        for j, own in enumerate(outputs)
        if goes_with_the_input(j)
    ]
    if not shares:
        return []
    return [
        f"A rigid body without a mode was found, and what it leaves goes with {model.input_name} "
        f"({', '.join(shares)}): input and output are swapped, the structure is not that of the sensors and their "
        "units, or modes lie outside the band."
    ]


def rate_warnings(found: float, known: Prior) -> list[str]:
    """Return what is to be said of a clock rate that contradicts what was known of it."""
    if not 0.0 < known.sd < math.inf or abs(found - known.mean) <= _CONTRADICTION * known.sd:
        return []
    return [
        f"The outputs' clock runs {1e6 * found:+.4g} ppm fast, {abs(found - known.mean) / known.sd:.2g} standard "
        f"deviations of clock_rate from what it states ({1e6 * known.mean:.4g} +- {1e6 * known.sd:.4g} ppm): are the "
        "stamps of both clocks seconds? Poles are biased, unless a wider clock_rate is given."
    ]
