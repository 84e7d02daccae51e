"""The report of an identification: one self-contained HTML page that a laboratory puts its name to.

It begins with a sheet to sign: verdict, modes, fit, response, validation, assumptions.  Behind it stands the
evidence: budgets, data, model, residuals, theory, and where everything came from.  Every caption says what is shown
and where not to trust it.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import figures
from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.amplitude.linearity import Linearity
from beam_ident.axis.axis_result import AxisResult, meaning_of
from beam_ident.best_linear.result import BestLinearApproximation
from beam_ident.data.records import TimeRecord, busiest_stretch
from beam_ident.evaluation.assumptions import assumptions
from beam_ident.figures.identification import Fitted
from beam_ident.modal.identification_result import FrequencyDomainResult, IdentificationResult
from beam_ident.quantities import nearest_mode, r_squared, sentence, small
from beam_ident.report.equation import add_equation
from beam_ident.report.evidence import (
    Agreement,
    Budget,
    ErrorSources,
    ModeRow,
    Theory,
    Trial,
    Unseen,
    beside_theory,
    fitted_outputs,
    mode_rows,
)
from beam_ident.report.gates import Gate
from beam_ident.report.measurement import (
    add_best_linear,
    add_frequency_domain,
    add_records,
    add_response,
    add_stabilisation,
)
from beam_ident.report.modes import add_budgets, add_modes, add_poles, add_shapes, add_theory
from beam_ident.report.page import Cell, Drawn, Page, Tone
from beam_ident.report.validation import add_predictions, add_trials, add_validation
from beam_ident.report.verdict import add_gates, add_verdict, judge
from beam_ident.results import LineResult, Result
from beam_ident.summary import models_of


def write_report(path: str | Path, title: str, *parts: Any, overwrite: bool = False, **more: Any) -> Path:
    """Write the report of an identification as one HTML file, which appears whole or not at all.

    Parameters
    ----------
    path : path of the file; its folder is made where it is missing
    title : str
    parts, more
        As ``identification_page`` takes them.
    overwrite : bool -- whether a file that is there may be replaced

    Raises
    ------
    ReportError
        The file is there and may not be replaced.
    """
    return identification_page(title, *parts, **more).write(path, overwrite)


def identification_page(
    title: str,
    record: TimeRecord | Sequence[TimeRecord],
    result: Result,
    reference_modes: Sequence[tuple[str, float, float]] | None = None,
    provenance: Mapping[str, Mapping[str, Any]] | None = None,
    notes: Sequence[str] = (),
    *,
    gates: Sequence[Gate] = (),
    validation: Sequence[Unseen] = (),
    theory: Theory | None = None,
    sources: ErrorSources | None = None,
    trials: Sequence[Trial] = (),
    curves: AmplitudeCurves | None = None,
    best_linear: BestLinearApproximation | None = None,
    linearity: Linearity | None = None,
    axis: AxisResult | None = None,
    links: Sequence[tuple[str, str]] = (),
    simulated: str = "",
    operator: str = "",
    drawn: Drawn = "all",
) -> Page:
    """Build the report of an identification.

    Parameters
    ----------
    title : str
    record : TimeRecord, or sequence of them -- what was measured
    result : Result -- of any estimator
    reference_modes : sequence of (name, omega [rad/s], zeta), optional
        Modes to mark beside the identified ones; None takes those of ``theory``.
    provenance : mapping of mappings, optional
        Where everything came from, group by group: bags, rig, versions.
    notes : sequence of str -- what a reader should know of the data
    gates : sequence of Gate -- what was looked at in the data before the fit
    validation : sequence of Unseen -- the result on records that it was not fitted to
    theory : Theory, optional
    sources : ErrorSources, optional -- what the scatter of the samples cannot show
    trials : sequence of Trial -- the records one by one, where there are several
    curves : AmplitudeCurves, optional -- of frequency and damping over amplitude
    best_linear : BestLinearApproximation, optional -- noise and nonlinear distortion line by line
    linearity : Linearity, optional -- whether one pole describes each mode
    axis : AxisResult, optional -- mass and friction of the axis
    links : sequence of (text, address) -- files beside the page
    simulated : str -- what stands under the title where the data are simulated; empty where they were measured
    operator : str -- who answers for the data
    drawn : "none", "sheet" or "all" -- which figures are drawn: those of the sheet to sign, or of the evidence too

    Returns
    -------
    Page
    """
    records = [record] if isinstance(record, TimeRecord) else list(record)
    known = ErrorSources() if sources is None else sources
    models = models_of(result)
    modes = mode_rows(models, known)
    agreement = None if theory is None else beside_theory(modes, theory)
    modal = result if isinstance(result, IdentificationResult) else None
    doubts, changes = ((), ()) if modal is None else (modal.doubts, modal.frequency_changes)
    page = Page(title, _lead(records, result, modes), simulated, drawn)
    longest = max(records, key=lambda one: one.outputs[0].times_s[-1] - one.outputs[0].times_s[0])
    shown = busiest_stretch(longest)
    outputs = fitted_outputs(result, records[0])
    page.section("Verdict")
    add_verdict(page, judge(result, gates, validation, agreement, records))
    page.section("Modes")
    add_modes(page, modes, doubts, changes)
    _add_fit(page, result, outputs)
    add_response(page, shown, models, modes)
    page.section("Validation")
    add_validation(page, validation)
    if curves is not None:
        _add_curves(page, curves, modes, theory)
    if axis is not None:
        _add_axis(page, axis)
    if best_linear is not None:
        page.section("Noise and distortion")
        add_best_linear(page, best_linear)
    page.section("Assumptions")
    _add_assumptions(page, result, records, validation, agreement, linearity)
    if linearity is not None and not linearity.is_linear:
        _add_linearity(page, linearity)
    page.signature(operator)
    for text, address in links:
        page.link(text, address)
    page.evidence()
    page.section("Modes and shapes")
    add_budgets(page, modes)
    add_poles(page, models, modes, _reference(reference_modes, theory, modes), known)
    for model in models:
        add_shapes(page, model, theory, known)
    _add_data(page, records, gates, notes)
    page.section("Model")
    add_equation(page, models, records[0])
    page.section("Residuals")
    _add_residuals(page, outputs, modes)
    if page.draws:
        _add_frequency_response(page, shown, longest, models, modes)
    page.section("Order")
    _add_orders(page, result)
    if page.draws:
        add_stabilisation(page, shown, models, modes)
    if theory is not None and agreement is not None and modes:
        page.section("Theory")
        add_theory(page, modes, theory, agreement)
    if validation and page.draws:
        page.section("Predictions")
        add_predictions(page, validation)
    if len(trials) > 1:
        page.section("Linearity and repeatability")
        add_trials(page, trials)
    page.provenance(provenance or {})
    return page


def _add_data(page: Page, records: Sequence[TimeRecord], gates: Sequence[Gate], notes: Sequence[str]) -> None:
    """Add what was looked at in the data before the fit."""
    page.section("Data quality")
    if gates:
        add_gates(page, gates)
    for note in notes:
        page.warning(f"{note}.", tone="doubt")
    add_records(page, records)


def _add_frequency_response(
    page: Page,
    shown: TimeRecord,
    longest: TimeRecord,
    models: Sequence[Any],
    modes: Sequence[ModeRow],
) -> None:
    """Add the frequency responses of a record, or of the stretch of it that moves most."""
    page.section("Frequency response")
    if shown is not longest:
        begin, end = shown.outputs[0].times_s[[0, -1]]
        page.paragraph(
            f"The record is long: frequency responses and stabilisation are those of {begin:.0f} to {end:.0f} s, "
            "where its input moves most. The fit is that of all of it."
        )
    add_frequency_domain(page, shown, models, modes)


def _add_assumptions(
    page: Page,
    result: Result,
    records: Sequence[TimeRecord],
    validation: Sequence[Unseen],
    agreement: Agreement | None,
    found: Linearity | None,
) -> None:
    """Add what the numbers rest on, each with the test of it, so that no untested assumption looks tested."""
    unseen = [o for one in validation for own in one.results for o in own.outputs]
    n_free = sum(o.input_correlation.is_independent for o in unseen)
    free = f"{n_free} of {len(unseen)} residuals of unseen data are free of the input"
    rows: list[tuple[str, str, float, str]] = [
        *((own.name, own.verdict, own.p_value, own.test) for own in assumptions(result, records)),
        (
            "the model holds for other data",
            "not tested" if not unseen else "holds" if n_free == len(unseen) else "fails",
            math.nan,
            free if unseen else "no unseen data",
        ),
        ("the structure is linear", "not tested", math.nan, "no test of it was made")
        if found is None
        else (
            "the structure is linear",
            "holds" if found.is_linear else "fails",
            found.p_value,
            found.verdict,
        ),
        ("the structure is that of theory", "not tested", math.nan, "there is no theory")
        if agreement is None or not np.isfinite(agreement.chi_squared)
        else (
            "the structure is that of theory",
            "fails" if agreement.is_doubtful else "holds",
            agreement.p_value,
            agreement.verdict,
        ),
    ]
    tones: dict[str, Tone] = {"holds": "good", "fails": "bad", "not tested": "doubt"}
    page.table(
        ["assumption", "verdict", "p", "test"],
        [[name, Cell(verdict, tones[verdict]), small(p), sentence(test)] for name, verdict, p, test in rows],
        "What the intervals above rest on. p: how often chance alone would speak against it as much.",
    )


def _add_linearity(page: Page, found: Linearity) -> None:
    """Write which modes one pole does not describe, and how much they change."""
    page.warning(
        sentence(found.verdict),
        "State frequency and damping with their amplitude, or ask for the curves (--amplitude).",
        tone="doubt",
    )
    others = [mode for mode in found.modes if mode.p_value != min(one.p_value for one in found.modes)]
    if others:
        page.paragraph(f"The others, to first order: {'; '.join(map(str, others))}.")


def _add_curves(
    page: Page, curves: AmplitudeCurves, modes: Sequence[ModeRow], theory: Theory | None = None
) -> None:
    """Write how frequency and damping change with amplitude."""
    page.section("Over amplitude")
    page.paragraph(sentence(curves.verdict))
    if not curves.is_one_pole:
        page.warning(
            "A frequency and a damping ratio of this mode hold at one amplitude only.",
            "State them with their amplitude, or this curve.",
            tone="doubt",
        )
    for warning in curves.warnings:
        page.warning(f"{warning}.", tone="doubt")
    own = nearest_mode(
        [mode.omega for mode in modes], 2.0 * math.pi * float(np.median(curves.frequencies_hz))
    )
    pole = None if own is None else (modes[own].omega / (2.0 * math.pi), modes[own].zeta)
    law = None
    if theory is not None and theory.over_amplitude is not None:
        middle = float(np.median(curves.frequencies_hz))
        law = theory.over_amplitude(curves.output_name, middle, curves.amplitudes)
    of_theory = " Dotted: what the rig's drag, large deflections and linear damping predict." if law else ""
    page.figure(
        partial(figures.amplitude_figure, curves, pole, law),
        "Frequency and damping ratio of the free decays over their amplitude; with 95 % the bands hold the whole of "
        f"each curve. Dashed: the single pole of the identification.{of_theory}",
        f"Two curves over amplitude with bands: {curves.verdict}",
        name="amplitude",
    )


def _add_axis(page: Page, axis: AxisResult) -> None:
    """Write mass and friction of the axis, and how far its records bear them out."""
    page.section("Axis")
    rows = []
    for name, unit, value, sd in zip(
        axis.names, axis.units, axis.estimates, axis.standard_deviations, strict=True
    ):
        interval = f"{value - 1.96 * sd:.6g} to {value + 1.96 * sd:.6g}"
        rows.append([meaning_of(name), unit, f"{value:.6g}", f"{sd:.2g}", interval])
    page.table(
        ["parameter", "unit", "estimate", "standard deviation", "95 %"],
        rows,
        f"The axis, by {axis.method.replace('_', ' ')}, from {axis.n_samples} positions in {axis.n_pieces} stretches "
        "of motion. Dry friction that differs by direction and a constant force cannot be told apart: without a "
        "known force, friction is taken to be equal in both directions.",
    )
    if axis.drive_verdict:
        page.paragraph(sentence(axis.drive_verdict))
    page.paragraph(sentence(axis.check.verdict))
    for warning in axis.warnings:
        page.warning(sentence(warning), tone="doubt")


def poles_table(modes: Sequence[ModeRow]) -> str:
    """Return the poles as comma-separated values, one mode a line, in SI units and Hz."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        [
            "output", "mode", "frequency_hz", "frequency_sd_hz", "damping_ratio", "damping_ratio_sd",
            "pole_real_rad_s", "pole_imaginary_rad_s", *(f"frequency_sd_{part}_hz" for part in Budget._fields),
        ]
    )  # fmt: skip
    for mode in modes:
        pole = complex(mode.omega * (-mode.zeta + np.emath.sqrt(mode.zeta**2 - 1.0)))
        numbers = (mode.omega / (2.0 * np.pi), mode.omega_sd / (2.0 * np.pi), mode.zeta, mode.zeta_sd)
        parts = ("" if np.isnan(part) else repr(part / (2.0 * np.pi)) for part in mode.of_omega)
        writer.writerow(
            [mode.output, mode.number, *map(repr, numbers), repr(pole.real), repr(abs(pole.imag)), *parts]
        )
    return stream.getvalue()


def _lead(records: Sequence[TimeRecord], result: Result, modes: Sequence[ModeRow]) -> str:
    n = sum(int(np.count_nonzero(output.is_valid)) for record in records for output in record.outputs)
    names = ", ".join(records[0].output_names)
    drives = ", ".join(drive.name for drive in records[0].inputs)
    end = "converged" if result.converged else "not converged"
    steps = f" after {result.iterations} iterations" if result.iterations else ""
    return (
        f"{len(modes)} modes from {n} samples of {names} under the input {drives}, "
        f"{len(records)} record{'s' if len(records) > 1 else ''} ({', '.join(r.name for r in records)}); "
        f"{end}{steps} ({result.reason})."
    )


def _reference(
    given: Sequence[tuple[str, float, float]] | None, theory: Theory | None, modes: Sequence[ModeRow]
) -> Sequence[tuple[str, float, float]] | None:
    if given is not None or theory is None or not modes:
        return given
    highest = 1.5 * max(mode.omega for mode in modes)
    pairs = zip(theory.natural_frequencies, theory.damping_ratios, strict=True)
    return [(f"mode {k}", float(w), float(z)) for k, (w, z) in enumerate(pairs, 1) if w < highest]


def _add_fit(page: Page, result: Result, outputs: Fitted) -> None:
    if isinstance(result, LineResult):
        ratio = result.misfit.chi_squared / result.misfit.expected
        page.paragraph(
            f"The model was fitted to lines of a frequency response. What it leaves is {ratio:.2f} times what the "
            "noise of the lines alone would leave: near 1 for a model that lacks nothing."
        )
    if not outputs:
        return
    is_modal = isinstance(result, IdentificationResult)
    page.table(
        [
            "output",
            "samples",
            "FIT [%]",
            "R²",
            "FIT of deflection [%]",
            "R² of deflection",
            "noise sd",
            "residuals",
        ],
        [
            [
                o.name,
                str(len(o.times_s)),
                f"{o.scores.fit_percent:.3f}",
                r_squared(o.scores.r_squared),
                f"{o.deflection_scores.fit_percent:.3f}" if is_modal else "–",
                r_squared(o.deflection_scores.r_squared) if is_modal else "–",
                f"{o.noise_sd:.3g} {o.unit}",
                "white" if o.whiteness.is_white else "not white",
            ]
            for o in outputs
        ],
        "How the model reproduces the data that it was fitted to. The deflection is the output less its direct part, "
        "offset and drift: the sterner score where an output is mostly its input.",
    )
    page.figure(
        partial(figures.fit_figure, outputs),
        "Measured and modelled outputs"
        + (", less direct part, offset and drift" if is_modal else ", less their mean")
        + ". A good agreement here is of the same data that the model was fitted to; only other data validate it.",
        f"measurement and model of {', '.join(o.name for o in outputs)} over time",
        "fit",
    )


def _add_residuals(page: Page, outputs: Fitted, modes: Sequence[ModeRow]) -> None:
    """Add what the model leaves over of the data that it was fitted to."""
    if not outputs:
        page.paragraph("The estimator leaves no residuals in time.")
        return
    for o in outputs:
        page.paragraph(f"{o.name}: {o.whiteness.verdict}.")
    page.figure(
        partial(figures.spectrum_figure, outputs, np.array([mode.omega for mode in modes]) / (2.0 * np.pi)),
        "Spectra of the outputs and of what the model leaves over. Numbers mark the modes; a dotted line is a mode "
        "above half the outputs' rate, drawn at its alias. A peak in the residual means a mode or a disturbance that "
        "is not in the model. Where stamps are irregular the frequency axis is approximate.",
        "spectra of outputs and residuals, with the modes marked",
        "spectra",
    )
    page.figure(
        partial(figures.residual_figure, outputs),
        "Residuals and their autocorrelation. Of white residuals one lag in a hundred leaves the band by chance; "
        "more means coloured noise, which the stated intervals count, or dynamics that the model has not, which they "
        "do not count. Whiteness does not prove the model right: noise on the input leaves white residuals too.",
        "residuals over time and their autocorrelation",
        "residuals",
    )


def _add_orders(page: Page, result: Result) -> None:
    entries = result.orders if isinstance(result, IdentificationResult | FrequencyDomainResult) else ()
    if not entries:
        page.paragraph("The order was given, or chosen output by output; the estimator keeps no table of it.")
        return
    alike = {own.weighed_by: [e for e in entries if e.weighed_by == own.weighed_by] for own in entries}
    least_bic = {kind: min(e.bic for e in own) for kind, own in alike.items()}
    least_aic = {kind: min(e.aic for e in own) for kind, own in alike.items()}
    kinds = "; ".join(kind for kind in alike if kind)
    page.table(
        ["modes", "parameters", "ΔBIC", "ΔAIC", "worst R²", "worst FIT [%]", "condition", "verdict"],
        [
            [
                str(e.n_modes),
                str(e.n_parameters),
                f"{e.bic - least_bic[e.weighed_by]:.1f}",
                f"{e.aic - least_aic[e.weighed_by]:.1f}",
                r_squared(e.r_squared),
                f"{e.worst_fit_percent:.2f}",
                f"{e.condition:.3g}",
                ("chosen" if e.is_chosen else (e.refused_because or "passed, with a higher BIC"))
                + (f" (weighed by: {e.weighed_by})" if e.weighed_by else ""),
            ]
            for e in entries
        ],
        "The orders that were tried. BIC and AIC are given above the lowest; lower is better. A number of modes that "
        "is listed twice was tried with its last mode at two frequencies."
        + (
            f" Orders weighed by other than equal weights ({kinds}) compare among themselves."
            if kinds
            else ""
        ),
        chosen=[k for k, e in enumerate(entries) if e.is_chosen],
    )
