"""Figures of modes beside theory, and over the amplitudes of several records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.figures.canvas import COLOURS, MODEL, REFERENCE, axes_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def mode_shape_figure(
    titles: Sequence[str],
    heights: FloatArray,
    shapes: FloatArray,
    places: FloatArray,
    place_sd: FloatArray,
    residues: FloatArray,
    residue_sd: FloatArray,
) -> Figure:
    """Draw theoretical mode shapes as the beam stands, and over them what every output shows.

    Parameters
    ----------
    titles : sequence of str -- of every mode
    heights : ndarray, shape (n_heights,) -- above the clamp [m]
    shapes : ndarray, shape (n_heights, n_modes) -- residues along the beam, of theory
    places, place_sd : ndarray, shape (n_outputs,) -- heights of the outputs, with standard uncertainties [m]
    residues, residue_sd : ndarray, shape (n_outputs, n_modes) -- identified
    """
    n = len(titles)
    figure, axes = axes_grid(1, n, (max(3.0, min(9.0, 2.4 * n)), 4.2), sharey=True)
    for k, axis in enumerate(axes[0]):
        axis.axvline(0.0, color="#9aa3ad", linewidth=0.6)
        axis.plot(shapes[:, k], 1e3 * heights, color=REFERENCE, linewidth=1.2, label="theory")
        axis.errorbar(
            residues[:, k],
            1e3 * places,
            xerr=1.96 * np.nan_to_num(residue_sd[:, k]),
            yerr=1.96e3 * place_sd,
            fmt="o",
            color=MODEL,
            capsize=2,
            markersize=4,
            label="identified, 95 %",
        )
        axis.set_title(titles[k], fontsize=9)
        axis.set_xlabel("residue")
    axes[0, 0].set_ylabel("height above the clamp [mm]")
    axes[0, -1].legend(loc="best", fontsize=7, frameon=False)
    return figure


def trend_figure(modes: Mapping[str, Sequence[FloatArray]], labels: Sequence[str], axis_label: str) -> Figure:
    """Draw how frequency and damping of every mode change from record to record.

    Parameters
    ----------
    modes : mapping from a mode's name to (abscissas, frequencies [Hz], their sd, damping ratios, their sd)
        Each an ndarray, shape (n_records,); NaN where a record lacks the mode.
    labels : sequence of str -- of the records
    axis_label : str -- of the abscissas
    """
    figure, axes = axes_grid(len(modes), 2, (9.0, 1.9 * len(modes) + 0.7), sharex=True)
    for row, (name, (x, hertz, hertz_sd, zeta, zeta_sd)) in enumerate(modes.items()):
        colour = COLOURS[row % len(COLOURS)]
        for axis, values, sds in ((axes[row, 0], hertz, hertz_sd), (axes[row, 1], 100 * zeta, 100 * zeta_sd)):
            axis.errorbar(
                x, values, yerr=1.96 * np.nan_to_num(sds), fmt="o", color=colour, capsize=3, markersize=4
            )
            axis.ticklabel_format(useOffset=False)
        axes[row, 0].set_ylabel(f"{name}\nfrequency [Hz]")
        axes[row, 1].set_ylabel("damping [%]")
        for label, at, value in zip(labels, x, hertz, strict=True):
            if np.isfinite(value):
                axes[row, 0].annotate(
                    label, (at, value), textcoords="offset points", xytext=(5, 4), fontsize=7
                )
    for axis in axes[-1]:
        axis.set_xlabel(axis_label)
    return figure
