"""An identification in plain numbers, beside the theory of its rig: for JSON, for a report and for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from beam_ident import (
    AxisResult,
    BestLinearApproximation,
    IdentificationResult,
    LineResult,
    ModalModel,
    Result,
    SeparateOutputsResult,
    TimeRecord,
    TimeResult,
    ValidationResult,
    models_of,
)
from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.amplitude.linearity import Linearity
from beam_ident.report.evidence import Agreement, ErrorSources, ModeRow, Theory, Unseen, beside_theory
from beam_ident.report.gates import Gate
from beam_ident.report.verdict import judge
from beam_ros.bags.apparatus import simulated_line
from beam_ros.offline.axis_bag import rig_values
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.offline.loading.options import FitOptions

SCHEMA = 1
_MOST_DEVIATIONS = 999
_HERTZ = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class IdentificationOutcome:
    """What came of bags: data, models, checks, validations and the verdict on them, for every page that shows it.

    Attributes
    ----------
    experiments : tuple of Experiment -- what was identified
    options : FitOptions -- how
    result : Result
    unseen : tuple of (Experiment, tuple of ValidationResult)
        What the models were scored on, and how each of them did there.
    modes : tuple of ModeRow -- every mode with all that is not known of it
    theory : Theory or None -- of the rig, where the bag describes it
    sources : ErrorSources -- what the scatter of the samples cannot show
    gates : tuple of Gate -- what was looked at in the data before the fit
    curves : AmplitudeCurves or None -- of frequency and damping over amplitude, where they were asked for
    best_linear : BestLinearApproximation or None -- noise and distortion by line, where they were asked for
    linearity : Linearity or None -- whether one pole describes each mode; None where the estimator has no modes
    axis : AxisResult or None -- mass and friction of the hub's axis, where they were asked for
    axis_notes : tuple of str -- what a reader should know of that
    """

    experiments: tuple[Experiment, ...]
    options: FitOptions
    result: Result
    unseen: tuple[tuple[Experiment, tuple[ValidationResult, ...]], ...]
    modes: tuple[ModeRow, ...]
    theory: Theory | None
    sources: ErrorSources
    gates: tuple[Gate, ...]
    curves: AmplitudeCurves | None = None
    best_linear: BestLinearApproximation | None = None
    linearity: Linearity | None = None
    axis: AxisResult | None = None
    axis_notes: tuple[str, ...] = ()

    @property
    def experiment(self) -> Experiment:
        """The first experiment, whose rig and structure hold for all."""
        return self.experiments[0]

    @property
    def simulated(self) -> str:
        """What a page must say under its title where no beam was measured; empty where all data are measured."""
        return simulated_line(
            one.apparatus for one in (*self.experiments, *(other for other, _ in self.unseen))
        )

    @property
    def records(self) -> tuple[TimeRecord, ...]:
        """The records of all experiments."""
        return tuple(record for one in self.experiments for record in one.records)

    @property
    def validation(self) -> list[Unseen]:
        """How the models did on what they had not seen, by the bag's name."""
        return [Unseen(other.path.name, results) for other, results in self.unseen]

    @cached_property
    def agreement(self) -> Agreement | None:
        """The modes beside theory, where there is one."""
        return None if self.theory is None else beside_theory(self.modes, self.theory)

    @cached_property
    def content(self) -> dict[str, Any]:
        """The same in plain numbers: what ``identification/result`` carries and ``--json`` prints."""
        return _described(self)


def _described(found: IdentificationOutcome) -> dict[str, Any]:
    """Summarise an identification in plain numbers, beside the theory of its rig."""
    experiments, result, agreement = found.experiments, found.result, found.agreement
    experiment = experiments[0]
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "bag": str(experiment.path),
        "bags": [str(one.path) for one in experiments],
        "apparatus": experiment.apparatus.kind,
        "estimator": found.options.estimator,
        "structure": experiment.structure,
        "outputs": list(experiment.output_names),
        "modes": _modes(result, found.modes, agreement),
    }
    if agreement is not None and agreement.beside:
        content["theory"] = {
            "chi_squared": agreement.chi_squared,
            "modes": len(agreement.beside),
            "p_value": agreement.p_value,
            "verdict": agreement.verdict,
        }
    model = models_of(result)[0]
    if isinstance(model, ModalModel):
        content |= {
            "latency_s": model.latency + experiment.late_s,
            "latency_sd_s": model.latency_sd,
            "clock_rate": model.clock_rate,
            "clock_rate_sd": model.clock_rate_sd,
        }
    content["scores"] = _scores(experiment, result)
    if isinstance(result, LineResult):
        content["misfit"] = result.misfit.chi_squared / result.misfit.expected
    if isinstance(result, SeparateOutputsResult) and result.tables:
        content["orders"] = list(result.tables)
    content |= {
        "converged": result.converged,
        "warnings": list(result.warnings),
        "notes": [*_notes(experiments), *found.axis_notes],
    }
    if found.unseen:
        content["validation"] = [
            {"bag": str(one.path), "scores": _validation_scores(results)} for one, results in found.unseen
        ]
    verdict = judge(result, found.gates, found.validation, agreement)
    content["verdict"] = {"tone": verdict.tone, "text": verdict.text, "reasons": list(verdict.reasons)}
    further = {
        "linearity": found.linearity,
        "amplitude": found.curves,
        "best_linear": found.best_linear,
        "axis": found.axis,
    }
    content |= {name: part.to_dict() for name, part in further.items() if part is not None}
    if found.axis is not None and experiment.rig is not None:
        content["rig_values"] = rig_values(found.axis, experiment.rig)
    return content


def _notes(experiments: Sequence[Experiment]) -> list[str]:
    """Return what a reader should know of the data, of several bags with the name of each."""
    named = (
        [(f"{one.path.name}: ", one) for one in experiments]
        if len(experiments) > 1
        else [("", experiments[0])]
    )
    return [f"{name}{note}" for name, one in named for note in one.notes]


def _modes(result: Result, modes: Sequence[ModeRow], agreement: Agreement | None) -> list[dict[str, Any]]:
    """Return every mode, beside the nearest of theory where there is one; by output where each has its own poles."""
    rows = []
    doubts = iter(result.doubts if isinstance(result, IdentificationResult) else ())
    for mode in modes:
        parts = mode.of_omega._asdict().items()
        row: dict[str, Any] = {
            "frequency_hz": mode.omega / _HERTZ,
            "frequency_sd_hz": mode.omega_sd / _HERTZ,
            "frequency_sd_parts_hz": {name: part / _HERTZ for name, part in parts if math.isfinite(part)},
            "damping_ratio": mode.zeta,
            "damping_ratio_sd": mode.zeta_sd,
        }
        beside = None if agreement is None else agreement.of(mode)
        if beside is not None:
            row |= {
                "theory_mode": beside.number,
                "theory_frequency_hz": beside.predicted / _HERTZ,
                "theory_frequency_sd_hz": beside.predicted_sd / _HERTZ,
                "theory_damping_ratio": beside.damping_ratio,
                "frequency_z": beside.z,
                "damping_ratio_z": beside.damping_z,
            }
        row["doubt"] = next(doubts, "")
        rows.append({"output": mode.output, **row} if mode.output else row)
    return rows


def _scores(experiment: Experiment, result: Result) -> dict[str, dict[str, Any]]:
    """Return how well every output is reproduced, where the result is one from samples."""
    if not isinstance(result, TimeResult):
        return {}
    parts = (result.scores, result.whiteness, result.residuals)
    scores = {
        name: {
            "fit_percent": own.fit_percent,
            "r_squared": own.r_squared,
            "noise_sd_m": float(np.std(residuals)),
            "residuals_are_white": whiteness.is_white,
        }
        for name, own, whiteness, residuals in zip(
            experiment.output_names,
            *(part if isinstance(part, tuple) else (part,) for part in parts),
            strict=True,
        )
    }
    for output in result.outputs if isinstance(result, IdentificationResult) else ():
        scores[output.name] |= {
            "deflection_fit_percent": output.deflection_scores.fit_percent,
            "deflection_r_squared": output.deflection_scores.r_squared,
            "noise_sd_m": output.noise_sd,
        }
    return scores


def _validation_scores(results: Sequence[ValidationResult]) -> dict[str, dict[str, Any]]:
    """Return how well models predict unseen data, in plain numbers, by output."""
    return {
        output.name: {
            "fit_percent": output.scores.fit_percent,
            "r_squared": output.scores.r_squared,
            "deflection_fit_percent": output.deflection_scores.fit_percent,
            "fit_from_rest_percent": output.simulation_scores.fit_percent,
            "residual_over_noise": output.noise_ratio,
            "is_independent": output.input_correlation.is_independent,
            "verdict": output.verdict,
        }
        for result in results
        for output in result.outputs
    }


def format_table(content: Mapping[str, Any]) -> str:
    """Format the identified modes, beside the theoretical ones where there are some, for a terminal."""
    has_theory = any("theory_mode" in mode for mode in content["modes"])
    lines = (
        [
            "mode    identified                    theory    off       identified            theory    off",
            "        natural frequency [Hz]                 [sd]      damping ratio [%]               [sd]",
        ]
        if has_theory
        else ["mode    natural frequency [Hz]      damping ratio [%]"]
    )
    for k, mode in enumerate(content["modes"], start=1):
        if mode.get("doubt"):
            # Deviations of a mode that is not there mean nothing, however small they come out.
            lines.append(
                f"{mode.get('output', k):>4} {mode['frequency_hz']:>13.1f} not a mode: {mode['doubt']}"
            )
            continue
        f_sd, zeta_sd = mode["frequency_sd_hz"], 100 * mode["damping_ratio_sd"]
        decimals = min(max(4, 1 - math.floor(math.log10(f_sd))), 8) if 0.0 < f_sd < math.inf else 6
        frequency = (
            f"{mode.get('output', k):>4} {mode['frequency_hz']:>13.{decimals}f} +- {_or_dash(f_sd, '<8.2g')} "
        )
        damping = f"{100 * mode['damping_ratio']:>8.5f} +- {_or_dash(zeta_sd, '<8.2g')} "
        if "theory_mode" in mode:
            frequency += (
                f"{mode['theory_frequency_hz']:>13.{decimals}f} {_deviations(mode['frequency_z'])}      "
            )
            damping += f"{100 * mode['theory_damping_ratio']:>7.4f} {_deviations(mode['damping_ratio_z'])}"
        lines.append((frequency + damping).rstrip())
    return "\n".join(lines)


def _deviations(z: float) -> str:
    """Return a difference from theory in standard deviations; so many that only "other" is true are not counted."""
    if abs(z) > _MOST_DEVIATIONS:
        return f"{'>' if z > 0.0 else '<-'}{_MOST_DEVIATIONS}".rjust(6)
    return _or_dash(z, ">+6.1f")


def _or_dash(value: float, form: str) -> str:
    """Return a number in a format that begins with alignment and width, or a dash where it is not known."""
    return (
        format(value, form) if math.isfinite(value) else format("-", form.replace("+", "").partition(".")[0])
    )
