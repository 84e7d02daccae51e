"""What stands beside axes lies within the figure, and over no other axes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident.figures.canvas import axes_grid, plain_decades

WORDS = ("", "z285 [mm]", "two lines\n[rad/s]")


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_cut_off_and_nothing_lies_over_other_axes(seed):
    draw = np.random.default_rng(seed)
    rows, columns = draw.integers(1, 4, 2)
    share = bool(draw.integers(2))
    size = (2.6 * columns + 1.0, 1.9 * rows + 0.8)
    figure, grid = axes_grid(rows, columns, size, sharex=share)
    for axes in grid.ravel():
        reach = 10.0 ** draw.uniform(-7, 7)
        axes.plot(
            np.linspace(0.0, 10.0 ** draw.uniform(-2, 3), 50), reach * draw.uniform(-1, 1, 50) ** 2 + 1e-9
        )
        axes.set_ylabel(draw.choice(WORDS))
        if draw.integers(2):
            axes.set_yscale("log")
        axes.set_title(draw.choice(["", "FIT 99.63 %"]), fontsize=9, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel(draw.choice(WORDS))
    plain_decades(figure)
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    width, height = figure.bbox.size
    for box in boxes:
        assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -1.0
    for (k, box), (other, axes) in itertools.product(enumerate(boxes), enumerate(figure.axes)):
        assert k == other or not box.overlaps(axes.get_window_extent())
    shares = [axes.get_position().width * axes.get_position().height for axes in figure.axes]
    # The room goes to the axes: at least a third of the figure is left for what is drawn.
    assert sum(shares) > 1 / 3
