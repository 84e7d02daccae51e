"""Figures of frequency and damping over amplitude."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beam_ident.arrays import FloatArray
from beam_ident.figures.canvas import MODEL, REFERENCE, axes_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from beam_ident.amplitude.curves import AmplitudeCurves


def amplitude_figure(
    curves: AmplitudeCurves,
    pole: tuple[float, float] | None = None,
    theory: tuple[FloatArray, FloatArray] | None = None,
) -> Figure:
    """Draw the curves with their simultaneous bands, and beside them the single pole and what theory says.

    Parameters
    ----------
    curves : AmplitudeCurves
    pole : (frequency [Hz], damping ratio), optional -- that was fitted
    theory : (frequencies [Hz], damping ratios), optional -- two arrays, each of shape (n,), at ``curves.amplitudes``
    """
    figure, axes = axes_grid(1, 2, (9.0, 3.4), sharex=True)
    x = 1e3 * curves.amplitudes if curves.unit == "m" else curves.amplitudes
    unit = "mm" if curves.unit == "m" else curves.unit
    rows: tuple[tuple[FloatArray, FloatArray, str, float], ...] = (
        (curves.frequencies_hz, curves.frequency_band_hz, "frequency [Hz]", 1.0),
        (curves.damping_ratios, curves.damping_band, "damping ratio [%]", 100.0),
    )
    for k, (axis, (values, band, label, scale)) in enumerate(zip(axes[0], rows, strict=True)):
        axis.fill_between(
            x, scale * band[0], scale * band[1], color=MODEL, alpha=0.25, label="95 %, the whole curve"
        )
        axis.plot(x, scale * values, color=MODEL, label="curve")
        if pole is not None:
            axis.axhline(scale * pole[k], color=REFERENCE, linestyle="--", label="one pole")
        if theory is not None:
            axis.plot(x, scale * theory[k], color=REFERENCE, linestyle=":", label="theory")
        axis.set_ylabel(label)
        axis.set_xlabel(f"amplitude of {curves.output_name} [{unit}]")
        axis.ticklabel_format(axis="y", useOffset=False)
    axes[0, 0].legend(fontsize=7, frameon=False)
    return figure
