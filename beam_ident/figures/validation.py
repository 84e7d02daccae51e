"""Figure of a validation: prediction, residual and what the residual still holds of the input."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beam_ident.evaluation.hold_out import ValidationResult
from beam_ident.figures.canvas import MEASURED, MODEL, REFERENCE, axes_grid, drawn, readable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def validation_figure(result: ValidationResult) -> Figure:
    """Draw every output's measurement under its prediction, and the residual's tests beside it."""
    outputs = result.outputs
    figure, axes = axes_grid(
        len(outputs), 2, (9.0, 2.2 * len(outputs) + 0.6), width_ratios=(2, 1), sharex="col"
    )
    for (left, right), output in zip(axes, outputs, strict=True):
        factor, unit = readable(output.measured, output.unit)
        for values, colour, width, label in (
            (output.measured, MEASURED, 1.4, "measured"),
            (output.simulated_from_rest, REFERENCE, 0.6, "simulated from rest"),
            (output.simulated, MODEL, 0.6, "with its own initial motion"),
        ):
            times, shown = drawn(output.times_s, factor * values)
            left.plot(times, shown, color=colour, linewidth=width, label=label)
        left.set_ylabel(f"{output.name} [{unit}]")
        left.set_title(
            f"FIT {output.scores.fit_percent:.2f} %, of the deflection "
            f"{output.deflection_scores.fit_percent:.2f} %; residuals {output.noise_ratio:.2f} times the noise",
            fontsize=9,
            loc="left",
        )
        correlation = output.input_correlation
        right.bar(correlation.lags, correlation.correlation, color=MEASURED, width=0.7)
        for bound in (-correlation.band, correlation.band):
            right.axhline(bound, color=MODEL, linewidth=0.8, linestyle="--")
    axes[0][0].legend(loc="upper right", fontsize=8, frameon=False, ncols=3)
    axes[0][1].set_title("residual with input, 99 % band", fontsize=9, loc="left")
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("lag [samples]")
    return figure
