"""What all figures share: palette, axes and units that read well, made without pyplot."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED = "#7a8794"
MODEL = "#c2410c"
REFERENCE = "#0f766e"
COLOURS = ("#1d4ed8", "#c2410c", "#0f766e", "#7e22ce", "#a16207", "#be185d")

_MAX_POINTS = 4000
_SUPERSCRIPTS = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GAP = 1.5  # times the usual step: samples are missing


def axes_grid(
    rows: int, columns: int, size: tuple[float, float], **options: Any
) -> tuple[Figure, np.ndarray[Any, np.dtype[Any]]]:
    """Return a new figure of ``size`` [inch] and its axes, shape (rows, columns), in the house's style."""
    from matplotlib.figure import Figure

    from beam_ident.figures.margins import Margins

    figure = Figure(figsize=size, layout=Margins())
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
    return (1e3, "mm") if size >= 1e-4 else (1e6, "µm")


def drawn(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return samples as they are drawn: broken where some are missing, and few enough for a page.

    Parameters
    ----------
    times_s : ndarray, shape (n,) -- stamps [s]; where they run back, another record begins behind the last one
    values : ndarray, shape (n,) -- NaN where nothing was seen

    Returns
    -------
    tuple of ndarray
        Stamps and values, NaN in every gap.  Of long records the least and the greatest value of every bin, so that
        no peak is lost and no oscillation looks slower than it is.
    """
    if len(times_s) < 2:
        return times_s, values
    steps = np.diff(times_s)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    later = np.where(steps > 0.0, 0.0, 10.0 * usual - steps)
    times = np.asarray(times_s + np.concatenate([[0.0], np.cumsum(later)]))
    holes = np.flatnonzero(np.diff(times) > _GAP * usual)
    keep = np.union1d(_extremes(values), np.concatenate([holes, holes + 1]))
    places = np.searchsorted(keep, holes) + 1
    middles = 0.5 * (times[holes] + times[holes + 1])
    return np.insert(times[keep], places, middles), np.insert(values[keep], places, np.nan)


def plain_decades(figure: Figure) -> None:
    """Label decades of logarithmic axes in plain text: typeset, they take a fifth of the time of a report."""
    from matplotlib.ticker import LogFormatterSciNotation

    class PlainDecades(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return _untypeset(super().__call__(x, pos))

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatterSciNotation):
                axis.set_major_formatter(PlainDecades())
            if isinstance(axis.get_minor_formatter(), LogFormatterSciNotation):
                axis.set_minor_formatter(PlainDecades(labelOnlyBase=False))


def _untypeset(label: str) -> str:
    """Return matplotlib's typeset power of ten as plain text."""
    plain = label.replace("$\\mathdefault{", "").replace("}$", "").replace("\\times", "×")
    return re.sub(r"\^\{(.*?)\}", lambda exponent: exponent[1].translate(_SUPERSCRIPTS), plain)


def _extremes(values: FloatArray) -> IndexArray:
    """Return where the least and the greatest value of every bin stand; of few values, every place."""
    size = -(-2 * len(values) // _MAX_POINTS)
    if size <= 2:
        return np.arange(len(values))
    bins = np.pad(values, (0, -len(values) % size), constant_values=np.nan).reshape(-1, size)
    first = size * np.arange(len(bins))
    lowest = np.argmin(np.where(np.isnan(bins), np.inf, bins), axis=1)
    highest = np.argmax(np.where(np.isnan(bins), -np.inf, bins), axis=1)
    return np.unique(np.concatenate([first + lowest, first + highest]))
