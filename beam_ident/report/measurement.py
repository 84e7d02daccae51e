"""What was measured: records with their gaps, spectra, responses, their noise and distortion, poles that settle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from beam_ident import figures
from beam_ident.arrays import FloatArray
from beam_ident.best_linear.result import BestLinearApproximation
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.gaps import describe_gaps
from beam_ident.data.records import OutputSignal, TimeRecord
from beam_ident.errors import EstimationError, IdentificationError
from beam_ident.figures.response_curves import drawing_lines, response_curves
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_analysis.stabilisation import ResponseForm, stabilisation_chart
from beam_ident.report.evidence import ModeRow
from beam_ident.report.page import Page
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.transfer_function.model import TransferFunctionModel

_MAX_DRAWN_LINES = 240
_MAX_CHART_LINES = 4000  # of a long record the chart takes the band about the modes
_SLACK = 0.02  # of a period: stamps that lie closer to a grid are taken to be on it
_FORMS: dict[int, ResponseForm] = {0: "receptance", 1: "mobility", 2: "accelerance"}


def add_records(page: Page, records: Sequence[TimeRecord]) -> None:
    """Add what went into the estimation, record by record, gaps drawn as gaps."""
    for number, record in enumerate(records, 1):
        name = f"record-{number}" if len(records) > 1 else "record"
        page.figure(
            partial(figures.time_figure, record),
            f"What was measured in {record.name}. Where samples are missing the line is broken and, for the longest "
            "gaps, shaded. Of long records the least and the greatest value of every stretch are drawn.",
            f"{len(record.inputs)} input and {len(record.outputs)} outputs of {record.name} over time",
            name,
        )
        for drive in record.inputs:
            if drive.gaps:
                page.paragraph(describe_gaps(drive.name, drive.gaps, drive.unit))
    page.table(
        ["signal", "samples", "missing", "first [s]", "last [s]", "rate [1/s]", "exposure [ms]"],
        [row for record in records for row in _signal_rows(record, len(records) > 1)],
        "The signals; missing samples are counted against the usual step between stamps.",
    )


def _signal_rows(record: TimeRecord, is_named: bool) -> list[list[str]]:
    signals: list[tuple[str, FloatArray, int, float | None]] = [
        (drive.name, drive.times_s, sum(gap.missing for gap in drive.gaps), None) for drive in record.inputs
    ]
    rows = []
    for output in record.outputs:
        times = output.times_s[output.is_valid]
        steps = np.diff(times)
        lost = np.sum(np.maximum(np.rint(steps / np.median(steps)) - 1.0, 0.0)) if len(steps) else 0
        signals.append((output.name, times, int(lost), output.exposure_s))
    for name, times, missing, exposure in signals:
        rows.append(
            [
                f"{record.name}: {name}" if is_named else name,
                str(len(times) - (missing if exposure is None else 0)),  # those of an input are filled in
                str(missing),
                f"{times[0]:.3f}",
                f"{times[-1]:.3f}",
                f"{1.0 / float(np.median(np.diff(times))):.6g}" if len(times) > 1 else "–",
                "–" if exposure is None else f"{exposure * 1e3:.3g}",
            ]
        )
    return rows


def add_frequency_domain(
    page: Page, record: TimeRecord, models: Sequence[Any], modes: Sequence[ModeRow]
) -> None:
    """Add the spectrum of the input, and the model's response over the whole band of its modes."""
    page.figure(
        partial(figures.input_spectrum_figure, record),
        "Spectrum of the input: what it excites. A mode outside the excited band is seen only as far as it rings "
        "from the beginning on.",
        "amplitude density of the input over frequency",
        "input-spectrum",
    )
    low, high = _band(record, modes)
    lines = drawing_lines(tuple(models), 2.0 * np.pi * low, 2.0 * np.pi * max(high, 1.2 * _highest_hz(modes)))
    curves = [curve for model in models for curve in response_curves(model, lines)]
    if curves:
        page.figure(
            partial(figures.frequency_response_figure, curves),
            "The model's response over the whole band of its modes, with 95 % bands where they are known. Beyond the "
            "excited band it is an extrapolation: the bands take the structure of the model to be right there.",
            "magnitude and phase of the model's response, with bands",
            "model-response",
        )


def add_response(page: Page, record: TimeRecord, models: Sequence[Any], modes: Sequence[ModeRow]) -> None:
    """Add the measured response under the model's with its 95 % bands."""
    if not page.draws:
        return
    latency = models[0].latency if isinstance(models[0], ModalModel) else 0.0
    responses, why = _measured(record, latency)
    low, high = _band(record, modes)
    drawable = [model for model in models if isinstance(model, ModalModel | TransferFunctionModel)]
    if responses and drawable and not getattr(models[0], "further_inputs", ()):
        shown = [_few_lines(one, models, low, high) for one in responses]
        for model in drawable:
            own = model.output_names if isinstance(model, ModalModel) else (model.output_name,)
            mine = [one for one in shown if one.output_names[0] in own]
            if mine:
                page.figure(
                    partial(figures.response_over_model_figure, mine, model),
                    "Points: the response measured by local polynomials, without a model. Lines: the model with its "
                    "95 % bands. Points about a resonance that is narrower than the record can resolve lie below the "
                    "line; beyond half the rate of the outputs nothing is measured.",
                    f"measured response and model's response of {', '.join(o.output_names[0] for o in mine)}",
                    "response" if len(models) == 1 else f"response-{own[0]}",
                )
    else:
        reason = why or "the model has several inputs, or states no response"
        page.paragraph(f"There is no measured response to compare with: {reason}.")


def add_best_linear(page: Page, found: BestLinearApproximation) -> None:
    """Add the best linear approximation with its levels, and the test on the detection lines."""
    page.paragraph(f"{found.verdict[0].upper()}{found.verdict[1:]}.")
    for warning in found.warnings:
        page.warning(f"{warning}.", tone="doubt")
    reference = f", correlated with {found.reference_name}" if found.reference_name else ""
    periods = " + ".join(map(str, found.n_periods))
    page.paragraph(
        f"From {len(found.n_periods)} realisations of {periods} periods of {found.line_period_s:.6g} s{reference}; "
        f"{found.skipped_periods} at the beginning of each were left out, while it settled."
    )
    page.figure(
        partial(figures.best_linear_figure, found),
        "The response that all realisations have in common, and by what deviations one realisation differs from it: "
        "noise, as the periods show it, and nonlinear distortion, which repeats with the period and is another one "
        "with other phases. Where it stands above the noise, more periods of the same signal make the response no "
        "truer, and a linear model holds for this level and spectrum of the excitation alone. A point is missing "
        "where nothing is left beside the noise. Bands and thin lines are 95 %; of a band that begins at zero the "
        "upper end alone is drawn.",
        f"response, noise and distortion of {', '.join(found.output_names)} over frequency",
        name="best-linear",
    )
    if found.distortion is not None:
        page.table(
            [
                "output",
                "lines",
                "number",
                "distortion [dB]",
                "at most, 95 % [dB]",
                "noise [dB]",
                "p",
                "verdict",
            ],
            [
                [
                    level.output_name,
                    level.parity,
                    str(level.n_lines),
                    f"{level.level_db:.1f}",
                    f"{level.largest_db:.1f}",
                    f"{level.noise_db:.1f}",
                    f"{level.p_value:.2g}",
                    "distortion" if level.is_detected else "noise alone",
                ]
                for level in found.distortion.levels
            ],
            "Power on the lines that were not excited, against that of the excited ones: even lines show even "
            "nonlinearities (an offset, slack to one side), odd ones odd nonlinearities (stiffening, friction).",
        )


def add_stabilisation(
    page: Page, record: TimeRecord, models: Sequence[Any], modes: Sequence[ModeRow]
) -> None:
    """Add the chart of poles over orders, from the measured response and independent of the fit."""
    responses, why = _measured(record, getattr(models[0], "latency", 0.0))
    if not responses:
        page.paragraph(f"There is no stabilisation chart: {why}.")
        return
    kind = models[0].structure if isinstance(models[0], ModalModel) else "base_motion"
    form = _FORMS[ModalStructure(kind).differentiations]
    measured = responses[0]
    if len(responses) > 1:
        measured = replace(
            measured,
            response=np.concatenate([one.response for one in responses], axis=1),
            variance=np.concatenate([one.variance for one in responses], axis=1),
            output_names=tuple(name for one in responses for name in one.output_names),
            output_units=tuple(unit for one in responses for unit in one.output_units),
            warnings=(),
        )
    high = min(measured.frequencies_hz[-1], 1.3 * _highest_hz(modes) if modes else math.inf)
    low = min([0.5 * mode.omega / (2.0 * np.pi) for mode in modes] or [measured.frequencies_hz[0]])
    try:
        measured = measured.between(low, high)
        if measured.n_lines > _MAX_CHART_LINES:
            page.paragraph(f"There is no stabilisation chart: {measured.n_lines} lines are too many for one.")
            return
        chart = stabilisation_chart(measured, form, max_order=max(12, 4 * len(modes)))
    except IdentificationError as err:
        page.paragraph(f"There is no stabilisation chart: {err}.")
        return
    page.figure(
        partial(figures.stabilisation_figure, chart),
        "Poles of polynomial models of rising order, fitted to the measured response without the model of this "
        "report. A mode of the structure stays where it is from order to order; what wanders is noise. Modes that "
        "the record does not resolve, or that lie above half the rate of the outputs, do not settle here.",
        f"stabilisation chart with {len(chart.natural_frequencies)} modes that settle",
        "stabilisation",
    )


def _highest_hz(modes: Sequence[ModeRow]) -> float:
    return max([mode.omega for mode in modes], default=0.0) / (2.0 * np.pi)


def _band(record: TimeRecord, modes: Sequence[ModeRow]) -> tuple[float, float]:
    """Return the lowest and the highest frequency [Hz] that the outputs hold."""
    times = record.outputs[0].times_s
    lowest = 2.0 / float(times[-1] - times[0])
    highest = 0.5 / float(np.median(np.diff(times)))
    if modes:
        lowest = max(lowest, 0.1 * min(mode.omega for mode in modes) / (2.0 * np.pi))
    return lowest, highest


def _measured(record: TimeRecord, latency: float) -> tuple[list[FrequencyRecord], str]:
    """Return the response of every output by local polynomials, or why there is none."""
    found, why = [], ""
    for output in record.outputs:
        try:
            one = TimeRecord(record.inputs[:1], (_on_grid(output, latency),), record.start_ns, record.name)
            found.append(local_polynomial_response(one))
        except EstimationError as err:
            why = str(err)
    same = [one for one in found if np.array_equal(one.omegas, found[0].omegas)]
    return same, why


def _on_grid(output: OutputSignal, latency: float) -> OutputSignal:
    """Return an output on its own regular grid, NaN where a sample is missing; as it is where there is no grid."""
    times = output.times_s - latency
    step = float(np.median(np.diff(times)))
    places = np.rint((times - times[0]) / step)
    step, first = np.polyfit(places, times, 1)
    grid: FloatArray = first + step * places
    if np.max(np.abs(times - grid)) > _SLACK * step or len(np.unique(places)) < len(places):
        return replace(output, times_s=times)
    values = np.full(int(places[-1]) + 1, np.nan)
    values[places.astype(np.intp)] = output.values
    return replace(output, times_s=first + step * np.arange(len(values)), values=values)


def _few_lines(
    response: FrequencyRecord, models: Sequence[Any], low_hz: float, high_hz: float
) -> FrequencyRecord:
    """Return a response with as many lines as a figure needs: all of them, or those nearest to what is drawn."""
    if response.n_lines <= _MAX_DRAWN_LINES:
        return response
    wanted = drawing_lines(tuple(models), 2.0 * np.pi * low_hz, 2.0 * np.pi * high_hz, _MAX_DRAWN_LINES)
    keep = np.unique(np.clip(np.searchsorted(response.omegas, wanted), 0, response.n_lines - 1))
    return replace(
        response,
        omegas=response.omegas[keep],
        response=response.response[keep],
        variance=None if response.variance is None else response.variance[keep],
        coherence=None if response.coherence is None else response.coherence[keep],
        covariance=None,
    )
