"""Figures of an identification: record, fit, spectra, model response, modes and residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    drawn,
    readable,
    stacked_axes,
)
from beam_ident.figures.response_curves import ResponseCurve
from beam_ident.modal.identification_result import OutputFit
from beam_ident.noise.scores import Scores, Whiteness
from beam_ident.numerics.segment_spectra import segment_spectra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES = ("-", "--", ":", "-.")  # of one input, or of one model, after the other
_MANY = 12  # gaps beyond which they are not shaded one by one

Modes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Natural frequencies [rad/s], damping ratios, and the standard deviations of both, as ``modes()`` gives them."""


@dataclass(frozen=True, eq=False)
class FittedOutput:
    """One output as these figures draw it, of estimators whose results have no ``OutputFit``.

    Attributes
    ----------
    name, unit : str
    times_s, measured, residuals : ndarray, shape (n_used,)
    deflection : ndarray, shape (n_used,) -- what is drawn: measured less its mean
    scores, deflection_scores : Scores -- both on the output
    whiteness : Whiteness
    noise_sd : float -- of the residuals
    """

    name: str
    unit: str
    times_s: FloatArray
    measured: FloatArray
    residuals: FloatArray
    deflection: FloatArray
    scores: Scores
    deflection_scores: Scores
    whiteness: Whiteness
    noise_sd: float


Fitted = Sequence[OutputFit | FittedOutput]


def time_figure(record: TimeRecord) -> Figure:
    """Draw every signal of a record over time, broken and shaded where samples are missing."""
    signals: list[InputSignal | OutputSignal] = [*record.inputs, *record.outputs]
    figure, axes = stacked_axes(len(signals), 1.5 * len(signals) + 0.6)
    for axis, signal in zip(axes, signals, strict=True):
        factor, unit = readable(signal.values, signal.unit)
        values = np.array(signal.values)
        is_input = isinstance(signal, InputSignal)
        if isinstance(signal, InputSignal):  # what was filled in was not measured
            for gap in signal.gaps:
                values[(signal.times_s > gap.start_s) & (signal.times_s < gap.end_s)] = np.nan
        times, values = drawn(signal.times_s, values)
        axis.plot(times, factor * values, color=MEASURED if is_input else COLOURS[0], linewidth=0.7)
        for start, end in _holes(signal)[:_MANY]:
            axis.axvspan(start, end, color=MODEL, alpha=0.25, linewidth=0.0)
        axis.set_ylabel(f"{signal.name} [{unit}]")
    axes[-1].set_xlabel("time [s]")
    return figure


def _holes(signal: InputSignal | OutputSignal) -> list[tuple[float, float]]:
    """Return between which instants a signal has no samples, the longest first."""
    if isinstance(signal, InputSignal):
        found = [(gap.start_s, gap.end_s) for gap in signal.gaps]
    else:
        times = signal.times_s[signal.is_valid]
        steps = np.diff(times)
        wide = np.flatnonzero(steps > 1.5 * np.median(steps)) if len(steps) else np.empty(0, dtype=np.intp)
        found = [(float(times[k]), float(times[k + 1])) for k in wide]
    return sorted(found, key=lambda hole: hole[0] - hole[1])


def fit_figure(outputs: Fitted, deflection: bool = True) -> Figure:
    """Draw the measured and the modelled outputs, or their deflections, over time (``result.outputs``)."""
    figure, axes = stacked_axes(len(outputs), 1.8 * len(outputs) + 0.6)
    for axis, output in zip(axes, outputs, strict=True):
        measured = output.deflection if deflection else output.measured
        factor, unit = readable(measured, output.unit)
        for values, colour, width, label in (
            (measured, MEASURED, 1.4, "measured"),
            (measured - output.residuals, MODEL, 0.6, "model"),
        ):
            times, shown = drawn(output.times_s, factor * values)
            axis.plot(times, shown, color=colour, linewidth=width, label=label)
        is_deflection = deflection and isinstance(output, OutputFit)
        axis.set_ylabel(f"{'w ' if is_deflection else ''}{output.name} [{unit}]")
        scores = output.deflection_scores if deflection else output.scores
        axis.set_title(f"FIT {scores.fit_percent:.2f} %", fontsize=9, loc="left")
    axes[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=2)
    axes[-1].set_xlabel("time [s]")
    return figure


def _density(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    steps = np.diff(times_s)
    period = float(np.median(steps[steps > 0.0]))
    frequencies, spectra = segment_spectra(values, period, min(len(values), 512))
    return frequencies[1:], np.sqrt(np.mean(np.square(np.abs(spectra[:, 1:])), axis=0))


def spectrum_figure(outputs: Fitted, modes_hz: FloatArray) -> Figure:
    """Draw the spectra of the deflections and of the residuals, up to half the outputs' rate, with the modes."""
    figure, axes = stacked_axes(len(outputs), 1.8 * len(outputs) + 0.6)
    for axis, output in zip(axes, outputs, strict=True):
        for values, colour, label in (
            (output.deflection, MEASURED, "measured"),
            (output.residuals, MODEL, "residual"),
        ):
            frequencies, density = _density(output.times_s, values)
            axis.semilogy(frequencies, density, color=colour, linewidth=0.9, label=label)
        rate = 1.0 / float(np.median(np.abs(np.diff(output.times_s))))
        for number, hertz in enumerate(modes_hz):
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


def input_spectrum_figure(record: TimeRecord) -> Figure:
    """Draw the spectrum of every input: what it excites, and what it cannot."""
    figure, (axis,) = stacked_axes(1, 2.6)
    for number, drive in enumerate(record.inputs):
        frequencies, density = _density(drive.times_s, drive.values - np.mean(drive.values))
        colour = COLOURS[number % len(COLOURS)]
        axis.loglog(
            frequencies, density, color=colour, linewidth=0.9, label=f"{drive.name} [{drive.unit}/√Hz]"
        )
    axis.set_ylabel("input")
    axis.legend(loc="upper right", fontsize=8, frameon=False)
    axis.set_xlabel("frequency [Hz]")
    return figure


def frequency_response_figure(curves: Sequence[ResponseCurve]) -> Figure:
    """Draw magnitude and phase with 95 % bands (``response_curves`` gives the curves).

    Outputs have colours and inputs lines of their own; of several models it is the model that has the colour.
    """
    figure, axes = stacked_axes(2, 5.0)
    several_models = len({curve.label for curve in curves}) > 1
    colours = [curve.label if several_models else curve.output_name for curve in curves]
    names = list(dict.fromkeys(colours))
    styles = list(
        dict.fromkeys((curve.output_name if several_models else "", curve.input_name) for curve in curves)
    )
    several_inputs = len({curve.input_name for curve in curves}) > 1
    for curve, name in zip(curves, colours, strict=True):
        colour = COLOURS[names.index(name) % len(COLOURS)]
        of_style = (curve.output_name if several_models else "", curve.input_name)
        style = _LINES[styles.index(of_style) % len(_LINES)]
        label = f"{curve.output_name} over {curve.input_name}" if several_inputs else curve.output_name
        label = f"{curve.label}: {label}" if curve.label else label
        size, spread = np.abs(curve.response), 1.96 * curve.magnitude_sd
        hertz = curve.frequencies_hz
        axes[0].loglog(hertz, size, color=colour, linewidth=1.0, linestyle=style, label=label)
        if np.all(np.isfinite(spread)):
            axes[0].fill_between(
                hertz, np.maximum(size - spread, size * 1e-3), size + spread, color=colour, alpha=0.2
            )
        phase = np.unwrap(np.angle(curve.response)) * 180.0 / np.pi
        axes[1].semilogx(hertz, phase, color=colour, linewidth=1.0, linestyle=style)
    axes[0].set_ylabel("magnitude")
    axes[0].legend(loc="best", fontsize=8, frameon=False, ncols=3)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def pole_figure(
    modes: Mapping[str, Modes], reference_modes: Sequence[tuple[str, float, float]] | None = None
) -> Figure:
    """Draw damping ratio over frequency with 95 % intervals, and reference modes where given.

    Parameters
    ----------
    modes : mapping from a name to what ``modes()`` of a model returns
    reference_modes : sequence of (name, omega [rad/s], zeta), optional
    """
    from matplotlib.ticker import LogFormatter

    figure, (axis,) = stacked_axes(1, 3.2)
    colours = (MODEL, *COLOURS) if len(modes) == 1 else COLOURS
    for number, (label, (omegas, zetas, omega_sd, zeta_sd)) in enumerate(modes.items()):
        axis.errorbar(
            omegas / (2.0 * np.pi),
            100.0 * zetas,
            xerr=1.96 * np.nan_to_num(omega_sd) / (2.0 * np.pi),
            yerr=196.0 * np.nan_to_num(zeta_sd),
            fmt="osd^v*"[number % 6],
            color=colours[number % len(colours)],
            capsize=3,
            markersize=5,
            label=label,
        )
    for number, (name, omega, zeta) in enumerate(reference_modes or ()):
        first = "reference" if number == 0 else None
        axis.plot(omega / (2.0 * np.pi), 100.0 * zeta, "x", color=REFERENCE, markersize=8, label=first)
        axis.annotate(
            name, (omega / (2.0 * np.pi), 100.0 * zeta), textcoords="offset points", xytext=(6, 6), fontsize=8
        )
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(LogFormatter())
    axis.xaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(2.0, 0.4)))
    axis.set_ylim(min(0.0, axis.get_ylim()[0]), 1.15 * axis.get_ylim()[1])
    axis.set_xlabel("natural frequency [Hz]")
    axis.set_ylabel("damping ratio [%]")
    axis.legend(loc="best", fontsize=8, frameon=False)
    return figure


def residual_figure(outputs: Fitted) -> Figure:
    """Draw the residuals over time beside their autocorrelation."""
    figure, axes = axes_grid(
        len(outputs), 2, (9.0, 1.8 * len(outputs) + 0.6), width_ratios=(2, 1), sharex="col"
    )
    for (left, right), output in zip(axes, outputs, strict=True):
        factor, unit = readable(output.residuals, output.unit)
        times, values = drawn(output.times_s, factor * output.residuals)
        left.plot(times, values, ".", color=MODEL, markersize=1.5)
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
