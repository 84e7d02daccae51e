"""Figures of an identification: record, fit, spectra, model response, modes and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.figures.canvas import (
    COLOURS,
    MEASURED,
    MODEL,
    REFERENCE,
    axes_grid,
    readable,
    stacked_axes,
    thinned,
)
from beam_ident.modal.identification_result import IdentificationResult, OutputFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES = ("-", "--", ":", "-.")  # of one input after the other


def time_figure(record: TimeRecord) -> Figure:
    """Draw every signal of a record over time."""
    signals: list[InputSignal | OutputSignal] = [*record.inputs, *record.outputs]
    figure, axes = stacked_axes(len(signals), 1.5 * len(signals) + 0.6)
    for number, (axis, signal) in enumerate(zip(axes, signals, strict=True)):
        factor, unit = readable(signal.values, signal.unit)
        keep = thinned(len(signal.values))
        colour = MEASURED if number < len(record.inputs) else COLOURS[0]
        axis.plot(signal.times_s[keep], factor * signal.values[keep], color=colour, linewidth=0.7)
        axis.set_ylabel(f"{signal.name} [{unit}]")
    axes[-1].set_xlabel("time [s]")
    return figure


def fit_figure(result: IdentificationResult, deflection: bool = True) -> Figure:
    """Draw the measured and the modelled outputs, or their deflections, over time."""
    outputs = result.outputs
    figure, axes = stacked_axes(len(outputs), 1.8 * len(outputs) + 0.6)
    for axis, output in zip(axes, outputs, strict=True):
        measured = output.deflection if deflection else output.measured
        modelled = measured - output.residuals
        factor, unit = readable(measured, output.unit)
        axis.plot(output.times_s, factor * measured, color=MEASURED, linewidth=1.4, label="measured")
        axis.plot(output.times_s, factor * modelled, color=MODEL, linewidth=0.6, label="model")
        axis.set_ylabel(f"{'w ' if deflection else ''}{output.name} [{unit}]")
        scores = output.deflection_scores if deflection else output.scores
        axis.set_title(f"FIT {scores.fit_percent:.2f} %, R² {scores.r_squared:.6f}", fontsize=9, loc="left")
    axes[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=2)
    axes[-1].set_xlabel("time [s]")
    return figure


def _density(output: OutputFit, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.signal import welch

    steps = np.diff(output.times_s)
    rate = 1.0 / float(np.median(steps[steps > 0.0]))
    frequencies, density = welch(values, rate, nperseg=min(len(values), 512))
    return frequencies[1:], np.sqrt(density[1:])


def spectrum_figure(result: IdentificationResult) -> Figure:
    """Draw the spectra of the deflections and of the residuals, up to half the outputs' rate."""
    outputs = result.outputs
    figure, axes = stacked_axes(len(outputs), 1.8 * len(outputs) + 0.6)
    for axis, output in zip(axes, outputs, strict=True):
        for values, colour, label in (
            (output.deflection, MEASURED, "measured deflection"),
            (output.residuals, MODEL, "residual"),
        ):
            frequencies, density = _density(output, values)
            axis.semilogy(frequencies, density, color=colour, linewidth=0.9, label=label)
        rate = 1.0 / float(np.median(np.abs(np.diff(output.times_s))))
        for number, hertz in enumerate(result.model.frequencies_hz):
            alias = abs(hertz - rate * round(hertz / rate))
            axis.axvline(alias, color=REFERENCE, linewidth=0.7, linestyle="-" if hertz < rate / 2 else ":")
            axis.annotate(
                f"{number + 1}",
                (alias, 0.96),
                xycoords=("data", "axes fraction"),
                fontsize=7,
                color=REFERENCE,
            )
        axis.set_ylabel(f"{output.name} [{output.unit}/√Hz]")
    axes[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=2)
    axes[-1].set_xlabel("frequency in the frames [Hz]")
    return figure


def frequency_response_figure(result: IdentificationResult, n_points: int = 1500) -> Figure:
    """Draw magnitude and phase of the model with 95 % bands over the searched band, from every input."""
    model = result.model
    low = max(result.band.low_hz, 1e-3)
    high = max(result.band.high_hz, 1.2 * float(model.frequencies_hz[-1]))
    near = [
        f * (1.0 + max(z, 1e-4) * np.linspace(-8.0, 8.0, 121))
        for f, z in zip(model.frequencies_hz, model.damping_ratios, strict=True)
    ]
    hertz = np.unique(np.concatenate([np.geomspace(low, high, n_points), *near]))
    hertz = hertz[hertz > 0.0]
    figure, axes = stacked_axes(2, 5.0)
    responses = [(path.input_name, path.frequency_response(2.0 * np.pi * hertz)) for path in model.paths]
    for number, (drive, response) in enumerate(responses):
        style = _LINES[number % len(_LINES)]
        for j, name in enumerate(model.output_names):
            colour = COLOURS[j % len(COLOURS)]
            label = f"{name} over {drive}" if len(responses) > 1 else name
            size, spread = np.abs(response.response[:, j]), 1.96 * response.magnitude_sd[:, j]
            axes[0].loglog(hertz, size, color=colour, linewidth=1.0, linestyle=style, label=label)
            axes[0].fill_between(
                hertz, np.maximum(size - spread, size * 1e-3), size + spread, color=colour, alpha=0.2
            )
            phase = np.unwrap(np.angle(response.response[:, j])) * 180.0 / np.pi
            axes[1].semilogx(hertz, phase, color=colour, linewidth=1.0, linestyle=style)
    axes[0].set_ylabel("magnitude")
    axes[0].legend(loc="best", fontsize=8, frameon=False, ncols=3)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def pole_figure(
    result: IdentificationResult, reference_modes: Sequence[tuple[str, float, float]] | None = None
) -> Figure:
    """Draw damping ratio over frequency with 95 % intervals, and reference modes where given."""
    from matplotlib.ticker import LogFormatter

    model = result.model
    figure, (axis,) = stacked_axes(1, 3.2)
    axis.errorbar(
        model.frequencies_hz,
        100.0 * model.damping_ratios,
        xerr=1.96 * model.natural_frequency_sd / (2.0 * np.pi),
        yerr=196.0 * model.damping_ratio_sd,
        fmt="o",
        color=MODEL,
        capsize=3,
        markersize=5,
        label="identified, 95 %",
    )
    for number, (name, omega, zeta) in enumerate(reference_modes or ()):
        label = "reference" if number == 0 else None
        axis.plot(omega / (2.0 * np.pi), 100.0 * zeta, "x", color=REFERENCE, markersize=8, label=label)
        axis.annotate(
            name, (omega / (2.0 * np.pi), 100.0 * zeta), textcoords="offset points", xytext=(6, 6), fontsize=8
        )
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(LogFormatter())
    axis.xaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(2.0, 0.4)))
    axis.set_ylim(0.0, 1.15 * axis.get_ylim()[1])
    axis.set_xlabel("natural frequency [Hz]")
    axis.set_ylabel("damping ratio [%]")
    axis.legend(loc="best", fontsize=8, frameon=False)
    return figure


def residual_figure(result: IdentificationResult) -> Figure:
    """Draw the residuals over time beside their autocorrelation."""
    outputs = result.outputs
    figure, axes = axes_grid(
        len(outputs), 2, (9.0, 1.8 * len(outputs) + 0.6), width_ratios=(2, 1), sharex="col"
    )
    for (left, right), output in zip(axes, outputs, strict=True):
        factor, unit = readable(output.residuals, output.unit)
        left.plot(output.times_s, factor * output.residuals, ".", color=MODEL, markersize=1.5)
        left.set_ylabel(f"{output.name} [{unit}]")
        lags = np.arange(1, len(output.whiteness.autocorrelation) + 1)
        right.bar(lags, output.whiteness.autocorrelation, color=MEASURED, width=0.7)
        for bound in (-output.whiteness.band, output.whiteness.band):
            right.axhline(bound, color=MODEL, linewidth=0.8, linestyle="--")
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("lag [samples]")
    axes[0][0].set_title("residual", fontsize=9, loc="left")
    axes[0][1].set_title("autocorrelation, 99 % band", fontsize=9, loc="left")
    return figure
