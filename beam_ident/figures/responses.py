"""Figures of non-parametric frequency responses, alone and under a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.frequency_record import FrequencyRecord, ResponseSeries
from beam_ident.errors import EstimationError
from beam_ident.figures.canvas import COLOURS, MEASURED, MODEL, REFERENCE, stacked_axes
from beam_ident.modal.model import ModalModel
from beam_ident.transfer_function.model import TransferFunctionModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from beam_ident.best_linear.result import BestLinearApproximation


def coherence_figure(records: Sequence[FrequencyRecord]) -> Figure:
    """Draw magnitude, phase and coherence of measured responses over frequency.

    Where an estimate has no coherence, because it does not average, its relative standard
    deviation stands in the lowest panel instead.
    """
    estimates = _series(records)
    figure, axes = stacked_axes(3, 6.4)
    averages = all(estimate.coherence is not None for estimate in estimates)
    for estimate, colour in zip(estimates, _colours(estimates), strict=True):
        hertz, size = estimate.frequencies_hz, np.abs(estimate.response)
        axes[0].semilogy(hertz, size, color=colour, linewidth=1.0, label=_name(estimate))
        _band(axes[0], hertz, size, estimate.sd / np.sqrt(2.0), colour)
        axes[1].plot(hertz, np.degrees(np.angle(estimate.response)), ".", color=colour, markersize=2.0)
        if averages and estimate.coherence is not None:
            axes[2].plot(hertz, estimate.coherence, color=colour, linewidth=0.9)
        else:
            axes[2].semilogy(hertz, estimate.sd / np.maximum(size, 1e-300), color=colour, linewidth=0.9)
    axes[0].set_ylabel("magnitude")
    axes[0].legend(loc="best", fontsize=8, frameon=False, ncols=2)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_ylim(-190.0, 190.0)
    axes[2].set_ylabel("coherence" if averages else "relative sd")
    if averages:
        axes[2].set_ylim(0.0, 1.05)
    axes[2].set_xlabel("frequency [Hz]")
    return figure


def response_over_model_figure(
    records: Sequence[FrequencyRecord], model: ModalModel | TransferFunctionModel
) -> Figure:
    """Draw measured responses as points over the model's curves with their 95 % bands.

    Parameters
    ----------
    records : sequence of FrequencyRecord
        Of outputs of the model, from the model's input.
    model : ModalModel or TransferFunctionModel

    Raises
    ------
    EstimationError
        No estimate, or one of an output or input that the model has not.
    """
    estimates = _series(records)
    figure, axes = stacked_axes(2, 5.2)
    lines = np.unique(np.concatenate([e.omegas[e.omegas > 0.0] for e in estimates]))
    poles = model.poles[model.poles.imag > 0.0]
    near = [abs(p) + np.linspace(-8.0, 8.0, 61) * max(-p.real, 1e-4 * abs(p)) for p in poles]
    omegas = np.unique(np.concatenate([np.geomspace(lines[0], lines[-1], 400), *near]))
    omegas = omegas[(omegas >= lines[0]) & (omegas <= lines[-1])]
    hertz = omegas / (2.0 * np.pi)
    for estimate, colour in zip(estimates, _colours(estimates), strict=True):
        response, sd = _model_response(model, estimate, omegas)
        size = np.abs(response)
        axes[0].semilogy(hertz, size, color=colour, linewidth=1.0, label=_name(estimate))
        _band(axes[0], hertz, size, sd, colour)
        axes[0].semilogy(
            estimate.frequencies_hz, np.abs(estimate.response), ".", color=colour, markersize=2.5, alpha=0.5
        )
        axes[1].plot(hertz, np.degrees(np.angle(response)), color=colour, linewidth=1.0)
        axes[1].plot(
            estimate.frequencies_hz,
            np.degrees(np.angle(estimate.response)),
            ".",
            color=colour,
            markersize=2.5,
            alpha=0.5,
        )
    axes[0].set_ylabel("magnitude")
    axes[0].set_title("points: measured; lines: model, 95 %", fontsize=9, loc="left")
    axes[0].legend(loc="best", fontsize=8, frameon=False, ncols=2)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def best_linear_figure(found: BestLinearApproximation) -> Figure:
    """Draw the response of every output with the deviations that noise and distortion make, each with its band.

    Parameters
    ----------
    found : BestLinearApproximation
    """
    n_outputs = len(found.output_names)
    figure, axes = stacked_axes(n_outputs, 1.2 + 2.6 * n_outputs)
    hertz = found.frequencies_hz
    for j, (axis, name) in enumerate(zip(axes, found.output_names, strict=True)):
        size = np.abs(found.response[:, j])
        axis.semilogy(hertz, size, ".-", color=COLOURS[0], markersize=3.0, linewidth=0.8, label="response")
        floor = 1e-2 * np.sqrt(np.median(found.excited.noise[:, j]))
        for what, values, band, colour in (
            ("noise", found.excited.noise, found.excited.noise_band(), MEASURED),
            ("distortion", found.excited.distortion, found.excited.distortion_band(), MODEL),
        ):
            low, high = np.sqrt(band[:, :, j])
            # A band that begins at zero would fill the figure: its upper end alone is drawn.
            axis.fill_between(hertz, low, high, where=low > 0.0, color=colour, alpha=0.25, linewidth=0.0)
            axis.semilogy(hertz, np.maximum(high, floor), color=colour, alpha=0.4, linewidth=0.6)
            drawn = np.where(values[:, j] > 0.0, np.sqrt(values[:, j]), np.nan)
            axis.semilogy(hertz, drawn, ".", color=colour, markersize=4.0, label=f"{what}, with 95 %")
        for parity, lines, marker in (("even", found.even, "+"), ("odd", found.odd, "x")):
            if lines is not None:
                drawn = np.where(lines.distortion[:, j] > 0.0, np.sqrt(lines.distortion[:, j]), np.nan)
                label = f"distortion on {parity} detection lines"
                axis.semilogy(
                    lines.frequencies_hz,
                    drawn,
                    marker,
                    color=REFERENCE,
                    markersize=4.0,
                    alpha=0.6,
                    label=label,
                )
        axis.set_ylim(bottom=floor)
        axis.set_ylabel(f"{name} over {found.input_name}")
    axes[0].legend(loc="best", fontsize=7, frameon=False, ncols=2)
    axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _series(records: Sequence[FrequencyRecord]) -> list[ResponseSeries]:
    if not records:
        raise EstimationError("no frequency response is given; expected at least one estimate to draw")
    return [series for record in records for series in record.series()]


def _colours(estimates: Sequence[Any]) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(len(estimates))]


def _name(estimate: ResponseSeries) -> str:
    return f"{estimate.output_name} over {estimate.input_name} ({estimate.method})"


def _band(axis: Any, hertz: FloatArray, size: FloatArray, sd: FloatArray, colour: str) -> None:
    low = np.maximum(size - 1.96 * sd, 1e-2 * size)
    axis.fill_between(hertz, low, size + 1.96 * sd, color=colour, alpha=0.2, linewidth=0.0)


def _model_response(
    model: ModalModel | TransferFunctionModel, estimate: ResponseSeries, omegas: FloatArray
) -> tuple[Any, FloatArray]:
    names = model.output_names if isinstance(model, ModalModel) else (model.output_name,)
    inputs = model.input_names if isinstance(model, ModalModel) else (model.input_name,)
    if estimate.output_name not in names or estimate.input_name not in inputs:
        raise EstimationError(
            f"the estimate goes from {estimate.input_name!r} to {estimate.output_name!r}, the model from "
            f"{', '.join(map(repr, inputs))} to {', '.join(names)}; give estimates of the model's own signals"
        )
    if isinstance(model, ModalModel):
        found = model.path(estimate.input_name).frequency_response(omegas)
        j = names.index(estimate.output_name)
        return found.response[:, j], found.magnitude_sd[:, j]
    return model.frequency_response(omegas)
