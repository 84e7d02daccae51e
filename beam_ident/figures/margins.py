"""Room for what stands beside axes, from the number of its lines and characters.

Matplotlib's own layouts measure every text twice before anything is drawn, which took half the time of a report.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.layout_engine import LayoutEngine

from beam_ident.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text

_WIDTH = 0.64
"""Width of a character in font sizes: a digit of the usual fonts; words need less."""

_HEIGHT = 1.25
"""Height of a line in font sizes."""

_AIR_PT = 4.0
"""Between texts, and at the edge of the figure."""


class Margins(LayoutEngine):
    """Places a grid of axes so that labels, titles and tick labels have room."""

    _adjust_compatible = True
    _colorbar_gridspec = True

    def execute(self, fig: Figure) -> None:
        """Place the axes of a grid; axes that lie over others are placed with them."""
        placed = [(axes, spec) for axes in fig.axes if (spec := axes.get_subplotspec()) is not None]
        if not placed:
            return
        rows, columns = placed[0][1].get_gridspec().get_geometry()
        # left, right, bottom, top of each axes [pt]
        beside = np.zeros((4, rows, columns))
        for axes, spec in placed:
            place = (slice(None), spec.rowspan.start, spec.colspan.start)
            beside[place] = np.maximum(beside[place], _beside(axes))
        width, height = 72.0 * fig.get_size_inches()
        left, right, between_columns = _edges(beside[0].max(axis=0), beside[1].max(axis=0))
        bottom, top, between_rows = _edges(beside[2].max(axis=1)[::-1], beside[3].max(axis=1)[::-1])
        fig.subplots_adjust(
            left=left / width,
            right=1.0 - right / width,
            bottom=bottom / height,
            top=1.0 - top / height,
            wspace=_share(between_columns, width - left - right, columns),
            hspace=_share(between_rows, height - bottom - top, rows),
        )


def _edges(before: FloatArray, after: FloatArray) -> tuple[float, float, float]:
    """Return the room before the first of some axes in a line, behind the last, and between any two [pt]."""
    between = before[1:] + after[:-1]
    return before[0] + _AIR_PT, after[-1] + _AIR_PT, float(between.max(initial=0.0)) + _AIR_PT


def _share(between_pt: float, all_pt: float, number: int) -> float:
    """Return the room between axes as a share of the mean size of the axes, which is how Matplotlib takes it."""
    return between_pt / max((all_pt - (number - 1) * between_pt) / number, 1.0)


def _beside(axes: Axes) -> tuple[float, float, float, float]:
    """Return the room that an axes needs on its left, right, lower and upper side [pt]."""
    upright, level = _tick_texts(axes.yaxis), _tick_texts(axes.xaxis)
    sides = {"left": 0.0, "right": 0.0, "bottom": 0.0, "top": 0.0}
    sides["right" if axes.yaxis.get_ticks_position() == "right" else "left"] += max(
        map(_wide, upright), default=0.0
    )
    sides[axes.yaxis.get_label_position()] += _high(axes.yaxis.label)
    sides["bottom"] += max(map(_high, level), default=0.0) + _high(axes.xaxis.label)
    sides["top"] += max(
        _lines_high(axes.get_title(loc=side), axes.title) for side in ("left", "center", "right")
    )
    if upright:  # a power of ten above the axis
        sides["top"] += _lines_high(
            axes.yaxis.get_major_formatter().get_offset(), axes.yaxis.get_offset_text()
        )
    # A tick label at an end of its axis reaches beyond it by half.
    for name, texts, extent in (("right", level, _wide), ("left", level, _wide), ("top", upright, _high)):
        sides[name] = max(sides[name], 0.5 * max(map(extent, texts), default=0.0))
    return sides["left"], sides["right"], sides["bottom"], sides["top"]


def _tick_texts(axis: Axis) -> list[Text]:
    shown: dict[str, Any] = axis.get_tick_params()
    if not (
        axis.get_visible() and any(shown.get(f"label{side}") for side in ("left", "right", "bottom", "top"))
    ):
        return []
    return [text for text in axis.get_ticklabels() if text.get_text()]


def _wide(text: Text) -> float:
    words = text.get_text()
    return (
        _WIDTH * float(text.get_fontsize()) * max(map(len, words.split("\n"))) + 2.0 * _AIR_PT
        if words
        else 0.0
    )


def _high(text: Text) -> float:
    return _lines_high(text.get_text(), text)


def _lines_high(words: str, like: Text) -> float:
    return _HEIGHT * float(like.get_fontsize()) * (1 + words.count("\n")) + _AIR_PT if words else 0.0
