"""Figures of a beam model: mode shapes, Bode plots, pole map.

Each function returns a Matplotlib ``Figure`` made without pyplot, so that nothing opens a window or keeps state;
Matplotlib is imported on the first call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beam_model.advice.experiment_advice import node_heights
from beam_model.errors import BeamModelError
from beam_model.galerkin.model import BeamModel, Drive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH_IN, _HEIGHT_IN = 8.0, 5.0


def _new_figure(height_in: float = _HEIGHT_IN) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as err:
        raise BeamModelError("figures need Matplotlib: `pip install matplotlib` brings it") from err
    return Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def mode_shape_figure(model: BeamModel, marker_heights: ArrayLike = (), n_modes: int | None = None) -> Figure:
    """Return the clamped mode shapes, drawn as the beam stands, with their nodes and the markers' heights.

    Parameters
    ----------
    model : BeamModel
    marker_heights : array_like
        Drawn as lines [m]: a marker on a node does not see that mode.
    n_modes : int, optional
        How many of the model's modes to draw.
    """
    n = model.n_modes if n_modes is None else min(n_modes, model.n_modes)
    figure = _new_figure()
    z = np.linspace(0.0, model.parameters.length, 300)
    shapes = model.shape(z)
    axes = figure.subplots(1, n, sharey=True, squeeze=False)[0]
    for mode, axis in enumerate(axes):
        scale = np.abs(shapes[:, mode]).max()
        axis.axvline(0.0, color="0.8", linewidth=0.8)
        for height in np.atleast_1d(np.asarray(marker_heights, dtype=np.float64)):
            axis.axhline(1000.0 * height, color="tab:orange", linewidth=0.8, linestyle="--")
        axis.plot(shapes[:, mode] / scale, 1000.0 * z)
        nodes = node_heights(model, mode)
        axis.plot(np.zeros(nodes.size), 1000.0 * nodes, "o", color="black", markersize=4)
        frequency = model.natural_frequencies[mode] / (2.0 * np.pi)
        axis.set_title(f"mode {mode + 1}\n{frequency:.4g} Hz", fontsize="medium")
        axis.set_xlim(-1.15, 1.15)
        axis.set_xticks([-1, 0, 1])
    axes[0].set_ylabel("height above the clamp [mm]")
    figure.supxlabel("amplitude over its largest value; dots: nodes, dashed: markers")
    return figure


def bode_figure(
    model: BeamModel,
    heights: ArrayLike,
    frequencies_hz: ArrayLike | None = None,
    drive: Drive = "motion",
) -> Figure:
    """Return magnitude and phase of the displacement u at ``heights``.

    Parameters
    ----------
    model : BeamModel
    heights : array_like
        Above the clamp [m].
    frequencies_hz : array_like, optional
        By default from a tenth of the first natural frequency to above the last; resonances are refined.
    drive : {"motion", "force"}
        From the hub's position, or from a force on it.
    """
    own = model.natural_frequencies if drive == "motion" else model.free_hub_natural_frequencies
    peaks = own / (2.0 * np.pi)
    if frequencies_hz is None:
        around = np.concatenate([peak * (1.0 + np.linspace(-0.03, 0.03, 121)) for peak in peaks])
        f = np.unique(np.concatenate([np.geomspace(0.1 * peaks[0], 1.3 * peaks[-1], 600), around]))
    else:
        f = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    response = model.frequency_response(2.0 * np.pi * f, heights, drive)
    figure = _new_figure(6.0)
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    for index, height in enumerate(response.heights):
        label = f"u at {1000.0 * height:.0f} mm"
        magnitude.loglog(f, response.magnitude[:, index], label=label)
        phase.semilogx(f, response.phase[:, index] / np.pi, label=label)
    for axis in (magnitude, phase):
        axis.grid(True, which="both", color="0.9", linewidth=0.5)
        for peak in peaks:
            axis.axvline(peak, color="0.6", linewidth=0.6, linestyle=":")
    magnitude.set_ylabel(
        "displacement per hub displacement" if drive == "motion" else "displacement per force [m/N]"
    )
    magnitude.legend(fontsize="small")
    phase.set_ylabel("phase [half turns]")
    phase.set_xlabel("frequency [Hz]; dotted: natural frequencies")
    return figure


def pole_figure(model: BeamModel) -> Figure:
    """Return the poles mode by mode: of the clamped beam, and with the hub free.

    Axes are damping ratio and natural frequency, which the eye can compare; decay rate is 2 pi times their product.
    """
    figure = _new_figure()
    axis = figure.subplots()
    ratios = (model.damping_ratios, model.free_hub_damping_ratios)
    omegas = (model.natural_frequencies, model.free_hub_natural_frequencies)
    labels = ("hub motion prescribed (clamped)", "force on a free hub")
    for zeta, omega, mark, label in zip(ratios, omegas, "x+", labels, strict=True):
        axis.plot(100.0 * zeta, omega / (2.0 * np.pi), mark, label=label)
    axis.set_yscale("log")
    widest = max(float(np.max(zeta)) for zeta in ratios)
    axis.set_xlim(0.0, 115.0 * widest if widest > 0.0 else 1.0)
    axis.set_xlabel("damping ratio [%]")
    axis.set_ylabel("natural frequency [Hz]")
    axis.grid(True, which="both", color="0.9", linewidth=0.5)
    axis.legend(fontsize="small")
    return figure
