"""An identification in plain numbers, beside the theory of its rig: for JSON, for a report and for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from beam_ident import (
    IdentificationResult,
    LineResult,
    ModalModel,
    Result,
    SeparateOutputsResult,
    TimeResult,
    ValidationResult,
    models_of,
)
from beam_ident.report.evidence import Agreement, ModeRow
from beam_ros.offline.loading.experiment import Experiment

SCHEMA = 1
_MOST_DEVIATIONS = 999
_HERTZ = 2.0 * math.pi


def describe(
    experiments: Sequence[Experiment],
    estimator: str,
    result: Result,
    modes: Sequence[ModeRow],
    agreement: Agreement | None,
) -> dict[str, Any]:
    """Summarise an identification in plain numbers, beside the theory of its rig.

    Parameters
    ----------
    experiments : sequence of Experiment
    estimator : str
    result : Result
    modes : sequence of ModeRow -- with all their uncertainties
    agreement : Agreement or None -- of the modes with theory
    """
    experiment = experiments[0]
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "bag": str(experiment.path),
        "bags": [str(one.path) for one in experiments],
        "apparatus": experiment.apparatus.kind,
        "estimator": estimator,
        "structure": experiment.structure,
        "outputs": list(experiment.output_names),
        "modes": _modes(result, modes, agreement),
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
    notes = [
        note if len(experiments) == 1 else f"{one.path.name}: {note}"
        for one in experiments
        for note in one.notes
    ]
    return content | {"converged": result.converged, "warnings": list(result.warnings), "notes": notes}


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


def validation_scores(results: Sequence[ValidationResult]) -> dict[str, dict[str, Any]]:
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
