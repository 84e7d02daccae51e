"""Figures of a shaped move: what it leaves where the modes lie elsewhere, and its command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beam_ident.figures.canvas import COLOURS, MEASURED, REFERENCE, axes_grid, plain_decades
from beam_ident.shaping.choice import Choice, JudgedMove
from beam_ident.shaping.residual import insensitivity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 161
_MIN_REACH = 0.01  # of the frequency: what a textbook value or another strip is off by
_SHOWN = 4.0  # half-widths of the identified interval


def insensitivity_figure(choice: Choice) -> Figure:
    """Draw what moves leave over the error of the frequencies, with the identified interval and the aim."""
    figure, axes = axes_grid(2, 1, (9.0, 4.7), height_ratios=(6.0, 1.0))
    axis, below = axes[:, 0]
    beam = choice.beam
    half = 1.96 * float(beam.frequency_sd[0])
    reach = max(_MIN_REACH, _SHOWN * half)
    errors = np.linspace(-reach, reach, _POINTS)
    drawn = _beside(choice)
    for trial, colour in zip(drawn, (COLOURS[1], *COLOURS[:1], *COLOURS[2:]), strict=False):
        axis.semilogy(
            100.0 * errors,
            1e6 * insensitivity(trial.move, beam, errors),
            color=colour,
            linewidth=2.0 if trial is choice.chosen else 1.0,
            label=f"{trial.move.name}, {trial.move.duration_s:.3f} s",
        )
    axis.axvspan(-100.0 * half, 100.0 * half, color=MEASURED, alpha=0.2, linewidth=0.0)
    axis.axhline(1e6 * choice.aim, color=REFERENCE, linestyle="--", linewidth=0.9)
    axis.annotate(
        "aim",
        (-100.0 * reach, 1e6 * choice.aim),
        xytext=(4.0, 2.0),
        textcoords="offset points",
        fontsize=9,
        color=REFERENCE,
    )
    axis.set_xlabel("error of the frequencies [%]")
    axis.set_ylabel("swing that is left [um]")
    axis.set_ylim(bottom=1e3 * choice.aim)
    axis.set_xlim(-100.0 * reach, 100.0 * reach)
    # Curves may be anywhere: their names stand below them.
    below.axis("off")
    below.legend(*axis.get_legend_handles_labels(), frameon=False, fontsize=9, loc="center", ncol=2)
    plain_decades(figure)
    return figure


def _beside(choice: Choice) -> list[JudgedMove]:
    """Return the chosen move and those that tell the most beside it."""
    chosen, wanted = choice.chosen, [choice.chosen]
    shapers = [trial for trial in choice.shapers if trial is not chosen and not trial.objection]
    wanted += shapers[:2]
    wanted += [trial for trial in choice.others if "long" in trial.move.name or "damping" in trial.move.name]
    return wanted


def command_figure(choice: Choice) -> Figure:
    """Draw acceleration, speed and way of the chosen move and of the unshaped one."""
    figure, axes = axes_grid(1, 3, (9.0, 2.8))
    plain = choice.others[0]
    for trial, colour in ((plain, COLOURS[0]), (choice.chosen, COLOURS[1])):
        move = trial.move
        times = move.period_s * np.arange(len(move.velocities))
        rows = (np.append(move.accelerations, 0.0), move.velocities, 1e3 * move.positions)
        for axis, row in zip(axes[0], rows, strict=True):
            axis.step(times, row, where="post", color=colour, linewidth=1.0, label=move.name)
    for axis, label in zip(axes[0], ("acceleration [m/s²]", "speed [m/s]", "way [mm]"), strict=True):
        axis.set_ylabel(label)
        axis.set_xlabel("time [s]")
    axes[0, 2].legend(frameon=False, fontsize=8, loc="lower right")  # where no move has come yet
    return figure
