"""Figure of an excitation before it is used: what the axis will do, and where its energy lies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beam_ident.design.summary import excitation_report
from beam_ident.excitation.sampled import HeldInput, SampledExcitation
from beam_ident.figures.canvas import COLOURS, MODEL, REFERENCE, readable, stacked_axes
from beam_ident.modal.model import ModalModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DRAWN_BEYOND = 3.0  # times the upper edge of the band: what lies above it is no longer of interest
_FLOOR = 1e-6  # of the highest amplitude density


def excitation_figure(excitation: SampledExcitation | HeldInput, model: ModalModel | None = None) -> Figure:
    """Draw every quantity over time with its crest factor, and the amplitude density over frequency.

    Parameters
    ----------
    excitation : SampledExcitation or HeldInput
    model : ModalModel, optional
        Its natural frequencies are marked in the spectrum.
    """
    report = excitation_report(excitation)
    if isinstance(excitation, SampledExcitation):
        series = [
            (excitation.accelerations, COLOURS[0]),
            (excitation.velocities, COLOURS[2]),
            (excitation.positions, COLOURS[3]),
        ]
    else:
        series = [(excitation.values, COLOURS[0])]
    figure, axes = stacked_axes(len(series) + 1, 1.5 * len(series) + 2.8, share_x=False)
    for axis, (values, colour), level in zip(axes, series, report.levels, strict=False):
        factor, unit = readable(values, level.unit)
        axis.plot(excitation.period_s * np.arange(len(values)), factor * values, color=colour, linewidth=0.7)
        axis.set_ylabel(f"{level.quantity} [{unit}]")
        axis.set_title(
            f"peak {factor * level.peak:.3g} {unit}, crest factor {level.crest_factor:.2f}",
            fontsize=9,
            loc="left",
        )
    axes[len(series) - 1].set_xlabel("time [s]")
    spectrum, level = axes[-1], report.levels[0]
    amplitude = np.sqrt(report.energy_density)
    low, high = report.band_hz
    shown = (report.frequencies_hz > 0.0) & (report.frequencies_hz <= _DRAWN_BEYOND * high)
    spectrum.loglog(report.frequencies_hz[shown], amplitude[shown], color=COLOURS[0], linewidth=0.7)
    spectrum.set_ylim(bottom=_FLOOR * float(np.max(amplitude)))
    spectrum.axvspan(low, high, color=MODEL, alpha=0.08, linewidth=0.0)
    for omega in () if model is None else model.natural_frequencies:
        spectrum.axvline(omega / (2.0 * np.pi), color=REFERENCE, linewidth=0.8, linestyle="--")
    spectrum.set_title(f"band of 20 dB: {low:.3g} to {high:.3g} Hz", fontsize=9, loc="left")
    spectrum.set_ylabel(f"density [{level.unit} s]")
    spectrum.set_xlabel("frequency [Hz]")
    return figure
