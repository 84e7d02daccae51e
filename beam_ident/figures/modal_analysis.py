"""Figures of an experimental modal analysis, drawn from its result objects, without pyplot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError
from beam_ident.figures.canvas import COLOURS, MEASURED, MODEL, stacked_axes
from beam_ident.modal_analysis.circle_fit import CircleFit
from beam_ident.modal_analysis.refinement import ModalAnalysis
from beam_ident.modal_analysis.stabilisation import DAMPING, FREQUENCY, NEW, STABLE, StabilisationChart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS: tuple[tuple[int, str, str, str], ...] = (
    (NEW, ".", "#c4cbd3", "new"),
    (FREQUENCY, "v", COLOURS[4], "frequency"),
    (DAMPING, "d", COLOURS[0], "and damping"),
    (STABLE, "s", COLOURS[2], "and shape"),
)


def stabilisation_figure(chart: StabilisationChart, analysis: ModalAnalysis | None = None) -> Figure:
    """Draw poles over orders with the complex mode indicator behind them.

    Lines mark the modes: those of the refinement where one is given, else the chart's own choice.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    axis = figure.subplots()
    behind = axis.twinx()
    for curve in chart.indicator.T:
        behind.semilogy(chart.record.frequencies_hz, np.maximum(curve, 1e-300), color=MEASURED, linewidth=0.8)
    behind.set_ylabel("mode indicator (singular values)", color=MEASURED)
    for stability, marker, colour, label in _MARKS:
        chosen = [pole for pole in chart.poles if pole.stability == stability]
        axis.plot(
            [pole.natural_frequency / (2.0 * np.pi) for pole in chosen],
            [pole.order for pole in chosen],
            marker,
            color=colour,
            markersize=3.5,
            linestyle="",
            label=label,
        )
    modes = chart.frequencies_hz if analysis is None else analysis.frequencies_hz
    for hertz in modes:
        axis.axvline(float(hertz), color=MODEL, linewidth=0.8, linestyle="--")
    # The poles stay in front of the indicator.
    axis.set_zorder(behind.get_zorder() + 1)
    axis.patch.set_visible(False)
    axis.set_xlim(float(chart.record.frequencies_hz[0]), float(chart.record.frequencies_hz[-1]))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("order")
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(loc="upper right", fontsize=8, title="stable in", title_fontsize=8)
    return figure


def assurance_figure(
    assurance: ArrayLike, rows: Sequence[str] | None = None, columns: Sequence[str] | None = None
) -> Figure:
    """Draw a matrix of modal assurance, its numbers in the cells.

    Parameters
    ----------
    assurance : ndarray, shape (n_rows, n_columns) -- from 0 to 1
    rows, columns : sequence of str or None -- names of the modes; None numbers them
    """
    from matplotlib.figure import Figure

    values: FloatArray = np.asarray(assurance, dtype=np.float64)
    if values.ndim != 2 or not values.size:
        raise EstimationError(
            f"the assurance has shape {values.shape}; expected a matrix of modes over modes"
        )
    figure = Figure(figsize=(1.6 + 0.6 * values.shape[1], 1.2 + 0.6 * values.shape[0]), layout="constrained")
    axis = figure.subplots()
    image = axis.imshow(values, vmin=0.0, vmax=1.0, cmap="Blues")
    for (row, column), value in np.ndenumerate(values):
        colour = "white" if value > 0.6 else "black"
        axis.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=8, color=colour)
    for names, count, put in (
        (columns, values.shape[1], axis.set_xticks),
        (rows, values.shape[0], axis.set_yticks),
    ):
        put(
            range(count), list(names) if names is not None else [str(k + 1) for k in range(count)], fontsize=8
        )
    figure.colorbar(image, ax=axis, label="modal assurance")
    return figure


def synthesis_figure(analysis: ModalAnalysis, pairs: Sequence[tuple[str, str]] | None = None) -> Figure:
    """Draw measured responses as points under the modal model's curves, magnitude above phase.

    Parameters
    ----------
    analysis : ModalAnalysis
    pairs : sequence of (output name, input name) or None -- None takes the first six
    """
    record = analysis.record
    every = [(o, i) for o in record.output_names for i in record.input_names]
    chosen = every[: len(COLOURS)] if pairs is None else list(pairs)
    for pair in chosen:
        if pair not in every:
            raise EstimationError(f"the analysis has no response of {pair[0]!r} to {pair[1]!r}")
    figure, axes = stacked_axes(2, 5.2)
    hertz = record.frequencies_hz
    for number, (output, drive) in enumerate(chosen):
        j, i = list(record.output_names).index(output), list(record.input_names).index(drive)
        colour = COLOURS[number % len(COLOURS)]
        for values, style in ((record.response[:, j, i], "."), (analysis.modelled[:, j, i], "-")):
            keywords: dict[str, Any] = {"color": colour, "markersize": 2.0, "linewidth": 1.0}
            keywords |= {"alpha": 0.4} if style == "." else {"label": f"{output} over {drive}"}
            axes[0].semilogy(hertz, np.abs(values), style, **keywords)
            keywords.pop("label", None)
            axes[1].plot(hertz, np.degrees(np.angle(values)), style, **keywords)
    for hertz_of_mode in analysis.frequencies_hz:
        for axis in axes:
            axis.axvline(float(hertz_of_mode), color="#9aa3ad", linewidth=0.6, linestyle=":")
    axes[0].set_ylabel(f"magnitude ({analysis.form})")
    axes[0].set_title("points: measured; lines: modal model", fontsize=9, loc="left")
    axes[0].legend(loc="best", fontsize=8, frameon=False, ncols=2)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def circle_figure(fit: CircleFit) -> Figure:
    """Draw the points of a resonance in the Nyquist plane with the circle through them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 4.6), layout="constrained")
    axis = figure.subplots()
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    circle = fit.centre + fit.radius * turn
    axis.plot(circle.real, circle.imag, color=MODEL, linewidth=1.0, label="circle")
    axis.plot(fit.points.real, fit.points.imag, ".", color=MEASURED, markersize=4.0, label="measured")
    axis.set_aspect("equal")
    axis.set_xlabel("real part of the mobility")
    axis.set_ylabel("imaginary part")
    axis.set_title(
        f"{fit.natural_frequency / (2.0 * np.pi):.5g} Hz, {100.0 * fit.damping_ratio:.3g} %",
        fontsize=9,
        loc="left",
    )
    axis.legend(loc="best", fontsize=8, frameon=False)
    return figure
