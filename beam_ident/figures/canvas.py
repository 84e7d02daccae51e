"""What all figures share: palette, axes and units that read well, made without pyplot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED = "#7a8794"
MODEL = "#c2410c"
REFERENCE = "#0f766e"
COLOURS = ("#1d4ed8", "#c2410c", "#0f766e", "#7e22ce", "#a16207", "#be185d")

_MAX_POINTS = 4000


def axes_grid(
    rows: int, columns: int, size: tuple[float, float], **options: Any
) -> tuple[Figure, np.ndarray[Any, np.dtype[Any]]]:
    """Return a new figure of ``size`` [inch] and its axes, shape (rows, columns), in the house's style."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.ravel():
        axis.grid(True, color="#e5e7eb", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    return figure, axes


def stacked_axes(rows: int, height: float, share_x: bool = True) -> tuple[Figure, list[Any]]:
    """Return a new figure of ``height`` [inch] and its axes, one below the other."""
    figure, axes = axes_grid(rows, 1, (9.0, height), sharex=share_x)
    return figure, list(axes[:, 0])


def readable(values: FloatArray, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which values of a length read well."""
    if unit != "m":
        return 1.0, unit
    size = float(np.nanmax(np.abs(values), initial=0.0))
    return (1e3, "mm") if size >= 1e-4 else (1e6, "um")


def thinned(n: int) -> slice:
    """Return the slice that leaves at most some thousand of ``n`` points to draw."""
    return slice(None, None, max(1, n // _MAX_POINTS))
